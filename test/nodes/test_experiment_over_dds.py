"""Complete experiments over DDS, one process per node."""

import dataclasses
import functools
import json
import re
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from ehls_command import ehls, trajectory_of
from layouts import series
from tiers import tiered

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from replayed import DEFAULT_PROFILE, Replay, stored_profile
from rosbags.rosbag2 import Reader

from ehls_msgs.msg import FrictionEstimate, ValveCommand
from ehls_ros.cli.main import main
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.nodes.latency import Latency
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.typestore import typestore


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
    """Use a position servo as disturbance."""
    servo = "disturbance: {name: position_servo, signal: {name: sine, amplitude: 0.05, frequency: 0.5}}"
    lines = [servo if line.startswith("disturbance") else line for line in spec.read_text().splitlines()]
    spec.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def over_dds(write_spec, tmp_path_factory):
    """Return a function that runs half a second with a controller, once for all tests, and returns spec and outcome."""

    @functools.cache
    def run(controller: str) -> tuple[Path, subprocess.CompletedProcess[str]]:
        folder = tmp_path_factory.mktemp(controller)
        spec = write_spec(folder, controller=controller)
        if controller == "fasmc_output_feedback":
            # The rig for which it is designed. config/experiments/ uses the same loop, which takes longest to compile.
            feeling_the_loader(spec)
            spec.write_text(f"{spec.read_text()}\neffects: [{{name: command_delay, delay: 1.0e-3}}]\n")
        if controller == "fasmc_predictive":
            feeling_the_loader(spec)
            more = "known_effects: [command_delay, coupling_stiffness]\ncompanions: [disturbance_preview]\n"
            spec.write_text(f"{spec.read_text()}\neffects: [{{name: command_delay, delay: 1.0e-3}}]\n{more}")
        return spec, ehls("experiment", spec, "--out", folder / "run", "--json")

    return run


@pytest.mark.long
def test_lockstep_is_deterministic(over_dds, tmp_path):
    spec, first = over_dds("fasmc")
    second = ehls("experiment", spec, "--out", tmp_path / "second", "--json", "--storage", "sqlite3")
    assert_same(trajectory_of(first), trajectory_of(second), relative=0.0)


# test_two_rigs.py shows the same for SIC.
@pytest.mark.parametrize("controller", tiered(["fasmc", "fasmc_output_feedback", "fasmc_predictive", "pid"], "fasmc"))
def test_lockstep_is_the_same_in_one_process(over_dds, tmp_path, controller):
    spec, done = over_dds(controller)
    recorded = trajectory_of(done)
    assert len(recorded) == 501
    assert not np.isnan(recorded["valve_command_m"]).any()
    assert_same(recorded, alone(spec, tmp_path / "alone"), relative=0.0 if controller == "pid" else 1e-9)
    if controller in {"fasmc_output_feedback", "fasmc_predictive"}:
        assert np.abs(recorded["disturbance_displacement_m"]).max() > 0.01, "the position servo does not react to the loader"


def on_friction_model(spec: Path, model: str) -> Path:
    """Give a spec the paper's rig with another friction model."""
    mapping = yaml.safe_load(spec.read_text())
    rig = yaml.safe_load(Path(mapping["rig"]).read_text())
    rig["friction"]["model"] = model
    spec.write_text(yaml.safe_dump({**mapping, "rig": rig}))
    return spec


@pytest.mark.long
def test_the_friction_model_of_the_rig_is_compensated(spec_file, tmp_path):
    model = next(name for name in FRICTION_MODELS.names() if name not in OBSERVERS.names())
    spec = on_friction_model(spec_file(), model)
    recorded = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "run", "--json"))
    assert np.ptp(recorded["friction_gms_n"]) > 600.0
    assert not recorded["friction_fallback"].any()
    assert_same(recorded, alone(spec, tmp_path / "alone"), relative=1e-9)


@pytest.mark.long
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
        "convergence_band_n", "oscillation_n", "causal_limit_n", "warnings",
        "cycles_per_second_asked", "cycles_per_second_reached", "in_real_time",
    }  # fmt: skip
    assert metrics["cycles"] == 501
    assert Path(metrics["report"]).stat().st_size > 1e5  # without plotly.js
    recorded = read_bag(Path(metrics["bag"]))
    assert recorded.metadata["rig"]["plant"]["moving_mass"] == 70.0
    assert recorded.metadata["spec"]["controller"]["k"] == 12.0
    assert recorded.metadata["versions"]["ehls_ros"]


def numbers(name: str, value) -> dict[str, float]:
    """Return the numbers in a message by the names PlotJuggler gives them; diagnostics are texts, some of them numbers."""
    if hasattr(value, "hardware_id"):
        texts = {f"{value.hardware_id}/{value.name}/{pair.key}": pair.value for pair in value.values}
        return {f"/diagnostics/{key}": float(text) for key, text in texts.items() if re.fullmatch(r"[-+.e\d]+", text)}
    if isinstance(value, bool | int | float | np.generic):
        return {name: float(value)}
    parts = {}
    if isinstance(value, list | np.ndarray):
        parts = {f"{name}[{i}]": part for i, part in enumerate(value)}
    elif dataclasses.is_dataclass(value):
        parts = {f"{name}/{field.name}": getattr(value, field.name) for field in dataclasses.fields(value)}
    return {key: number for child, part in parts.items() for key, number in numbers(child, part).items()}


def test_every_series_of_the_layouts_is_a_number_in_the_bag_of_a_whole_graph(over_dds):
    _, done = over_dds("fasmc")
    bag = Path(json.loads(done.stdout.splitlines()[-1])["bag"])
    found = {}
    with Reader(bag) as reader:
        for connection, _, raw in reader.messages():
            found |= numbers(connection.topic, typestore().deserialize_cdr(raw, connection.msgtype))
    # The diagnostics come once a second, and a run on a quick machine is over before that.
    latency = Latency()
    latency.add(1e-3)
    found |= {f"/diagnostics/ehls/fasmc_node/{name}": figure for name, figure in latency.figures().items()}
    missing = {name for name in series() if not np.isfinite(found.get(name, np.nan))}
    # A run follows either a force or a position, and the paper's rig has one pressure.
    of_chambers = {f"/ehls/chamber_pressures/pressure_{side}" for side in "ab"}
    assert missing == {"/ehls/position_reference/position", *of_chambers}


@pytest.mark.parametrize(
    "profile", [pytest.param(stored_profile, marks=pytest.mark.long), lambda _: DEFAULT_PROFILE], ids=["stored", "default"]
)
def test_a_replayed_bag_drives_estimator_and_controller(over_dds, graph, participant, profile):
    """Like `ros2 bag play`, whose default profile is volatile."""
    spec, done = over_dds("fasmc")
    recorded = trajectory_of(done)
    for name in ("friction_estimator_node", "fasmc_node"):
        graph.start(name, spec=spec, timing="lockstep")
    estimates = participant.collect(FrictionEstimate, "friction_estimate")
    commands = participant.collect(ValveCommand, "valve_command")
    replay = Replay(participant.node, spec.parent / "run" / "bag", ["loader_state", "force_reference"], profile)
    participant.until(lambda: replay.readers() >= 3 and len(participant.publishers("friction_estimate")) == 1)
    for topic, count in replay.play(participant.rest):
        if topic.endswith("loader_state"):
            # A delayed reader must not miss messages: the publisher keeps the last ten.
            participant.until(lambda count=count: len(estimates) > count - DEFAULT_PROFILE.depth // 2)
    participant.until(lambda: len(estimates) >= len(recorded) and commands)
    for field, signal in (("gms_force", "friction_gms_n"), ("viscous_force", "friction_viscous_n")):
        assert np.array_equal([getattr(estimate, field) for estimate in estimates], recorded[signal])
    assert np.array_equal([estimate.element_forces for estimate in estimates], recorded["friction_elements_n"])
    # On a busy machine the controller leaves cycles out, as it answers only the newest.
    answered = next((i for i, command in enumerate(commands) if command.cycle != i), len(commands))
    assert np.array_equal([command.spool for command in commands[:answered]], recorded["valve_command_m"][:answered])


@pytest.mark.long
def test_a_run_is_kept_whose_controller_cannot_write_what_it_has_learnt(ros_domain_id, tmp_path):
    kept, run = tmp_path / "kept", tmp_path / "run"
    spec = tmp_path / "spec.yaml"
    data = {
        "rig": str(Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"),
        "duration": 6.0,
        "reference": {"name": "sine", "amplitude": 4e3, "frequency": 2.5},
        "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 4e3, "frequency": 2.5}},
        "controller": {"name": "fasmc"},
        "companions": [{"name": "learning", "period": 0.4, "file": str(kept / "learnt.npz")}],
    }
    spec.write_text(yaml.safe_dump(data), encoding="utf-8")

    def remove_folder() -> None:
        while not any(file.stat().st_size > 50_000 for file in (run / "bag").glob("*.mcap")):
            time.sleep(0.01)
        kept.rename(tmp_path / "gone")

    removing = threading.Thread(target=remove_folder, daemon=True)
    removing.start()
    done = ehls("experiment", spec, "--out", run)
    removing.join()
    assert done.returncode == 1
    assert "fasmc_node ended with exit code 1" in done.stderr
    assert f"learnt arrays are lost: {kept / 'learnt.npz'}: cannot be written (No such file or directory)" in done.stderr
    assert {"bag", "metrics.json", "report.html"} <= {path.name for path in run.iterdir()}
    assert len(read_bag(run / "bag")) == 6001
