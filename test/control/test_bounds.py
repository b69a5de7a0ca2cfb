import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ehls_ros.control import bounds

PAPER = {"k": 12.0, "g": 60.0, "h": 25.0, "b": 107.5}
REACH = {"h": 25.0, "b": 107.5, "xi": 1.0, "e1": 4.784, "delta_f": 5500.0, "moving_mass": 0.07}
OTHERS = [(12.0, 60.0, 25.0, 107.5), (30.0, 20.0, 25.0, 107.5), (12.0, 200.0, 50.0, 107.5), (8.0, 5.0, 1.0, 0.02)]


@pytest.mark.parametrize(("k", "g", "h", "b"), OTHERS)
def test_pressure_bound_is_where_the_surface_holds_b_over_h(k, g, h, b):
    root = brentq(lambda e: k / (1.0 + math.exp(-g * e)) - k / 2.0 - b / h, 0.0, 10.0, xtol=1e-15, rtol=1e-15)
    assert bounds.pressure_error_bound(k, g, h, b) == pytest.approx(root, rel=1e-9)


def test_papers_numbers_give_the_digests_bound():
    assert bounds.pressure_error_bound(**PAPER) == pytest.approx(0.0300, abs=1e-4)
    assert bounds.force_error_bound(**PAPER, piston_area=2.6e-3) == pytest.approx(78.1, abs=0.1)
    assert bounds.reaching_rate(**REACH) == pytest.approx(8.78e4, rel=1e-3)


@pytest.mark.parametrize("k", [0.1, 8.0, 8.6])
def test_no_bound_where_the_surface_cannot_balance(k):
    # k h <= 2 b = 215
    assert bounds.pressure_error_bound(k, 60.0, 25.0, 107.5) == math.inf


def test_no_robust_term_gives_no_bound():
    assert bounds.pressure_error_bound(12.0, 60.0, 0.0, 107.5) == math.inf
    assert bounds.reaching_time_bound(100.0, **{**REACH, "h": 0.0}) == math.inf


@pytest.mark.parametrize(("k", "g", "xi"), [(12.0, 60.0, 1.0), (30.0, 5.0, 0.4), (2.0, 300.0, 3.0)])
@pytest.mark.parametrize("start", [3.85, -3.85, 0.2])
def test_sliding_time_is_that_of_the_surfaces_differential_equation(k, g, xi, start):
    end = 0.03

    def arrived(_: float, e: np.ndarray) -> float:
        return abs(e[0]) - end

    arrived.terminal = True
    run = solve_ivp(
        lambda _, e: -0.5 * k * np.tanh(0.5 * g * e) / xi, (0.0, 1e4), [start], events=arrived, rtol=1e-10, atol=1e-13
    )
    assert bounds.sliding_time(start, end, k, g, xi) == pytest.approx(run.t_events[0][0], rel=1e-6)


def test_sliding_is_over_where_the_error_is_small_already():
    assert bounds.sliding_time(0.01, 0.03, 12.0, 60.0, 1.0) == 0.0
    assert bounds.sliding_time(-0.03, 0.03, 12.0, 60.0, 1.0) == 0.0


def test_a_steep_surface_does_not_overflow():
    # Far out the error falls at k/2.
    assert bounds.sliding_time(10.0, 5.0, 12.0, 1e4, 1.0) == pytest.approx(5.0 / 6.0, rel=1e-9)


@pytest.mark.parametrize("start", [5.0, 50.0, -2000.0])
@pytest.mark.parametrize("seed", range(5))
def test_reaching_time_bounds_every_run_of_s(start, seed):
    random = np.random.default_rng(seed)
    rate = bounds.reaching_rate(**REACH)
    push = REACH["xi"] * REACH["e1"] / REACH["moving_mass"]  # s' = -K s + push fd
    limit = bounds.reaching_time_bound(start, **REACH)
    inside = REACH["b"] / REACH["h"]
    assert limit > 0.0
    pieces = 400
    step = limit / pieces
    for _ in range(40):
        s = start
        forces = random.uniform(-5500.0, 5500.0, pieces) if random.random() < 0.5 else random.choice([-5500.0, 5500.0], pieces)
        for fd in forces:
            settled = push * fd / rate
            s = settled + (s - settled) * math.exp(-rate * step)
        assert abs(s) <= inside, f"seed {seed}"
        # Beyond this point no disturbance can move it out again.
        assert abs(push * 5500.0 / rate) < inside


@pytest.mark.parametrize("start", [5.0, -2000.0])
def test_reaching_time_is_met_by_the_worst_disturbance(start):
    run = solve_ivp(
        lambda _, s: (-25.0 * s - 25.0 * 4.784 * 5500.0 / 107.5 * s + 4.784 * math.copysign(5500.0, start)) / 0.07,
        (0.0, bounds.reaching_time_bound(start, **REACH)),
        [start],
        rtol=1e-11,
        atol=1e-11,
        method="LSODA",
    )
    assert abs(run.y[0, -1]) == pytest.approx(107.5 / 25.0, rel=1e-6)


def test_no_time_is_needed_inside():
    assert bounds.reaching_time_bound(4.2, **REACH) == 0.0
    assert bounds.reaching_time_bound(-4.3, **REACH) == 0.0


@pytest.mark.parametrize("s", [0.0, 1.0, 4.28])
def test_sliding_time_is_the_time_an_integrator_takes(s):
    k, g, xi, start, end = 12.0, 60.0, 1.0, 3.846, 0.0301

    def falls(t: float, e: np.ndarray) -> np.ndarray:
        return (-0.5 * k * np.tanh(0.5 * g * e) + s) / xi

    def arrived(t: float, e: np.ndarray) -> float:
        return float(e[0] - end)

    arrived.terminal = True  # type: ignore[attr-defined]
    out = solve_ivp(falls, (0.0, 20.0), [start], events=arrived, rtol=1e-10, atol=1e-12)
    assert bounds.sliding_time(start, end, k, g, xi, s) == pytest.approx(out.t_events[0][0], rel=1e-6)


def test_sliding_never_ends_where_s_holds_the_error_up():
    assert bounds.sliding_time(1.0, 0.01, 12.0, 60.0, 1.0, 4.3) == math.inf


def test_what_is_left_of_s_lies_under_b_over_h():
    left = bounds.remaining_s(25.0, 107.5, 1.0, 4.784, 5500.0, 0.07)
    assert 4.28 < left < 4.3
