"""The plant against published numbers, balances and closed forms."""

import math

import numpy as np
import pytest
from rig_runs import PERIOD, run

from ehls_ros.physics.equations import load_flow, load_pressure_rate
from ehls_ros.physics.simulator import Simulator

# A negligible contact, so that the remaining plant is linear.
SLIPPERY = {
    "coulomb_force": 1e-9,
    "static_force": 1e-9,
    "viscous_coefficient": 0.0,
    "element_stiffness": [1e-7, 1e-7, 1e-7],
    "element_weight": [0.5, 0.3, 0.2],
}
SIMPSON = np.array([1.0, 4.0, 1.0]) / 3.0


def integral(values, spacing):
    """Integrate an odd number of samples by Simpson's rule."""
    return float(np.sum(SIMPSON * np.lib.stride_tricks.sliding_window_view(values, 3)[::2]) * spacing)


def test_rated_flow_is_reached_at_0_44_mm(make_rig):
    """40 L/min, the rated flow of the paper's valve, without load."""
    flow = load_flow.py_func(0.44e-3, 1.0, 0.0, 7e6, make_rig().plant)
    assert flow * 60e3 == pytest.approx(40.0, rel=5e-3)


def test_flow_follows_the_orifice_law(make_rig):
    plant = make_rig().plant
    at = lambda opening, pressure: load_flow.py_func(opening, math.copysign(1.0, opening), pressure, 7e6, plant)  # noqa: E731
    assert at(1e-4, 5.25e6) == pytest.approx(0.5 * at(1e-4, 0.0))
    assert at(-1e-4, -5.25e6) == pytest.approx(-at(1e-4, 5.25e6))
    assert at(-1e-4, 5.25e6) == pytest.approx(-math.sqrt(12.25 / 7.0) * at(1e-4, 0.0))
    assert at(1e-4, 8e6) < 0.0


def test_pressure_rises_by_4_784_mpa_per_mm(make_rig):
    plant = make_rig().plant
    rate = load_pressure_rate.py_func(0.0, -1e-3, 0.0, 0.0, plant.bulk_modulus, plant)
    assert rate == pytest.approx(4.784e6, rel=1e-4)


def test_spool_lags_exponentially(make_rig):
    states = run(Simulator(make_rig()), np.tile([2e-4, 0.0, 0.0], (100, 1)))
    t = np.arange(101) * PERIOD
    np.testing.assert_allclose(states[:, 3], 2e-4 * -np.expm1(-2.0 * np.pi * 17.74 * t), rtol=1e-8)


def linear(make_rig, step, cycles=400):
    """Return position, velocity and pressure of the locked cylinder after its release, and their closed form."""
    rig = make_rig(
        plant={"gravity": 0.0, "leakage_coefficient": 0.0, "viscous_damping": 0.0, "spring_stiffness": 0.0},
        friction=SLIPPERY,
    )
    simulator = Simulator(rig, PERIOD, step)
    simulator.y[1] = 0.1
    states = run(simulator, np.zeros((cycles, 3)))
    t = np.arange(cycles + 1) * PERIOD
    omega = math.sqrt(4.0 * 6.9e8 * 2.6e-3**2 / (1.5e-3 * 70.0))
    exact = np.column_stack(
        [
            0.1 / omega * np.sin(omega * t),
            0.1 * np.cos(omega * t),
            -4.0 * 6.9e8 * 2.6e-3 / 1.5e-3 * 0.1 / omega * np.sin(omega * t),
        ]
    )
    return states[:, :3], exact


def test_locked_cylinder_swings_at_the_hydraulic_frequency(make_rig):
    states, exact = linear(make_rig, 2.5e-5)
    assert np.max(np.abs(states - exact) / np.abs(exact).max(axis=0)) < 2e-6


def test_order_is_5_where_nothing_switches(make_rig):
    errors = []
    for step in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        states, exact = linear(make_rig, step, cycles=60)
        errors.append(np.max(np.abs(states - exact) / np.abs(exact).max(axis=0)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 5.0, atol=0.15)


@pytest.fixture(scope="module")
def sampled_motion(make_rig):
    """Return states each 0.1 ms, with constant inputs, after break-away and before any reversal."""
    simulator = Simulator(make_rig(), period=1e-4, step=2.5e-5)
    for _ in range(1500):
        simulator.advance(3e-4, 1000.0, 0.0, 0.0, 0.0)
    states = [simulator.y.copy()]
    for _ in range(4000):
        assert simulator.advance(1e-4, 1000.0, 0.0, 0.0, 0.0) == 0
        states.append(simulator.y.copy())
    assert np.all(simulator.mode == 1.0)
    return np.array(states)


def test_oil_is_neither_made_nor_lost(sampled_motion):
    """(2) integrated: the inflow moved the piston, was compressed or leaked."""
    x, _, pressure, spool = sampled_motion[:, :4].T
    flow = 0.62 * 0.0267 * spool * np.sqrt((7e6 - pressure) / 840.0)
    entered = integral(flow, 1e-4)
    moved = 2.6e-3 * (x[-1] - x[0])
    pressed = 1.5e-3 / (4.0 * 6.9e8) * (pressure[-1] - pressure[0])
    leaked = integral(4.7e-12 * pressure, 1e-4)
    assert abs(x[-1] - x[0]) > 0.01
    assert entered == pytest.approx(moved + pressed + leaked, rel=1e-7)


def test_energy_is_balanced(sampled_motion):
    """Work of the pressure went into motion, spring, height, disturbance and friction."""
    x, v, pressure = sampled_motion[:, :3].T
    elements = sampled_motion[:, 4:].sum(axis=1)
    done = integral(2.6e-3 * pressure * v, 1e-4)
    kinetic = 0.5 * 70.0 * (v[-1] ** 2 - v[0] ** 2)
    spring = 0.5 * 4e4 * (x[-1] ** 2 - x[0] ** 2)
    height = 70.0 * 9.81 * (x[-1] - x[0])
    disturbance = 1000.0 * (x[-1] - x[0])
    friction = integral((elements + (7265.0 + 60.0) * v) * v, 1e-4)
    assert done == pytest.approx(kinetic + spring + height + disturbance + friction, rel=1e-7)


def test_period_is_cut_into_equal_steps_no_longer_than_asked(make_rig):
    rig = make_rig()
    assert Simulator(rig, 1e-3, 1e-4).constants.steps == 10
    uneven = Simulator(rig, 1e-3, 3e-4)
    assert (uneven.constants.steps, uneven.constants.step) == (4, 2.5e-4)
    assert Simulator(rig, 1e-3, 1.0).constants.steps == 1


def test_disturbance_goes_on_at_its_rate_within_a_cycle(make_rig):
    """One cycle of 10 ms with a ramp is ten cycles of 1 ms that follow it."""
    rig = make_rig()
    long, short = Simulator(rig, period=1e-2), Simulator(rig, period=1e-3)
    long.advance(0.0, 100.0, 2e5, 0.0, 0.0)
    for k in range(10):
        short.advance(0.0, 100.0 + 200.0 * k, 2e5, 0.0, 0.0)
    np.testing.assert_allclose(long.y, short.y, rtol=1e-9, atol=1e-15)
