"""Output of `ehls foxglove` to a viewer, requested over a WebSocket like Foxglove."""

import json
import signal
import socket
import struct
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pytest
import yaml
from patience import PATIENCE

pytest.importorskip("foxglove", reason="foxglove-sdk, of the extra foxglove, is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.sync.client import connect

from ehls_ros.cli.main import main
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import load_spec
from ehls_ros.extras import install_command
from ehls_ros.process import Stopping
from ehls_ros.recording.bag_writer import write_trajectory
from ehls_ros.recording.topics import CYCLE_TOPICS
from ehls_ros.report.foxglove import TICK, play
from ehls_ros.trajectory import Trajectory

CONFIG = Path(__file__).resolve().parents[2] / "config"
MESSAGE = struct.Struct("<BIQ")
MESSAGE_DATA = 1
SAMPLES = 300
START_S = 5.0


class Received(NamedTuple):
    topic: str
    time_ns: int
    fields: Any


class Viewer:
    """Subscribes to every topic and decodes the messages with only the advertised schemas."""

    def __init__(self, address: str) -> None:
        self._opening = connect(address, subprotocols=["foxglove.sdk.v1"], open_timeout=PATIENCE, ping_interval=None)
        self.topics: dict[str, str] = {}
        self.received: list[Received] = []
        self._types: dict[str, Any] = {}

    def __enter__(self) -> Self:
        self.connection = self._opening.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._opening.__exit__(*error)

    def ask(self) -> None:
        while (told := json.loads(self.connection.recv(PATIENCE)))["op"] != "advertise":
            pass
        for channel in told["channels"]:
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            self.topics[channel["topic"]] = channel["schemaName"]
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
            self._types[channel["topic"]] = store
        topics = {channel["id"]: channel["topic"] for channel in told["channels"]}
        wishes = [{"id": number, "channelId": number} for number in topics]
        self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wishes}))
        self._topic_of = topics

    def take(self, count: int) -> list[Received]:
        """Return the next ``count`` messages."""
        taken: list[Received] = []
        while len(taken) < count:
            data = self.connection.recv(PATIENCE)
            if isinstance(data, bytes) and data[0] == MESSAGE_DATA:
                _, number, time_ns = MESSAGE.unpack_from(data)
                topic = self._topic_of[number]
                fields = self._types[topic].deserialize_cdr(data[MESSAGE.size :], self.topics[topic])
                taken.append(Received(topic, time_ns, fields))
        return taken


@pytest.fixture
def stream() -> Iterator[Callable[..., str]]:
    """Return a function that starts the command and returns its address; the command must exit with success."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: object) -> str:
        command = [sys.executable, "-m", "ehls_ros.cli.main", "foxglove", *map(str, arguments), "--port", "0"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        return process.stdout.readline().strip()

    yield start
    for process in started:
        process.send_signal(signal.SIGINT)
    for process in started:
        process.communicate(timeout=PATIENCE)
        assert process.returncode == 0


@pytest.fixture
def recorded() -> Trajectory:
    random = np.random.default_rng(3)
    names = ("force_n", "load_pressure_pa", "force_reference_n", "valve_command_m", "friction_gms_n", "alpha", "force_error_n")
    signals = {name: random.normal(size=SAMPLES) for name in names}
    signals["friction_elements_n"] = random.normal(size=(SAMPLES, 3))
    signals["friction_slipping"] = random.integers(0, 2, (SAMPLES, 3)).astype(float)
    return Trajectory(START_S + np.arange(SAMPLES) / 1000, signals)


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    mapping = yaml.safe_load((CONFIG / "experiments" / "sine_fd2.yaml").read_text(encoding="utf-8"))
    mapping |= {"rig": yaml.safe_load((CONFIG / "rig_paper.yaml").read_text(encoding="utf-8")), "duration": 2.2}
    path = tmp_path / "spec.yaml"
    path.write_text(yaml.safe_dump(mapping), encoding="utf-8")
    return path


def messages_in(trajectory: Trajectory) -> int:
    """Return the number of messages, one per sample and topic with a signal of the trajectory."""
    return len(trajectory) * sum(bool(trajectory.signals.keys() & set(topic.signals.values())) for topic in CYCLE_TOPICS)


def assert_shows(received: list[Received], namespace: str, wanted: Trajectory) -> None:
    """Check that the messages of a namespace equal a trajectory, to the last bit."""
    by_topic: dict[str, list[Received]] = defaultdict(list)
    for message in received:
        by_topic[message.topic].append(message)
    for topic in CYCLE_TOPICS:
        known = {field: signal for field, signal in topic.signals.items() if signal in wanted}
        messages = by_topic[topic.resolve(namespace)]
        assert len(messages) == (len(wanted) if known else 0), topic.name
        for field, name in known.items():
            assert np.array_equal([getattr(message.fields, field) for message in messages], wanted[name]), name
        if known:
            assert [message.fields.cycle for message in messages] == list(range(len(wanted)))


@pytest.mark.long
def test_a_recording_and_a_simulation_come_on_one_clock(recorded, spec, stream, tmp_path):
    write_trajectory(tmp_path / "bag", recorded)
    simulated = run_in_process(load_spec(spec))
    with Viewer(stream(tmp_path / "bag", "--simulate", spec, "--rate", 10)) as viewer:
        viewer.ask()
        received = viewer.take(messages_in(recorded) + messages_in(simulated))

    assert {topic.split("/")[1] for topic in viewer.topics} == {"ehls", "sim"}
    assert_shows(received, "/ehls", recorded)
    assert_shows(received, "/sim", simulated)
    times = [message.time_ns for message in received]
    assert times == sorted(times)
    for message in received:
        assert message.fields.header.stamp.sec * 10**9 + message.fields.header.stamp.nanosec == message.time_ns
    for topic, count in (("/ehls/loader_state", SAMPLES), ("/sim/loader_state", len(simulated))):
        shown = [message.time_ns for message in received if message.topic == topic]
        assert shown == [round(START_S * 1e9) + 10**6 * k for k in range(count)]


def test_who_comes_after_all_have_left_sees_it_from_the_start_and_only_this_machine_sees_it(recorded, stream, tmp_path):
    write_trajectory(tmp_path / "bag", recorded)
    address = stream(tmp_path / "bag", "--rate", 100)
    for _ in range(2):
        with Viewer(address) as viewer:
            viewer.ask()
            assert_shows(viewer.take(messages_in(recorded)), "/ehls", recorded)
    host, _, port = address.removeprefix("ws://").partition(":")
    assert host == "127.0.0.1"
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", int(port)), timeout=PATIENCE)


class Clock:
    """A wall clock without waiting; it also replaces the event that ends a playback."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now

    def wait(self, seconds: float) -> None:
        self.now += seconds

    def is_set(self) -> bool:
        return False


def test_messages_are_sent_when_they_are_due(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("ehls_ros.report.foxglove.time", clock)
    sent: list[tuple[float, int]] = []
    messages = [(k * 50_000_000, "topic", b"") for k in range(100)]
    play(messages, 20.0, lambda m: sent.append((clock.now, m[0])), lambda _: None, clock)
    assert [time_ns for _, time_ns in sent] == [time_ns for time_ns, _, _ in messages]
    assert all(0.0 <= after - 1e-9 * time_ns / 20.0 <= TICK + 1e-9 for after, time_ns in sent)


def test_a_play_that_is_stopped_sends_nothing_more():
    stopping = Stopping()
    sent: list[int] = []
    messages = [(0, "topic", b""), (3600 * 10**9, "topic", b"")]
    play(messages, 1.0, lambda m: sent.append(m[0]), lambda _: stopping.set(), stopping)
    assert sent == [0]


def complaint(capsys, *arguments: object) -> str:
    assert main(["foxglove", *map(str, arguments)]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    return line


def test_without_the_extra_it_says_which(monkeypatch, spec, capsys):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    monkeypatch.delitem(sys.modules, "ehls_ros.report.foxglove")
    assert install_command("foxglove") in complaint(capsys, "--simulate", spec)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "nothing to stream"),
        (("--simulate", "x.yaml", "--rate", "0"), "--rate is 0"),
        (("--simulate", "x.yaml", "--rate", "nan"), "--rate is nan"),
        (("--simulate", "x.yaml", "--host", "localhost "), "an IP address"),
        (("--simulate", "x.yaml", "--port", "70000"), "--port is 70000"),
        (("--simulate", "x.yaml", "--columns", "y.yaml"), "data with it"),
        (("nowhere.csv",), "nowhere.csv"),
    ],
)
def test_bad_input(arguments, words, capsys):
    assert words in complaint(capsys, *arguments)


def test_a_port_that_is_taken(recorded, tmp_path, capsys):
    write_trajectory(tmp_path / "bag", recorded)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert "--port" in complaint(capsys, tmp_path / "bag", "--port", taken.getsockname()[1])
