"""Simulated measurements of the paper's static experiment."""

import numpy as np

from ehls_ros.identification import stribeck
from ehls_ros.identification.optimisers.base import Problem

TRUTH = stribeck.StaticFriction(640.8, 865.4, 2.031e-3, 0.8764, 7265.0)
DAMPING = 60.0
SPEEDS = np.array([2, 3, 4, 6, 8, 10, 12, 14, 16, 20, 25, 30, 45, 60, 75, 90, 105, 120, 135, 150]) * 1e-3


def steady_force(velocity: np.ndarray, friction: stribeck.StaticFriction = TRUTH, damping: float = DAMPING) -> np.ndarray:
    """Return the driving force (20) without the spring's [N]."""
    fc, fs, vs, delta, sigma = friction
    level = fc + (fs - fc) * np.exp(-(np.abs(velocity / vs) ** delta))
    return (damping + sigma) * velocity + np.sign(velocity) * level


def paper_problem(seed: int = 1, noise: float = 2.0, resolution: float = 4.0) -> Problem:
    """Return the objective of 40 velocities, six times, with noise and the force sensor's resolution [N]."""
    velocity = np.tile(np.concatenate([SPEEDS, -SPEEDS]), 6)
    force = steady_force(velocity) + noise * np.random.default_rng(seed).standard_normal(velocity.size)
    if resolution > 0.0:
        force = np.round(force / resolution) * resolution
    return stribeck.problem(velocity, force, viscous_damping=DAMPING)
