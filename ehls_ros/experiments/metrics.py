"""What a run is judged by."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.errors import BadInput
from ehls_ros.physics.parameters import Limits
from ehls_ros.physics.plausibility import FLAGGED, SHOWN, beyond
from ehls_ros.recording.topics import LOADER_STATE
from ehls_ros.schema import parse
from ehls_ros.trajectory import Trajectory, steady_error

CONVERGENCE_BAND = 0.01
"""Part of the largest reference the error must stay within to count as converged."""

LOST = 0.2
"""Part of the largest reference from which on an error means that the reference is not followed."""

MOSTLY = 0.5
"""Part of the last half from which on a command is said to have been at its limit all the time."""


IN_REAL_TIME = 0.99
"""Part of the cycles due by the wall's clock that has to be answered for a run to have been in real time."""


class Metrics(NamedTuple):
    """Figures of one run; errors are taken over its last half, the steady part, and NaN where no force was to be followed.

    Cycles a second, those due and those answered, and whether that was real time, are told of a run by the wall's clock.

    Attributes:
        convergence_s: when the error entered its band for good, from the start; None where it did not do so in the first half.
        convergence_band_n: half width of the band.
        oscillation_n: half of the way between smallest and largest error.
        warnings: sentences on what makes the run of little use.
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
    convergence_band_n: float = math.nan
    oscillation_n: float = math.nan
    warnings: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the mapping that ``metrics.json`` holds; JSON has null for NaN."""
        plain = {**self._asdict(), "warnings": list(self.warnings)}
        unknown = {name for name, value in plain.items() if isinstance(value, float) and math.isnan(value)}
        return {name: None if name in unknown else value for name, value in plain.items()}


def evaluate(trajectory: Trajectory) -> Metrics:
    """Judge a run.

    The error has converged when it stays within :data:`CONVERGENCE_BAND` times the largest reference, at the latest
    from the middle of the run on. The band is the same whatever the error does: an error that keeps swinging beyond
    it never converges.

    Args:
        trajectory: must hold a sample; the rig's limits are those of its metadata.

    Returns:
        The metrics. Errors are NaN and ``convergence_s`` is None when the run has no cycle that holds both force
        and force reference.
    """
    time = trajectory.time_s
    late = time >= time[0] + 0.5 * (time[-1] - time[0])
    missed = int(np.sum(~np.isfinite(trajectory["valve_command_m"]))) if "valve_command_m" in trajectory else 0
    told = tuple(_warnings(trajectory, late))
    asked, reached, in_real_time = _pace(trajectory, missed)
    metrics = Metrics(
        max_error_n=np.nan,
        rms_error_n=np.nan,
        convergence_s=None,
        cycles=len(time),
        missed_cycles=missed,
        duration_s=float(time[-1] - time[0]),
        warnings=told,
        cycles_per_second_asked=asked,
        cycles_per_second_reached=reached,
        in_real_time=in_real_time,
    )
    steady = steady_error(trajectory, "force_n", "force_reference_n")
    if not steady.size:
        return metrics
    error = trajectory["force_n"] - trajectory["force_reference_n"]
    known = np.isfinite(error)
    band = CONVERGENCE_BAND * float(np.nanmax(np.abs(trajectory["force_reference_n"])))
    outside = np.flatnonzero(known & (np.abs(error) > band))
    entered = float(time[min(outside[-1] + 1, len(time) - 1)] - time[0]) if outside.size else 0.0
    return metrics._replace(
        max_error_n=float(steady.max()),
        rms_error_n=float(np.sqrt(np.mean(steady**2))),
        convergence_s=entered if steady.max() <= band else None,
        convergence_band_n=band,
        oscillation_n=0.5 * float(np.ptp(error[known & late])),
    )


def _warnings(run: Trajectory, late: Any) -> Iterator[str]:
    """Say what makes a run of little use: nothing is followed, the valve has no more to give, the rig's limits are left."""
    followed = (("force", "force_n", "force_reference_n", "N"), ("position", "position_m", "position_reference_m", "m"))
    for quantity, signal, reference, unit in followed:
        error = steady_error(run, signal, reference)
        largest = float(np.nanmax(np.abs(run[reference]))) if error.size else 0.0
        if error.size and error.max() > LOST * largest > 0.0:
            yield (
                f"the {quantity} does not follow its reference: the error of the last half reaches {error.max():.3g} {unit}, "
                f"the reference {largest:.3g} {unit}"
            )
    if "saturated" in run and (share := float(np.mean(run["saturated"][late] > 0.5))) >= MOSTLY:
        yield f"the valve command is at its limit for {100.0 * share:.0f} % of the last half: the rig has no more to give"
    limits = _limits(run.metadata)
    for name in SHOWN if limits is not None else ():
        signal = LOADER_STATE.signals[name]
        if signal in run and limits is not None and (out := beyond(run[signal], limits, name, FLAGGED)) is not None:
            yield f"the rig's limits are left: {out.what} (at {run.time_s[out.row]:.3g} s); a real rig would have been stopped"


def _limits(metadata: Mapping[str, Any]) -> Limits | None:
    """Return the limits of the rig that a run says it is of, None where it says nothing usable."""
    rig = metadata.get("rig")
    if not isinstance(rig, Mapping) or not isinstance(rig.get("limits"), Mapping):
        return None
    try:
        return parse(Limits, rig["limits"], "metadata")
    except BadInput:
        return None


def _pace(trajectory: Trajectory, missed: int) -> tuple[float | None, float | None, bool | None]:
    """Return cycles a second asked for and answered, and whether that is real time; None of a run by no wall's clock."""
    wall = trajectory.metadata.get("wall_s")
    duration = float(trajectory.time_s[-1] - trajectory.time_s[0])
    if trajectory.metadata.get("timing") != "realtime" or not isinstance(wall, float) or not (wall > 0.0 < duration):
        return None, None, None
    due = len(trajectory) - 1
    asked, reached = due / duration, (due - missed) / wall
    return asked, reached, reached >= IN_REAL_TIME * asked
