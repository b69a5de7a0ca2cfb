"""What a run is judged by."""

from typing import Any, NamedTuple

import numpy as np

from ehls_ros.trajectory import Trajectory

CONVERGENCE_BAND = 0.01
"""Part of the largest reference the error must stay within to count as converged."""


GROWTH = 1.25
"""The error still grows when the last quarter of a run has one this many times larger than the quarter before."""


class Metrics(NamedTuple):
    """Figures of one run; errors are taken over its last half, the steady part."""

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
        """Return the mapping that ``metrics.json`` holds."""
        return self._asdict()


def evaluate(trajectory: Trajectory) -> Metrics:
    """Judge a run.

    The error has converged when it no longer leaves the larger of :data:`CONVERGENCE_BAND` times the
    largest reference and the largest error of the last half, so that a controller with a large
    steady error is not said never to settle.

    Args:
        trajectory: must hold ``force_n`` and ``force_reference_n``.

    Returns:
        The metrics; ``convergence_s`` is None when the error still grows at the end. Errors are NaN
        when the run has no cycle that holds both force and reference.
    """
    time = trajectory.time_s
    error = np.abs(trajectory["force_n"] - trajectory["force_reference_n"])
    known = np.isfinite(error)
    steady = error[known & (time >= time[0] + 0.5 * (time[-1] - time[0]))]
    missed = int(np.sum(~np.isfinite(trajectory["valve_command_m"]))) if "valve_command_m" in trajectory else 0
    if not steady.size:
        return Metrics(np.nan, np.nan, None, len(time), missed, float(time[-1] - time[0]))
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
