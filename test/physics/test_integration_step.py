"""The step that resolves a rig: the rates of its parts, and the limits of the scheme."""

import math

import numpy as np
import pytest
import yaml
from rig_runs import rig_file_for

from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.integration_step import (
    DECAY,
    LONGEST_STEP,
    OSCILLATION,
    SHORTEST_STEP,
    check_step,
    rates,
    steps_per_period,
)
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import declarations


def ends_of_ranges():
    for name in EFFECTS.names():
        for declared in declarations(EFFECTS.load(name).Parameters):
            for end in {declared.minimum, declared.maximum} - {None}:
                yield pytest.param({"name": name, declared.name: end}, id=f"{name}.{declared.name}={end:g}")


@pytest.mark.parametrize("effect", list(ends_of_ranges()))
def test_no_effect_is_too_fast_anywhere_in_its_range(effect):
    mapping = yaml.safe_load(rig_file_for(effect["name"]).read_text(encoding="utf-8"))
    check_step(rig_from_mapping({**mapping, "effects": [effect]}, "rig"), SHORTEST_STEP, "rig.yaml")


def test_the_papers_rates_are_what_its_numbers_give(make_rig):
    found = {part.what: part.rate for part in rates(make_rig())}
    assert found["valve"] == pytest.approx(2.0 * math.pi * 17.74)
    assert found["oil column"] == pytest.approx(2.0 * math.pi * 67.1, rel=1e-3)
    assert found["presliding friction"] == pytest.approx(math.sqrt(2.265e6 / 70.0))
    assert found["damping"] == pytest.approx(7325.0 / 70.0)
    assert found["spring"] == pytest.approx(math.sqrt(4e4 / 70.0))


def test_the_stiffness_between_piston_and_load_acts_on_the_lighter_of_both(make_rig):
    hinge = {"name": "hinge_backlash", "load_gap": 1e-3, "piston_share": 0.1, "stiffness": 1e8}
    [stiff] = [part for part in rates(make_rig(effects=[hinge])) if part.further.startswith("stiffness")]
    assert "on 7 kg" in stiff.further
    assert stiff.rate == pytest.approx(math.sqrt(1e8 / 7.0))


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_the_rates_of_friction_are_those_of_its_model(make_rig, model):
    rig = make_rig(friction={"model": model})
    law, friction = rig.friction_law, rig.friction
    found = {part.what: part for part in rates(rig)}
    assert found["slipping friction"].rate == law.relaxation_rate(friction, rig.limits.velocity)
    assert "coulomb_force" in found["slipping friction"].keys
    assert ("presliding friction" in found) == math.isfinite(law.stiffness(friction))
    if "presliding friction" in found:
        assert all("stiffness" in key for key in found["presliding friction"].keys)
        assert found["presliding friction"].rate == pytest.approx(math.sqrt(2.265e6 / 70.0))


@pytest.mark.parametrize(
    ("plant", "friction", "part", "named"),
    [
        ({"moving_mass": 0.15}, {}, "damping", "on 0.15 kg"),
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
        check_step(rig, SHORTEST_STEP, "rig.yaml")
    assert f"the rate of the {part}," in caught.value.what
    assert named in caught.value.what
    longest = min(part.step for part in rates(rig))
    assert f"integration_step of at most {longest:.2g} s" in caught.value.expected
    check_step(rig, 0.99 * longest, "rig.yaml")


def released(rig, rate, product):
    """Velocities of a piston released at 1 m/s, one per step."""
    step = product / rate
    simulator = Simulator(rig, period=step, step=step)
    simulator.y[1] = 1.0
    velocities = []
    for _ in range(200):
        simulator.advance(0.0, 0.0, 0.0, 0.0, 0.0)
        velocities.append(simulator.y[1])
    return np.array(velocities)


@pytest.fixture
def free(make_rig):
    """A rig of 1 kg without hydraulics and friction, on a spring [N/m] and a damper [N s/m]."""

    def make(stiffness, damping):
        alone = {"bulk_modulus": 1e-6, "leakage_coefficient": 0.0, "gravity": 0.0, "moving_mass": 1.0}
        smooth = {"viscous_coefficient": 0.0, "coulomb_force": 1e-6, "static_force": 1e-6, "attraction_rate": 1e-9}
        return make_rig(
            plant={**alone, "spring_stiffness": stiffness, "viscous_damping": damping},
            friction={**smooth, "element_stiffness": [1e-6] * 3},
        )

    return make


def test_what_decays_does_so_at_the_step_asked_for_and_grows_beyond_the_schemes_limit(free):
    rig = free(0.0, 7325.0)
    assert abs(released(rig, 7325.0, DECAY)[-1]) < 1e-9
    assert abs(released(rig, 7325.0, 3.25)[-1]) < 1.0
    assert abs(released(rig, 7325.0, 3.35)[-1]) > 1.0


def test_an_undamped_oscillation_keeps_its_amplitude_at_the_step_asked_for_and_grows_beyond(free):
    rig = free(4e6, 0.0)
    kept = released(rig, 2000.0, OSCILLATION)
    assert np.abs(kept[-10:]).max() == pytest.approx(np.abs(kept[:10]).max(), rel=2e-3)
    assert np.abs(released(rig, 2000.0, 1.6 * OSCILLATION)[-10:]).max() > 2.0


@pytest.mark.parametrize(("stiffness", "steps"), [(4e6, 4), (1e8, 10), (1e12, 20)], ids=["slow", "fast", "too fast"])
def test_the_default_step_follows_the_fastest_part_down_to_what_is_plausible(free, stiffness, steps):
    """On 1 kg, 1e8 N/m oscillates at 1e4 rad/s, so 0.1 ms are needed; 1e12 N/m is refused."""
    rig = free(stiffness, 0.0)
    assert steps_per_period(rig, 1e-3) == steps
    assert steps_per_period(rig, 1e-3, 5e-4) == 2


def test_a_period_shorter_than_the_default_step_is_one_step(free):
    assert steps_per_period(free(4e6, 0.0), 0.4 * LONGEST_STEP) == 1
