"""What the page asks of the graph; ``ehls_ros.nodes.dashboard_graph`` answers it over ROS."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from ehls_ros.dashboard.window import Window
from ehls_ros.experiments.spec import Spec

Value = float | int | bool | str


class Health(NamedTuple):
    """What a node last said of itself.

    Attributes:
        node: its name.
        level: 0 well, 1 warning, 2 error, 3 silent for longer than it should be.
        message: its sentence.
        figures: by name.
    """

    node: str
    level: int
    message: str
    figures: Mapping[str, str]


class Tunable(NamedTuple):
    """A parameter of a running node that may change while it runs.

    Attributes:
        name: its name.
        value: its value.
        description: help with the unit in brackets.
        minimum: smallest value the node takes; None: no limit.
        maximum: largest value the node takes; None: no limit.
    """

    name: str
    value: Value
    description: str
    minimum: float | None
    maximum: float | None


class Beginning(NamedTuple):
    """How far nodes are that are being started.

    Attributes:
        seconds: since they were started.
        nodes: what each is doing, in the order they are started.
    """

    seconds: float
    nodes: Mapping[str, str]


class Answer(NamedTuple):
    """What came of a wish: whether it was done, and the sentence of whoever did or refused it."""

    done: bool
    message: str


class Graph(Protocol):
    """A running graph, or one that may be started. Every method may be called from any thread.

    Attributes:
        window: the last seconds of its signals.
        where: its namespace and domain, for people.
    """

    window: Window
    where: str

    def rate(self) -> float:
        """Return the snapshots that came in over the last second or so [1/s]; 0 where there is no graph."""

    def health(self) -> tuple[Health, ...]:
        """Return what the nodes say."""

    def tunable_nodes(self) -> tuple[str, ...]:
        """Return the nodes with parameters to change, the controller first."""

    def parameters(self, node: str) -> tuple[Tunable, ...]:
        """Ask a node for its parameters; nothing where it does not answer."""

    def set_parameter(self, node: str, name: str, value: Value) -> Answer:
        """Ask a node to take a value; it says why if it does not."""

    def emergency_stop(self) -> Answer:
        """Cut the command."""

    def acknowledge_stop(self) -> Answer:
        """Let go of the emergency stop that is engaged."""

    def reset_trips(self) -> Answer:
        """Let the gate forget what tripped it."""

    def enable(self) -> Answer:
        """Let commands through again."""

    def start(self, spec: Spec, name: str) -> Answer:
        """Start the nodes for a spec, in real time and without an end; returns once they run."""

    def stop(self) -> Answer:
        """End the nodes that were started here."""

    def record(self, *, on: bool) -> Answer:
        """Begin a recording, or end it."""

    def beginning(self) -> Beginning | None:
        """Return how far the nodes are that are being started here; None where none are."""

    def complaint(self) -> str:
        """Say which of the nodes started here ended although nobody wanted it, and its last words; empty where none did."""

    def activity(self) -> str:
        """Say in a sentence what was started here: recording, files."""

    def started_here(self) -> bool:
        """Tell whether nodes run that were started here."""

    def recording(self) -> bool:
        """Tell whether a recording that was begun here goes on."""

    def give_up(self) -> None:
        """Let every wish that waits for an answer end now: the server ends."""
