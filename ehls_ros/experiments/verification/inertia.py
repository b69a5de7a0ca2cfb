"""Inertia correction of a load cell for the mass between it and the specimen.

The cell measures the force on the specimen plus the inertia force of that mass: F_cell = F_specimen + m a, with force and
position positive in the same direction. The acceleration is that of the measured position's fundamental, -(2 pi f)^2 x, so that
no sample is differentiated.
"""

import math

import numpy as np

from ehls_ros.experiments.verification.cycles import Cycles
from ehls_ros.experiments.verification.results import Inertia, Quantity, Refused
from ehls_ros.experiments.verification.uncertainty import COVERAGE, Uncertainty, of_mean


def correct(cycles: Cycles, mass: float, resolution: float, amplitude: Quantity, phase: Quantity) -> Inertia | Refused:
    """Return the inertia correction of a block's amplitude and phase.

    Args:
        cycles: the judged cycles.
        mass: mass between load cell and specimen [kg].
        resolution: standard uncertainty of the position sensor's resolution [m].
        amplitude: amplitude of the measured force.
        phase: phase of the measured force.

    Returns:
        The correction; Refused if the acceleration is not available.
    """
    measured = np.isfinite(cycles.position[:, 0])
    if not measured.any():
        return Refused("the position was not measured over whole cycles, and without it there is no acceleration")
    kept = cycles.only(measured)
    motion = complex(kept.position[:, 0].mean())
    fit = math.sqrt(float(np.mean(kept.position_variance)) / len(kept))
    scatter = of_mean(kept.position[:, 0], 2)
    motion_std = math.hypot(float(np.nanmax([fit, scatter, 0.0])), resolution)
    per_metre = mass * (2.0 * math.pi * float(kept.frequency.mean())) ** 2
    if abs(motion) <= COVERAGE * motion_std:
        return Refused(
            f"the motion, {abs(motion):.2g} m at the cycle's frequency, is not above its uncertainty of "
            f"{COVERAGE * motion_std:.2g} m; the force that it takes is at most {per_metre * 2.0 * COVERAGE * motion_std:.2g} N"
        )
    force, reference = complex(cycles.force[:, 0].mean()), complex(cycles.reference[:, 0].mean())
    inertia, std = -per_metre * motion, per_metre * motion_std
    specimen = force - inertia
    size = abs(specimen)
    in_degrees = math.degrees(std / size) if size else math.nan
    return Inertia(
        mass_kg=mass,
        force_n=abs(inertia),
        force_expanded_n=COVERAGE * std,
        percent=100.0 * abs(inertia) / abs(force) if force else math.nan,
        phase_deg=math.degrees(np.angle(inertia / force)) if force else math.nan,
        amplitude=amplitude._replace(measured=size, uncertainty=_wider(amplitude.uncertainty, std)),
        phase=phase._replace(
            measured=math.degrees(np.angle(specimen / reference)), uncertainty=_wider(phase.uncertainty, in_degrees)
        ),
    )


def _wider(given: Uncertainty, std: float) -> Uncertainty:
    """Add the independent uncertainty of the position to the random part of an uncertainty."""
    return given._replace(repeatability=math.hypot(given.random, std))
