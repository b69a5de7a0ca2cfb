"""Interface of the page to the graph; ``ehls_ros.nodes.dashboard_graph`` implements it over ROS.

Texts from the graph may have any length, so they are shortened for display.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:  # a second that `ehls rig stop`, which shares the values below, must not wait
    from ehls_ros.dashboard.window import Window
    from ehls_ros.experiments.spec import Spec

Value = float | int | bool | str

MAX_NAME = 100
"""Maximum length of a name [characters]."""

MAX_TEXT = 500
"""Maximum length of a message or value [characters]."""

MAX_FIGURES = 100
"""Maximum number of values of a node."""

RETRY_TIME = 3.0
"""Time for which a refused request to the gate is repeated [s]: a ramp, or the shortest emergency stop, may not be over."""

RETRY_INTERVAL = 0.1
"""Time between two of these requests [s]."""

EVALUATIONS: Mapping[str, str] = MappingProxyType({"verify": "Verification", "report": "Report"})
"""Verbs of ``ehls`` that evaluate a recording, and the names of the documents that they write."""

TUNING_DOCUMENTS: Mapping[str, str] = MappingProxyType(
    {"tuning-report": "Report", "tuning-experiment": "Experiment", "tuning-numbers": "Parameter file"}
)
"""Documents of a tuning, and their names on the page."""


class NodeHealth(NamedTuple):
    """A node's latest diagnostics.

    Attributes:
        node: its name.
        level: 0 OK, 1 warning, 2 error, 3 overdue.
        message: its message.
        figures: its values by name.
    """

    node: str
    level: int
    message: str
    figures: Mapping[str, str]


class Tunable(NamedTuple):
    """A parameter that may change while its node runs.

    Attributes:
        name: its name.
        value: its value.
        description: help, with the unit in brackets.
        minimum: smallest value the node accepts; None: no limit.
        maximum: largest value the node accepts; None: no limit.
    """

    name: str
    value: Value
    description: str
    minimum: float | None
    maximum: float | None


class Timing(Enum):
    """Time mode of a graph started here; the value is the text on the page.

    In the first two, every cycle waits for its answers. The first is the default. A simulated rig need not keep real time; the
    result is then independent of the machine's speed and load.
    """

    LOCKSTEP = "in step, at most as fast as real time"
    FASTEST = "in step, as fast as this machine"
    REALTIME = "real time: late answers count as late"


class StartProgress(NamedTuple):
    """Progress of nodes being started.

    Attributes:
        seconds: time since their start [s].
        nodes: stage of each, in starting order.
    """

    seconds: float
    nodes: Mapping[str, str]


class RigChange(NamedTuple):
    """A change of the rig detected by the monitor.

    Attributes:
        sentence: kind of change, size, onset and confidence.
        active: whether it persists.
        acknowledged: whether an operator has seen it.
    """

    sentence: str
    active: bool
    acknowledged: bool


class RigCoefficient(NamedTuple):
    """A coefficient of the rig as estimated by the monitor.

    Attributes:
        name: its name, such as ``leakage_coefficient``.
        value: its newest value.
        deviation: standard error.
        unit: of both, SI.
        why_not: reason if the programme does not determine it; otherwise empty.
        times: times of the values since this dashboard subscribed [s].
        values: values at these times, NaN where not determined.
    """

    name: str
    value: float
    deviation: float
    unit: str
    why_not: str
    times: tuple[float, ...]
    values: tuple[float, ...]


class RigHealth(NamedTuple):
    """Rig health reported by a monitor.

    Attributes:
        state: state of the monitor, in one word.
        summary: the rig's health in a sentence.
        changes: detected changes, newest first.
        coefficients: the rig's coefficients.
        outside: fraction of the last minute outside the range of the baseline.
    """

    state: str
    summary: str
    changes: tuple[RigChange, ...] = ()
    coefficients: tuple[RigCoefficient, ...] = ()
    outside: float = 0.0


class TunedNumber(NamedTuple):
    """A number of a law before and after a tuning.

    Attributes:
        name: its name.
        unit: its unit; 1 without one.
        meaning: its description.
        default: value in the experiment.
        found: value found.
    """

    name: str
    unit: str
    meaning: str
    default: float
    found: float


class TuningPoint(NamedTuple):
    """Error and margins of a set of numbers, in simulation.

    Attributes:
        error: largest error of the true force [N]; None: the force is lost.
        gain_db: gain margin [dB]; None: unlimited.
        phase_deg: phase margin [degree]; None: unlimited.
        held: swing of the error of a small force against an actuator under test that holds, over its amplitude; None: lost.
    """

    error: float | None
    gain_db: float | None
    phase_deg: float | None
    held: float | None


class TuningResult(NamedTuple):
    """Result of a tuning.

    Attributes:
        sentence: the result in a sentence.
        holds: whether the force is held with the margins asked for.
        lost: whether the force is lost, so that the numbers are of no use.
        numbers: the numbers tuned.
        default: results of the experiment's numbers.
        found: results of the numbers found.
        curve: results of the numbers found, made slower and faster together.
        wanted_db: gain margin asked for [dB].
        causal_limit: error of the best law without foresight [N]; None: unknown.
        remarks: sentences for the user.
    """

    sentence: str
    holds: bool
    lost: bool
    numbers: tuple[TunedNumber, ...]
    default: TuningPoint
    found: TuningPoint
    curve: tuple[TuningPoint, ...]
    wanted_db: float
    causal_limit: float | None
    remarks: tuple[str, ...]


class Tuning(NamedTuple):
    """The last tuning begun here.

    Attributes:
        law: law tuned.
        experiment: name of the experiment tuned for.
        running: whether it runs.
        seconds: time since its beginning, or its duration [s].
        done: number of sets of numbers tried.
        most: largest number of sets to be tried; 0 until the first is done.
        failure: reason for the lack of a result; empty if there is one or it is awaited.
        result: the result; None until it is there.
        folder: folder of its files.
        applied: sentence on the last application of the numbers to a running controller; empty before.
        applications: number of applications of all tunings so far.
    """

    law: str
    experiment: str
    running: bool = True
    seconds: float = 0.0
    done: int = 0
    most: int = 0
    failure: str = ""
    result: TuningResult | None = None
    folder: str = ""
    applied: str = ""
    applications: int = 0


class GraphSnapshot(NamedTuple):
    """State of the graph at one moment; all texts of the page at one time come from one snapshot.

    Attributes:
        rate: rate of cycles over about the last second [1/s]; 0 without a graph.
        period: the rig's time between two cycles [s]; 0 if unknown.
        health: the nodes' diagnostics.
        starting: progress of the nodes being started here; None if none are.
        complaint: name and last log line of a node started here that died; empty if none died.
        activity: recording and files started here.
        started_here: whether nodes started here are running.
        recording: whether a recording started here is running.
        recorded: whether one has ended, so that it can be evaluated.
        results: what its evaluations found, in a sentence each, by verb.
        rig: rig health reported by a monitor; None without a monitor.
        laws: laws with a running node, the driving one first.
        on_rig: whether the graph may drive a real rig: anything but the simulated rig alone.
        tuning: the last tuning begun here; None before the first.
    """

    rate: float = 0.0
    period: float = 0.0
    health: tuple[NodeHealth, ...] = ()
    starting: StartProgress | None = None
    complaint: str = ""
    activity: str = ""
    started_here: bool = False
    recording: bool = False
    recorded: bool = False
    results: Mapping[str, str] = MappingProxyType({})
    rig: RigHealth | None = None
    laws: tuple[str, ...] = ()
    on_rig: bool = False
    tuning: Tuning | None = None


class Answer(NamedTuple):
    """Outcome of a request: whether it was carried out, and the message of the node."""

    done: bool
    message: str


def until_granted(request: Callable[[], Answer], wait: Callable[[float], object] = time.sleep) -> Answer:
    """Repeat a request to the safety gate that is refused for the moment; return the last answer.

    Args:
        request: the request.
        wait: waits for a time [s]; a true result ends the repetition.
    """
    deadline = time.monotonic() + RETRY_TIME
    while not (answer := request()).done and time.monotonic() < deadline and not wait(RETRY_INTERVAL):
        pass
    return answer


class Graph(Protocol):
    """A running graph, or one that can be started. All methods are thread-safe.

    Attributes:
        window: the last seconds of its signals.
        where: its namespace and domain, as text.
        simulated: whether a graph started here has the simulated rig.
    """

    window: "Window"
    where: str
    simulated: bool

    def snapshot(self) -> GraphSnapshot:
        """Return the present state of the graph, without the signals."""

    def tunable_nodes(self) -> tuple[str, ...]:
        """Return the nodes with live parameters, the driving controller first."""

    def parameters(self, node: str) -> tuple[Tunable, ...]:
        """Return a node's live parameters; empty if it does not answer."""

    def set_parameter(self, node: str, name: str, value: Value) -> Answer:
        """Set a node's parameter; the answer carries the node's reason if it refuses."""

    def emergency_stop(self) -> Answer:
        """Cut the command."""

    def acknowledge_stop(self) -> Answer:
        """Acknowledge the engaged emergency stop."""

    def acknowledge_changes(self) -> Answer:
        """Acknowledge the changes of the rig detected by the monitor."""

    def unload(self) -> Answer:
        """Let the load pressure decay, then close the valve."""

    def reset_trips(self) -> Answer:
        """Reset the gate's latched trips."""

    def enable(self) -> Answer:
        """Enable the gate, so that commands reach the valve again."""

    def reset_and_enable(self) -> Answer:
        """Reset the gate's latched trips, and enable the gate."""

    def programme(self, request: str) -> Answer:
        """Stop, resume or skip a block of the running programme: ``stop``, ``resume`` or ``skip``."""

    def start(self, spec: "Spec", name: str, timing: Timing) -> Answer:
        """Start the nodes of a spec for a run without end; return once they run."""

    def stop(self) -> Answer:
        """Stop the nodes started here."""

    def record(self, *, on: bool) -> Answer:
        """Start or end a recording."""

    def evaluate(self, verb: str) -> Answer:
        """Evaluate the last recording that ended here with one of :data:`EVALUATIONS`, and write its document."""

    def tune(self, spec: "Spec | None", name: str) -> Answer:
        """Begin to tune the law of an experiment in simulation; :attr:`GraphSnapshot.tuning` shows the progress.

        Args:
            spec: the experiment; None: that of the running graph, with the law that drives it.
            name: its name, if it is given.
        """

    def cancel_tuning(self) -> Answer:
        """End the running tuning without a result."""

    def apply_tuning(self, folder: str, *, confirmed: bool) -> Answer:
        """Set the numbers found by a tuning in the law's running node, all in one request.

        Args:
            folder: folder of the tuning's files, which identifies it.
            confirmed: whether the operator has confirmed that a real rig is to run with them.
        """

    def document(self, name: str) -> Path | None:
        """Return a document of an evaluation or of a tuning; None if there is none of that name."""

    def abort(self) -> None:
        """Abort every pending request: the server is shutting down."""


def shortened(text: str, max_length: int = MAX_TEXT) -> str:
    """Return a text as one line of limited length, with unprintable characters replaced.

    Args:
        text: the text.
        max_length: maximum number of characters kept.
    """
    kept = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:max_length])
    return kept if len(text) <= max_length else f"{kept}…"


def shortened_figures(pairs: Iterable[tuple[str, str]]) -> Mapping[str, str]:
    """Return the values by name, at most :data:`MAX_FIGURES` of them."""
    kept: dict[str, str] = {}
    for name, value in pairs:
        if len(kept) == MAX_FIGURES:
            break
        kept[shortened(name, MAX_NAME)] = shortened(value)
    return kept
