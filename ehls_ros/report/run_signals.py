"""Signals and settings of one run for its report."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report.page import Configuration, number
from ehls_ros.report.plot import KILONEWTON, NEWTON, Unit
from ehls_ros.trajectory import Trajectory

PLANE_SAMPLES = 10_000
"""Maximum number of samples in a figure of one signal against another, a few periods."""

UNUSED_AT_ZERO = frozenset({"e3_pa", "s_pa_s", "alpha", "beta", "delta_n", "force_error_n", "force_bound_n"})
"""Signals set to zero by a controller without a sliding mode."""


def known(run: Trajectory, name: str) -> bool:
    """Return whether a signal was recorded and has values."""
    return not _absence(run, name)


def since_start(run: Trajectory) -> NDArray[np.float64]:
    """Return the time since the start [s], shape (n,)."""
    time: NDArray[np.float64] = run.time_s - run.time_s[0]
    return time


def error_of(run: Trajectory) -> NDArray[np.float64] | None:
    """Return force minus reference [N], shape (n,), as measured, else the controller's value; None if neither is known."""
    if "force_n" in run and "force_reference_n" in run:
        with np.errstate(invalid="ignore"):
            error: NDArray[np.float64] = run["force_n"] - run["force_reference_n"]
        if np.isfinite(error).any():
            return error
    return run["force_error_n"] if known(run, "force_error_n") else None


def setting(metadata: Configuration, *keys: str) -> float | None:
    """Return a number from the configuration; None if there is none.

    Args:
        metadata: a trajectory's metadata.
        keys: path to the number.
    """
    value: object = metadata
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def sliding_bound(metadata: Configuration) -> float | None:
    """Return the bound b/h of the sliding variable [Pa/s]; None if the controller has none."""
    b, h = setting(metadata, "spec", "controller", "b"), setting(metadata, "spec", "controller", "h")
    return 1e6 * b / h if b is not None and h else None


def _absence(run: Trajectory, name: str) -> str:
    if name not in run:
        return "not been recorded"
    values = run[name][np.isfinite(run[name])]
    if not values.size:
        return "no values"
    return "no values but zero" if name in UNUSED_AT_ZERO and not values.any() else ""


def missing_reason(run: Trajectory, *names: str) -> str:
    """Return the reason why signals cannot be shown; empty if all can."""
    reasons: dict[str, list[str]] = {}
    for name in names:
        if absence := _absence(run, name):
            reasons.setdefault(absence, []).append(name)
    return ", ".join(
        f"{' and '.join(which)} {'has' if len(which) == 1 else 'have'} {absence}" for absence, which in reasons.items()
    )


def none_known(run: Trajectory, *names: str) -> str:
    """Return the reason why none of some signals can be shown; empty if one can."""
    return "" if any(known(run, name) for name in names) else missing_reason(run, *names)


def missing_together(run: Trajectory, samples: slice, *names: str) -> str:
    """Return the reason why signals cannot be shown together in some samples; empty if they can."""
    if missing := missing_reason(run, *names):
        return missing
    together = np.logical_and.reduce([np.isfinite(run[name][samples]) for name in names])
    return "" if together.any() else f"none of the cycles shown has both {' and '.join(names)}"


def columns_of(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the columns of a signal, shape (columns, n)."""
    columns: NDArray[np.float64] = values.reshape(len(values), -1).T
    return columns


def response_of(run: Trajectory) -> NDArray[np.float64] | None:
    """Return the response times of the loop [s], NaN for untimed cycles, shape (n,); None if no cycle was timed."""
    if not known(run, "response_s"):
        return None
    # Zero means not timed, and cannot be shown on a logarithmic axis.
    response = np.where(np.isfinite(run["response_s"]) & (run["response_s"] > 0), run["response_s"], np.nan)
    return response if np.isfinite(response).any() else None


def largest_of(values: NDArray[np.float64]) -> float:
    """Return the largest finite magnitude, 0 if there is none."""
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if known.size else 0.0


def force_unit(*forces: NDArray[np.float64]) -> Unit:
    """Return the unit in which forces [N] are shown together."""
    return KILONEWTON if max(map(largest_of, forces)) >= 1.0 / KILONEWTON.factor else NEWTON


def last_samples(run: Trajectory) -> slice:
    """Return the samples of the last half shown in a figure of one signal against another."""
    return slice(len(run) - min(len(run) - len(run) // 2, PLANE_SAMPLES), len(run))


def last_seconds(run: Trajectory) -> str:
    """Return a label with the length of the stretch of :func:`last_samples`."""
    return f"last {number(float(run.time_s[-1] - run.time_s[last_samples(run).start]), 2)} s"


WITHOUT_VISCOUS = "without viscous friction"
"""Label of the elements' force if there is only one element."""


def several_elements(run: Trajectory) -> bool:
    """Return whether the friction estimate of a run has more than one element."""
    return any(known(run, name) and len(columns_of(run[name])) > 1 for name in ("friction_elements_n", "friction_slipping"))
