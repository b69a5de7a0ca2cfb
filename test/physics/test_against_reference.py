"""The plant against a solution that shares no code with it."""

from dataclasses import replace

import numpy as np
import pytest
from reference_solver import cases, solve

CASES = cases()
DURATION = 0.5
# Largest deviation at the default step, of each state relative to its range; benchmarks/physics_accuracy.py has the table.
# The edges of the dead zone in break-away are bends that no event marks.
TOLERANCE = {"stick-slip": 1e-7, "large sine": 5e-7, "break-away": 5e-5, "bristle": 1e-7}


def deviation(states, reference):
    compared = states[:, : reference.shape[1]]
    return float(np.max(np.abs(compared - reference).max(axis=0) / np.abs(reference).max(axis=0)))


@pytest.fixture(scope="module")
def reference():
    """Solve each case once."""
    solved = {}

    def of(name):
        if name not in solved:
            case = CASES[name].shortened(DURATION)
            solved[name] = solve(case.constants, case.law, case.inputs, case.period)
        return solved[name]

    return of


@pytest.mark.parametrize("name", CASES)
def test_default_step_agrees(name, reference, simulated):
    solution = reference(name)
    assert solution.events >= 4
    assert deviation(simulated(CASES[name].shortened(DURATION)), solution.y) < TOLERANCE[name]


@pytest.mark.parametrize("name", ["stick-slip", "bristle"])
def test_order_is_5_through_stick_and_slip(name, reference, simulated):
    case = CASES[name].shortened(DURATION)
    coarse, fine = (deviation(simulated(case, step), reference(name).y) for step in (1e-3, 2.5e-4))
    assert 4.5 < np.log(coarse / fine) / np.log(4.0) < 5.5


def test_order_with_a_friction_force_that_jumps_into_the_balance_follows_the_stribeck_exponent(simulated):
    """|v|^0.8764 has no derivative at standstill; with an exponent of 2 the method keeps its order."""
    case = CASES["break-away"].shortened(DURATION)
    # Without the overlap, whose edges are bends that no event marks.
    case = replace(case, inputs=case.inputs * [0.6, 1.0, 1.0], effects=[])
    orders = {}
    for exponent in (0.8764, 2.0):
        exact, coarse, fine = (simulated(case, step, {"stribeck_exponent": exponent})[:, :4] for step in (6.25e-6, 5e-4, 5e-5))
        orders[exponent] = np.log10(deviation(coarse, exact) / deviation(fine, exact))
    assert 1.8 < orders[0.8764] < 4.0
    assert 4.5 < orders[2.0] < 6.5
