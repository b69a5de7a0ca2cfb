"""Implications of a rig's numbers: necessary relations, impossible states."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from reference_single_rod import SingleRodConstants

from ehls_ros.errors import BadInput
from ehls_ros.physics.cylinder import two_chamber
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.integration_step import LONGEST_STEP, check_step
from ehls_ros.physics.parameters import Limits, Plant
from ehls_ros.physics.plausibility import (
    ABORT_FACTOR,
    RANGES,
    beyond,
    check_rig,
    check_signal,
    implausible,
)
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import notes

ROOT = Path(__file__).parents[2]
RIGS = [*sorted((ROOT / "config").glob("rig_*.yaml")), *sorted((ROOT / "examples").rglob("rig*.yaml"))]
LIMITS = Limits(spool=0.01, force=1.82e4, load_pressure=7e6, position=(-0.1, 0.3), velocity=2.0)


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_the_rigs_that_come_along_are_rigs(path):
    rig = rig_from_mapping(yaml.safe_load(path.read_text(encoding="utf-8")), path.name)
    check_rig(rig, path.name)
    check_step(rig, LONGEST_STEP, path.name)


def test_ranges_name_what_there_is_and_hold_the_papers_rig_well_inside(make_rig):
    rig = make_rig()
    kinds = {"plant": Plant, "friction": type(rig.friction), "cylinder": two_chamber.Parameters, "limits": Limits}
    for (section, key), (low, high) in RANGES.items():
        assert key in kinds[section]._fields
        usual = notes(kinds[section])[key].typical if section == "cylinder" else getattr(getattr(rig, section), key)
        assert low * 1.5 < usual < high / 1.5


def test_areas_in_mm2_are_named(rig_data):
    rig = rig_from_mapping(SingleRodConstants(areas=(2000.0, 1000.0), volumes=(1e-3, 1e-3)).mapping(rig_data, "gms"), "rig")
    with pytest.raises(BadInput, match=r"area_a is 2000 m\^2; expected .*2000 mm\^2 is 0\.002 m\^2"):
        check_rig(rig, "rig")


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_every_friction_model_is_one_of_a_rig_on_the_papers(make_rig, model):
    rig = make_rig(friction={"model": model})
    check_rig(rig, "rig.yaml")
    check_step(rig, LONGEST_STEP, "rig.yaml")


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_a_friction_that_the_cylinder_cannot_overcome_is_refused(make_rig, model):
    rig = make_rig(friction={"model": model, "coulomb_force": 2e4, "static_force": 2e4})
    with pytest.raises(BadInput, match="a friction in N that the cylinder can overcome"):
        check_rig(rig, "rig.yaml")


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_a_stiffness_in_n_per_mm_is_refused_where_a_model_has_one(make_rig, model):
    rig = make_rig(friction={"model": model, "element_stiffness": [1884.0, 196.9, 184.1]})
    if math.isfinite(rig.friction_law.stiffness(rig.friction)):
        with pytest.raises(BadInput, match=r"travel to break-away.*1 N/mm is 1e3 N/m"):
            check_rig(rig, "rig.yaml")
    else:
        check_rig(rig, "rig.yaml")


def row(**values):
    readings = np.zeros((3, 7))
    order = ("position", "velocity", "load_pressure", "spool_position", "force", "supply_pressure", "oil_temperature")
    for signal, value in values.items():
        readings[1, order.index(signal)] = value
    return readings


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"velocity": math.nan}, "no longer finite"),
        ({"oil_temperature": math.inf}, "no longer finite"),
        ({"force": 1.83e5}, "force 1.83e+05 N, where the rig's limit is 18200 N"),
        ({"load_pressure": -1e296}, "load pressure -1e+296 Pa, where the rig's limit is -7e+06 Pa"),
        ({"position": -2.0}, "position -2 m, where the rig's limit is -0.1 m"),
        ({"position": 2.5, "velocity": 1e9}, "velocity 1e+09 m/s"),
    ],
)
def test_an_impossible_state_is_named_with_advice(values, words):
    found = implausible(row(**values), LIMITS)
    assert found is not None
    assert found.row == 1
    assert words in found.what
    assert "integration_step" in found.what


def test_a_state_just_within_ten_times_the_limits_is_possible(make_rig):
    near = row(force=0.999 * ABORT_FACTOR * 1.82e4, load_pressure=-0.999 * ABORT_FACTOR * 7e6, velocity=19.9, position=2.0)
    assert implausible(near, LIMITS) is None
    assert beyond(near[:, 4], LIMITS, "force", 1.05) is not None


def test_a_simulator_says_what_has_become_of_it(make_rig):
    simulator = Simulator(make_rig())
    simulator.measure(np.zeros(7))
    assert simulator.trouble() == ""
    simulator.y[1] = 1e30
    simulator.measure(np.zeros(7))
    assert "velocity 1e+30 m/s" in simulator.trouble()
    simulator.y[2] = math.nan
    simulator.measure(np.zeros(7))
    assert "no longer finite" in simulator.trouble()
    assert "(at 0 s)" in simulator.trouble()


def sine(amplitude, frequency):
    t = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 4096))
    omega = 2.0 * math.pi * frequency
    return np.column_stack([amplitude * np.sin(omega * t), omega * amplitude * np.cos(omega * t)])


@pytest.mark.parametrize(
    ("rows", "part", "kind", "said"),
    [
        (sine(5e4, 1.0), "reference", "force", "2 times -18200 to 18200 N"),
        (sine(50.0, 1.0), "reference", "position", "limits.position; is it in m?"),
        (sine(5e5, 1.0), "disturbance", "force", "10 times -18200 to 18200 N"),
        (sine(1e4, 600.0), "reference", "force", "a shorter control_period"),
        (np.array([[math.nan, 0.0]]), "reference", "force", "finite numbers"),
    ],
)
def test_a_signal_that_a_rig_cannot_follow_or_bear_is_refused(make_rig, rows, part, kind, said):
    with pytest.raises(BadInput) as caught:
        check_signal(rows, part, kind, make_rig(), 1e-3, f"spec.yaml: {part}")
    assert said in str(caught.value)


@pytest.mark.parametrize("rows", [sine(3e4, 1.0), sine(1e3, 400.0), np.array([[1e4, 0.0]] * 5), sine(0.0, 0.0)])
def test_a_signal_that_only_asks_much_is_not(make_rig, rows):
    check_signal(rows, "reference", "force", make_rig(), 1e-3, "spec.yaml: reference")
