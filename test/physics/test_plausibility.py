"""What a rig's numbers imply: rates the step has to resolve, relations that have to hold, impossible states."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.parameters import Limits, Plant
from ehls_ros.physics.plausibility import (
    ABORT_FACTOR,
    MAX_STEP_RATE,
    RANGES,
    beyond,
    check_rig,
    check_signal,
    check_step,
    implausible,
    rates,
)
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.physics.simulator import DEFAULT_STEP, Simulator
from ehls_ros.schema import declarations

ROOT = Path(__file__).parents[2]
RIGS = [*sorted((ROOT / "config").glob("rig_*.yaml")), *sorted((ROOT / "examples").rglob("rig*.yaml"))]
LIMITS = Limits(spool=0.01, force=1.82e4, load_pressure=7e6, position=(-0.1, 0.3), velocity=2.0)


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_the_rigs_that_come_along_are_rigs(path):
    rig = rig_from_mapping(yaml.safe_load(path.read_text(encoding="utf-8")), path.name)
    check_rig(rig, path.name)
    check_step(rig, DEFAULT_STEP, path.name)


def ends_of_ranges():
    for name in EFFECTS.names():
        for declared in declarations(EFFECTS.load(name).Parameters):
            for end in {declared.minimum, declared.maximum} - {None}:
                yield pytest.param({"name": name, declared.name: end}, id=f"{name}.{declared.name}={end:g}")


@pytest.mark.parametrize("effect", list(ends_of_ranges()))
def test_no_effect_is_too_fast_anywhere_in_its_range(make_rig, effect):
    check_step(make_rig(effects=[effect]), DEFAULT_STEP, "rig.yaml")


def test_ranges_name_what_there_is_and_hold_the_papers_rig_well_inside(make_rig):
    rig = make_rig()
    kinds = {"plant": Plant, "friction": type(rig.friction), "limits": Limits}
    for (section, key), (low, high) in RANGES.items():
        assert key in kinds[section]._fields
        assert low * 1.5 < getattr(getattr(rig, section), key) < high / 1.5


def test_the_papers_rates_are_what_its_numbers_give(make_rig):
    found = {part.what: part.rate for part in rates(make_rig())}
    assert found["valve"] == pytest.approx(2.0 * math.pi * 17.74)
    assert found["oil column"] == pytest.approx(2.0 * math.pi * 67.1, rel=1e-3)
    assert found["presliding friction"] == pytest.approx(math.sqrt(2.265e6 / 70.0))
    assert found["damping"] == pytest.approx(7325.0 / 70.0)
    assert found["spring"] == pytest.approx(math.sqrt(4e4 / 70.0))


def test_the_stiffness_between_piston_and_load_acts_on_the_lighter_of_both(make_rig):
    hinge = {"name": "hinge_backlash", "load_gap": 1e-3, "piston_share": 0.1, "stiffness": 1e8}
    found = {part.besides: part.rate for part in rates(make_rig(effects=[hinge]))}
    [basis] = [basis for basis in found if basis.startswith("stiffness")]
    assert "on 7 kg" in basis
    assert found[basis] == pytest.approx(math.sqrt(1e8 / 7.0))


@pytest.mark.parametrize(
    ("plant", "friction", "part", "named"),
    [
        ({"moving_mass": 0.2}, {}, "damping", "on 0.2 kg"),
        ({"valve_bandwidth": 5e4}, {}, "valve", "valve_bandwidth 50000 rad/s"),
        ({"total_volume": 1e-8}, {}, "valve's flow", "total_volume 1e-08 m^3"),
        ({"piston_area": 1.0}, {}, "oil column", "piston_area 1 m^2"),
        ({"spring_stiffness": 1e12}, {}, "spring", "spring_stiffness 1e+12 N/m"),
        ({}, {"element_stiffness": [1e15, 1.0, 1.0]}, "presliding friction", "element_stiffness 1e+15, 1, 1 N/m"),
        ({}, {"coulomb_force": 1e-3}, "slipping friction", "coulomb_force 0.001 N"),
    ],
)
def test_a_part_too_fast_is_named_with_the_step_it_needs(make_rig, plant, friction, part, named):
    rig = make_rig(plant=plant, friction=friction)
    with pytest.raises(BadInput) as caught:
        check_step(rig, 1e-4, "rig.yaml")
    assert f"the rate of the {part}," in caught.value.what
    assert named in caught.value.what
    fastest = max(part.rate for part in rates(rig))
    assert f"integration_step of at most {MAX_STEP_RATE / fastest:.2g} s" in caught.value.expected
    check_step(rig, 0.99 * MAX_STEP_RATE / fastest, "rig.yaml")


@pytest.mark.parametrize("factor", [0.9, 1.6])
def test_the_step_asked_for_is_where_the_scheme_begins_to_fail(make_rig, factor):
    """The piston coasts in its viscous damping: e-folding while the step resolves it, growing beyond 2.8."""
    rig = make_rig(
        plant={"bulk_modulus": 1e-6, "leakage_coefficient": 0.0, "gravity": 0.0, "spring_stiffness": 0.0, "moving_mass": 1.0},
        friction={"coulomb_force": 1e-6, "static_force": 1e-6, "element_stiffness": [1e-6] * 3, "attraction_rate": 1e-9},
    )
    step = factor * MAX_STEP_RATE / 7325.0
    simulator = Simulator(rig, period=step, step=step)
    simulator.y[1] = 1.0
    for _ in range(50):
        simulator.advance(0.0, 0.0, 0.0, 0.0, 0.0)
    assert (abs(simulator.y[1]) < 1.0) == (factor < 1.0)


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_every_friction_model_is_one_of_a_rig_on_the_papers(make_rig, model):
    rig = make_rig(friction={"model": model})
    check_rig(rig, "rig.yaml")
    check_step(rig, DEFAULT_STEP, "rig.yaml")


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


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_the_rates_of_friction_are_those_of_its_model(make_rig, model):
    rig = make_rig(friction={"model": model})
    law, friction = rig.friction_law, rig.friction
    found = {part.what: part for part in rates(rig)}
    assert found["slipping friction"].rate == law.relaxation_rate(friction, rig.limits.velocity)
    assert "coulomb_force" in found["slipping friction"].keys
    assert ("presliding friction" in found) == math.isfinite(law.stiffness(friction))
    if "presliding friction" in found:
        assert any("stiffness" in key for key in found["presliding friction"].keys)
        assert found["presliding friction"].rate == pytest.approx(math.sqrt(2.265e6 / 70.0))


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
