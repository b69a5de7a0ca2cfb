"""Whole experiments over DDS, each node its own process."""

import functools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from patience import PATIENCE

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from rosbags.rosbag2 import Reader

from ehls_ros.cli.main import main
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.topics import LOADER_STATE


def ehls(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "ehls_ros.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def trajectory_of(done: subprocess.CompletedProcess[str]):
    assert done.returncode == 0, done.stderr
    return read_bag(Path(json.loads(done.stdout.splitlines()[-1])["bag"]))


def assert_same(one, other, relative):
    names = set(one.signals) - {"response_s"}
    assert names == set(other.signals) - {"response_s"}
    assert len(one) == len(other)
    for name in names:
        scale = np.nanmax(np.abs(one[name])) * relative
        assert np.array_equal(np.isnan(one[name]), np.isnan(other[name])), name
        assert np.nanmax(np.abs(one[name] - other[name])) <= scale, name


def alone(spec: Path, folder: Path):
    """Run the same experiment without DDS, in this process."""
    assert main(["experiment", str(spec), "--out", str(folder), "--in-process"]) == 0
    return read_bag(folder / "bag")


def feeling_the_loader(spec: Path):
    """Let a position servo disturb the rig."""
    servo = "disturbance: {name: position_servo, signal: {name: sine, amplitude: 0.05, frequency: 0.5}}"
    lines = [servo if line.startswith("disturbance") else line for line in spec.read_text().splitlines()]
    spec.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def over_dds(write_spec, tmp_path_factory):
    """Return a function that returns the spec and the outcome of half a second under a controller, run once for all tests."""

    @functools.cache
    def run(controller: str) -> tuple[Path, subprocess.CompletedProcess[str]]:
        folder = tmp_path_factory.mktemp(controller)
        spec = write_spec(folder, controller=controller)
        if controller == "fasmc_output_feedback":
            # What it is meant for; of these loops, which take longest to compile, config/experiments/ has the same.
            feeling_the_loader(spec)
            spec.write_text(f"{spec.read_text()}\neffects: [{{name: command_delay, delay: 1.0e-3}}]\n")
        return spec, ehls("experiment", spec, "--out", folder / "run", "--json")

    return run


def test_lockstep_is_deterministic(over_dds, tmp_path):
    spec, first = over_dds("fasmc")
    second = ehls("experiment", spec, "--out", tmp_path / "second", "--json", "--storage", "sqlite3")
    assert_same(trajectory_of(first), trajectory_of(second), relative=0.0)


@pytest.mark.parametrize("controller", ["fasmc", "fasmc_output_feedback", "sic", "pid"])
def test_lockstep_is_the_same_in_one_process(over_dds, tmp_path, controller):
    spec, done = over_dds(controller)
    recorded = trajectory_of(done)
    assert len(recorded) == 501
    assert not np.isnan(recorded["valve_command_m"]).any()
    assert_same(recorded, alone(spec, tmp_path / "alone"), relative=0.0 if controller == "pid" else 1e-9)


def on_friction_model(spec: Path, model: str) -> Path:
    """Give a spec the paper's rig with another friction model."""
    mapping = yaml.safe_load(spec.read_text())
    rig = yaml.safe_load(Path(mapping["rig"]).read_text())
    rig["friction"]["model"] = model
    spec.write_text(yaml.safe_dump({**mapping, "rig": rig}))
    return spec


@pytest.mark.parametrize("model", [name for name in FRICTION_MODELS.names() if name not in OBSERVERS.names()])
def test_the_friction_model_of_the_rig_is_compensated(model, spec_file, tmp_path):
    spec = on_friction_model(spec_file(), model)
    recorded = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "run", "--json"))
    assert np.ptp(recorded["friction_gms_n"]) > 600.0
    assert not recorded["friction_fallback"].any()
    assert_same(recorded, alone(spec, tmp_path / "alone"), relative=1e-9)


def test_a_position_is_followed_over_dds(over_dds):
    _, done = over_dds("pid")
    recorded = trajectory_of(done)
    assert "force_reference_n" not in recorded
    assert np.max(np.abs(recorded["position_reference_rate_m_s"])) == 0.02
    assert not np.isnan(recorded["position_reference_m"]).any()
    assert np.max(np.abs(recorded["position_m"] - recorded["position_reference_m"])) < 0.5e-3
    metrics = json.loads(done.stdout.splitlines()[-1])
    assert metrics["max_error_n"] is None
    assert metrics["missed_cycles"] == 0
    assert "mm\n" in done.stdout


def test_the_run_folder_holds_what_the_contract_says(over_dds):
    spec, done = over_dds("fasmc")
    metrics = json.loads(done.stdout.splitlines()[-1])
    assert metrics == json.loads((spec.parent / "run" / "metrics.json").read_text())
    assert set(metrics) == {
        "max_error_n", "rms_error_n", "convergence_s", "cycles", "missed_cycles", "duration_s", "wall_s", "bag", "report",
        "convergence_band_n", "oscillation_n", "warnings",
        "cycles_per_second_asked", "cycles_per_second_reached", "in_real_time",
    }  # fmt: skip
    assert metrics["cycles"] == 501
    assert Path(metrics["report"]).stat().st_size > 1e6
    recorded = read_bag(Path(metrics["bag"]))
    assert recorded.metadata["rig"]["plant"]["moving_mass"] == 70.0
    assert recorded.metadata["spec"]["controller"]["k"] == 12.0
    assert recorded.metadata["versions"]["ehls_ros"]


def test_a_position_servo_feels_the_loader(spec_file, tmp_path):
    spec = spec_file(duration=0.3)
    feeling_the_loader(spec)
    recorded = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "dds", "--json"))
    assert np.abs(recorded["disturbance_displacement_m"]).max() > 0.01
    assert_same(recorded, alone(spec, tmp_path / "alone"), relative=1e-9)


@pytest.mark.usefixtures("one_realtime_graph")
def test_realtime_keeps_the_wall_clock_and_loses_no_sample(spec_file, tmp_path):
    spec = spec_file(duration=2.0, controller="pid")
    # A loop so slow that it bears a computer that keeps the controller waiting, and cycles so long that one a tenth as fast
    # keeps up with them; the force loop of a stiff rig does neither.
    slow = "name: pid, proportional: 1.0, integral: 0.0"
    spec.write_text(f"{spec.read_text().replace('name: pid', slow)}control_period: 0.01\n")
    recorded = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "run", "--json", "--timing", "realtime"))
    assert np.array_equal(np.round(recorded.time_s * 1e2).astype(int), np.arange(201))
    assert not np.isnan(recorded["force_n"]).any()
    with Reader(tmp_path / "run" / "bag") as reader:
        states = [connection for connection in reader.connections if connection.topic == LOADER_STATE.resolve()]
        sent_s = np.array([stamp_ns for _, stamp_ns, _ in reader.messages(states)]) * 1e-9
    # A loop that goes faster or slower than the wall's clock comes away from it by as much as it lasts.
    late_s = sent_s - recorded.time_s
    assert np.median(late_s) - late_s.min() < 0.5
    # However fast the computer is: what is said of the pace is what the bag shows.
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["cycles_per_second_asked"] == pytest.approx(100.0)
    reached = (200 - metrics["missed_cycles"]) / recorded.metadata["wall_s"]
    assert metrics["cycles_per_second_reached"] == pytest.approx(reached)
    assert metrics["in_real_time"] is (reached >= 99.0)


def long_run_under_way(spec_file, out: Path) -> subprocess.Popen[str]:
    """Start an experiment that does not end by itself, and wait until its bag grows."""
    command = [sys.executable, "-m", "ehls_ros.cli.main", "experiment", str(spec_file(duration=1000.0))]
    process = subprocess.Popen([*command, "--out", str(out)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE
    bag = out / "bag" / "bag.mcap"
    while not (bag.exists() and bag.stat().st_size > 100_000):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return process


def test_ctrl_c_in_the_middle_closes_the_bag(spec_file, tmp_path):
    out = tmp_path / "run"
    process = long_run_under_way(spec_file, out)
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert complaint.strip() == "ehls experiment: interrupted"
    recorded = read_bag(out / "bag")
    assert len(recorded) > 100
    assert not np.isnan(recorded["force_n"]).any()


def test_a_node_that_dies_ends_the_experiment_with_its_reason(spec_file, tmp_path):
    out = tmp_path / "run"
    process = long_run_under_way(spec_file, out)
    [estimator] = children(process.pid, "friction_estimator_node")
    os.kill(estimator, signal.SIGTERM)
    _, complaint = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "friction_estimator_node ended" in complaint
    assert len(complaint.strip().splitlines()) == 1


def children(pid: int, word: str) -> list[int]:
    """Return the processes that a process started and whose command line holds a word."""
    started = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in started if word.encode() in Path(f"/proc/{child}/cmdline").read_bytes()]
