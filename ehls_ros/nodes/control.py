"""Base of the control-path nodes: parameters, experiment file, and the hooks that a node implements.

A node's :class:`~ehls_ros.nodes.lifecycle.Lifecycle`, :class:`~ehls_ros.nodes.loop.Loop`,
:class:`~ehls_ros.nodes.scheduling.Scheduling` and :class:`~ehls_ros.nodes.diagnostics.Diagnostics` call them;
:mod:`ehls_ros.nodes.running` makes a process of nodes.
"""

import os
import signal
import time
from collections.abc import Sequence
from typing import Annotated, NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter

from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import chosen_spec
from ehls_ros.nodes.diagnostics import OK, Diagnostics, Health
from ehls_ros.nodes.failures import Failures
from ehls_ros.nodes.graph_nodes import LOCKSTEP, TIMINGS
from ehls_ros.nodes.lifecycle import Lifecycle
from ehls_ros.nodes.links import Links
from ehls_ros.nodes.loop import WAIT, Loop
from ehls_ros.nodes.owners import Owners
from ehls_ros.nodes.parameters import DeclaredParameters, declare
from ehls_ros.nodes.scheduling import Scheduling
from ehls_ros.nodes.transport import Waiter, kept_at
from ehls_ros.process import Stopping
from ehls_ros.recording.topics import CLOCK
from ehls_ros.schema import quantity, text

NAMESPACE = "ehls"
"""Default namespace of the nodes; a launch file or `-r __ns:=` may set another."""

CLOCK_TOPIC = CLOCK.name
"""Topic of the time, in lockstep and with use_sim_time; the name that rclpy uses, which `-r` remaps."""

USE_SIM_TIME = "use_sim_time"
"""Parameter of every ROS node: take the time from the clock topic."""

PARENT = "EHLS_PARENT"
"""Environment variable with the id of the process that started a node; the node ends with it. Unset: the node has no parent."""

PATIENCE = 1.0
"""Longest quiet wait [s]. After it, diagnostics report the missing input, and in lockstep messages are repeated to readers
that may have missed them."""

HEARTBEAT = 0.05
"""Period of the service thread's heartbeat [s]."""


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


class ControlNode(DeclaredParameters):
    """A lifecycle node whose loop runs in the main thread while it is active.

    Subclasses implement :meth:`prepare`, :meth:`start`, :meth:`once`, :meth:`stop`, :meth:`release` and
    :meth:`health`.

    Attributes:
        sender: name of this node and process in messages.
        spec: the experiment.
        lockstep: whether each cycle waits for its answer.
        cycles_kept: history depth of the control-path topics.
        links: links to the nodes of the same process; None if it has no other.
        hosted: whether another node of the process runs this node's loop.
        refused: why another sender owns an input that this node sends; empty if none does.
        failures: unforeseen exceptions of the process.
        steady: clock that does not depend on ROS time, which may stop.
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
        self._uses_clock_topic = bool(self.get_parameter(USE_SIM_TIME).value)
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
        self._parent = int(os.environ.get(PARENT, "0"))
        self.links: Links | None = None
        self.failures = Failures(Stopping())
        self.hosted = False
        self.refused = ""
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.scheduling = Scheduling(self)
        self.loop = Loop(self)
        self.lifecycle = Lifecycle(self)
        self.owners = Owners(self)
        self._diagnostics = Diagnostics(self)
        self.create_timer(1.0, self._look_around, clock=self.steady)
        self._heartbeat = self.create_timer(HEARTBEAT, self._beat, clock=self.steady)

    # --- implemented by subclasses ------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Build the resources of the loop: compile code, open topics."""
        raise NotImplementedError

    def is_ready(self) -> bool:
        """Wait for whatever the loop needs at its start; return False if the node is not to be activated."""
        return True

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
            self.idle()

    def idle(self) -> None:
        """Run after a turn in which there was nothing to do."""

    def stop(self) -> None:
        """Run after the last turn of the loop."""

    def release(self) -> None:
        """Undo :meth:`prepare`."""

    def secure(self) -> None:
        """Bring the rig into its safe state; called at the end of the process, even after a failure."""

    def health(self) -> Health:
        """Return level, message and values for diagnostics; called once the node is configured."""
        return OK, self.activity, {}

    def advice(self) -> str:
        """Return the remedy that the log adds to a complaint; empty if there is no command to type."""
        return ""

    def note_service_silence(self, silence: float) -> None:
        """React to a silent service thread; called after each turn with the time since its last heartbeat [s]."""

    # --- provided to subclasses ---------------------------------------------------------------------------------------------

    @property
    def is_active(self) -> bool:
        """Whether the loop is to run, i.e. the node is active."""
        return self.loop.is_active

    @property
    def activity(self) -> str:
        """Whether the node is active, in a word for diagnostics."""
        return "running" if self.is_active else "inactive"

    @property
    def primary_state(self) -> int:
        """Number of the present state of the lifecycle."""
        return int(self._state_machine.current_state[0])

    @property
    def shown_name(self) -> str:
        """Name in the diagnostics, which all rigs share: nodes outside the default namespace are shown with theirs."""
        return str(self.get_fully_qualified_name()).removeprefix(f"/{NAMESPACE}/").removeprefix("/")

    def now_ns(self) -> int | None:
        """Return the time of the node's clock [ns]: the system's or, with use_sim_time, /clock's; None before the first."""
        return self.get_clock().now().nanoseconds or None if self._uses_clock_topic else time.time_ns()

    def missing_time(self) -> str:
        """Return a complaint if the node's clock has no time yet."""
        return f"{USE_SIM_TIME} is set, but no time arrives on {CLOCK_TOPIC}" if self.now_ns() is None else ""

    def _note_clock(self, parameters: Sequence[Parameter]) -> None:
        """Note which clock the node uses: querying the clock itself takes longer than a control law in each cycle."""
        for parameter in parameters:
            if parameter.name == USE_SIM_TIME:
                self._uses_clock_topic = bool(parameter.value)

    def text_parameter(self, name: str) -> str:
        """Return a text parameter's value."""
        return str(self.get_parameter(name).value)

    def report(self) -> None:
        """Publish diagnostics."""
        self._diagnostics.report()

    def report_change(self) -> None:
        """Publish diagnostics at once if level or message have changed."""
        self._diagnostics.report_change()

    def report_failure(self, error: Exception, activity: str) -> None:
        """Log an unforeseen exception and end the process; the valve is closed as on a regular stop.

        Args:
            error: the exception.
            activity: during which it was raised.
        """
        self.failures.note(error, self, activity)

    # --- called by the process and by other parts of the node ---------------------------------------------------------------

    def bring_up(self, stopping: Stopping) -> bool:
        """Configure and activate; return whether both succeeded. Otherwise the log has the reason.

        Args:
            stopping: is set when the process is to end meanwhile.
        """
        return self.lifecycle.configure() and self.lifecycle.activate()

    def be_hosted(self) -> None:
        """Let another node in the same process run this node's loop; that node handles heartbeat and processor demand."""
        self.hosted = True
        self._heartbeat.cancel()

    def be_refused(self, topic: str, owner: str) -> None:
        """Deactivate the node: another sender owns an input that this node sends.

        Args:
            topic: of the input.
            owner: the sender whose messages are accepted.
        """
        self.refused = f"{topic} of this node is refused: {owner} owns it; deactivate or stop that node, then activate this one"
        if self.is_active:
            self.trigger_deactivate()
        self.report_change()

    def make_safe(self) -> None:
        """Secure the rig once no loop runs any more, and release a request that waits for the end of the loop."""
        self.loop.release_waiting()
        self.secure()

    def _beat(self) -> None:
        self.loop.note_heartbeat()

    def _look_around(self) -> None:
        """Check parent process, topics and owners, and publish diagnostics; called once a second by the service thread."""
        if self._parent and os.getppid() != self._parent:
            self.get_logger().error("the process that started this node has ended, so the node ends")
            signal.raise_signal(signal.SIGINT)
        self._await_pause()
        self._diagnostics.check_topics()
        self.owners.look()
        if self.links is not None and not self.hosted:
            self._await_pause()
            self.links.look_outside()
        self._await_pause()
        health = self._diagnostics.health()
        self._await_pause()
        self._diagnostics.publish(*health)

    def _await_pause(self) -> None:
        """Wait briefly for a time at which no loop in this process has an answer to compute."""
        if self.links is not None:
            self.links.await_pause()
