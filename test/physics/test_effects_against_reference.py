"""Effects against a solution that shares no code with them, several at once, stage by stage and across stages."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from reference_effects import plant_with
from reference_solver import Constants, solve
from rig_runs import PERIOD, run, stage_effects
from tiers import tiered

from ehls_ros.physics.simulator import Simulator

PAPER = Constants()
STEP = 2.5e-5


@dataclass(frozen=True)
class Case:
    """Effects of a rig file, the corresponding coefficients of the reference, and the largest deviation."""

    effects: list[dict[str, Any]]
    numbers: dict[str, Any]
    tolerance: float
    constants: Constants = PAPER


LOSS = {"resistance": 2e9, "quadratic": 3e12}
MODE = {"mass": 20.0, "frequency": 30.0, "damping": 0.05}
CASES = {
    "valve": Case(
        stage_effects(
            "valve",
            {
                "command_delay": {"delay": 1.37e-3},
                "valve_null_bias": {"command": 4e-5},
                "valve_second_order": {"natural_frequency": 300.0, "damping": 0.4},
            },
        ),
        {"delay": 1.37e-3, "bias": 4e-5, "natural": 300.0, "damping": 0.4},
        1e-7,
    ),
    "flow": Case(
        stage_effects(
            "flow",
            {
                "supply_pressure_droop": LOSS,
                "entrained_air": {"chambers": 0.01},
                "external_leakage": {"first": 2e-11},
                "turbulent_leakage": {"coefficient": 1e-8},
            },
        ),
        {"laminar": 2e9, "turbulent": 3e12, "air": 0.01, "outward": 2e-11, "scratch": 1e-8},
        # The root in the leakage has no slope at pL = 0.
        1e-5,
    ),
    "a loss that lags": Case(
        stage_effects("flow", {"supply_pressure_droop": {**LOSS, "time_constant": 0.02}}),
        {"laminar": 2e9, "turbulent": 3e12, "settling": 0.02},
        1e-7,
    ),
    "friction": Case(
        stage_effects(
            "friction",
            {
                "coulomb_asymmetry": {"offset": 60.0},
                "viscous_asymmetry": {"asymmetry": 400.0},
                "pressure_dependent_friction": {"slope": 5e-5},
                "position_dependent_friction": {
                    "slope": 2e3,
                    "curvature": 3e4,
                    "sine": 40.0,
                    "cosine": 20.0,
                    "wavelength": 0.02,
                },
            },
        ),
        {
            "one_way": 60.0,
            "viscous_one_way": 400.0,
            "squeeze": 5e-5,
            "slope": 2e3,
            "bend": 3e4,
            "sine": 40.0,
            "cosine": 20.0,
            "wavelength": 0.02,
        },
        5e-6,
    ),
    "mechanics": Case(
        stage_effects(
            "mechanics",
            {
                "spring_hardening": {"cubic": 1e7},
                "hinge_backlash": {"gap": 4e-3},
                "end_stop": {"upper": 4e-3, "stiffness": 2e6, "damping": 2e3},
                "flexible_mode": {**MODE, "taken": 0.75},
            },
        ),
        {
            "cubic": 1e7,
            "gap": 4e-3,
            "stop": 4e-3,
            "stop_stiffness": 2e6,
            "stop_damping": 2e3,
            "mass": 20.0,
            "mode_frequency": 30.0,
            "mode_damping": 0.05,
            "taken": 0.75,
        },
        # Damping sets in abruptly at the stop, in the middle of a step.
        5e-4,
        replace(PAPER, m0=PAPER.m0 - 15.0),
    ),
    "a load behind a play": Case(
        stage_effects(
            "mechanics",
            {
                "hinge_backlash": {
                    "load_gap": 3e-4,
                    "piston_share": 0.3,
                    "stiffness": 2e7,
                    "damping": 5e3,
                    "rounding": 0.1,
                },
                "spring_hardening": {"cubic": 1e7},
            },
        ),
        {"piston": 0.3 * PAPER.m0, "play": 3e-4, "rounding": 0.1, "joint_stiffness": 2e7, "joint_damping": 5e3, "cubic": 1e7},
        5e-6,
        replace(PAPER, m0=0.7 * PAPER.m0),
    ),
    "a load behind an elastic beam": Case(
        stage_effects("mechanics", {"flexible_mode": {"piston_share": 0.25, "frequency": 25.0, "damping": 0.1}}),
        {
            "piston": 0.25 * PAPER.m0,
            "joint_stiffness": 0.75 * PAPER.m0 * (50.0 * np.pi) ** 2,
            "joint_damping": 0.75 * PAPER.m0 * 0.2 * 50.0 * np.pi,
        },
        5e-6,
        replace(PAPER, m0=0.75 * PAPER.m0),
    ),
    "one of each stage": Case(
        [
            {"name": "periodic_disturbance", "sine": 300.0, "frequency": 17.0},
            {"name": "constant_load", "force": 150.0},
            {"name": "flexible_mode", **MODE},
            {"name": "coulomb_asymmetry", "offset": -50.0},
            {"name": "supply_pressure_droop", **LOSS},
            {"name": "command_delay", "delay": 1.37e-3},
            {"name": "mass_shift", "factor": 1.5},
        ],
        {
            "ripple": 300.0,
            "ripple_frequency": 17.0,
            "weight": 150.0,
            "mass": 20.0,
            "mode_frequency": 30.0,
            "mode_damping": 0.05,
            "one_way": -50.0,
            "laminar": 2e9,
            "turbulent": 3e12,
            "delay": 1.37e-3,
        },
        5e-6,
        replace(PAPER, m0=1.5 * PAPER.m0),
    ),
}


@pytest.mark.parametrize("name", tiered(CASES, *list(CASES)[::4]))
def test_states_are_those_of_the_reference(name, make_rig):
    case = CASES[name]
    t = np.arange(200) * PERIOD
    omega = 2.0 * np.pi * 5.0
    inputs = np.column_stack([3e-4 * np.sin(omega * t) + 1e-5, 2e3 * np.sin(30.0 * t), 6e4 * np.cos(30.0 * t)])
    states = run(Simulator(make_rig(effects=case.effects), PERIOD, STEP), inputs)[:, :7]
    expected = solve(case.constants, "gms", inputs, PERIOD, kind=plant_with(**case.numbers)).y[:, :7]
    unchanged = solve(PAPER, "gms", inputs, PERIOD).y
    scale = np.abs(expected).max(axis=0)
    assert np.max(np.abs(states - expected) / scale) < case.tolerance
    assert np.max(np.abs(unchanged - expected) / scale) > 1e-2
    assert np.ptp(np.sign(states[:, 1])) == 2.0
