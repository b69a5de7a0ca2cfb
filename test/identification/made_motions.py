"""Motions made of plain arrays, without sensors, and a single-branch friction model to fit to them."""

from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.identification.joint import REACH
from ehls_ros.identification.motion import Motion

PERIOD = 0.01


def motion(velocity: Array, force: Array | None = None, *, period: float = PERIOD, **changed: Any) -> Motion:
    """Return a motion with a velocity; its position is the integral, and its force is zero."""
    position = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1])) * period])
    made = Motion(
        name="made",
        period=period,
        time=(np.arange(len(velocity)) + 0.5) * period,
        position=position,
        velocity=velocity,
        acceleration=np.gradient(velocity, period),
        force=np.zeros(len(velocity)) if force is None else force,
        scatter=np.zeros(len(velocity)),
        fresh=np.arange(len(velocity)) == 0,
        resolved=np.ones(len(velocity), dtype=bool),
        force_noise=1.0,
        velocity_noise=1e-9,
        turn_doubt=1e-5,
        outliers=0.0,
    )
    return made._replace(**changed)


def sine(amplitude: float = 0.1, periods: int = 20, blocks: int = 2000) -> Array:
    """Return the velocity of a sine with a different amplitude in each half period, so that no two strokes are equal."""
    phase = np.linspace(0.0, 2.0 * np.pi * periods, blocks, endpoint=False)
    return amplitude * (1.0 + 0.3 * np.sin(0.37 * np.floor(phase / np.pi))) * np.cos(phase)


class PowerLaw(NamedTuple):
    """A friction F = level sgn(v) |v|^exponent."""

    level: float
    exponent: float
    viscous_coefficient: float = 0.0


class PowerCoordinates(NamedTuple):
    """Logarithms of level and exponent."""

    names: tuple[str, ...] = ("level", "exponent")

    def pack(self, friction: PowerLaw) -> Array:
        return np.log(friction[:2])

    def unpack(self, z: Array) -> PowerLaw:
        return PowerLaw(*np.exp(z).tolist())

    def bounds(self, z: Array, period: float) -> tuple[Array, Array]:
        return z - REACH, z + REACH

    def force(self, made: Motion, friction: PowerLaw) -> Array:
        return friction.level * np.sign(made.velocity) * np.abs(made.velocity) ** friction.exponent

    def slopes(self, made: Motion, friction: Any) -> Array:
        level, exponent = friction.level, friction.exponent
        power = np.sign(made.velocity) * np.abs(made.velocity) ** exponent.value
        bent = level.value * power * np.log(np.maximum(np.abs(made.velocity), 1e-300))
        return np.column_stack([power * level.tangents.get(i, 0.0) + bent * exponent.tangents.get(i, 0.0) for i in range(2)])
