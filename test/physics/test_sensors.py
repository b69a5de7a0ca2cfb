"""Measurement of each imperfection of a sensor."""

import numpy as np
import pytest

from ehls_ros.physics import sensors
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator

PERIOD = 1e-3
ROW = SENSED.index("force")


def read(signal, noise=None, **imperfections):
    """Return the force sensor's output for a signal, and the positions read beside it."""
    state = sensors.prepare({"force": Sensor(**imperfections)}, PERIOD)
    truth, measured = np.zeros(len(SENSED)), np.zeros(len(SENSED))
    readings, beside = [], []
    for cycle, value in enumerate(signal):
        truth[:] = value
        deviates = np.zeros(len(SENSED)) if noise is None else noise[cycle]
        sensors.measure.py_func(cycle, truth, deviates, state, measured)
        readings.append(measured[ROW])
        beside.append(measured[0])
    return np.array(readings), np.array(beside)


RAMP = 3.0 + 200.0 * np.arange(60) * PERIOD


def test_a_perfect_sensor_reads_the_truth():
    readings, beside = read(RAMP)
    np.testing.assert_array_equal(readings, RAMP)
    np.testing.assert_array_equal(beside, RAMP)


def test_only_the_sensor_meant_is_imperfect():
    readings, beside = read(RAMP, bias=0.25)
    np.testing.assert_array_equal(readings, RAMP + 0.25)
    np.testing.assert_array_equal(beside, RAMP)


def test_gain_scales_the_truth_and_not_the_bias():
    readings, _ = read(RAMP, gain=1.5, bias=0.25)
    np.testing.assert_allclose(readings, 1.5 * RAMP + 0.25, rtol=1e-15)


def test_gain_scales_neither_noise_nor_resolution():
    noise = np.random.default_rng(2).standard_normal((500, len(SENSED)))
    loud, plain = (read(np.zeros(500), noise, noise_std=4.0, gain=gain)[0] for gain in (10.0, 1.0))
    np.testing.assert_array_equal(loud, plain)
    steps = read(RAMP, gain=10.0, resolution=0.7)[0] / 0.7
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_noise_has_its_standard_deviation_and_is_white():
    random = np.random.default_rng(1)
    readings, _ = read(np.zeros(5000), random.standard_normal((5000, len(SENSED))), noise_std=4.0)
    assert np.std(readings) == pytest.approx(4.0, rel=0.03)
    assert abs(np.corrcoef(readings[1:], readings[:-1])[0, 1]) < 0.05


def test_readings_lie_on_the_converter_grid():
    readings, _ = read(RAMP, resolution=0.7)
    steps = readings / 0.7
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.max(np.abs(readings - RAMP)) <= 0.35 + 1e-12
    assert len(np.unique(readings)) > 10


def test_bandwidth_is_a_first_order_lag_that_starts_settled():
    step = np.concatenate([[1.0], np.full(80, 3.0)])
    readings, _ = read(step, bandwidth=60.0)
    assert readings[0] == 1.0
    np.testing.assert_allclose(readings[1:], 3.0 - 2.0 * np.exp(-60.0 * PERIOD * np.arange(1, 81)), rtol=1e-12)


@pytest.mark.parametrize("delay", [1e-3, 4e-3, 2.5e-3, 0.3e-3])
def test_delay_shifts_by_whole_and_part_cycles(delay):
    readings, _ = read(RAMP, delay=delay)
    filled = int(np.ceil(delay / PERIOD))
    np.testing.assert_allclose(readings[filled:], RAMP[filled:] - 200.0 * delay, rtol=1e-12)
    assert np.all(readings[: int(delay / PERIOD)] == RAMP[0])


def test_a_jump_arrives_whole_after_a_whole_delay():
    jump = np.where(np.arange(20) < 8, 0.0, 1.0)
    readings, _ = read(jump, delay=3e-3)
    np.testing.assert_array_equal(readings, np.where(np.arange(20) < 11, 0.0, 1.0))


def test_the_simulator_reads_its_state(make_rig):
    simulator = Simulator(make_rig(), position=0.01)
    simulator.advance(1e-4, 0.0, 0.0, 0.0, 0.0)
    reading = dict(zip(SENSED, simulator.measure(np.zeros(len(SENSED))), strict=True))
    assert reading["position"] == simulator.y[0]
    assert reading["velocity"] == simulator.y[1]
    assert reading["load_pressure"] == simulator.y[2]
    assert reading["spool_position"] == simulator.y[3]
    assert reading["force"] == pytest.approx(2.6e-3 * simulator.y[2])
    assert reading["supply_pressure"] == 7e6
