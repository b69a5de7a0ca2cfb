"""Figures of merit of a run."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.estimate_bounds import Bound, bounds_of, sentence
from ehls_ros.errors import BadInput
from ehls_ros.physics.parameters import Limits
from ehls_ros.physics.plausibility import LIMIT_UNITS, WARNING_FACTOR, beyond
from ehls_ros.recording.events import read_pauses, time_closed
from ehls_ros.recording.topics import CONTROLLER_STATUS, LOADER_STATE
from ehls_ros.schema import parse
from ehls_ros.trajectory import Trajectory, steady_error

CONVERGENCE_BAND = 0.01
"""Band of a converged error, as a fraction of the largest reference."""

MIN_LOST_ERROR = 0.2
"""Error above which the reference counts as not followed, as a fraction of the largest reference."""

MIN_SATURATED = 0.5
"""Fraction of the last half above which saturation of the command is a warning."""

IN_REAL_TIME = 0.99
"""Fraction of the cycles due by wall clock that a real-time run must answer."""


class Metrics(NamedTuple):
    """Content of ``metrics.json`` for one run; NaN is null there.

    Errors refer to the last half, the steady part; NaN without a force reference.

    Attributes:
        max_error_n, rms_error_n: largest and rms force error [N].
        convergence_s: time from the start until the error stays in its band [s]; None if it does not within the first half.
        cycles, missed_cycles: control cycles, and those without an answer.
        duration_s: plant time [s].
        cycles_per_second_asked, cycles_per_second_reached: cycles due and answered by wall clock [1/s]; None in lockstep.
        in_real_time: whether enough of these cycles were answered; None in lockstep.
        wall_s: wall time [s].
        bag, report: paths of the recording and of the report.
        convergence_band_n: half width of the band [N].
        oscillation_n: half the distance between smallest and largest error [N].
        causal_limit_n: largest true error expected of the best controller without foresight [N], see
            :mod:`ehls_ros.control.limits`; NaN if not requested or not determined.
        warnings: one sentence per reason why the run is of limited use.
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
    causal_limit_n: float = math.nan
    warnings: tuple[str, ...] = ()


def evaluate(trajectory: Trajectory) -> Metrics:
    """Evaluate a run.

    The error has converged when it stays within :data:`CONVERGENCE_BAND` times the largest reference, by the middle of the
    run at the latest. The band does not depend on the error: one that keeps oscillating beyond it never converges.

    Args:
        trajectory: the run, at least one sample; the rig's limits are those of its metadata.

    Returns:
        The metrics. Errors are NaN and ``convergence_s`` is None if no cycle has both force and force reference.
    """
    metrics = evaluate_errors(trajectory)
    asked, reached, in_real_time = _pace(trajectory, metrics.missed_cycles)
    return metrics._replace(
        warnings=tuple(_warnings(trajectory, _late(trajectory))),
        cycles_per_second_asked=asked,
        cycles_per_second_reached=reached,
        in_real_time=in_real_time,
    )


def evaluate_errors(trajectory: Trajectory) -> Metrics:
    """Evaluate a run without warnings and without its pace; see :func:`evaluate`."""
    time = trajectory.time_s
    missed = int(np.sum(~np.isfinite(trajectory["valve_command_m"]))) if "valve_command_m" in trajectory else 0
    metrics = Metrics(
        max_error_n=np.nan,
        rms_error_n=np.nan,
        convergence_s=None,
        cycles=len(time),
        missed_cycles=missed,
        duration_s=float(time[-1] - time[0]),
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
        oscillation_n=0.5 * float(np.ptp(error[known & _late(trajectory)])),
    )


def _late(trajectory: Trajectory) -> NDArray[np.bool_]:
    """Return which samples are in the last half."""
    time = trajectory.time_s
    late: NDArray[np.bool_] = time >= time[0] + 0.5 * (time[-1] - time[0])
    return late


def evaluate_controlled(trajectory: Trajectory) -> Metrics | None:
    """Evaluate a recording; None without a reference."""
    return evaluate(trajectory) if {"force_reference_n", "position_reference_m"} & trajectory.signals.keys() else None


def _warnings(run: Trajectory, late: NDArray[np.bool_]) -> Iterator[str]:
    """Yield warnings on a run: reference not followed, valve saturated, an estimate at its bound, limits exceeded."""
    followed = (("force", "force_n", "force_reference_n", "N"), ("position", "position_m", "position_reference_m", "m"))
    for quantity, signal, reference, unit in followed:
        error = steady_error(run, signal, reference)
        largest = float(np.nanmax(np.abs(run[reference]))) if error.size else 0.0
        if error.size and error.max() > MIN_LOST_ERROR * largest > 0.0:
            reached, wanted = (f"{_rounded(value)} {unit}" for value in (error.max(), largest))
            lost = f"the error of the last half reaches {reached}, the reference {wanted}"
            yield f"the {quantity} does not follow its reference: {lost}"
    if "saturated" in run and (share := float(np.mean(run["saturated"][late] > 0.5))) >= MIN_SATURATED:
        yield f"the valve command is at its limit for {100.0 * share:.0f} % of the last half: the rig can give no more"
    for bound in bounds_in(run.metadata):
        # An estimate has the same index in the status as its signal in the topic.
        values = run.signals.get(tuple(CONTROLLER_STATUS.signals.values())[bound.place])
        stood = 0.0 if values is None else float(np.mean(bound.reached(values[late])))
        if stood > 0.0:
            yield sentence(bound, f"for {max(round(100.0 * stood), 1)} % of the last half")
    limits = _limits(run.metadata)
    for name in LIMIT_UNITS if limits is not None else ():
        signal = LOADER_STATE.signals[name]
        if signal in run and limits is not None and (out := beyond(run[signal], limits, name, WARNING_FACTOR)) is not None:
            time = _rounded(run.time_s[out.row] - run.time_s[0])
            yield f"the rig leaves its limits: {out.what} (at {time} s); a real rig would have been stopped"


def _rounded(value: float) -> str:
    """Return three significant digits, without a power of ten up to a million."""
    return f"{float(f'{value:.3g}'):g}"


def stops_of(bag: Path, run: Trajectory) -> tuple[str, ...]:
    """Return a warning for a run in which the safety gate closed the valve; empty otherwise.

    Args:
        bag: folder of its bag, or one storage file.
        run: the run.
    """
    closed = time_closed(read_pauses(bag), run.time_s[0], run.time_s[-1]) if len(run) else 0.0
    return (f"the safety gate kept the valve closed for {closed:.3g} s; the errors include that time",) if closed else ()


def bounds_in(metadata: Mapping[str, Any]) -> tuple[Bound, ...]:
    """Return the bounds of the estimates of a run's controller; none if the metadata do not contain the controller."""
    spec = metadata.get("spec")
    given = spec.get("controller") if isinstance(spec, Mapping) else None
    if not isinstance(given, Mapping) or given.get("name") not in CONTROLLERS.names():
        return ()
    law = CONTROLLERS.load(str(given["name"]))
    try:
        tuning = parse(law.Parameters, {key: value for key, value in given.items() if key != "name"}, "metadata")
    except BadInput:
        return ()
    return bounds_of(law, tuning)


def _limits(metadata: Mapping[str, Any]) -> Limits | None:
    """Return the limits of the rig from a run's metadata; None if missing or unusable."""
    rig = metadata.get("rig")
    if not isinstance(rig, Mapping) or not isinstance(rig.get("limits"), Mapping):
        return None
    try:
        return parse(Limits, rig["limits"], "metadata")
    except BadInput:
        return None


def _pace(trajectory: Trajectory, missed: int) -> tuple[float | None, float | None, bool | None]:
    """Return cycles due and answered per second of wall clock, and whether this is real time; None for a run in lockstep."""
    wall = trajectory.metadata.get("wall_s")
    if trajectory.metadata.get("timing") != "realtime" or not isinstance(wall, float) or not wall > 0.0 or len(trajectory) < 2:
        return None, None, None
    # The median, not the mean: when simulated time falls behind, the stamps are set to the clock.
    asked, reached = 1.0 / float(np.median(np.diff(trajectory.time_s))), (len(trajectory) - 1 - missed) / wall
    return asked, reached, reached >= IN_REAL_TIME * asked
