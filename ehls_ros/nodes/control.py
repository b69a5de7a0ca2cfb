"""Base of the control-path nodes: lifecycle, spec, the loop in the main thread, diagnostics, shutdown."""

import contextlib
import faulthandler
import gc
import math
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Annotated, Any, NamedTuple, NoReturn

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import chosen_spec
from ehls_ros.hardware.courtesy import Courtesy, statistics_of
from ehls_ros.hardware.realtime import be_frugal, claim, exact_wake_ups, keep_to, processors_of
from ehls_ros.nodes.failures import Failures
from ehls_ros.nodes.links import Links
from ehls_ros.nodes.mismatches import Mismatches
from ehls_ros.nodes.owners import DISCOVERY_RANGE, LOCALHOST, Owners
from ehls_ros.nodes.parameters import DeclaredParameters, declare
from ehls_ros.nodes.transport import Notice, Waiter, kept_at
from ehls_ros.process import Stopping, end
from ehls_ros.recording.topics import CLOCK, LEAVING
from ehls_ros.schema import quantity, text

NAMESPACE = "ehls"
"""Default namespace of the nodes; a launch file or `-r __ns:=` may set another."""

CLOCK_TOPIC = CLOCK.name
"""Topic of the time, in lockstep and with use_sim_time; the name that rclpy uses, which `-r` remaps."""

USE_SIM_TIME = "use_sim_time"
"""Parameter of every ROS node: take the time from the clock topic."""

LOCKSTEP, REALTIME = TIMINGS = ("lockstep", "realtime")
"""Timing modes."""

PARENT = "EHLS_PARENT"
"""Environment variable with the id of the process that started a node; the node ends with it. Unset: the node has no parent."""

CLOSING = 30.0
"""Longest time the middleware may take to close the node's topics and services [s]."""

WAIT = 0.1
"""Longest time a loop waits before it checks whether to stop [s]."""

FAREWELL = 0.2
"""Longest wait for the readers to receive the announcement that a node's loop has ended [s]."""

PATIENCE = 1.0
"""Longest quiet wait [s]. After it, diagnostics report the missing input, and in lockstep messages are repeated to readers
that may have missed them."""

REPEAT = 10.0
"""Time after which a warning that differs from an earlier one only in its figures is logged again [s]."""

BEAT = 0.05
"""Period of the service thread's heartbeat [s]."""

LONGEST_TURN = 0.1
"""Largest contribution of one turn of the loop to the time without a heartbeat [s]: a suspended process was not unreachable."""

SWITCH_INTERVAL = 1e-4
"""Time after which a thread yields the interpreter to a waiting one [s]."""

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Common(NamedTuple):
    """Parameters every node has."""

    spec: Annotated[str, text("experiment file; empty: the 10 kN sine that comes with the package")] = ""
    rig: Annotated[str, text("rig file used in place of the spec's; empty: the spec's")] = ""
    timing: Annotated[str, text("realtime: wall clock; lockstep: each cycle waits for its answer, deterministic")] = "realtime"
    priority: Annotated[
        int,
        quantity("1", "SCHED_FIFO priority in realtime, with memory locked; 0: neither", minimum=0, maximum=99),
    ] = 0
    processor_share: Annotated[
        float,
        quantity("1", "share of a processor above which the loop gives up its priority; 1: never", minimum=0.05, maximum=1.0),
    ] = 0.9
    processors: Annotated[str, text("processors that the node's process keeps to, such as 1 or 0,2-3; empty: any")] = ""
    autostart: Annotated[bool, text("configure and activate at start; false: wait for lifecycle requests")] = True


def transition(
    callback: Callable[[Any, LifecycleState], TransitionCallbackReturn],
) -> Callable[[Any, LifecycleState], TransitionCallbackReturn]:
    """End the process when a lifecycle callback raises; rclpy drops the exception.

    Args:
        callback: method of a :class:`ControlNode`.
    """

    @wraps(callback)
    def reported(node: "ControlNode", state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return callback(node, state)
        except Exception as error:  # noqa: BLE001
            node.report_failure(error, callback.__name__.removeprefix("on_"))
            return TransitionCallbackReturn.ERROR

    return reported


class ControlNode(DeclaredParameters):
    """A lifecycle node whose loop runs in the main thread while it is active.

    Subclasses implement :meth:`prepare`, :meth:`start`, :meth:`once`, :meth:`stop`, :meth:`release` and
    :meth:`health`.
    """

    longest_wait = WAIT
    """Longest time one turn of the loop waits [s]."""

    answers = True
    """Whether another node waits for this loop's output within the cycle; otherwise the loop runs at a lower priority."""

    background = False
    """Whether the node takes no real-time priority, whatever the parameter says: it has no deadline."""

    announces = True
    """Whether the node announces the end of its loop: its messages are inputs of the control cycle."""

    def __init__(self, name: str) -> None:
        """Declare the common parameters and read the spec.

        Raises:
            BadInput: the spec or rig file is wrong.
        """
        super().__init__(name, namespace=NAMESPACE)
        # The process number distinguishes two nodes of the same name.
        self.sender = f"{self.get_fully_qualified_name()}-{os.getpid()}"
        self._note_clock([self.get_parameter(USE_SIM_TIME)])
        self.add_post_set_parameters_callback(self._note_clock)
        declare(self, Common, live=False)
        self.spec = chosen_spec(self.text_parameter("spec"), self.text_parameter("rig"))
        self.cycles_kept = kept_at(self.spec.settings.control_period)
        timing = self.text_parameter("timing")
        if timing not in TIMINGS:
            raise BadInput(f"timing is '{timing}'", self.get_name(), f"one of {', '.join(TIMINGS)}")
        self.lockstep = timing == LOCKSTEP
        if self.lockstep:
            # The plant's cycles are the only clock of such a graph.
            self.set_parameters([Parameter(USE_SIM_TIME, value=True)])
        self._processors = processors_of(self.text_parameter("processors"), self.get_name())
        self._parent = int(os.environ.get(PARENT, "0"))
        self.links: Links | None = None
        self.failures = Failures(Stopping())
        self.hosted = False
        self.is_running = False
        self.configured = False
        self.not_permitted: tuple[str, ...] = ()
        self.courtesy: Courtesy | None = None
        self._active = threading.Event()
        self._idle = threading.Event()
        self._idle.set()
        # rclpy's state machine admits one thread at a time; the main thread brings the node up, the other serves requests.
        self.changing = threading.RLock()
        self._begun = False
        # Guards the two events above: a thread must not see one before a change and the other after it.
        self._switching = threading.Lock()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._reported: tuple[bytes, str] | None = None
        self._warned: dict[str, float] = {}
        self._beaten = False
        self._mismatches = Mismatches(self)
        # Steady time: ROS time may stop.
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.owners = Owners(self)
        self.refused = ""
        self.create_timer(1.0, self._look_around, clock=self.steady)
        self._beating = self.create_timer(BEAT, self._beat, clock=self.steady)

    def be_hosted(self) -> None:
        """Let another node in the same process run this node's loop; that node handles the heartbeat and the courtesy."""
        self.hosted = True
        self._beating.cancel()

    def now_ns(self) -> int | None:
        """Return the time of the node's clock [ns]: the system's or, with use_sim_time, /clock's; None before the first."""
        return self.get_clock().now().nanoseconds or None if self._is_told_time else time.time_ns()

    def _note_clock(self, parameters: Sequence[Parameter]) -> None:
        """Note which clock the node uses: querying the clock itself takes longer than a control law in each cycle."""
        for parameter in parameters:
            if parameter.name == USE_SIM_TIME:
                self._is_told_time = bool(parameter.value)

    def text_parameter(self, name: str) -> str:
        """Return a text parameter's value."""
        return str(self.get_parameter(name).value)

    def prepare(self) -> None:
        """Build the resources of the loop: compile code, open topics."""
        raise NotImplementedError

    def start(self) -> None:
        """Run before the first turn of the loop."""

    def awaited_inputs(self) -> Waiter:
        """Return the inputs that the loop awaits at present; used by the default :meth:`once`."""
        raise NotImplementedError

    def react(self) -> bool:
        """Process the messages that have arrived, without waiting for more.

        Returns:
            Whether there was anything to do.
        """
        raise NotImplementedError

    def once(self) -> None:
        """Run one turn of the loop, waiting no longer than :data:`WAIT`."""
        self.awaited_inputs().wait(self.longest_wait)
        if not self.react():
            self.have_nothing_to_do()

    def have_nothing_to_do(self) -> None:
        """Run after a turn in which there was nothing to do."""

    def stop(self) -> None:
        """Run after the last turn of the loop."""

    def release(self) -> None:
        """Undo :meth:`prepare`."""

    def secure(self) -> None:
        """Bring the rig into its safe state; called at the end of the process, even after a failure."""

    def make_safe(self) -> None:
        """Secure the rig once no loop runs any more, and release a request that waits for the end of the loop."""
        self._idle.set()
        self.secure()

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Return level, message and values for diagnostics; called once the node is configured."""
        return OK, "running" if self._active.is_set() else "inactive", {}

    def report_failure(self, error: Exception, activity: str) -> None:
        """Log an unforeseen exception and end the process; the valve is closed as on a regular stop.

        Args:
            error: the exception.
            activity: during which it was raised.
        """
        self.failures.note(error, self, activity)

    def be_refused(self, topic: str, owner: str) -> None:
        """Deactivate the node: another sender owns an input that this node sends.

        Args:
            topic: of the input.
            owner: the sender whose messages are accepted.
        """
        self.refused = f"{topic} of this node is refused: {owner} owns it; deactivate or stop that node, then activate this one"
        if self._active.is_set():
            self.trigger_deactivate()
        self.report_change()

    @transition
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Prepare; a wrong configuration leaves the node unconfigured, with the reason in the log."""
        self._leaving = Notice(self, String, LEAVING.name, 1)
        try:
            self.prepare()
        except (BadInput, OSError) as error:
            self.get_logger().error(str(error))
            self._release_after_failure()
            return TransitionCallbackReturn.FAILURE
        except Exception:
            self._release_after_failure()
            raise
        # The middleware's receiver threads hold locks that senders need too. Even if the loop itself runs at a lower
        # priority, its receivers must not be preempted while they hold one.
        loops = (
            ()
            if self.answers or self.links is not None
            else [thread.native_id for thread in threading.enumerate() if thread.native_id]
        )
        priority = 0 if self.lockstep or self.background else int(self.get_parameter("priority").value)
        self.not_permitted = claim(priority, loops)
        if self._processors and not self.hosted:
            keep_to(self._processors)
        if priority and not self.hosted:
            # The loop runs in the main thread, whose id is that of the process.
            self.courtesy = Courtesy(float(self.get_parameter("processor_share").value), statistics_of(os.getpid()))
        self.configured = True
        return TransitionCallbackReturn.SUCCESS

    @transition
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release the loop to run."""
        self.refused = ""
        with self._switching:
            if self._begun:
                self._idle.clear()
            self._active.set()
        return super().on_activate(state)

    @transition
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the loop to end its turn."""
        self._active.clear()
        self._idle.wait()
        return super().on_deactivate(state)

    @transition
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the loop as deactivation does, and release everything."""
        return self._end_and_release(super().on_shutdown, state)

    @transition
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to unconfigured: a half-finished transition is not resumed."""
        return self._end_and_release(super().on_error, state)

    def _end_and_release(
        self, proceed: Callable[[LifecycleState], TransitionCallbackReturn], state: LifecycleState
    ) -> TransitionCallbackReturn:
        self._active.clear()
        self._idle.wait()
        self.give_back()
        return proceed(state)

    @transition
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything."""
        self.give_back()
        return TransitionCallbackReturn.SUCCESS

    def give_back(self) -> None:
        """Release the prepared resources, if any."""
        if self.configured:
            self.configured = False
            self.release()
            self._leaving.destroy()
            if self.courtesy is not None:
                self.courtesy.close()
                self.courtesy = None

    def _release_after_failure(self) -> None:
        """Release the resources prepared before an exception."""
        # Attributes assigned after the failed step of `prepare` do not exist.
        with contextlib.suppress(AttributeError):
            self.release()
        self._leaving.destroy()

    def bring_up(self, stopping: Stopping) -> bool:
        """Configure and activate; return whether both succeeded. Otherwise the log has the reason.

        Args:
            stopping: is set when the node is told to stop meanwhile.
        """
        return self.configure_itself() and self.activate_itself()

    def configure_itself(self) -> bool:
        """Configure, unless a lifecycle request has done so; return whether the node is configured."""
        return self._change_from(State.PRIMARY_STATE_UNCONFIGURED, self.trigger_configure)

    def activate_itself(self) -> bool:
        """Activate, unless a lifecycle request has changed the state; return whether the node is as requested."""
        return self._change_from(State.PRIMARY_STATE_INACTIVE, self.trigger_activate)

    def _change_from(self, state: int, trigger: Callable[[], TransitionCallbackReturn]) -> bool:
        with self.changing:
            return bool(self._state_machine.current_state[0] != state or trigger() == TransitionCallbackReturn.SUCCESS)

    def begin_work(self) -> None:
        """Note that a loop serves the node from now on: until then no request has to wait for the loop's end."""
        with self._switching:
            self._begun = True
            if self._active.is_set():
                self._idle.clear()

    def work(self, stopping: Stopping) -> None:
        """Run the loop whenever the node is active, until told to stop."""
        be_punctual()
        self.begin_work()
        while not stopping.is_set():
            if not self._active.wait(WAIT):
                # A request to deactivate may wait for the end of a loop that never ran because the node was active too briefly.
                self.settle()
                continue
            # A garbage collection within a cycle would delay the answer; the loops create no reference cycles.
            gc.disable()
            try:
                self.enter()
                while self.is_to_run and not stopping.is_set():
                    self.once()
                    self.look_after()
            except Exception as error:  # noqa: BLE001
                self.report_failure(error, "loop")
            finally:
                gc.enable()
                self.leave()

    @property
    def is_to_run(self) -> bool:
        """Whether the loop is to run, i.e. the node is active."""
        return self._active.is_set()

    def enter(self) -> None:
        """Begin the loop."""
        self._idle.clear()
        self._silence, self._turned = 0.0, time.monotonic()
        self.is_running = True
        self.start()

    def leave(self) -> None:
        """End the loop, and announce the end to the readers of this node's messages."""
        self.is_running = False
        try:
            self.stop()
            if self.announces:
                self._leaving.publish(String(data=self.sender), self.sender)
                if not self.hosted:
                    # A process that goes on sends the announcement anyway and must not wait.
                    self._leaving.publisher.wait_for_all_acked(Duration(seconds=FAREWELL))
        except Exception as error:  # noqa: BLE001
            self.report_failure(error, "end of the loop")
        finally:
            if self.links is not None:
                # Once the node is idle, a request may destroy its publishers.
                self.links.publish()
            self._idle.set()

    def settle(self) -> None:
        """Mark the loop as ended if the node was active too briefly for it to run."""
        with self._switching:
            if not self._active.is_set():
                self._idle.set()

    def look_after(self) -> None:
        """Check the service thread's heartbeat (it handles the emergency stop) and the loop's CPU demand after a turn."""
        now = time.monotonic()
        self._silence = 0.0 if self._beaten else self._silence + min(now - self._turned, LONGEST_TURN)
        self._beaten, self._turned = False, now
        self.unheard(self._silence)
        if self.courtesy is not None and self.courtesy.look(now):
            self.report_change()

    def _beat(self) -> None:
        self._beaten = True

    def _look_around(self) -> None:
        if self._parent and os.getppid() != self._parent:
            self.get_logger().error("the process that started this node has ended, so the node ends")
            signal.raise_signal(signal.SIGINT)
        self._await_rest()
        self._mismatches.look()
        self.owners.look()
        if self.links is not None and not self.hosted:
            self._await_rest()
            self.links.look_outside()
        self._await_rest()
        health = self._health()
        self._await_rest()
        self._publish_health(*health)

    def _await_rest(self) -> None:
        """Wait briefly for a time at which no loop in this process has an answer to compute."""
        if self.links is not None:
            self.links.await_rest()

    def unheard(self, silence: float) -> None:
        """React to a silent service thread; called after each turn with the time since its last heartbeat [s]."""

    def finish(self) -> None:
        """End the loop from within, on completion of its task."""
        self._active.clear()

    def _health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        if self.refused:
            return ERROR, self.refused, {}
        if not self.configured:
            return OK, "unconfigured", {}
        level, message, figures = self.health()
        if level == OK and self._active.is_set() and self.now_ns() is None:
            # In lockstep the plant, which is the source of the time, starts last.
            level, message = OK if self.lockstep else WARN, f"{USE_SIM_TIME} is set, but no time arrives on {CLOCK_TOPIC}"
        if self.courtesy is not None:
            figures = {**figures, **self.courtesy.figures()}
            if self.courtesy.complaint:
                level, message = max(level, WARN), f"{self.courtesy.complaint}; {message}"
        if unmatched := self._mismatches.found:
            level, message = max(level, WARN), f"{unmatched[0]}; {message}"
        if contention := self.owners.complaint():
            level, message = max(level, WARN), f"{contention}; {message}"
        lists = {"not_permitted": self.not_permitted, "not_matched": unmatched}
        return (
            level,
            message,
            {**figures, **{f"{key}_{i}": text for key, texts in lists.items() for i, text in enumerate(texts, 1)}},
        )

    def advice(self) -> str:
        """Return the remedy that the log adds to a complaint; empty if there is no command to type."""
        return ""

    def report(self) -> None:
        """Publish diagnostics."""
        self._publish_health(*self._health())

    def _publish_health(self, level: bytes, message: str, figures: Mapping[str, Any]) -> None:
        status = DiagnosticStatus(
            level=level,
            # All rigs share /diagnostics: nodes outside the default namespace are shown with theirs.
            name=self.get_fully_qualified_name().removeprefix(f"/{NAMESPACE}/").removeprefix("/"),
            message=message,
            hardware_id=self.get_namespace().strip("/"),
            values=[
                KeyValue(key=key, value=f"{value:.6g}" if isinstance(value, float) else str(value))
                for key, value in figures.items()
            ],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
        if (level, message) != self._reported and level != OK:
            self._complain(level, f"{message}{self.advice()}")
        self._reported = (level, message)

    def _complain(self, level: bytes, message: str) -> None:
        # rclpy binds each call site to the severity of its first call.
        if level == ERROR:
            self.get_logger().error(message)
            return
        kind, now = re.sub(r"[\d.]+", "", message), time.monotonic()
        if now - self._warned.get(kind, -math.inf) >= REPEAT:
            self._warned[kind] = now
            self.get_logger().warning(message)

    def report_change(self) -> None:
        """Publish diagnostics at once if level or message have changed."""
        level, message, _ = self._health()
        if (level, message) != self._reported:
            self.report()


def survive_requests(node: Node) -> None:
    """Refuse and log a request whose handler raises; rclpy would let it end the thread of all services.

    Args:
        node: owner of the services.
    """
    for service in node.services:
        service.callback = _surviving(node, service)


def _surviving(node: Node, service: Any) -> Callable[[Any, Any], Any]:
    """Return a service's handler that answers with a refusal if the original handler raises."""
    answer = service.callback
    changes_state = service.srv_name.endswith("/change_state")
    guard = node.changing if changes_state and isinstance(node, ControlNode) else contextlib.nullcontext()

    def answer_or_refuse(request: Any, response: Any) -> Any:
        try:
            with guard:
                return answer(request, response)
        except Exception as error:  # noqa: BLE001
            reason = f"{type(error).__name__}: {error}"
            node.get_logger().error(f"{service.srv_name}: a request was refused: {reason}")
            return _refusal(request, response, reason)

    return answer_or_refuse


def _refusal(request: Any, response: Any, reason: str) -> Any:
    """Fill in a refusal, with the reason if the response has a field for it; ``success`` is false by default."""
    refused = SetParametersResult(successful=False, reason=reason)
    if isinstance(response, SetParameters.Response):
        # The parameters before the failed one have been set.
        response.results = [*response.results, *[refused] * (len(request.parameters) - len(response.results))]
    elif isinstance(response, SetParametersAtomically.Response):
        response.result = refused
    elif hasattr(response, "message"):
        response.message = reason
    return response


class _Services:
    """The thread that serves services and timers of a process's nodes; its failure stops the nodes."""

    def __init__(self, nodes: Sequence[ControlNode], failures: Failures) -> None:
        self._failures = failures
        self._blamed = nodes[-1]
        self._executor = EventsExecutor()
        for node in nodes:
            self._executor.add_node(node)
        self._thread = threading.Thread(target=self._serve, name="services")
        self._thread.start()

    def join(self) -> None:
        self._thread.join()

    def close(self, nodes: Sequence[ControlNode]) -> None:
        for node in nodes:
            self._executor.remove_node(node)
        self._executor.shutdown()

    def _serve(self) -> None:
        try:
            while not self._failures.stopping.is_set():
                self._executor.spin_once(timeout_sec=WAIT)
        except BaseException as error:  # noqa: BLE001
            # A node that can no longer be stopped over ROS must not continue, whatever the error.
            self._failures.note(error, self._blamed, "service thread")


def _made(makes: Sequence[Callable[[], ControlNode]], failures: Failures) -> list[ControlNode]:
    """Return the nodes; none if one cannot be made. As a function, it keeps no reference to a failed node."""
    try:
        return [make() for make in makes]
    except (BadInput, ParameterException) as error:
        print(error, file=sys.stderr)
    except Exception as error:  # noqa: BLE001
        failures.note(error, None, "start")
    return []


def _joined() -> str:
    """Join the ROS graph; return the error in the arguments or files of `--ros-args`, or an empty string."""
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        # The text after the first source location of rcl does not help the user.
        return str(error).partition(", at /")[0]
    return ""


def be_punctual() -> None:
    """Make the calling thread, which runs a loop, wake up and get the interpreter on time."""
    exact_wake_ups()
    # By default the other thread may keep the interpreter for 5 ms.
    sys.setswitchinterval(SWITCH_INTERVAL)


def run_node(make: Callable[[], ControlNode]) -> NoReturn:
    """Run one node as a process: the loop in the main thread, lifecycle and parameters in a second one.

    The exit code is 0 after SIGINT or SIGTERM, 1 if the node cannot configure itself, and 2 for bad input.

    Args:
        make: builds the node, after ``rclpy.init``.
    """
    run_nodes([make], lambda nodes: nodes[0].work)


def run_nodes(
    makes: Sequence[Callable[[], ControlNode]],
    join: Callable[[Sequence[ControlNode]], Callable[[Stopping], None]],
) -> NoReturn:
    """Run nodes as one process: their loops in the main thread, lifecycle and parameters of all in a second one.

    The exit code is that of :func:`run_node`; a node that fails ends them all.

    Args:
        makes: build the nodes, after ``rclpy.init``; in the order in which they configure and activate themselves.
        join: returns a function that runs the nodes' loops until an event is set.
    """
    be_frugal()
    stopping = Stopping()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    # However the node is started, it is visible on this host only unless the variable says otherwise.
    os.environ[DISCOVERY_RANGE] = os.environ.get(DISCOVERY_RANGE) or LOCALHOST
    failures = Failures(stopping)
    complaint = _joined()
    if complaint:
        print(complaint, file=sys.stderr)
    nodes = [] if complaint else _made(makes, failures)
    code = _work(nodes, join, failures) if nodes else 2
    # Objects that refer to the middleware must be collected before it shuts down.
    del nodes
    gc.unfreeze()
    gc.collect()
    rclpy.try_shutdown()
    end(1 if failures.noted else code)


def _work(
    nodes: Sequence[ControlNode],
    join: Callable[[Sequence[ControlNode]], Callable[[Stopping], None]],
    failures: Failures,
) -> int:
    """Run nodes until the process is stopped, and destroy them; return the exit code."""
    stopping, code = failures.stopping, 0
    for node in nodes:
        node.failures = failures
        survive_requests(node)
    work = join(nodes)
    services = _Services(nodes, failures)
    try:
        if all(not node.get_parameter("autostart").value or node.bring_up(stopping) for node in nodes):
            for node in nodes:
                node.get_logger().info("up")
            work(stopping)
        else:
            code = 1
    except Exception as error:  # noqa: BLE001
        failures.note(error, nodes[-1], "run")
    stopping.set()
    # Fast DDS occasionally deadlocks while it destroys readers and writers (its issues 4026 and 6193), in a call that
    # holds the interpreter lock; only this watchdog then ends the process. The node's data have been written by now.
    faulthandler.dump_traceback_later(CLOSING, exit=True)
    _each(nodes, lambda node: node.make_safe())
    services.join()
    services.close(nodes)
    _each(nodes, lambda node: node.give_back())
    _each(nodes, lambda node: node.destroy_node())
    return code


def _each(nodes: Sequence[ControlNode], step: Callable[[ControlNode], None]) -> None:
    """Apply a shutdown step to all nodes, even if some of them fail."""
    for node in nodes:
        try:
            step(node)
        except Exception as error:  # noqa: BLE001
            node.report_failure(error, "end")
