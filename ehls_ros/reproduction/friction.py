"""Identified friction as in the paper's Figures 4 and 5: Stribeck curve and hysteresis loop."""

import numpy as np

from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.reproduction.cases import paper_rig
from ehls_ros.reproduction.results import FrictionCurves

FASTEST = 0.15
"""Largest velocity of the paper's sweep [m/s]."""

STROKE, FREQUENCY = 1.2e-3, 0.1
"""Amplitude [m] and frequency [Hz] of the small sine; the paper gives no frequency."""

PERIOD = 1e-3


def curves() -> FrictionCurves:
    """Return both curves: force over velocity, and force over displacement with the force of each element."""
    rig = paper_rig()
    friction = rig.friction
    velocity = np.linspace(-FASTEST, FASTEST, 602)
    level = np.array([rig.friction_level(v) for v in velocity])
    steady = np.sign(velocity) * level + friction.viscous_coefficient * velocity

    # Two periods: the first starts from rest and leads to the loop.
    time = np.arange(round(2.0 / FREQUENCY / PERIOD)) * PERIOD
    omega = 2.0 * np.pi * FREQUENCY
    displacement, speed = STROKE * np.sin(omega * time), STROKE * omega * np.cos(omega * time)
    estimator = FrictionEstimator("gms", rig, PERIOD)
    elements = len(friction.element_stiffness)
    rows = np.array([estimator.update(v)[: 2 + elements].copy() for v in speed])[::20]
    return FrictionCurves(
        velocity_m_s=tuple(velocity.tolist()),
        steady_force_n=tuple(steady.tolist()),
        displacement_m=tuple(displacement[::20].tolist()),
        hysteresis_n=tuple(rows[:, 0].tolist()),
        elements_n=tuple(map(tuple, rows[:, 2:].T.tolist())),
    )
