"""Separation of two candidate models: the unexplained part of one's record by the other, in units of the noise floor."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EVERY_SENSED, EffectUse, Rig
from ehls_ros.physics.sensors import POSITION, VELOCITY

MEMORY = 0.05
"""Time constant with which a model's position is drawn to the recorded one [s]."""

BLOCK = 0.025
"""Interval over which readings are averaged before comparison [s]; a few periods of the hydraulic resonance."""

SETTLING, WORN_IN = 0.5, 6.0
"""Excluded at the start: time [s], and travel in presliding displacements."""

MODEL_ERROR = 1e-3
"""Error of the best model of a rig, as a fraction of a signal's magnitude: the floor with perfect sensors."""

NULL_ERROR = 2e-4
"""Uncertainty of the valve's null, as a fraction of the spool's limit."""

STEP = 0.05
"""Step of a parameter for its sensitivity, as a fraction of its value or of its distance from neutral."""


class Difference(NamedTuple):
    """Part of one candidate's record that another candidate cannot explain.

    Attributes:
        blocks: block means in units of the noise floor, shape (blocks, signals).
        scale: noise floor of each block and signal in its unit, shape (blocks, signals).
        parameter_deviation: deviation of the fitted parameters from the data so far, in standard deviations.
    """

    blocks: Array
    scale: Array
    parameter_deviation: float = 0.0

    @property
    def sigma(self) -> float:
        """Separation, in standard deviations."""
        return math.hypot(float(np.linalg.norm(self.blocks)), self.parameter_deviation)


def start_of(record: Array, period: float, yielding: float) -> int:
    """Return the sample at which friction no longer depends on its initial state; the last one if it always does."""
    way = np.cumsum(np.abs(record[:, VELOCITY])) * period
    return max(round(SETTLING / period), int(np.searchsorted(way, WORN_IN * yielding)))


def scale_of(
    records: Mapping[str, Array],
    candidates: Mapping[str, Rig],
    columns: Sequence[int],
    noise: Mapping[str, float],
    period: float,
) -> Array:
    """Return the uncertainty of each signal's block mean, in its unit, shape (signals,)."""
    scale = np.empty(len(columns))
    for place, column in enumerate(columns):
        signal = EVERY_SENSED[column]
        scatter = [noise[signal]] if signal in noise else []
        for rig in candidates.values() if signal not in noise else ():
            sensor = rig.sensors.get(signal)
            if sensor is not None:
                scatter.append(sensor.reading_std)
        largest = max(_size(record, column, period) for record in records.values())
        scale[place] = math.hypot(max(scatter, default=0.0), MODEL_ERROR * largest) or 1.0
    return scale


def _size(record: Array, column: int, period: float) -> float:
    """Return the magnitude of a signal to be predicted; for the position, the travel within the memory."""
    if column != POSITION:
        return float(np.max(np.abs(record[:, column])))
    ahead = max(round(MEMORY / period), 1)
    return float(np.max(np.abs(record[ahead:, column] - record[:-ahead, column]), initial=0.0))


def block_means(values: Array, columns: Sequence[int], period: float, start: int) -> Array:
    """Return means over blocks from a sample on, shape (blocks, signals)."""
    length = max(round(BLOCK / period), 1)
    settled = values[start:, list(columns)]
    count = len(settled) // length
    means: Array = settled[: count * length].reshape(count, length, len(columns)).mean(axis=1)
    return means


def unexplained(base: Difference, stepped: Sequence[Array], parameter_std: float) -> Difference:
    """Return the residual of a difference after a fit of the candidate's parameters to the record and the data so far.

    Args:
        base: the difference with unchanged parameters.
        stepped: block means of the difference with one parameter stepped, in units of the noise floor, one array of shape
            (blocks, signals) per parameter.
        parameter_std: relative standard deviation of the parameters by the data so far.
    """
    slopes = [(blocks - base.blocks).ravel() for blocks in stepped if np.all(np.isfinite(blocks))]
    if not slopes:
        return base
    directions = np.column_stack(slopes)
    held = np.eye(len(slopes)) * STEP / parameter_std
    target = np.concatenate([-base.blocks.ravel(), np.zeros(len(slopes))])
    steps, *_ = np.linalg.lstsq(np.vstack([directions, held]), target)
    left = base.blocks + (directions @ steps).reshape(base.blocks.shape)
    return Difference(left, base.scale, float(np.linalg.norm(held @ steps)))


def stepped_rigs(candidates: Mapping[str, Rig], name: str) -> list[Rig]:
    """Return a candidate's rig with each parameter of its cause stepped towards its neutral value, one rig per parameter."""
    rig = candidates[name]
    rigs = []
    for index, use in enumerate(rig.effects):
        if all(use in other.effects for other in candidates.values()):
            continue
        neutral = EFFECTS.load(use.name).Parameters()
        for field, value in use.parameters._asdict().items():
            way = getattr(neutral, field) - value
            if way == 0.0:
                continue
            # A neutral value may represent infinity, such as the position of an end stop.
            size = min(abs(way), abs(value)) or abs(way)
            nearer = use.parameters._replace(**{field: value + STEP * math.copysign(size, way)})
            effects = (*rig.effects[:index], EffectUse(use.name, nearer), *rig.effects[index + 1 :])
            rigs.append(rig._replace(effects=effects))
    return rigs
