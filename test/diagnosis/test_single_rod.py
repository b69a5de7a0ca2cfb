"""Diagnosis of a single rod: balances of both chambers, causes with their side, one pressure only, exchanged sensors."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from tiers import tiered

from ehls_ros.diagnosis.contradictions import check_suits
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.free_run import free_run
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import Comparison, setup, usable
from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import side_of
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.report.diagnosis_findings import noun_of
from ehls_ros.trajectory import OF_CHAMBERS, Preparation, Trajectory
from truth_generator import record

RIG_FILE = yaml.safe_load((Path(__file__).parents[2] / "config" / "rig_single_rod.yaml").read_text(encoding="utf-8"))
RIG = rig_from_mapping(RIG_FILE, "rig")

HIDDEN = {
    "external_leakage": ({"coefficient": 1e-12, "side": "a"}, "a"),
    "hose_compliance": ({"compliance": 3e-13, "side": "b"}, "b"),
    "entrained_air": ({"fraction": 0.01, "side": "b"}, "b"),
    "edge_gain": ({"factor": 0.9, "edge": "at", "side": "a"}, "a"),
    "edge_wear": ({"worn": 3e-5, "edge": "pb", "side": "b"}, "b"),
    "tank_pressure_shift": ({"offset": 3e5}, None),
    "pressure_sensor_bias": ({"bias": 1e5, "side": "b"}, "b"),
    "coulomb_shift": ({"offset": 60.0}, None),
}
"""Sizes of hidden effects, and their sides."""


def recorded(hidden=None, duration=10.0, seed=11, without=(), **more):
    made = record(RIG_FILE, hidden or {}, "rich", seed=seed, duration=duration, **more)
    return Trajectory(made.time, {name: values for name, values in made.columns.items() if name not in without})


def residuals(trajectory, rig=RIG):
    """Return the residuals of a recording, each over its measured quantity."""
    prepared = prepare(trajectory, rig, "case")
    comparison = Comparison(prepared, setup(prepared, rig))
    found = comparison.residuals(rig)
    return {c: np.std(values[20:-20]) / np.std(comparison.measured(rig, c)[20:-20]) for c, values in found.items()}


def test_a_recording_without_noise_leaves_nothing_in_either_chamber():
    left = residuals(recorded(noise=0.0))
    assert set(left) == {"spool", "volume_a", "volume_b", "supply", "force", "cell", "velocity"}
    # The commanded disturbance is linear between samples, and so are the measured states.
    assert left["volume_a"] < 2e-5
    assert left["volume_b"] < 2e-5
    assert left["supply"] < 1e-3


@pytest.mark.parametrize("without", tiered([{"pressure_a_pa"}, {"pressure_b_pa"}, {"supply_pressure_pa"}], {"pressure_b_pa"}))
def test_a_pressure_that_was_not_recorded_follows_from_the_others(without):
    left = residuals(recorded(noise=0.0, without=without))
    assert left["volume_a"] < 1e-4
    assert left["volume_b"] < 1e-4


def test_one_pressure_alone_leaves_the_flow_unjudged():
    found = residuals(recorded(without={*OF_CHAMBERS}))
    assert {"volume", "volume_a", "volume_b", "supply"}.isdisjoint(found)
    assert "force" in found


def test_the_load_pressure_follows_from_the_chambers_of_the_rig_file():
    trajectory = recorded(duration=2.0)
    a, b = (trajectory[signal] for signal in OF_CHAMBERS)
    # As on reading without areas, which takes them to be equal.
    wrong = Trajectory(trajectory.time_s, {**trajectory.signals, "load_pressure_pa": a - b}, preparation=Preparation())
    p = RIG.cylinder.parameters
    expected = (p.area_a * a - p.area_b * b) / RIG.plant.piston_area
    np.testing.assert_allclose(prepare(wrong, RIG, "case").signals["load_pressure_pa"], expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", tiered(HIDDEN, "external_leakage"))
def test_a_cause_is_named_with_its_side(name):
    sizes, side = HIDDEN[name]
    found = diagnose(recorded({name: sizes}, duration=20.0), RIG, threads=2)
    assert found.verdict == "effect"
    assert [(cause.name, cause.side) for cause in found.causes] == [(name, side)]
    chamber = {"a": " of chamber A", "b": " of chamber B", None: ""}[side]
    assert noun_of(found.causes[0]) == EFFECTS.load(name).WORDS.noun + chamber
    assert free_run(recorded({name: sizes}, duration=2.0), RIG, found.extended).signals


@pytest.mark.long
def test_a_healthy_rig_is_consistent():
    assert diagnose(recorded(duration=20.0), RIG, threads=2).verdict == "consistent"


@pytest.mark.parametrize("experiment", ["rich", "paper_sine"])
@pytest.mark.parametrize("without", [(), ("force_n",), ("force_n", "disturbance_force_n")])
def test_exchanged_pressures_are_refused(experiment, without):
    made = record(RIG_FILE, {"swapped_pressure_sensors": {"swapped": 1.0}}, experiment, seed=2, duration=4.0)
    signals = {name: values for name, values in made.columns.items() if name not in without}
    with pytest.raises(BadInput, match=r"pressure_a_pa and pressure_b_pa .* if they are swapped; expected the two col"):
        check_suits(Trajectory(made.time, signals), RIG, "case", fitted=True)
    a, b = OF_CHAMBERS
    right = {**signals, a: signals[b], b: signals[a]}
    assert check_suits(Trajectory(made.time, right), RIG, "case", fitted=True) == ()


@pytest.mark.parametrize(
    ("name", "values", "side"),
    [
        ("external_leakage", {"first": 1e-13}, "a"),
        ("external_leakage", {"first": 1e-13, "second": 1e-13}, "both"),
        ("external_leakage", {"each": 1e-13}, "both"),
        ("edge_wear", {"lap_pb": 1e-6, "round_bt": 1e-6}, "b"),
        ("edge_gain", {}, None),
        ("coulomb_shift", {"offset": 1.0}, None),
    ],
)
def test_side_of_an_effect(name, values, side):
    effect = EFFECTS.load(name)
    assert side_of(effect, effect.Parameters(**values)) == side


@pytest.mark.parametrize(
    ("effect", "reason"),
    [
        ({"name": "hose_compliance", "first": 1e-14}, "acts on a chamber, and cylinder double_rod has one pressure for both"),
        ({"name": "pressure_sensor_bias", "second": 1e4}, "second of effect 'pressure_sensor_bias' is 10000, which has no"),
    ],
)
def test_an_effect_of_a_chamber_is_refused_in_a_double_rod(effect, reason, rig_file):
    with pytest.raises(BadInput, match=reason):
        rig_from_mapping({**rig_file, "effects": [effect]}, "rig")


def test_friction_is_judged_after_the_first_sliding():
    prepared = prepare(recorded(duration=4.0), RIG, "case")
    comparison = Comparison(prepared, setup(prepared, RIG))
    window = comparison.setup.window_of("force")
    judged = window.mean(prepared.time)[usable(comparison, "force", RIG)]
    position = prepared.signals["position_m"]
    moved = np.abs(position - position[0]) > 2.0 * comparison.setup.presliding
    first = prepared.time[np.argmax(moved)]
    assert first < judged[0] < first + 0.5
