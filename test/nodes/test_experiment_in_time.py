"""Experiments over DDS with timing: in real time, interrupted, and with a node that dies."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ehls_command import ehls, trajectory_of
from patience import PATIENCE

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from rosbags.rosbag2 import Reader

from ehls_ros.experiments.compiling import announce_compiling, graph_jobs
from ehls_ros.experiments.spec import load_spec
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.topics import LOADER_STATE


@pytest.mark.long
@pytest.mark.usefixtures("one_realtime_graph")
def test_realtime_keeps_the_wall_clock_and_loses_no_sample(spec_file, tmp_path):
    spec = spec_file(duration=2.0, controller="pid")
    # A loop slow enough to tolerate late answers, and cycles long enough for a computer a tenth as fast; the force loop of a
    # stiff rig is neither.
    slow = "name: pid, proportional: 1.0, integral: 0.0"
    spec.write_text(f"{spec.read_text().replace('name: pid', slow)}control_period: 0.01\n")
    recorded = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "run", "--json", "--timing", "realtime"))
    assert np.array_equal(np.round(recorded.time_s * 1e2).astype(int), np.arange(201))
    assert not np.isnan(recorded["force_n"]).any()
    with Reader(tmp_path / "run" / "bag") as reader:
        states = [connection for connection in reader.connections if connection.topic == LOADER_STATE.resolve()]
        sent_s = np.array([stamp_ns for _, stamp_ns, _ in reader.messages(states)]) * 1e-9
    # A loop faster than the wall clock departs from it by up to the duration of the run; a delayed one regains two cycles.
    late_s = sent_s - recorded.time_s
    assert np.max(np.maximum.accumulate(late_s) - late_s) < 0.05
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text(encoding="utf-8"))
    # So does a slower one, unless the computer is slow; then the pace shows it, which is that of the bag.
    assert np.ptp(late_s) < 0.5 or not metrics["in_real_time"]
    assert metrics["cycles_per_second_asked"] == pytest.approx(100.0)
    reached = (200 - metrics["missed_cycles"]) / recorded.metadata["wall_s"]
    assert metrics["cycles_per_second_reached"] == pytest.approx(reached)
    assert metrics["in_real_time"] is (reached >= 99.0)


def long_run_under_way(spec_file, out: Path) -> subprocess.Popen[str]:
    """Start an endless experiment, and wait until its bag has more than the definitions and the first cycles."""
    spec = spec_file(duration=1000.0)
    # The command would announce kernels that no earlier test compiled.
    for compile_kernel in announce_compiling(graph_jobs(load_spec(spec))):
        compile_kernel()
    command = [sys.executable, "-m", "ehls_ros.cli.main", "experiment", str(spec)]
    process = subprocess.Popen([*command, "--out", str(out)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE
    bag = out / "bag" / "bag.mcap"
    while not (bag.exists() and bag.stat().st_size > 1_000_000):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return process


@pytest.mark.long
def test_ctrl_c_in_the_middle_closes_the_bag(spec_file, tmp_path):
    out = tmp_path / "run"
    process = long_run_under_way(spec_file, out)
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    # Before them there may be lines of progress.
    said = [f"the recording so far is kept in {out / 'bag'}", "ehls experiment: interrupted"]
    assert complaint.splitlines()[-2:] == said
    recorded = read_bag(out / "bag")
    assert len(recorded) > 100
    assert not np.isnan(recorded["force_n"]).any()


@pytest.mark.long
def test_a_node_that_dies_ends_the_experiment_with_its_reason(spec_file, tmp_path):
    out = tmp_path / "run"
    process = long_run_under_way(spec_file, out)
    [estimator] = children(process.pid, "friction_estimator_node")
    os.kill(estimator, signal.SIGTERM)
    _, complaint = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "friction_estimator_node ended" in complaint
    # Before the reason there may be lines of progress.
    assert len([line for line in complaint.splitlines() if line.startswith("ehls experiment:")]) == 1


def children(pid: int, word: str) -> list[int]:
    """Return the child processes whose command line contains a word."""
    started = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in started if word.encode() in Path(f"/proc/{child}/cmdline").read_bytes()]
