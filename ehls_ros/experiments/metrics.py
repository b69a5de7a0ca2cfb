"""What a run is judged by."""

import math
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.trajectory import Trajectory, steady_error

CONVERGENCE_BAND = 0.01
"""Part of the largest reference the error must stay within to count as converged."""


GROWTH = 1.25
"""The error still grows when the last quarter of a run has one this many times larger than the quarter before."""


IN_REAL_TIME = 0.99
"""Part of the cycles due by the wall's clock that has to be answered for a run to have been in real time."""


class Metrics(NamedTuple):
    """Figures of one run; errors are taken over its last half, the steady part, and NaN where no force was to be followed.

    Cycles a second, those due and those answered, and whether that was real time, are told of a run by the wall's clock.
    """

    max_error_n: float
    rms_error_n: float
    convergence_s: float | None
    cycles: int
    missed_cycles: int
    duration_s: float
    cycles_per_second_asked: float | None = None
    cycles_per_second_reached: float | None = None
    in_real_time: bool | None = None
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
    asked, reached, in_real_time = _pace(trajectory, missed)
    if not steady.size:
        return Metrics(np.nan, np.nan, None, len(time), missed, float(time[-1] - time[0]), asked, reached, in_real_time)
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
        cycles_per_second_asked=asked,
        cycles_per_second_reached=reached,
        in_real_time=in_real_time,
    )


def _pace(trajectory: Trajectory, missed: int) -> tuple[float | None, float | None, bool | None]:
    """Return cycles a second asked for and answered, and whether that is real time; None of a run by no wall's clock."""
    wall = trajectory.metadata.get("wall_s")
    duration = float(trajectory.time_s[-1] - trajectory.time_s[0])
    if trajectory.metadata.get("timing") != "realtime" or not isinstance(wall, float) or not (wall > 0.0 < duration):
        return None, None, None
    due = len(trajectory) - 1
    asked, reached = due / duration, (due - missed) / wall
    return asked, reached, reached >= IN_REAL_TIME * asked
