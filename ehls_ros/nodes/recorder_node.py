"""`recorder_node`: records every topic to a rosbag2, including the configuration of the run and all interventions."""

import time
from collections import deque
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn, cast, get_args

from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.timer import Timer

from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import metadata
from ehls_ros.experiments.spec import with_programme
from ehls_ros.nodes import node_names
from ehls_ros.nodes.control import ControlNode
from ehls_ros.nodes.diagnostics import ERROR, OK, WARN
from ehls_ros.nodes.parameter_stock import ParameterStock
from ehls_ros.nodes.parameters import declare
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.transport import RECORDER_DEPTH, Inbox, control_qos, message_class
from ehls_ros.recording.bag_writer import BagWriter, Storage
from ehls_ros.recording.topics import (
    CLOCK,
    CYCLE_TOPICS,
    LOADER_STATE,
    PARAMETER_EVENTS,
    ROSOUT,
    TELEMETRY_TOPICS,
    Topic,
    transition_topic,
)
from ehls_ros.schema import quantity, text

PAUSE = 0.02
"""Interval between bulk reads of the messages [s]; the middleware holds them meanwhile."""

FLUSH = 0.5
"""Interval between flushes to the file, by which the data survive a killed recorder [s]."""

LOOK = 0.25
"""Interval between checks for nodes whose parameters are not in the bag yet [s]."""

DISCOVERY = 30.0
"""Longest wait for the expected publishers [s]."""

QUIET = 0.3
"""Time without messages after which a recording ends [s]."""

SLOW = 3.0
"""The same while expected messages are missing [s]: on a busy computer they may be under way."""

LAST = 1.0
"""Messages sent later than this after the stop are left out [s]; the graph may continue."""


class Parameters(NamedTuple):
    """Parameters of the recorder."""

    bag: Annotated[str, text("folder of the bag; empty: bags/<time>")] = ""
    storage: Annotated[str, text("mcap or sqlite3")] = "mcap"
    expected: Annotated[str, text("topics, separated by commas, whose publishers must exist before recording starts")] = ""
    programme: Annotated[str, text("test programme that the programme node was given in place of the spec's reference")] = ""
    cycles: Annotated[int, quantity("1", "cycles to wait for on these topics at the end; 0: unknown", minimum=0)] = 0


class RecorderNode(ControlNode):
    """Writes messages byte for byte, stamped with the publisher's sending time."""

    answers = False
    announces = False

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("recorder_node")
        declare(self, Parameters, live=False)
        self.spec = with_programme(self.spec, self.text_parameter("programme"))
        storage = self.text_parameter("storage")
        if storage not in get_args(Storage):
            raise BadInput(f"storage is '{storage}'", self.get_name(), f"one of {', '.join(get_args(Storage))}")
        self.storage = cast(Storage, storage)
        self.expected = tuple(filter(None, self.text_parameter("expected").split(",")))
        self.cycles = int(self.get_parameter("cycles").value)
        # Made by `prepare`:
        self.path: Path
        self.written: int
        self.lost: int
        self.newest: dict[str, int]
        self.newest_ns: int
        self.often: list[str]
        self.topics: dict[str, Topic]
        self.taken: dict[str, int]
        self.inboxes: dict[str, Inbox]
        self.parameters: deque[tuple[int, bytes]]
        self.stock: ParameterStock
        self.looking: Timer
        self.failure: str
        self.writer: BagWriter | None
        self.flushed: float

    def prepare(self) -> None:
        """Open the bag and subscribe."""
        chosen = self.text_parameter("bag")
        self.path = Path(chosen) if chosen else Path("bags") / time.strftime("%Y%m%d-%H%M%S")
        self.written = 0
        self.lost = 0
        self.newest = {}
        self.newest_ns = 0
        events = [PARAMETER_EVENTS, ROSOUT, *map(transition_topic, node_names())]
        # Without lockstep, /clock belongs to another publisher.
        events += [CLOCK] if self.lockstep else []
        self.often = [topic.name for topic in (*CYCLE_TOPICS, *TELEMETRY_TOPICS)]
        self.topics = {topic.name: topic for topic in (*CYCLE_TOPICS, *TELEMETRY_TOPICS, *events)}
        self.taken = dict.fromkeys(self.topics, 0)
        self.inboxes = {
            name: Inbox(self, message_class(topic.type), name, _wanted(topic), bytes) for name, topic in self.topics.items()
        }
        self.parameters = deque()
        self.stock = ParameterStock(self, lambda stamp_ns, event: self.parameters.append((stamp_ns, event)))
        self.looking = self.create_timer(LOOK, self.stock.look, clock=self.steady)
        self.failure = ""
        self.writer = None

    def is_ready(self) -> bool:
        """Wait until the expected publishers exist, so that even a run shorter than discovery is recorded completely."""
        deadline = time.monotonic() + DISCOVERY
        for name in self.expected:
            while self.inboxes[name].handle.get_publisher_count() == 0:
                if time.monotonic() > deadline:
                    self.get_logger().error(f"{name} has no publisher")
                    return False
                time.sleep(PAUSE)
        return True

    def release(self) -> None:
        """Unsubscribe."""
        self.destroy_timer(self.looking)
        self.stock.close()
        for inbox in self.inboxes.values():
            inbox.destroy()

    def start(self) -> None:
        """Open the bag, in the thread that writes it."""
        namespace = self.get_namespace()
        described = metadata(self.spec, self.text_parameter("timing"))
        try:
            self.writer = BagWriter.create(self.path, self.storage, described, namespace=namespace)
        except BadInput as error:
            self.fail(str(error))
        self.flushed = time.perf_counter()

    def once(self) -> None:
        """Write the gathered messages."""
        time.sleep(PAUSE)
        self._drain(self.often)
        if self.writer is not None and time.perf_counter() - self.flushed > FLUSH:
            self.flushed = time.perf_counter()
            self._drain(self.topics)
            try:
                self.writer.flush()
            except OSError as error:
                self.fail(str(error))

    def _drain(self, names: Iterable[str]) -> int:
        """Write all messages received so far on some topics and the parameters found; return the number of messages."""
        before = self.written
        while self.parameters:
            self._write(PARAMETER_EVENTS.name, *self.parameters.popleft())
        for name in names:
            inbox = self.inboxes[name]
            # Sequence numbers show losses only with a single publisher that keeps more than the newest message.
            numbered = self.topics[name].depth > 1 and inbox.handle.get_publisher_count() == 1
            while (taken := inbox.take_raw()) is not None:
                message, info = taken
                if numbered:
                    self._count_lost(name, info["publication_sequence_number"])
                if name == PARAMETER_EVENTS.name and not _node_of(message).startswith(f"{self.get_namespace()}/"):
                    continue
                self.taken[name] += 1
                self.newest_ns = max(self.newest_ns, info["source_timestamp"])
                self._write(name, info["source_timestamp"], message)
        return self.written - before

    def _count_lost(self, name: str, number: int) -> None:
        """Count the gaps in a publisher's sequence numbers; a decrease means that it was restarted."""
        last = self.newest.get(name, number - 1)
        self.lost += max(0, number - last - 1)
        self.newest[name] = number

    def _write(self, name: str, stamp_ns: int, message: bytes) -> None:
        if self.writer is None:
            return
        try:
            self.writer.add_topic(self.topics[name])
            self.writer.write(name, stamp_ns, message)
            self.written += 1
        except OSError as error:
            self.fail(str(error))

    def fail(self, reason: str) -> None:
        """Stop recording and report the reason; the graph continues."""
        self.writer = None
        self.failure = reason
        self.get_logger().error(reason)
        self.report_change()

    def stop(self) -> None:
        """Write the messages still under way and close the bag."""
        quiet_since, last_ns = time.perf_counter(), time.time_ns() + int(LAST * 1e9)
        while self.newest_ns < last_ns:
            if self._drain(self.topics):
                quiet_since = time.perf_counter()
            missing = any(self.taken[name] < self.cycles for name in self.expected)
            if time.perf_counter() - quiet_since > (SLOW if missing else QUIET):
                break
            time.sleep(PAUSE)
        if self.writer is not None:
            try:
                self.writer.close()
            except OSError as error:
                self.fail(str(error))
            self.writer = None
        self.get_logger().info(f"{self.written} messages in {self.path}")

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the numbers of messages written and lost."""
        cycles = self.taken[LOADER_STATE.name]
        counts = {"written": self.written, "cycles": cycles, "lost": self.lost, "nodes_known": self.stock.known}
        figures = {"bag": self.path} | counts
        if self.failure:
            return ERROR, f"not recording: {self.failure}", figures
        if self.lost:
            return WARN, "messages were lost before they reached the recorder", figures
        if not self.is_active:
            return OK, "inactive", figures
        return OK, "recording" if cycles else "recording, no snapshot yet", figures


def _wanted(topic: Topic) -> QoSProfile:
    """Return the QoS profile that the recorder requests, including earlier messages where they are offered."""
    if topic in CYCLE_TOPICS:
        return control_qos(RECORDER_DEPTH)
    durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.transient_local else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=1000, durability=durability)


def _node_of(event: bytes) -> str:
    """Return the node that a serialized ParameterEvent concerns."""
    length = int.from_bytes(event[12:16], "little" if event[1:2] == b"\1" else "big")
    return event[16 : 16 + length].rstrip(b"\0").decode(errors="replace")


def main() -> NoReturn:
    """Run the node."""
    run_node(RecorderNode)


if __name__ == "__main__":
    main()
