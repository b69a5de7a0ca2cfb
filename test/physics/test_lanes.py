"""The integrator for lanes: every lane gives the same numbers as alone, events included."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit

from ehls_ros.arrays import kernel_no_refcount
from ehls_ros.physics.integration import WORK_ROWS, integrator
from ehls_ros.physics.lane_memory import LANES, Rows, flat, numbers, numbers_in
from ehls_ros.physics.lanes import LaneRows, lanes_integrator

SIZE, MODES = 2, 1
HEIGHT, SPEED = range(SIZE)


class Ball(NamedTuple):
    """A ball above a floor, in thinning air; the mode is 1 once it has hit the floor."""

    gravity: float
    bounce: float
    drag: tuple[float, float]


@kernel_no_refcount
def evaluate(t, y, mode, c, rate):
    rate[HEIGHT] = y[SPEED]
    rate[SPEED] = -c.gravity - (c.drag[0] - c.drag[1] * t) * y[SPEED]
    return -y[HEIGHT] if y[SPEED] < 0.0 else -1.0


@kernel_no_refcount
def switch(t, y, mode, c):
    if y[HEIGHT] < 0.0 and y[SPEED] < 0.0:
        y[SPEED] *= -c.bounce
        mode[0] += 1.0


rows = Rows()
PLACES = LaneRows.of(rows, SIZE, MODES)
LIKE = Ball(9.81, 0.8, (0.1, 0.05))
BALL = rows.take(numbers_in(LIKE))


@kernel_no_refcount
def ball(block, like, lane):
    return numbers(like, block, BALL, lane)


together, alone = lanes_integrator(evaluate, switch, ball, PLACES, SIZE, MODES), integrator(evaluate, switch, SIZE)


@njit(error_model="numpy")
def run_together(calls, block, like, step, steps, work):
    dense = 0
    for call in range(calls):
        dense += together(call * step * steps, block, like, step, steps, work)
    return dense


@njit(error_model="numpy")
def run_alone(calls, y, mode, c, step, steps, work):
    dense = 0
    for call in range(calls):
        dense += alone(call * step * steps, y, mode, c, step, steps, work)
    return dense


@pytest.mark.long
def test_each_of_many_bouncing_balls_bounces_as_it_does_alone():
    random = np.random.default_rng(3)
    balls = [Ball(g, b, (d, 0.5 * d)) for g, b, d in random.uniform((5.0, 0.3, 0.0), (15.0, 0.9, 0.5), (LANES, 3))]
    heights = random.uniform(0.1, 3.0, LANES)
    block = np.zeros((rows.count, LANES))
    block[PLACES.y + HEIGHT] = heights
    block[BALL:] = np.transpose([flat(one) for one in balls])
    work: Any = np.empty((WORK_ROWS, SIZE))
    dense = run_together(50, block.reshape(-1), LIKE, 1e-2, 4, work)
    bounces, expected_dense = [], 0
    for lane, one in enumerate(balls):
        y, mode = np.array([heights[lane], 0.0]), np.zeros(MODES)
        expected_dense += run_alone(50, y, mode, one, 1e-2, 4, work)
        np.testing.assert_array_equal(block[PLACES.y : PLACES.y + SIZE, lane], y)
        assert block[PLACES.mode, lane] == mode[0]
        bounces.append(mode[0])
    assert dense == expected_dense
    assert len(set(bounces)) > 3
    assert min(bounces) >= 1
