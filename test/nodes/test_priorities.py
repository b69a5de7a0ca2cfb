"""In realtime every node requests its priority, and receiver threads are never blocked by normal work."""

import contextlib
import os
from pathlib import Path

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray

from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import load_spec
from ehls_ros.hardware.realtime import preferring_what_starts, threads
from ehls_ros.nodes.graph import REALTIME_PRIORITY, SIMULATED, node_parameters

PRIORITY = 7


def permitted() -> bool:
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    os.sched_setscheduler(0, before, os.sched_param(0))
    return True


needs_permission = pytest.mark.skipif(not permitted(), reason="needs SCHED_FIFO permitted (RLIMIT_RTPRIO)")


def priorities(process: int) -> dict[str, set[tuple[int, int]]]:
    """Return scheduling class and priority of a process's threads: the middleware's, the loop's and others."""
    found: dict[str, set[tuple[int, int]]] = {"middleware": set(), "loop": set(), "others": set()}
    for task in Path(f"/proc/{process}/task").iterdir():
        # A thread may end meanwhile.
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            middleware = (task / "comm").read_text().startswith("dds.")
            kind = "middleware" if middleware else "loop" if int(task.name) == process else "others"
            number = int(task.name)
            found[kind].add((os.sched_getscheduler(number), os.sched_getparam(number).sched_priority))
    return found


@pytest.mark.parametrize(("timing", "asked"), [("realtime", REALTIME_PRIORITY), ("lockstep", None)])
def test_an_experiment_requests_the_priority_for_all_its_nodes(spec_file, tmp_path, timing, asked):
    folder = RunFolder.create(tmp_path / "run", "run", overwrite=False)
    parameters = node_parameters(load_spec(spec_file()), SIMULATED, folder, timing, "mcap")
    assert len(parameters) == 6
    assert {own.get("priority") for own in parameters.values()} == {asked}


# test_realtime_citizens.py shows the priorities of a background node.
@needs_permission
def test_a_loop_that_answers_and_its_receivers_have_the_priority(graph, participant, spec_file):
    process = graph.start("friction_estimator_node", spec=spec_file(), timing="realtime", priority=PRIORITY)
    heard = participant.collect(DiagnosticArray, "/diagnostics")
    participant.until(lambda: any(status.message == "running" for array in heard for status in array.status))
    found = priorities(process.pid)
    assert found["middleware"] == {(os.SCHED_FIFO, PRIORITY)}
    assert found["loop"] == {(os.SCHED_FIFO, PRIORITY)}


@needs_permission
def test_of_an_observer_only_the_receivers_get_priority():
    script = threads()
    with preferring_what_starts(PRIORITY):
        import rclpy

        context = rclpy.Context()
        rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        node = rclpy.create_node("visitor", context=context)
    try:
        assert {os.sched_getscheduler(thread) for thread in threads() - script} == {os.SCHED_FIFO}
        assert os.sched_getscheduler(0) != os.SCHED_FIFO
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
