"""Numbers with derivatives: every rule against differences, and impacts against their closed form."""

import math

import numpy as np
import pytest
from numba import njit

from ehls_ros.arrays import kernel
from ehls_ros.duals import Dual, dual_array, joined, linear, rows_of, value_of, width_of
from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.integration import WORK_ROWS

WIDTH = width_of(2)

# A ball on the floor with restitution c[1] under the gravity c[0].
_BALL = '''"""A bouncing ball, generated."""
from numba import njit
from bouncing_ball import evaluate, switch
from ehls_ros.duals import constant, dual_array
from ehls_ros.physics import integration

run = integration.integrator(evaluate, switch, size=2)


@njit(cache=True, error_model="numpy")
def advance(y, mode, c, step, steps, work):
    start, length = constant(0.0, 8), constant(step, 8)
    return run(start, dual_array(y, 8), mode, dual_array(c, 8), length, steps, dual_array(work, 8))
'''


@kernel
def mixed(a, b, n):
    """Return a number that involves every operation, with the numbers on either side."""
    one = (2.0 - a) / b + (a + n) * 0.5 - 1.5 / a + b**a + a**1.5 + 2.0**b + (-a) * n
    one += math.exp(-a) + math.expm1(b) + math.log(a) * math.log1p(b) + math.sqrt(a) * math.sin(b) - math.cos(a)
    one -= math.tanh(a) + math.atan(b) + math.hypot(a, b) * abs(b - a) + math.copysign(a, -b) + math.fabs(-b)
    one *= min(a, b) + max(a, 3.0) + max(b, 0.0) + math.floor(a) + math.ceil(b)
    one /= 1.0 + a * a
    return one if a > 0.0 else 0.0


@njit(error_model="numpy")
def of_duals(rows, n, out):
    values, result = dual_array(rows, 4), dual_array(out, 4)
    result[0] = mixed(values[0], values[1], n)


@pytest.mark.parametrize("at", [(0.7, 1.3), (1.9, 0.4)])
def test_the_rules_agree_with_differences_and_the_values_with_floats_to_the_bit(at):
    rows, out = rows_of([Dual(at[0], {0: 1.0}), Dual(at[1], {1: 1.0})], WIDTH), np.zeros((1, WIDTH))
    of_duals(rows, 3, out)
    assert out[0, 0] == mixed(*at, 3)
    for i, h in enumerate((1e-5, 1e-5)):
        moved = [[x + s * h * (j == i) for j, x in enumerate(at)] for s in (-2, -1, 1, 2)]
        f = [mixed(*place, 3) for place in moved]
        difference = (8.0 * (f[2] - f[1]) - (f[3] - f[0])) / (12.0 * h)
        assert out[0, 1 + i] == pytest.approx(difference, rel=1e-9)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5])
def test_a_derivative_at_a_root_s_zero_is_finite(exponent):
    @njit(error_model="numpy")
    def power(rows, out):
        x = dual_array(rows, 4)
        dual_array(out, 4)[0] = abs(x[0]) ** x[1] + math.sqrt(x[0]) + math.hypot(x[0], 0.0)

    out = np.zeros((1, WIDTH))
    power(rows_of([Dual(0.0, {0: 1.0}), Dual(exponent, {1: 1.0})], WIDTH), out)
    assert out[0, :3].tolist() == [0.0, 1.0 if exponent == 1.0 else 0.0, 0.0]


def test_a_short_cut_for_a_special_value_is_not_taken_by_what_varies():
    @njit(error_model="numpy")
    def softened(rows, out):
        x, result = dual_array(rows, 4), dual_array(out, 4)
        result[0] = x[0] if x[1] == 1.0 else x[0] ** x[1]
        result[1] = x[0] ** x[1] if x[1] != 1.0 else x[0]

    for lane, slope in (({1: 1.0}, 0.5 * math.log(0.5)), ({}, 0.0)):
        out = np.zeros((2, WIDTH))
        softened(rows_of([Dual(0.5, {0: 1.0}), Dual(1.0, lane)], WIDTH), out)
        assert out[:, 0].tolist() == [0.5, 0.5]
        assert out[:, 1] == pytest.approx([1.0, 1.0])
        assert out[:, 2] == pytest.approx([slope, slope])


def test_duals_of_python_follow_the_same_rules():
    a, b = Dual(0.8, {0: 1.0}), Dual(1.7, {1: 1.0})
    found = (2.0 - a) / b + 3.0 * a * b - 1.0 / b - (-a) + max(a, 0.0) + (b - a) / 4.0
    assert found.value == pytest.approx(1.2 / 1.7 + 3.0 * 0.8 * 1.7 - 1.0 / 1.7 + 0.8 + 0.8 + 0.9 / 4.0)
    assert found.tangents == pytest.approx({0: -1.0 / 1.7 + 5.1 + 2.0 - 0.25, 1: -1.2 / 1.7**2 + 2.4 + 1.0 / 1.7**2 + 0.25})
    assert [a < b, a <= 0.8, b > a, b >= 1.7, b < a] == [True] * 4 + [False]
    # The variable is at no special value.
    assert [a == 0.8, Dual(0.8, {}) == 0.8] == [False, True]
    assert value_of(a) == 0.8


def test_a_signal_keeps_its_derivatives_through_what_is_linear():
    x, time = Dual(3.0, {2: 1.0}), np.arange(4.0)
    signal = time**2 * x - time
    assert signal.value.tolist() == [0.0, 2.0, 10.0, 24.0]
    assert linear(np.diff, signal).tangents[2].tolist() == [1.0, 3.0, 5.0]
    # A result independent of the parameter has no tangent.
    assert signal[:1].tangents == {}
    assert joined([1.0, x]).tangents[2].tolist() == [0.0, 1.0]
    rows = rows_of(joined([1.0, x]), 4, [5, 2])
    assert rows.tolist() == [[1.0, 0.0, 0.0, 0.0], [3.0, 0.0, 1.0, 0.0]]


def test_a_tangent_next_to_nothing_is_kept_as_zero_and_no_number_as_such():
    @njit(error_model="numpy")
    def copied(rows, out):
        dual_array(out, 4)[0] = dual_array(rows, 4)[0]

    out = np.zeros((1, WIDTH))
    copied(np.array([[1e-300, -1e-300, math.nan, -2e-290]]), out)
    assert out[0, :2].tolist() == [1e-300, 0.0]
    assert math.isnan(out[0, 2])
    assert out[0, 3] == -2e-290


def bounced(height, gravity, restitution, time):
    """Return height and speed of a ball after its bounces, and their number."""
    speed, left, count = np.sqrt(2.0 * gravity * height), time - np.sqrt(2.0 * height / gravity), 0
    while True:
        speed, count = restitution * speed, count + 1
        flight = 2.0 * speed / gravity
        if left.real < flight.real:
            return speed * left - 0.5 * gravity * left * left, speed - gravity * left, count
        left = left - flight


@pytest.mark.parametrize(("step", "steps"), [(0.1, 13), (0.0413, 30)])
def test_derivatives_across_impacts_are_those_of_the_closed_form(step, steps):
    at = (1.0, 9.81, 0.7)
    y = rows_of([Dual(at[0], {0: 1.0}), 0.0], 8)
    c = rows_of([Dual(at[1], {1: 1.0}), Dual(at[2], {2: 1.0})], 8)
    assert kernel_module(_BALL).advance(y, np.zeros(1), c, step, steps, np.zeros((WORK_ROWS, 2, 8))) == 0
    height, speed, count = bounced(*at, step * steps)
    assert count >= 2
    assert y[:, 0] == pytest.approx([height, speed], rel=1e-7)
    for i in range(3):
        # The derivative of a smooth function by a step along the imaginary axis has no rounding error.
        moved = [x + 1e-30j * (j == i) for j, x in enumerate(at)]
        exact = [part.imag / 1e-30 for part in bounced(*moved, step * steps)[:2]]
        assert y[:, 1 + i] == pytest.approx(exact, rel=1e-7)
