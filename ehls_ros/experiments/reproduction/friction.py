"""The identified friction as the paper's Figures 4 and 5 draw it: Stribeck curve and hysteresis loop."""

from typing import Any

import numpy as np

from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.experiments.reproduction.cases import paper_rig

FASTEST = 0.15
"""Largest velocity of the paper's sweep [m/s]."""

STROKE, FREQUENCY = 1.2e-3, 0.1
"""Amplitude [m] and frequency [Hz] of the small sine; the paper gives no frequency."""

PERIOD = 1e-3


def curves() -> dict[str, Any]:
    """Return both curves: force over velocity, and force over displacement with each element's part."""
    rig = paper_rig()
    friction = rig.friction
    velocity = np.linspace(-FASTEST, FASTEST, 602)
    level = np.array([rig.friction_level(v) for v in velocity])
    steady = np.sign(velocity) * level + friction.viscous_coefficient * velocity

    # Two periods: the first one starts from rest and leads to the loop.
    time = np.arange(round(2.0 / FREQUENCY / PERIOD)) * PERIOD
    omega = 2.0 * np.pi * FREQUENCY
    displacement, speed = STROKE * np.sin(omega * time), STROKE * omega * np.cos(omega * time)
    estimator = FrictionEstimator("gms", rig, PERIOD)
    elements = len(friction.element_stiffness)
    rows = np.array([estimator.update(v)[: 2 + elements].copy() for v in speed])[::20]
    return {
        "velocity_m_s": velocity.tolist(),
        "steady_force_n": steady.tolist(),
        "displacement_m": displacement[::20].tolist(),
        "hysteresis_n": rows[:, 0].tolist(),
        "elements_n": rows[:, 2:].T.tolist(),
    }
