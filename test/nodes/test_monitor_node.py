"""The monitor follows a graph without joining it: it finds changes, survives a kill, and keeps the record before a trip."""

import json
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from patience import PATIENCE
from rclpy.event_handler import PublisherEventCallbacks
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from benchmarks.spoilt_memory import make_monitor
from ehls_msgs.msg import Disturbance, LoaderState, ModelHealth, ValveCommand
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import load_spec
from ehls_ros.nodes.codec import Encoder
from ehls_ros.nodes.transport import control_qos
from ehls_ros.recording.bag_reader import is_closed, read_bag
from ehls_ros.recording.topics import DISTURBANCE, LOADER_STATE, VALVE_COMMAND, Topic
from ehls_ros.trajectory import Trajectory

GRAPH = ("reference_node", "disturbance_node", "friction_estimator_node", "fasmc_node")
RIG = Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"
WALL = 1_700_000_000 * 10**9
ADDED = 2.0e-12
"""Leakage of the rig in excess of its file [m^5/(N s)]."""


class Replay:
    """Sends a trajectory's messages, like the graph in which it was recorded."""

    def __init__(self, participant: Any, trajectory: Trajectory) -> None:
        self._node = participant.node
        self._trajectory = trajectory
        self.readers = dict[str, int]()
        self._topics = [
            (
                topic,
                Encoder(kind, "loader", sender="fasmc_node"),
                participant.node.create_publisher(kind, topic.name, control_qos(50_000), event_callbacks=self._counting(topic)),
            )
            for topic, kind in ((LOADER_STATE, LoaderState), (VALVE_COMMAND, ValveCommand), (DISTURBANCE, Disturbance))
        ]
        self._clock = participant.node.create_publisher(Clock, "/clock", control_qos(1))

    def _counting(self, topic: Topic) -> PublisherEventCallbacks:
        """Count all readers that ever joined a topic: a killed one seems to be present for a while."""

        def joined(matched: Any) -> None:
            self.readers[topic.name] = matched.total_count

        return PublisherEventCallbacks(matched=joined)

    def has(self, readers: int) -> bool:
        """Return whether as many have joined each topic."""
        return len(self.readers) == len(self._topics) and min(self.readers.values()) >= readers

    def send(self, first: int, last: int, epoch_ns: int = WALL) -> None:
        """Send the messages of some cycles."""
        self._clock.publish(Clock(clock=Time(sec=1)))
        rows = [self._rows(topic, first, last) for topic, *_ in self._topics]
        for cycle, values in zip(range(first, last), zip(*rows, strict=True), strict=True):
            for (_, encode, publisher), row in zip(self._topics, values, strict=True):
                publisher.handle.publish_raw(encode(epoch_ns + cycle * 10**6, cycle, *row))

    def close(self) -> None:
        """End, as a rig's process does: a live publisher repeats its messages to new readers."""
        for *_, publisher in self._topics:
            self._node.destroy_publisher(publisher)

    def _rows(self, topic: Topic, first: int, last: int) -> list[list[float]]:
        columns = [self._trajectory[name][first:last] for name in topic.signals.values()]
        return np.column_stack(columns).tolist()


@pytest.fixture(scope="module")
def leaky(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    """Return 75 s of a rig whose leakage exceeds its file's."""
    text = (
        "title: a leaky rig\nduration: 75.0\nrig: {rig}\neffects: [{{name: internal_leakage_shift, added: {added}}}]\n"
        "reference: {{name: sine, amplitude: 1.0e+4, frequency: 0.5}}\ncontroller: {{name: fasmc}}\n"
        "disturbance: {{name: force, signal: {{name: sine, amplitude: 5.0e+3, frequency: 1.0}}}}\n"
    )
    path = tmp_path_factory.mktemp("leaky") / "spec.yaml"
    path.write_text(text.format(rig=RIG, added=ADDED), encoding="utf-8")
    return run_in_process(load_spec(path))


def newest(heard: list[Any], condition: Callable[[Any], bool]) -> Callable[[], bool]:
    return lambda: bool(heard) and condition(heard[-1])


def says(diagnostics: list[DiagnosticArray], level: int, sentence: str) -> bool:
    """Return whether the monitor's newest diagnostics have a level, and begin with a sentence."""
    own = [s for array in diagnostics for s in array.status if s.name == "monitor_node"]
    return bool(own) and own[-1].level == bytes([level]) and own[-1].message.startswith(sentence)


@pytest.mark.long
def test_it_finds_what_differs_and_goes_on_after_a_kill(graph, participant, spec_file, tmp_path: Path, leaky: Trajectory):
    def start() -> None:
        graph.start("monitor_node", spec=spec_file(), timing="lockstep", learning_time=30.0, folder=tmp_path / "monitor")

    heard, diagnostics = participant.collect(ModelHealth, "model_health"), participant.collect(DiagnosticArray, "/diagnostics")
    replay = Replay(participant, leaky)
    start()
    participant.until(lambda: replay.has(readers=1))
    # More than it needs: a reader drops messages that arrive before it has discovered the sender.
    replay.send(0, 45_000)
    participant.until(newest(heard, lambda health: bool(health.changes)))
    replay.send(45_000, 55_000)
    participant.until(newest(heard, lambda health: health.watched > 0.0))
    health = heard[-1]
    [change] = health.changes
    assert (change.cause, change.group, change.active, change.acknowledged) == ("internal_leakage_shift", "flow", True, False)
    assert change.values[0] == pytest.approx(ADDED, abs=4.0 * change.deviations[0])
    assert change.sentence.startswith("rig: internal leakage ")
    assert 32 <= health.header.stamp.sec - WALL // 10**9 <= 55
    told = {coefficient.name: coefficient for coefficient in health.coefficients}
    assert any(c.told and 0.0 < c.deviation < abs(c.value) for c in told.values())
    assert all(math.isinf(c.deviation) and c.why_not for c in told.values() if not c.told)
    participant.until(lambda: says(diagnostics, 1, change.sentence))

    answer, repeated = participant.ask(Trigger, "monitor_acknowledge", Trigger.Request())
    assert answer.message == "internal_leakage_shift" or repeated
    participant.until(lambda: says(diagnostics, 0, f"acknowledged: {change.sentence}"))
    participant.until(newest(heard, lambda health: health.changes[0].acknowledged))
    graph.kill("monitor_node")
    replay.close()
    heard.clear()

    # The rig was restarted meanwhile, and its clock was set back.
    replay = Replay(participant, leaky)
    participant.until(lambda: replay.has(readers=1))
    start()
    participant.until(lambda: bool(heard) and replay.has(readers=2))
    replay.send(55_000, 75_000, WALL - 3600 * 10**9)
    participant.until(newest(heard, lambda health: health.watched > heard[0].watched))
    again = heard[-1]
    assert [(c.number, c.cause, c.acknowledged, c.since) for c in again.changes] == [(1, change.cause, True, change.since)]
    # It learns nothing anew, and is idle until the first cycle and after the last.
    assert {health.state for health in heard} <= {ModelHealth.WATCHING, ModelHealth.IDLE}


@pytest.mark.long
def test_a_trip_leaves_a_bag_and_a_monitor_that_hangs_holds_nobody_up(graph, participant, spec_file, tmp_path: Path):
    spec = spec_file(duration=1000.0)
    folder = tmp_path / "monitor"
    folder.mkdir()
    # Neither a spoilt memory nor foreign files keep it from starting, and they are preserved.
    make_monitor(folder, "memory.json")
    (folder / "learnt_0.npz").write_bytes(b"")
    (folder / "mine.npz").write_bytes(b"mine")
    own = {"spec": spec, "timing": "lockstep", "folder": folder, "flight_time": 3.0}
    monitor = graph.start("monitor_node", **own)
    heard, states = participant.collect(ModelHealth, "model_health"), participant.collect(LoaderState, "loader_state")
    participant.until(lambda: bool(heard))
    assert f"the monitor learns again: {folder / 'learnt_0.npz'}: the healthy rig cannot be used (it is empty)" in graph.log(
        "monitor_node"
    )
    # A second monitor in the folder would remove the files of the first.
    words = [word for key, value in own.items() for word in ("-p", f"{key}:={value}")]
    second = graph.run("second", ["-m", "ehls_ros.nodes.monitor_node", "--ros-args", *words, "-r", "__node:=monitor_node_2"])
    assert second.wait(PATIENCE) != 0
    assert "runs another monitor in the folder; expected another folder" in graph.log("second")
    for name in (*GRAPH, "plant_sim_node"):
        more = {"partners": ",".join(GRAPH), "speed": 4.0} if name == "plant_sim_node" else {}
        graph.start(name, spec=spec, timing="lockstep", **more)
    # A node that has just joined may miss the first messages of another.
    participant.until(lambda: bool(states))
    first = states[-1].cycle
    participant.until(lambda: states[-1].cycle > first + 12_000)
    assert participant.call(Trigger, "emergency_stop", Trigger.Request()).success
    participant.until(lambda: any(is_closed(bag) for bag in folder.glob("flights/*/bag")))
    [flight] = folder.glob("flights/*")
    found = read_bag(flight / "bag")
    # The monitor yields to all others: messages missed on a busy machine are a gap.
    assert 2.0 < found.time_s[-1] <= 3.001
    assert np.mean(np.isfinite(found["valve_command_m"])) > 0.5
    assert "emergency stop" in found.metadata["trip"]["cause"]
    participant.until(newest(heard, lambda health: health.state == ModelHealth.IDLE and "gate" in health.reason))
    assert all(not health.changes for health in heard)
    graph.freeze(monitor)
    cycle = states[-1].cycle
    participant.until(lambda: states[-1].cycle > cycle + 5000)
    monitor.send_signal(signal.SIGCONT)
    participant.until((flight / "diagnosis" / "diagnosis.json").exists)
    assert json.loads((flight / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))["verdict"]
    assert list(folder.glob("flights/*")) == [flight]
    assert (folder / "mine.npz").read_bytes() == b"mine"
    assert (folder / "aside-1" / "memory.json").exists()
