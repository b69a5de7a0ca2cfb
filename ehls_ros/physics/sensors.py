"""Sensor models: lag, delay, gain, bias, noise and resolution, applied in this order."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant, Sensor
from ehls_ros.physics.plant import PL, XV, V, X
from ehls_ros.physics.rig import SENSED

POSITION, VELOCITY, LOAD_PRESSURE, SPOOL, FORCE, SUPPLY_PRESSURE, OIL_TEMPERATURE = range(len(SENSED))
"""Index of each signal in a measurement, in the order of a loader_state."""


class SensorState(NamedTuple):
    """Parameters and state of the sensors, one row per signal of :data:`SENSED`.

    Attributes:
        table: columns smoothing factor of the lag, delay [cycles], gain, bias, noise_std, resolution.
        lagged: output of the first-order lag.
        past: ring buffer of ``lagged``, shape (signals, cycles of the longest delay + 2); without delays, only the last value.
    """

    table: Array
    lagged: Array
    past: Array


def prepare(sensors: Mapping[str, Sensor], period: float) -> SensorState:
    """Prepare sensors for :func:`measure`.

    Args:
        sensors: sensors by signal; a missing one is perfect.
        period: sampling period [s].

    Returns:
        State of the sensors before the first sample.
    """
    table = np.zeros((len(SENSED), 6))
    for row, signal in enumerate(SENSED):
        sensor = sensors.get(signal, Sensor())
        smoothing = 1.0 - np.exp(-sensor.bandwidth * period) if sensor.bandwidth > 0.0 else 1.0
        table[row] = smoothing, sensor.delay / period, sensor.gain, sensor.bias, sensor.noise_std, sensor.resolution
    longest = int(np.ceil(table[:, 1].max()))
    return SensorState(table, np.zeros(len(SENSED)), np.zeros((len(SENSED), longest + 2 if longest > 0 else 1)))


@kernel
def true_signals(y: Array, temperature: float, supply: float, plant: Plant, truth: Array) -> None:
    """Write the true values of the sensed signals.

    Args:
        y: state of the plant.
        temperature: oil temperature [K].
        supply: supply pressure at the valve [Pa].
        plant: the rig's coefficients.
        truth: output, shape (signals,).
    """
    truth[POSITION] = y[X]
    truth[VELOCITY] = y[V]
    truth[LOAD_PRESSURE] = y[PL]
    truth[SPOOL] = y[XV]
    truth[FORCE] = plant.piston_area * y[PL]
    truth[SUPPLY_PRESSURE] = supply
    truth[OIL_TEMPERATURE] = temperature


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
