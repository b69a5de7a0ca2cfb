"""Sensor models: lag, delay, gain, bias, noise and resolution, applied in this order."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant, Sensor
from ehls_ros.physics.rig import CHAMBER_SENSED, SENSED

POSITION, VELOCITY, LOAD_PRESSURE, SPOOL, FORCE, SUPPLY_PRESSURE, OIL_TEMPERATURE, PRESSURE_A, PRESSURE_B = range(
    len(SENSED) + len(CHAMBER_SENSED)
)
"""Index of each signal in a measurement, in the order of a loader_state; only a cylinder of two chambers has the last two."""


class SensorState(NamedTuple):
    """Parameters and state of the sensors, one row per signal.

    Attributes:
        table: columns smoothing factor of the lag, delay [cycles], gain, bias, noise_std, resolution.
        lagged: output of the first-order lag.
        past: ring buffer of ``lagged``, shape (signals, cycles of the longest delay + 2); without delays, only the last value.
    """

    table: Array
    lagged: Array
    past: Array


def prepare(sensors: Mapping[str, Sensor], period: float, signals: Sequence[str] = SENSED) -> SensorState:
    """Prepare sensors for :func:`measure`.

    Args:
        sensors: sensors by signal; a missing one is perfect.
        period: sampling period [s].
        signals: the signals, in order.

    Returns:
        State of the sensors before the first sample.
    """
    table = np.zeros((len(signals), 6))
    for row, signal in enumerate(signals):
        sensor = sensors.get(signal, Sensor())
        smoothing = 1.0 - np.exp(-sensor.bandwidth * period) if sensor.bandwidth > 0.0 else 1.0
        table[row] = smoothing, sensor.delay / period, sensor.gain, sensor.bias, sensor.noise_std, sensor.resolution
    longest = int(np.ceil(table[:, 1].max()))
    return SensorState(table, np.zeros(len(signals)), np.zeros((len(signals), longest + 2 if longest > 0 else 1)))


@kernel
def read_supply(measured: Array, plant: Plant) -> float:
    """Return the supply pressure of a measurement, or that of the rig file if it is not a number [Pa]."""
    return measured[SUPPLY_PRESSURE] if math.isfinite(measured[SUPPLY_PRESSURE]) else plant.supply_pressure


@kernel
def measure(cycle: int, truth: Array, noise: Array, state: SensorState, measured: Array) -> None:
    """Sample every sensor once.

    Args:
        cycle: index of the sample; sample 0 initialises lag and delay with the true values.
        truth: true values, shape (signals,).
        noise: standard normal numbers, shape (signals,).
        state: from :func:`prepare`, updated in place.
        measured: output, shape (signals,).
    """
    columns = state.past.shape[1]
    place = cycle % columns
    for row in range(truth.size):
        smoothing, delay, gain, bias, deviation, resolution = state.table[row]
        if cycle == 0:
            state.lagged[row] = truth[row]
            state.past[row][:] = truth[row]
        state.lagged[row] += smoothing * (truth[row] - state.lagged[row])
        state.past[row, place] = state.lagged[row]
        whole = int(delay)
        fraction = delay - whole
        now = place - whole if place >= whole else place - whole + columns
        newer = state.past[row, now]
        older = state.past[row, now - 1 if now > 0 else columns - 1]
        value = gain * (newer + fraction * (older - newer)) + bias + deviation * noise[row]
        if resolution > 0.0:
            value = np.round(value / resolution) * resolution
        measured[row] = value
