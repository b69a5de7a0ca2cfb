"""Causal limit of an experiment: :mod:`ehls_ros.control.limits` applied to a run's rig, disturbance and delay."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.limits import CausalLimit, causal_limit, flow_pressure
from ehls_ros.control.local_plant import double_rod_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.metrics import Metrics, evaluate_controlled
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.physics.rig import Rig
from ehls_ros.recording.topics import DISTURBANCE
from ehls_ros.trajectory import Trajectory

MAX_MISSING = 0.05
"""Fraction of missing samples up to which the disturbance is interpolated linearly."""

MIN_CYCLES = 100
"""Minimum number of cycles for a limit."""


class LimitOfRun(NamedTuple):
    """The causal limit of a run.

    Attributes:
        limit: the limit; None if it cannot be determined.
        reason: reason if there is none; otherwise empty.
    """

    limit: CausalLimit | None
    reason: str = ""


def limit_of_run(run: Trajectory) -> LimitOfRun:
    """Return the causal limit of a run.

    The disturbance is the recorded one, including any reaction of the actuator under test to the loader in that run. The
    velocity reading is considered if the run's controller uses it.

    Args:
        run: a recording whose metadata hold rig and spec.
    """
    given, rig = run.metadata.get("spec"), run.metadata.get("rig")
    if not isinstance(given, dict) or not isinstance(rig, dict):
        return LimitOfRun(None, "the recording has no rig and experiment in its metadata")
    try:
        spec = spec_from_mapping({**given, "rig": rig}, "the recording", Path())
    except BadInput as error:
        return LimitOfRun(None, f"the recording's experiment cannot be read: {error}")
    reason = _inapplicable(spec)
    return LimitOfRun(None, reason) if reason else _limit(spec, run)


def with_causal_limit(metrics: Metrics, run: Trajectory) -> Metrics:
    """Return the metrics of a run with its causal limit beside the error."""
    limit = limit_of_run(run).limit
    return metrics._replace(causal_limit_n=math.nan if limit is None else limit.largest)


def evaluate_recording(run: Trajectory) -> Metrics | None:
    """Evaluate a recording, including its causal limit; None without a reference."""
    metrics = evaluate_controlled(run)
    return None if metrics is None else with_causal_limit(metrics, run)


def _inapplicable(spec: Spec) -> str:
    """Return the reason why an experiment has no causal limit; empty if it has one."""
    if CONTROLLERS.load(spec.controller.name).FOLLOWS != "force":
        return "the reference is a position, not a force"
    rig = spec.loader_rig().effective()
    if rig.piston_mass() > 0.0:
        return "the load is separate from the piston"
    return ""


def _limit(spec: Spec, run: Trajectory) -> LimitOfRun:
    disturbing = tuple(DISTURBANCE.signals.values())
    if not all(signal in run for signal in disturbing):
        return LimitOfRun(None, "the disturbance was not recorded")
    if len(run) < MIN_CYCLES:
        return LimitOfRun(None, f"{len(run)} cycles are too few")
    rows = np.stack([run[signal] for signal in disturbing], axis=1)
    known = np.all(np.isfinite(rows), axis=1)
    if np.mean(~known) > MAX_MISSING:
        return LimitOfRun(None, "the disturbance is missing in too many cycles")
    if not np.all(known):
        cycles = np.arange(len(rows))
        rows = np.stack([np.interp(cycles, cycles[known], column[known]) for column in rows.T], axis=1)
    unread = np.full(len(run), np.nan)
    return limit_under(spec, rows, run.signals.get("spool_m", unread), run.signals.get("load_pressure_pa", unread))


def limit_under(spec: Spec, disturbance: Array, spool: Array, load_pressure: Array) -> LimitOfRun:
    """Return the causal limit of an experiment under a disturbance.

    Args:
        spec: the experiment.
        disturbance: rows as of :func:`~ehls_ros.control.limits.causal_limit`, shape (n, 4).
        spool: spool displacement, NaN where not measured, shape (n,) [m].
        load_pressure: likewise [Pa].
    """
    rig, offset = double_rod_of(spec.loader_rig())
    pressure = load_pressure - offset / rig.plant.piston_area
    limit = causal_limit(
        rig,
        spec.settings.control_period,
        disturbance,
        flow_pressure=_flow_pressure(rig, spool, pressure),
        velocity_read="velocity" in CONTROLLERS.load(spec.controller.name).NEEDS,
    )
    if not math.isfinite(limit.largest):
        return LimitOfRun(None, "the disturbance is not finite or beyond the precision of the numbers")
    return LimitOfRun(limit)


def _flow_pressure(rig: Rig, spool: Array, pressure: Array) -> float:
    """Return the valve's mean flow-pressure coefficient over the last half; 0, its value at null, if not measured."""
    half = len(spool) // 2
    spool, pressure = spool[half:], pressure[half:]
    known = np.isfinite(spool) & np.isfinite(pressure)
    return flow_pressure(spool[known], pressure[known], rig.effective().plant) if np.any(known) else 0.0
