"""Effects on the sensors: readings of a known state."""

import numpy as np
import pytest

from ehls_ros.physics.plant import PL, V, X
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator

SENSORS = {"load_pressure": {"bias": 1e4, "gain": 1.1, "bandwidth": 200.0, "delay": 2e-3}, "force": {"bias": 3.0}}
NONE = np.zeros(len(SENSED))


@pytest.fixture
def read(make_rig):
    """Return the readings, by signal, of a piston whose position and pressure jump after the first cycle."""

    def along(effects, sensors=None, cycles=40):
        simulator = Simulator(make_rig(effects=effects, sensors=sensors or {}))
        rows = []
        for cycle in range(cycles):
            simulator.cycle = cycle
            simulator.y[X], simulator.y[V], simulator.y[PL] = (0.0, 0.0, 0.0) if cycle == 0 else (0.02, 0.5, 2e6)
            rows.append(simulator.measure(NONE).copy())
        return dict(zip(SENSED, np.array(rows).T, strict=True))

    return along


def test_gain_and_bias_of_the_pressure_leave_the_load_cell_alone(read):
    found = read([{"name": "pressure_sensor_gain", "gain": 0.9}, {"name": "pressure_sensor_bias", "bias": 5e4}])
    assert found["load_pressure"][-1] == pytest.approx(0.9 * 2e6 + 5e4)
    assert found["load_pressure"][0] == pytest.approx(5e4)
    assert found["force"][-1] == pytest.approx(5200.0)


def test_gain_and_bias_of_the_position(read):
    found = read([{"name": "position_sensor_gain", "gain": 1.2}, {"name": "position_sensor_bias", "bias": -1e-3}])
    assert found["position"][-1] == pytest.approx(0.023)
    assert found["velocity"][-1] == 0.5


def test_a_lag_of_the_pressure(read):
    found = read([{"name": "pressure_sensor_lag", "time_constant": 8e-3}])
    after = np.arange(1, 40) * 1e-3
    np.testing.assert_allclose(found["load_pressure"][1:], -2e6 * np.expm1(-after / 8e-3), rtol=1e-9)
    np.testing.assert_array_equal(found["force"][1:], 5200.0)


def arrivals(found):
    """Return the delay in cycles of each signal that jumps."""
    return {
        name: int(np.argmax(found[name] != found[name][0])) - 1 for name in ("position", "velocity", "load_pressure", "force")
    }


@pytest.mark.parametrize(
    ("delays", "expected"),
    [
        ({"position": 4e-3}, {"position": 4, "velocity": 0, "load_pressure": 0, "force": 0}),
        ({"pressure": 3e-3}, {"position": 0, "velocity": 0, "load_pressure": 3, "force": 0}),
        ({"every": 2e-3}, {"position": 2, "velocity": 2, "load_pressure": 2, "force": 2}),
        ({"every": 2e-3, "position": 4e-3}, {"position": 6, "velocity": 2, "load_pressure": 2, "force": 2}),
    ],
)
def test_delays_of_one_channel_or_of_all(delays, expected, read):
    assert arrivals(read([{"name": "sensor_delay", **delays}])) == expected


def test_what_an_effect_does_comes_on_top_of_the_sensors_own(read, make_rig):
    effects = [
        {"name": "pressure_sensor_gain", "gain": 2.0},
        {"name": "pressure_sensor_bias", "bias": 1e3},
        {"name": "pressure_sensor_lag", "time_constant": 0.015},
        {"name": "sensor_delay", "pressure": 1e-3},
    ]
    sensor = make_rig(effects=effects, sensors=SENSORS).effective().sensors["load_pressure"]
    assert (sensor.gain, sensor.bias) == pytest.approx((2.2, 1.1e4))
    assert (sensor.bandwidth, sensor.delay) == pytest.approx((50.0, 3e-3))
    assert make_rig(effects=effects, sensors=SENSORS).effective().sensors["force"].bias == 3.0
    assert read(effects, SENSORS)["load_pressure"][0] == pytest.approx(1.1e4)
