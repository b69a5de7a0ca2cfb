"""Recordings of a rod dragged along a given motion, with the digitised noise of the paper's sensors.

The elements are integrated here sample by sample, in an independent formulation: stick like a spring, yield, follow.
"""

import math
from collections.abc import Sequence

import numpy as np

from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

PERIOD = 1e-3
PAPER_VELOCITIES = 1e-3 * np.array([2, 3, 4, 6, 8, 10, 12, 14, 16, 20, 25, 30, 45, 60, 75, 90, 105, 120, 135, 150])


def sweep(velocities: Sequence[float] = tuple(PAPER_VELOCITIES), longest: float = 4.0, travel: float = 0.5) -> np.ndarray:
    """Velocity of strokes to and fro, each speed once."""
    parts = []
    for speed in velocities:
        samples = int(min(travel / speed, longest) / PERIOD)
        ramp = np.linspace(0.0, speed, max(2, int(speed / PERIOD)), endpoint=False)
        stroke = np.concatenate([ramp, np.full(samples, speed), ramp[::-1], np.zeros(200)])
        parts += [stroke, -stroke]
    return np.concatenate(parts)


def small_sine(amplitude: float = 1.2e-3, frequency: float = 0.3, duration: float = 30.0) -> np.ndarray:
    """Velocity of the paper's small sine."""
    t = np.arange(int(duration / PERIOD)) * PERIOD
    return amplitude * 2.0 * np.pi * frequency * np.cos(2.0 * np.pi * frequency * t)


def elements(velocity: np.ndarray, friction: Friction) -> np.ndarray:
    """Force of the elements along a velocity, with ten small steps a sample."""
    k, weight = friction.element_stiffness, friction.element_weight
    forces, slips = [0.0] * len(k), [False] * len(k)
    last, step, out = 0.0, PERIOD / 10.0, np.empty(len(velocity))
    rise = friction.static_force - friction.coulomb_force
    for n, v in enumerate(velocity.tolist()):
        if v * last < 0.0:
            slips = [False] * len(k)
        sign = 1.0 if v > 0.0 else -1.0
        level = friction.coulomb_force + rise * math.exp(-((abs(v) / friction.stribeck_velocity) ** friction.stribeck_exponent))
        for i in range(len(k)):
            if not slips[i]:
                forces[i] += k[i] * v * PERIOD
                if sign * forces[i] > weight[i] * level:
                    forces[i], slips[i] = sign * weight[i] * level, True
            elif v != 0.0:
                for _ in range(10):
                    forces[i] += step * friction.attraction_rate * (sign * weight[i] - forces[i] / level)
        last = v if v != 0.0 else last
        out[n] = sum(forces)
    return out


def recorded(
    velocity: np.ndarray,
    rig: Rig,
    seed: int = 0,
    *,
    force_noise: float = 2.0,
    force_step: float = 4.0,
    position_noise: float = 2e-6,
    position_step: float = 5e-6,
) -> Trajectory:
    """Return position and force as the paper's sensors and converters give them."""
    random = np.random.default_rng(seed)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1])) * PERIOD])
    position -= 0.5 * (position.max() + position.min())
    p = rig.plant
    force = (
        p.moving_mass * (np.gradient(velocity, PERIOD) + p.gravity)
        + (p.viscous_damping + rig.friction.viscous_coefficient) * velocity
        + p.spring_stiffness * position
        + elements(velocity, rig.friction)
    )
    noisy_position = position + position_noise * random.standard_normal(len(position))
    noisy_force = force + force_noise * random.standard_normal(len(force))
    signals = {
        "position_m": np.round(noisy_position / position_step) * position_step if position_step else noisy_position,
        "force_n": np.round(noisy_force / force_step) * force_step if force_step else noisy_force,
    }
    return Trajectory(np.arange(len(velocity)) * PERIOD, signals)
