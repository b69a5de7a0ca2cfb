"""The end of a node: by the lifecycle's shutdown, after which it stays silent, and with the process that started it."""

import os
import time
from pathlib import Path

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from patience import PATIENCE

from ehls_msgs.msg import ControllerStatus
from ehls_ros.nodes.control import PARENT
from ehls_ros.nodes.shared_memory import SHARED_MEMORY, used_by

TOPICS = {
    "fasmc_node": "valve_command",
    "plant_sim_node": "loader_state",
    "reference_node": "force_reference",
    "disturbance_node": "disturbance",
    "friction_estimator_node": "friction_estimate",
}


@pytest.mark.long
def test_a_node_shut_down_while_active_stops_publishing(graph, participant, spec_file):
    spec = spec_file(duration=1000.0)
    for name in TOPICS:
        graph.start(name, spec=spec, timing="lockstep")
    statuses = participant.collect(ControllerStatus, "controller_status")
    participant.until(lambda: len(statuses) > 200, PATIENCE)

    for name, topic in TOPICS.items():
        assert participant.change(name, "shutdown"), name
        assert participant.state_of(name) == "finalized"
        participant.until(lambda topic=topic: participant.node.count_publishers(topic) == 0, PATIENCE)
        assert not participant.change(name, "configure")
    for name in TOPICS:
        assert graph.stop(name) == 0, graph.log(name)
        assert "Traceback" not in graph.log(name)


def test_a_node_ends_with_the_process_that_started_it(graph, monkeypatch):
    monkeypatch.setenv(PARENT, str(os.getpid()))
    child = graph.start("reference_node")
    monkeypatch.setenv(PARENT, str(child.pid))
    orphan = graph.start("disturbance_node")
    assert orphan.wait(PATIENCE) == 0
    assert "the process that started this node has ended" in graph.log("disturbance_node")
    assert graph.stop("reference_node") == 0
    assert "has ended" not in graph.log("reference_node")


def users_of(file: Path) -> list[str]:
    """Return the command lines of the processes that use a shared-memory file."""
    pids = [process.name for process in Path("/proc").glob("[0-9]*") if file in used_by(int(process.name))]
    return [f"{pid}: {Path(f'/proc/{pid}/cmdline').read_bytes().replace(bytes(1), b' ').decode()}" for pid in pids]


@pytest.mark.parametrize("name", ["fasmc_node", "plant_sim_node"])
def test_a_node_that_ends_leaves_nothing_in_shared_memory(graph, spec_file, name):
    before = set(SHARED_MEMORY.iterdir())
    node = graph.start(name, spec=spec_file(duration=1000.0), timing="lockstep")
    deadline = time.monotonic() + PATIENCE
    while ": up" not in graph.log(name):
        assert time.monotonic() < deadline, graph.log(name)
        time.sleep(0.05)
    # Without a participant of the test, whose segments it would use too. Ports may belong to other processes, or killed ones.
    new = used_by(node.pid) - before
    segments = [file for file in new if file.name.startswith("fast") and "_port" not in file.name]
    assert segments
    assert graph.stop(name) == 0
    left = {file: users_of(file) for file in segments if file.exists()}
    assert not left
