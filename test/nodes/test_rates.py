"""Control cycles of 2 and 4 kHz: the same trajectory everywhere, recorded completely; a rig of another rate is refused."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from ehls_command import ehls, trajectory_of

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from emulated_rig import BLEND_IN, ROOT, own_port
from patience import PATIENCE
from std_srvs.srv import SetBool

from ehls_msgs.msg import LoaderState
from ehls_ros.cli.main import main
from ehls_ros.nodes.transport import MOST_KEPT, kept_at
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.topics import DEPTH

MEASURED = ROOT / "config" / "rig_paper_measured.yaml"
REFERENCE = {"name": "sine", "amplitude": 4e3, "frequency": 1.0}


def at(period: float, path: Path, **other: object) -> Path:
    """Write an experiment with a control period on the rig for which its controller is designed, with 1 ms of command delay."""
    disturbance = {"name": "force", "signal": {"name": "sine", "amplitude": 1e3, "frequency": 0.5}}
    rig = {"rig": str(MEASURED), "effects": [{"name": "command_delay", "delay": 1e-3}]}
    spec = {"title": "fast", **rig, "reference": REFERENCE, "disturbance": disturbance}
    path.write_text(yaml.safe_dump({**spec, "control_period": period, **other}), encoding="utf-8")
    return path


def assert_even(trajectory, cycles, period):
    """Check that all cycles are there, at their times."""
    assert len(trajectory) == cycles
    assert np.max(np.abs(np.diff(trajectory.time_s) - period)) < 1e-9
    assert not np.isnan(trajectory["valve_command_m"]).any()
    assert not np.isnan(trajectory["force_n"]).any()


@pytest.mark.parametrize(
    ("period", "cycles", "controller", "together"),
    [
        (2.5e-4, 1001, "sic", ("--compose",)),
        pytest.param(5e-4, 501, "fasmc_output_feedback", ("--compose",), marks=pytest.mark.long),
        pytest.param(2.5e-4, 1001, "fasmc_output_feedback", (), marks=pytest.mark.long),
    ],
    ids=["4 kHz, composed", "2 kHz, composed", "4 kHz, apart"],
)
def test_in_lockstep_a_fast_graph_is_the_loop_in_one_process_to_the_last_bit(tmp_path, period, cycles, controller, together):
    spec = at(period, tmp_path / "fast.yaml", duration=0.25, controller=controller)
    recorded = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "graph", "--json", *together))
    assert_even(recorded, cycles, period)
    assert main(["experiment", str(spec), "--out", str(tmp_path / "alone"), "--in-process"]) == 0
    alone = read_bag(tmp_path / "alone" / "bag")
    names = set(recorded.signals) - {"response_s"}
    assert names == set(alone.signals)
    for name in names:
        assert np.array_equal(recorded[name], alone[name], equal_nan=True), name


@pytest.fixture
def emulator(tmp_path):
    """Return a function that starts the emulated rig of an experiment and returns a bridge file for it."""
    running = []

    def start(spec: Path, *arguments: str) -> Path:
        bridge = yaml.safe_load((ROOT / "config" / "bridge_udp.yaml").read_text(encoding="utf-8"))
        bridge["backend"]["port"] = own_port()
        file = tmp_path / "bridge.yaml"
        file.write_text(yaml.safe_dump(bridge), encoding="utf-8")
        command = [sys.executable, "-m", "ehls_ros.cli.main", "rig-emulator", "--spec", str(spec), "--bridge", str(file)]
        running.append(subprocess.Popen([*command, *arguments], stdout=subprocess.DEVNULL, env=os.environ))
        return file

    yield start
    for process in running:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)


@pytest.mark.long
def test_a_rig_at_4_khz_is_followed_through_the_bridge(graph, participant, tmp_path, emulator):
    period = 2.5e-4
    spec = at(period, tmp_path / "fast.yaml", duration=1000.0, controller="fasmc_output_feedback")
    bridge = emulator(spec, "--lockstep", "--patience", str(PATIENCE))
    states = participant.collect(LoaderState, "loader_state")
    nodes = "hardware_bridge_node+reference_node+fasmc_output_feedback_node"
    given = {"spec": spec, "bridge": bridge, "timing": "lockstep", "enable_time": BLEND_IN}
    arguments = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
    graph.run("composed", ["-m", "ehls_ros.cli.main", "run", nodes, "--ros-args", *arguments])
    participant.until(lambda: participant.call(SetBool, "enable", SetBool.Request(data=True)).success)

    def is_followed() -> bool:
        """Return whether the reference has been followed for the last fifth of a second."""
        newest = states[-800:]
        time = np.array([state.cycle for state in newest]) * period
        wanted = REFERENCE["amplitude"] * np.sin(2.0 * np.pi * REFERENCE["frequency"] * time)
        return bool(np.max(np.abs([state.force for state in newest] - wanted)) < 0.025 * REFERENCE["amplitude"])

    participant.until(lambda: len(states) > 800 and is_followed())
    cycles = [state.cycle for state in states]
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))
    stamps_ns = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in states]
    assert stamps_ns == [cycle * 250_000 for cycle in cycles]
    assert graph.stop("composed") == 0


@pytest.mark.long
def test_a_rig_with_another_rate_than_the_experiments_is_not_enabled(graph, participant, tmp_path, emulator):
    """The law would mistake a sample of one millisecond for one of half a millisecond."""
    bridge = emulator(at(1e-3, tmp_path / "rig.yaml", controller="sic"))
    spec = at(5e-4, tmp_path / "fast.yaml", controller="sic", duration=1000.0)
    graph.start("reference_node", spec=spec)
    graph.start("sic_node", spec=spec)
    graph.start("hardware_bridge_node", spec=spec, bridge=bridge, enable_time=BLEND_IN)
    said = []

    def refused_for_it() -> bool:
        answer = participant.call(SetBool, "enable", SetBool.Request(data=True))
        said.append(answer.message)
        assert not answer.success
        return "times a second" in answer.message

    participant.until(refused_for_it)
    assert "control_period 0.0005 s means 2000: set one of them to the other's" in said[-1]


@pytest.mark.parametrize(("period", "kept"), [(1e-2, DEPTH), (1e-3, DEPTH), (5e-4, 2000), (2.5e-4, 4000), (1e-6, MOST_KEPT)])
def test_topics_of_the_cycles_keep_a_second_of_them(period, kept):
    assert kept_at(period) == kept
