"""Events: located to the tolerance at any scale, each in order, and counted when they are too dense."""

import numpy as np
import pytest

from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.integration import MAX_EVENTS, WORK_ROWS

# y0 runs at rate mode 0; where it passes c[i], mode i + 1 is set. The event function of the second is a million times steeper
# than that of the first and hidden behind a flat one, as a force is behind a displacement.
_LADDER = '''"""Two thresholds of different scale, generated."""
from numba import njit
from ehls_ros.arrays import kernel
from ehls_ros.physics import integration


@kernel
def evaluate(t, y, mode, c, rate):
    rate[0] = mode[0]
    rate[1] = mode[1]
    first = -1.0 if mode[1] != 0.0 else 1e-6 * (y[0] - c[0])
    second = -1.0 if mode[2] != 0.0 else 1e6 * (y[0] - c[1])
    return max(-1e-9, max(first, second))


@kernel
def switch(t, y, mode, c):
    if mode[1] == 0.0 and y[0] > c[0]:
        mode[1] = 1.0
    if mode[2] == 0.0 and y[0] > c[1]:
        mode[2] = 1.0
        mode[1] = -3.0


run = integration.integrator(evaluate, switch)


@njit(cache=True, error_model="numpy")
def advance(t, y, mode, c, step, steps, work):
    return run(t, y, mode, c, step, steps, work)
'''

# A ball on the floor: y is height and speed; with restitution c[1] its bounces become ever more frequent.
_BALL = '''"""A bouncing ball, generated."""
from numba import njit
from bouncing_ball import evaluate, switch
from ehls_ros.physics import integration

run = integration.integrator(evaluate, switch, size=2)


@njit(cache=True, error_model="numpy")
def advance(t, y, mode, c, step, steps, work):
    return run(t, y, mode, c, step, steps, work)
'''


@pytest.fixture(scope="module")
def ladder():
    return kernel_module(_LADDER).advance


@pytest.fixture(scope="module")
def ball():
    return kernel_module(_BALL).advance


@pytest.mark.parametrize("second", [0.51, 0.5 + 1e-5, 0.7341, 0.9])
def test_two_events_of_different_scale_in_one_step_are_both_located(ladder, second):
    y, mode = np.zeros(2), np.array([1.0, 0.0, 0.0])
    assert ladder(0.0, y, mode, np.array([0.5, second]), 1.0, 1, np.empty((WORK_ROWS, 2))) == 0
    assert y[0] == pytest.approx(1.0, rel=1e-12)
    assert y[1] == pytest.approx((second - 0.5) - 3.0 * (1.0 - second), abs=2e-8)


def test_an_impact_changes_the_state_at_its_time(ball):
    y = np.array([1.0, 0.0])
    ball(0.0, y, np.zeros(1), np.array([10.0, 1.0]), 0.3, 2, np.empty((WORK_ROWS, 2)))
    fall = np.sqrt(0.2)
    after = 0.6 - fall
    assert y[0] == pytest.approx(10.0 * fall * after - 5.0 * after**2, rel=1e-7)
    assert y[1] == pytest.approx(10.0 * fall - 10.0 * after, rel=1e-7)


def test_steps_with_events_too_dense_are_counted(ball):
    # Bounces of 0.5^n of the first: 16 of them fit into the step that holds the last.
    y = np.array([1.0, 0.0])
    dense = ball(0.0, y, np.zeros(1), np.array([10.0, 0.5]), 0.1, 20, np.empty((WORK_ROWS, 2)))
    assert MAX_EVENTS < 20
    assert 1 <= dense < 20
