"""What the control-path nodes share: lifecycle, spec, the loop in the main thread, diagnostics, shutdown."""

import faulthandler
import gc
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NamedTuple, NoReturn

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import Spec, load_spec
from ehls_ros.hardware.courtesy import Courtesy, statistics_of
from ehls_ros.hardware.realtime import be_frugal, claim, exact_wake_ups
from ehls_ros.nodes.parameters import declare, refuse_unknown
from ehls_ros.process import end
from ehls_ros.schema import quantity, text

NAMESPACE = "ehls"
"""Namespace of the nodes unless a launch file or `-r __ns:=` says otherwise."""

LOCKSTEP, REALTIME = TIMINGS = ("lockstep", "realtime")
"""Timing modes."""

DISCOVERY_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""Variable by which the middleware is told how far nodes look for each other."""

CLOSING = 30.0
"""Time the middleware has for closing what the node had open [s]."""

WAIT = 0.1
"""Longest time a loop waits before it looks whether it should stop [s]."""

BEAT = 0.05
"""Time between two signs of life of the thread that answers services [s]."""

LONGEST_TURN = 0.1
"""What a turn of the loop adds at most to the time without a sign of life: a process that slept has not been deaf [s]."""

SWITCH_INTERVAL = 1e-4
"""Time after which a thread hands the interpreter over to one that waits for it [s]."""

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Common(NamedTuple):
    """Parameters every node has."""

    spec: Annotated[str, text("experiment file; empty: the 10 kN sine that comes with the package")] = ""
    rig: Annotated[str, text("rig file in place of the spec's; empty: the spec's")] = ""
    timing: Annotated[str, text("realtime: wall clock; lockstep: each cycle waits for its answer, deterministic")] = "realtime"
    priority: Annotated[
        int,
        quantity("1", "in realtime: priority of SCHED_FIFO, with memory locked; 0: neither", minimum=0, maximum=99),
    ] = 0
    processor_share: Annotated[
        float,
        quantity("1", "part of a processor beyond which the loop gives its priority back; 1: never", minimum=0.05, maximum=1.0),
    ] = 0.9
    autostart: Annotated[bool, text("configure and activate at start, as when started by hand")] = True


class ControlNode(LifecycleNode):
    """A lifecycle node whose loop runs in the main thread while it is active.

    Subclasses implement :meth:`prepare`, :meth:`start`, :meth:`once`, :meth:`stop`, :meth:`release` and
    :meth:`health`.
    """

    answers = True
    """Whether somebody waits for what the loop publishes; a loop that only has to keep up lets the others go first."""

    def __init__(self, name: str) -> None:
        """Declare the common parameters and read the spec.

        Raises:
            BadInput: the spec or rig file is wrong.
        """
        super().__init__(name, namespace=NAMESPACE)
        declare(self, Common, live=False)
        self.spec = self._load_spec()
        timing = self.text_parameter("timing")
        if timing not in TIMINGS:
            raise BadInput(f"timing is '{timing}'", self.get_name(), f"one of {', '.join(TIMINGS)}")
        self.lockstep = timing == LOCKSTEP
        self.configured = False
        self.not_permitted: tuple[str, ...] = ()
        self.courtesy: Courtesy | None = None
        self._active = threading.Event()
        self._idle = threading.Event()
        self._idle.set()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._reported: tuple[bytes, str] | None = None
        self._beaten = False
        # By a clock that nobody can stop, as they can ROS time.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self.report, clock=steady)
        self.create_timer(BEAT, self._beat, clock=steady)

    @property
    def clock_topic(self) -> str:
        """The topic of the cycles' time: /clock is that of the whole ROS graph, so a rig of another namespace has its own."""
        return "/clock" if self.get_namespace() == f"/{NAMESPACE}" else "clock"

    def text_parameter(self, name: str) -> str:
        """Return a text parameter's value."""
        return str(self.get_parameter(name).value)

    def _load_spec(self) -> Spec:
        chosen = self.text_parameter("spec")
        path = Path(chosen) if chosen else config_folder() / "experiments" / "sine_fd2.yaml"
        rig = self.text_parameter("rig")
        return load_spec(path, Path(rig) if rig else None)

    def prepare(self) -> None:
        """Build what the loop needs: compile, publish, subscribe."""
        raise NotImplementedError

    def start(self) -> None:
        """Do what precedes the first turn of the loop."""

    def once(self) -> None:
        """Take one turn of the loop, waiting no longer than :data:`WAIT`."""
        raise NotImplementedError

    def stop(self) -> None:
        """Do what follows the last turn of the loop."""

    def release(self) -> None:
        """Give back what :meth:`prepare` built."""

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Return level, message and figures for diagnostics, once the node is configured."""
        return OK, "running" if self._active.is_set() else "inactive", {}

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Prepare; a wrong configuration leaves the node unconfigured, with the reason in the log."""
        try:
            self.prepare()
        except (BadInput, OSError) as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        # The middleware's receivers hold locks that whoever sends to them takes as well: even where the loop goes behind
        # the others, its receivers must never be kept from running while they hold one.
        loops = () if self.answers else [thread.native_id for thread in threading.enumerate() if thread.native_id]
        priority = 0 if self.lockstep else int(self.get_parameter("priority").value)
        self.not_permitted = claim(priority, loops)
        if priority:
            # The loop is the main thread's.
            self.courtesy = Courtesy(float(self.get_parameter("processor_share").value), statistics_of(os.getpid()))
        self.configured = True
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the loop run."""
        self._idle.clear()
        self._active.set()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the loop end its turn and wait for that."""
        self._active.clear()
        self._idle.wait()
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the loop as deactivation does, and give everything back."""
        return self._end_for_good(super().on_shutdown, state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning: what failed half-way is not gone on with."""
        return self._end_for_good(super().on_error, state)

    def _end_for_good(
        self, proceed: Callable[[LifecycleState], TransitionCallbackReturn], state: LifecycleState
    ) -> TransitionCallbackReturn:
        self._active.clear()
        self._idle.wait()
        self.give_back()
        return proceed(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give everything back."""
        self.give_back()
        return TransitionCallbackReturn.SUCCESS

    def give_back(self) -> None:
        """Release what was prepared, if anything was."""
        if self.configured:
            self.configured = False
            self.release()
            if self.courtesy is not None:
                self.courtesy.close()
                self.courtesy = None

    def start_by_itself(self) -> bool:
        """Configure and activate; return whether that went well, the reason is in the log."""
        wanted = TransitionCallbackReturn.SUCCESS
        return bool(self.trigger_configure() == wanted and self.trigger_activate() == wanted)

    def work(self, stopping: threading.Event) -> None:
        """Run the loop whenever the node is active, until told to stop."""
        exact_wake_ups()
        # The other thread, once under way, would keep the interpreter for up to 5 ms.
        sys.setswitchinterval(SWITCH_INTERVAL)
        while not stopping.is_set():
            if not self._active.wait(WAIT):
                continue
            # A collection in the middle of a cycle would be a late answer; the loops make no cyclic garbage.
            gc.disable()
            try:
                self.start()
                self._turn(stopping)
            finally:
                gc.enable()
                self.stop()
                self._idle.set()

    def _turn(self, stopping: threading.Event) -> None:
        """Turn the loop, and watch that the other thread answers: by it a rig is stopped."""
        silence, turned = 0.0, time.monotonic()
        while self._active.is_set() and not stopping.is_set():
            self.once()
            now = time.monotonic()
            silence = 0.0 if self._beaten else silence + min(now - turned, LONGEST_TURN)
            self._beaten, turned = False, now
            self.unheard(silence)
            if self.courtesy is not None and self.courtesy.look(now):
                self.report_change()

    def _beat(self) -> None:
        self._beaten = True

    def unheard(self, silence: float) -> None:
        """Do what has to be done once services have not been answered for a time [s]; told after each turn of the loop."""

    def finish(self) -> None:
        """End the loop from inside: its task is done."""
        self._active.clear()

    def _health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        if not self.configured:
            return OK, "unconfigured", {}
        level, message, figures = self.health()
        if self.courtesy is not None:
            figures = {**figures, **self.courtesy.figures()}
            if self.courtesy.complaint:
                level, message = max(level, WARN), f"{self.courtesy.complaint}; {message}"
        return level, message, {**figures, **{f"not_permitted_{i}": text for i, text in enumerate(self.not_permitted, 1)}}

    def report(self) -> None:
        """Publish diagnostics."""
        level, message, figures = self._health()
        status = DiagnosticStatus(
            level=level,
            # /diagnostics is everybody's: a rig of another namespace has that in its names.
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
            self.get_logger().warning(message)
        self._reported = (level, message)

    def report_change(self) -> None:
        """Publish diagnostics at once when level or message are other than last time."""
        level, message, _ = self._health()
        if (level, message) != self._reported:
            self.report()


def survive_requests(node: Node, service: Any) -> None:
    """Let a request that a service cannot bear be refused and logged, where rclpy would let it end the thread of all services.

    Args:
        node: the service's, for its log.
        service: of rclpy.
    """
    answer = service.callback

    def answer_or_refuse(request: Any, response: Any) -> Any:
        try:
            return answer(request, response)
        except Exception as error:  # noqa: BLE001
            reason = f"{type(error).__name__}: {error}"
            node.get_logger().error(f"{service.srv_name}: a request was refused: {reason}")
            return _refusal(request, response, reason)

    service.callback = answer_or_refuse


def _refusal(request: Any, response: Any, reason: str) -> Any:
    """Fill in a response that says no: most do by themselves, and have the reason where they have room for one."""
    fields = response.get_fields_and_field_types()
    no = SetParametersResult(successful=False, reason=reason)
    if fields.get("results") == "sequence<rcl_interfaces/SetParametersResult>":
        # What stood before the parameter that cannot be has been set.
        response.results = [*response.results, *[no] * (len(request.parameters) - len(response.results))]
    if fields.get("result") == "rcl_interfaces/SetParametersResult":
        response.result = no
    if "message" in fields:
        response.message = reason
    return response


def _made(make: Callable[[], ControlNode]) -> tuple[ControlNode | None, str]:
    """Return a node, or what is wrong with its parameters; nothing then refers to the half-made node any more."""
    try:
        return make(), ""
    except BadInput as error:
        return None, str(error)


def run_node(make: Callable[[], ControlNode]) -> NoReturn:
    """Run one node as a process: main thread for the loop, a second one for lifecycle and parameters.

    The process ends with code 0 after SIGINT or SIGTERM, with 1 when it cannot configure itself, and with 2 for bad input.

    Args:
        make: builds the node, after ROS is up.
    """
    be_frugal()
    stopping = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        stopping.set()

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    # However the node is started: whoever wants it found beyond this host has to say so.
    os.environ[DISCOVERY_RANGE] = os.environ.get(DISCOVERY_RANGE) or "LOCALHOST"
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, complaint = _made(make)
    if node is None:
        print(complaint, file=sys.stderr)
        gc.collect()
        rclpy.try_shutdown()
        end(2)
    refuse_unknown(node)
    for service in node.services:
        survive_requests(node, service)
    executor = EventsExecutor()
    executor.add_node(node)

    unserved: list[str] = []

    def serve(executor: Any) -> None:
        try:
            while not stopping.is_set():
                executor.spin_once(timeout_sec=WAIT)
        except BaseException:  # noqa: BLE001
            # Whatever it was: a node that nobody can stop must not go on.
            unserved.append(traceback.format_exc())
            stopping.set()

    server = threading.Thread(target=serve, args=(executor,), name="services")
    server.start()
    code = 0
    try:
        if not node.get_parameter("autostart").value or node.start_by_itself():
            node.get_logger().info("up")
            node.work(stopping)
        else:
            code = 1
    finally:
        stopping.set()
        # Fast DDS deadlocks now and then while it takes readers and writers down (its issues 4026 and 6193), within a call
        # that keeps the interpreter; only this ends the process then. What the node had to write, it has written.
        faulthandler.dump_traceback_later(CLOSING, exit=True)
        server.join()
        if unserved:
            node.get_logger().fatal(f"services are answered no more, so the node ends: {unserved[0]}")
            code = 1
        executor.remove_node(node)
        executor.shutdown()
        node.give_back()
        node.destroy_node()
    # What still refers to the middleware has to go before the middleware does; the loop has put off collection.
    del executor, node
    gc.unfreeze()
    gc.collect()
    rclpy.try_shutdown()
    end(code)
