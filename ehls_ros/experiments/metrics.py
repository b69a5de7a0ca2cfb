"""What a run is judged by."""

import math
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.trajectory import Trajectory, steady_error

CONVERGENCE_BAND = 0.01
"""Part of the largest reference the error must stay within to count as converged."""


GROWTH = 1.25
"""The error still grows when the last quarter of a run has one this many times larger than the quarter before."""


class Metrics(NamedTuple):
    """Figures of one run; errors are taken over its last half, the steady part, and NaN where no force was to be followed."""

    max_error_n: float
    rms_error_n: float
    convergence_s: float | None
    cycles: int
    missed_cycles: int
    duration_s: float
    wall_s: float | None = None
    bag: str | None = None
    report: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the mapping that ``metrics.json`` holds; JSON has null for NaN."""
        unknown = {name for name, value in self._asdict().items() if isinstance(value, float) and math.isnan(value)}
        return {name: None if name in unknown else value for name, value in self._asdict().items()}


def evaluate(trajectory: Trajectory) -> Metrics:
    """Judge a run.

    The error has converged when it no longer leaves the larger of :data:`CONVERGENCE_BAND` times the
    largest reference and the largest error of the last half, so that a controller with a large
    steady error is not said never to settle.

    Args:
        trajectory: must hold a sample.

    Returns:
        The metrics; ``convergence_s`` is None when the error still grows at the end. Errors are NaN and
        ``convergence_s`` is None when the run has no cycle that holds both force and force reference.
    """
    time = trajectory.time_s
    steady = steady_error(trajectory, "force_n", "force_reference_n")
    missed = int(np.sum(~np.isfinite(trajectory["valve_command_m"]))) if "valve_command_m" in trajectory else 0
    if not steady.size:
        return Metrics(np.nan, np.nan, None, len(time), missed, float(time[-1] - time[0]))
    error = np.abs(trajectory["force_n"] - trajectory["force_reference_n"])
    known = np.isfinite(error)
    largest_reference = float(np.nanmax(np.abs(trajectory["force_reference_n"])))
    band = max(CONVERGENCE_BAND * largest_reference, float(steady.max()))
    outside = np.flatnonzero(known & (error > band))
    converged: float | None = float(time[outside[-1] + 1] - time[0]) if outside.size else 0.0
    earlier, later = np.array_split(steady, 2)
    if later.max(initial=0.0) > max(CONVERGENCE_BAND * largest_reference, GROWTH * earlier.max(initial=0.0)):
        converged = None
    return Metrics(
        max_error_n=float(steady.max()),
        rms_error_n=float(np.sqrt(np.mean(steady**2))),
        convergence_s=converged,
        cycles=len(time),
        missed_cycles=missed,
        duration_s=float(time[-1] - time[0]),
    )
