"""Effects without memory, each against a number worked out by hand; and effects that shift parameters."""

import math
from operator import attrgetter

import numpy as np
import pytest

from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.plant import FD, INPUTS, PL, TEMPERATURE, VD, XD, XV, V, X

STATE = {"x": X, "v": V, "pL": PL, "xv": XV}
INPUT = {"T": TEMPERATURE, "xd": XD, "vd": VD}
ATMOSPHERE = 101325.0

# Effect, parameters, hook, value before, state and inputs, value after. The paper's rig: ps = 7 MPa, ks = 40 kN/m, g = 9.81.
WORKED = [
    ("valve_null_bias", {"command": 2e-5}, "command", -1e-4, {}, -8e-5),
    ("valve_null_bias", {"opening": -3e-5}, "opening", 1e-5, {}, -2e-5),
    ("valve_gain_asymmetry", {"command_positive": 0.1, "command_negative": -0.2}, "command", 1e-4, {}, 1.1e-4),
    ("valve_gain_asymmetry", {"command_positive": 0.1, "command_negative": -0.2}, "command", -1e-4, {}, -0.8e-4),
    ("valve_gain_asymmetry", {"opening_positive": 0.5, "opening_negative": 0.3}, "opening", 2e-4, {}, 3e-4),
    ("valve_gain_asymmetry", {"opening_positive": 0.5, "opening_negative": 0.3}, "opening", -2e-4, {}, -2.6e-4),
    ("valve_saturation", {"command_limit": 3e-4}, "command", 5e-4, {}, 3e-4),
    ("valve_saturation", {"command_limit": 3e-4}, "command", -5e-4, {}, -3e-4),
    ("valve_saturation", {"opening_limit": 3e-4}, "opening", -2e-4, {}, -2e-4),
    ("valve_saturation", {"opening_limit": 3e-4}, "opening", -4e-4, {}, -3e-4),
    ("valve_dead_zone", {"positive": 2e-5, "negative": 5e-5}, "opening", 1e-4, {}, 8e-5),
    ("valve_dead_zone", {"positive": 2e-5, "negative": 5e-5}, "opening", -1e-4, {}, -5e-5),
    ("valve_dead_zone", {"positive": 2e-5, "negative": 5e-5}, "opening", -3e-5, {}, 0.0),
    # Mean overlap 40 um, corners of 4 um: ln 2 of one at the edge of the positive side.
    (
        "valve_dead_zone",
        {"positive": 3e-5, "negative": 5e-5, "rounding": 0.1},
        "opening",
        3e-5,
        {},
        4e-6 * math.log(2.0) - 4e-6 * math.log1p(math.exp(-20.0)),
    ),
    ("valve_dead_zone", {"positive": 3e-5, "negative": 5e-5, "rounding": 0.1}, "opening", -1e-3, {}, -9.5e-4),
    # The air has its whole volume at 1 atm, and (1/32)^(1/1.4) of it at 32 atm; it is 1.4 p stiff.
    ("entrained_air", {"load": 0.01}, "bulk_modulus", 7e8, {"pL": 0.0}, 1.0 / (1.0 / 7e8 + 0.01 / (1.4 * ATMOSPHERE))),
    (
        "entrained_air",
        {"load": 0.01},
        "bulk_modulus",
        7e8,
        {"pL": -31.0 * ATMOSPHERE},
        1.0 / (1.0 / 7e8 + 0.01 * 2.0 ** (-5.0 / 1.4) / (1.4 * 32.0 * ATMOSPHERE)),
    ),
    # One chamber at 7 MPa, the other at no more than the atmosphere's pressure.
    (
        "entrained_air",
        {"chambers": 0.02},
        "bulk_modulus",
        7e8,
        {"pL": 7e6},
        1.0
        / (
            1.0 / 7e8 + 0.01 / (1.4 * ATMOSPHERE) + 0.01 * (1.0 + 7e6 / ATMOSPHERE) ** (-1.0 / 1.4) / (1.4 * (7e6 + ATMOSPHERE))
        ),
    ),
    ("turbulent_leakage", {"coefficient": 1e-8}, "leakage", 1e-5, {"pL": 4e6}, 3e-5),
    ("turbulent_leakage", {"coefficient": 1e-8}, "leakage", 0.0, {"pL": -9e6}, -3e-5),
    # Chambers at 5 and 2 MPa.
    ("external_leakage", {"first": 2e-11}, "leakage", 1e-5, {"pL": 3e6}, 1e-5 + 5e-5),
    ("external_leakage", {"second": 2e-11}, "leakage", 0.0, {"pL": 3e6}, -2e-5),
    ("external_leakage", {"each": 2e-11}, "leakage", 0.0, {"pL": 3e6}, 3e-5),
    ("external_leakage", {"second": 2e-11}, "leakage", 0.0, {"pL": 9e6}, 0.0),
    ("coulomb_asymmetry", {"offset": 50.0}, "friction_level", 800.0, {"v": 0.1}, 850.0),
    ("coulomb_asymmetry", {"offset": 50.0}, "friction_level", 800.0, {"v": -0.1}, 750.0),
    ("coulomb_asymmetry", {"offset": 50.0}, "friction_level", 800.0, {"v": 0.0}, 800.0),
    ("coulomb_asymmetry", {"offset": 900.0}, "friction_level", 800.0, {"v": -0.1}, 1.0),
    ("coulomb_asymmetry", {"forward": 40.0, "backward": 30.0}, "friction_level", 800.0, {"v": 0.1}, 840.0),
    ("coulomb_asymmetry", {"forward": 40.0, "backward": 30.0}, "friction_level", 800.0, {"v": -0.1}, 830.0),
    ("coulomb_asymmetry", {"forward": 40.0, "backward": 30.0}, "friction_level", 800.0, {"v": 0.0}, 835.0),
    ("viscous_asymmetry", {"forward": 300.0, "backward": 200.0}, "force", 5.0, {"v": 0.1}, -25.0),
    ("viscous_asymmetry", {"forward": 300.0, "backward": 200.0}, "force", 5.0, {"v": -0.1}, 25.0),
    ("viscous_asymmetry", {"asymmetry": 300.0}, "force", 5.0, {"v": 0.1}, -25.0),
    ("viscous_asymmetry", {"asymmetry": 300.0}, "force", 5.0, {"v": -0.1}, -25.0),
    # At ln 3 / 2 turning speeds the hyperbolic tangent is a half.
    ("viscous_asymmetry", {"asymmetry": 300.0, "turning_speed": 0.2 / math.log(3.0)}, "force", 5.0, {"v": -0.1}, -10.0),
    ("stribeck_shift", {"tail_force": 90.0, "tail_velocity": 0.01}, "friction_level", 800.0, {"v": 0.0}, 890.0),
    ("stribeck_shift", {"tail_force": 90.0, "tail_velocity": 0.01}, "friction_level", 800.0, {"v": -0.02}, 818.0),
    ("pressure_dependent_friction", {"slope": 1e-4}, "friction_level", 800.0, {"pL": -2e6}, 1000.0),
    ("pressure_dependent_friction", {"slope": -1e-3}, "friction_level", 800.0, {"pL": 2e6}, 1.0),
    ("pressure_dependent_friction", {"slope": 1e-4, "saturation": 1e5}, "friction_level", 800.0, {"pL": -9e6}, 810.0),
    ("pressure_dependent_friction", {"slope": 1e-4, "exponent": 0.5}, "friction_level", 800.0, {"pL": -4e6}, 1000.0),
    ("pressure_dependent_friction", {"chamber_slope": 1e-4}, "friction_level", 800.0, {"pL": -2e6}, 600.0),
    ("pressure_dependent_friction", {"growth": 1e-7, "viscous_part": 5e3}, "friction_level", 800.0, {"pL": -2e6}, 960.0),
    ("pressure_dependent_friction", {"growth": 1e-7, "viscous_part": 5e3}, "force", 7.0, {"pL": -2e6, "v": 0.1}, -93.0),
    ("position_dependent_friction", {"slope": 1e3, "curvature": 1e4}, "friction_level", 800.0, {"x": -0.2}, 1000.0),
    ("position_dependent_friction", {"cubic": -1e4}, "friction_level", 800.0, {"x": -0.2}, 880.0),
    ("position_dependent_friction", {"slope": -1e4}, "friction_level", 800.0, {"x": 0.2}, 1.0),
    ("position_dependent_friction", {"sine": 30.0, "wavelength": 0.4}, "friction_level", 800.0, {"x": 0.1}, 830.0),
    ("position_dependent_friction", {"cosine": 30.0, "wavelength": 0.4}, "friction_level", 800.0, {"x": 0.2}, 770.0),
    ("temperature_dependent_friction", {"coulomb_slope": -50.0}, "friction_level", 800.0, {"T": 333.15}, 1.0),
    ("temperature_dependent_friction", {"viscous_slope": -60.0}, "force", 1.0, {"T": 323.15, "v": 0.1}, 61.0),
    ("spring_hardening", {"cubic": 1e7}, "force", 0.0, {"x": -0.02}, 80.0),
    ("spring_hardening", {"cubic": 1e7, "quintic": 1e10}, "force", 0.0, {"x": -0.02}, 112.0),
    # ks x is in (3) already; the additional force cancels it within the gap, and half a gap's worth beyond.
    ("hinge_backlash", {"gap": 4e-3}, "force", 0.0, {"x": 1e-3}, 40.0),
    ("hinge_backlash", {"gap": 4e-3}, "force", 0.0, {"x": -0.05}, -80.0),
    ("end_stop", {"upper": 0.1, "stiffness": 1e6, "damping": 1e3}, "force", 7.0, {"x": 0.099, "v": 1.0}, 7.0),
    ("end_stop", {"upper": 0.1, "stiffness": 1e6, "damping": 1e3}, "force", 7.0, {"x": 0.101, "v": 1.0}, 7.0 - 2000.0),
    ("end_stop", {"upper": 0.1, "stiffness": 1e6, "damping": 1e3}, "force", 7.0, {"x": 0.101, "v": -1.0}, 7.0 - 1000.0),
    ("end_stop", {"upper": 0.1, "stiffness": 1e6, "damping": 0.0, "exponent": 1.5}, "force", 7.0, {"x": 0.104}, 7.0 - 8000.0),
    ("end_stop", {"lower": -0.1, "stiffness": 1e6, "damping": 1e3}, "force", 7.0, {"x": -0.101, "v": -1.0}, 7.0 + 2000.0),
    ("end_stop", {"lower": -0.1, "stiffness": 1e6, "damping": 1e3}, "force", 7.0, {"x": -0.101, "v": 1.0}, 7.0 + 1000.0),
    ("flexible_mode", {"mass": 20.0, "taken": 0.5}, "force", 0.0, {}, -98.1),
    ("periodic_disturbance", {"sine": 30.0, "cosine": 7.0, "frequency": 2.0}, "force", 1.0, {"t": 0.125}, 31.0),
    ("periodic_disturbance", {"sine": 30.0, "cosine": 7.0, "frequency": 2.0}, "force", 1.0, {"t": 0.25}, -6.0),
    ("periodic_disturbance", {"second_sine": 5.0, "second_cosine": 3.0, "frequency": 2.0}, "force", 1.0, {"t": 0.0625}, 6.0),
    ("periodic_disturbance", {"second_sine": 5.0, "second_cosine": 3.0, "frequency": 2.0}, "force", 1.0, {"t": 0.125}, -2.0),
    ("constant_load", {"force": -40.0}, "force", 1.0, {}, -39.0),
    (
        "coupling_stiffness",
        {"stiffness": 1e5, "damping": 1e3},
        "force",
        0.0,
        {"x": 0.01, "v": 0.1, "xd": 0.03, "vd": 0.3},
        2200.0,
    ),
]


@pytest.mark.parametrize(("name", "parameters", "hook", "before", "given", "after"), WORKED)
def test_a_hook_gives_what_was_worked_out(name, parameters, hook, before, given, after, make_rig):
    effect = EFFECTS.load(name)
    y, w = np.zeros(7), np.zeros(INPUTS)
    w[TEMPERATURE] = 313.15
    for key, value in given.items():
        if key in STATE:
            y[STATE[key]] = value
        elif key in INPUT:
            w[INPUT[key]] = value
    p = effect.Parameters(**parameters)
    z = np.zeros(getattr(effect, "STATES", 0))
    got = getattr(effect, hook).py_func(before, given.get("t", 0.0), y, w, z, p, make_rig().plant)
    assert got == pytest.approx(after, rel=1e-12, abs=1e-18)


# Effect, parameters, the rig's changed coefficient, and its change from the paper's value.
SHIFTED = [
    ("valve_gain_shift", {"gain": 0.8}, "plant.valve_gain", 0.8),
    ("valve_gain_shift", {"flow_gain": 1.5}, "plant.discharge_coefficient", 0.93),
    ("valve_bandwidth_shift", {"factor": 0.5}, "plant.valve_bandwidth", 55.731853715),
    ("supply_pressure_shift", {"factor": 0.9}, "plant.supply_pressure", 6.3e6),
    ("bulk_modulus_shift", {"factor": 0.5}, "plant.bulk_modulus", 3.45e8),
    ("internal_leakage_shift", {"added": 1e-12}, "plant.leakage_coefficient", 5.7e-12),
    ("internal_leakage_shift", {"added": -1e-11}, "plant.leakage_coefficient", 0.0),
    ("mass_shift", {"factor": 1.2}, "plant.moving_mass", 84.0),
    ("spring_rate_shift", {"added": 5e3}, "plant.spring_stiffness", 4.5e4),
    ("spring_rate_shift", {"added": -5e4}, "plant.spring_stiffness", 0.0),
    ("flexible_mode", {"mass": 20.0, "taken": 0.5}, "plant.moving_mass", 60.0),
    ("flexible_mode", {"mass": 200.0, "taken": 1.0}, "plant.moving_mass", 0.7),
    ("coulomb_shift", {"offset": 100.0}, "friction.coulomb_force", 740.8),
    ("coulomb_shift", {"offset": 100.0}, "friction.static_force", 965.4),
    ("coulomb_shift", {"offset": -1000.0}, "friction.coulomb_force", 1.0),
    ("coulomb_shift", {"offset": 320.4, "stiffening": 1.0}, "friction.element_stiffness", (2.826e6, 2.9535e5, 2.7615e5)),
    ("coulomb_shift", {"offset": 100.0}, "friction.element_stiffness", (1.884e6, 1.969e5, 1.841e5)),
    ("viscous_shift", {"added": 735.0}, "friction.viscous_coefficient", 8000.0),
    ("viscous_shift", {"added": -1e4}, "friction.viscous_coefficient", 0.0),
    ("stribeck_shift", {"static_offset": 34.6}, "friction.static_force", 900.0),
    ("stribeck_shift", {"static_offset": -500.0}, "friction.static_force", 640.8),
    ("stribeck_shift", {"velocity_factor": 2.0}, "friction.stribeck_velocity", 4.062e-3),
    ("stribeck_shift", {"exponent_factor": 2.0}, "friction.stribeck_exponent", 1.7528),
    ("stribeck_shift", {"exponent_factor": 9.0}, "friction.stribeck_exponent", 4.0),
    ("presliding_stiffness_shift", {"factor": 2.0}, "friction.element_stiffness", (3.768e6, 3.938e5, 3.682e5)),
]


@pytest.mark.parametrize(("name", "parameters", "place", "value"), SHIFTED)
def test_a_shift_moves_what_it_says(name, parameters, place, value, make_rig):
    rig = make_rig(effects=[{"name": name, **parameters}])
    assert attrgetter(place)(rig.effective()) == pytest.approx(value, rel=1e-12)


def test_no_shift_is_applied_twice(make_rig):
    effective = make_rig(effects=[{"name": "mass_shift", "factor": 1.3}]).effective()
    assert effective.plant.moving_mass == pytest.approx(91.0)
    assert not hasattr(effective, "effective")
    assert effective.without_effects().effective().plant.moving_mass == effective.plant.moving_mass


def test_two_shifts_add_up(make_rig):
    rig = make_rig(effects=[{"name": "mass_shift", "factor": 1.5}, {"name": "flexible_mode", "mass": 5.0, "taken": 1.0}])
    assert rig.effective().plant.moving_mass == pytest.approx(100.0)


def test_a_preloaded_spring_changes_about_its_zero(make_rig):
    """At 5 mm, where the spring of 40 kN/m, with a constant load of 200 N, is free."""
    loaded = make_rig(effects=[{"name": "constant_load", "force": 200.0}])
    middle, about_zero = EFFECTS.load("spring_rate_shift").forms(loaded)
    assert not middle.fixed
    assert about_zero.fixed == {"zero": pytest.approx(5e-3)}
    stiffer = make_rig(
        effects=[{"name": "constant_load", "force": 200.0}, {"name": "spring_rate_shift", "added": 4e3, "zero": 5e-3}]
    )
    effective = stiffer.effective()
    assert effective.plant.spring_stiffness == pytest.approx(4.4e4)
    assert effective.effects[0].parameters.force == pytest.approx(220.0)


def test_a_preloaded_spring_that_is_lost_takes_its_preload_with_it(make_rig):
    lost = make_rig(
        effects=[{"name": "constant_load", "force": 200.0}, {"name": "spring_rate_shift", "added": -1e6, "zero": 5e-3}]
    ).effective()
    assert lost.plant.spring_stiffness == 0.0
    assert lost.effects[0].parameters.force == pytest.approx(0.0)


def test_a_mass_taken_over_by_a_flexible_mode_weighs_what_it_did(make_rig):
    """At rest, where the mode pulls only with the weight."""
    rig = make_rig(effects=[{"name": "flexible_mode", "mass": 20.0, "taken": 1.0}]).effective()
    force = EFFECTS.load("flexible_mode").force.py_func
    p = rig.effects[0].parameters
    pulled = force(0.0, 0.0, np.zeros(7), np.zeros(INPUTS), np.zeros(2), p, rig.plant)
    assert pulled - rig.plant.moving_mass * rig.plant.gravity == pytest.approx(-70.0 * 9.81)


@pytest.mark.parametrize("mass", [0.0, 0.02, 20.0])
def test_a_load_on_a_flexible_mass_at_rest_reaches_the_piston_in_full_however_light_the_mass(mass, make_rig):
    mode, plant = EFFECTS.load("flexible_mode"), make_rig(plant={"spring_stiffness": 0.0}).plant
    p = mode.Parameters(mass=mass, frequency=20.0, loaded=1.0)
    y, w, z, rates = np.zeros(7), np.zeros(INPUTS), np.zeros(2), np.zeros(2)
    w[FD] = 150.0
    mode.derivatives.py_func(0.0, 0.0, y, w, z, p, plant, rates)
    z[0] = rates[1] / (2.0 * math.pi * p.frequency) ** 2
    mode.derivatives.py_func(0.0, 0.0, y, w, z, p, plant, rates)
    np.testing.assert_allclose(rates, 0.0, atol=1e-9)
    assert mode.force.py_func(7.0, 0.0, y, w, z, p, plant) == pytest.approx(7.0)


@pytest.mark.parametrize("spool", [2e-4, -2e-4])
@pytest.mark.parametrize("pressure", [3e6, -3e6, 6.9e6, 9e6])
@pytest.mark.parametrize(
    ("resistance", "quadratic"), [(0.0, 0.0), (3e9, 0.0), (0.0, 4e12), (3e9, 4e12), (1e12, 0.0), (0.0, 1e16)]
)
def test_the_supply_loses_what_the_flow_through_the_valve_costs(resistance, quadratic, pressure, spool, make_rig):
    droop = EFFECTS.load("supply_pressure_droop")
    y = np.zeros(7)
    y[PL], y[XV] = pressure, spool
    p = droop.Parameters(resistance, quadratic)
    supply = droop.supply_pressure.py_func(7e6, 0.0, y, np.zeros(INPUTS), np.zeros(1), p, make_rig().plant)
    across = supply - math.copysign(1.0, spool) * pressure
    if math.copysign(1.0, spool) * pressure > 7e6:
        # The load drives the oil back: nothing is drawn from the supply.
        assert supply == 7e6
        return
    flow = 0.62 * 0.0267 * abs(spool) * math.sqrt(max(across, 0.0) / 840.0)
    lost = resistance * flow + quadratic * flow**2
    assert 0.0 <= supply <= 7e6
    assert supply == pytest.approx(max(7e6 - lost, 0.0), rel=1e-6)
