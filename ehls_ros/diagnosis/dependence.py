"""Dependence of a remaining residual on the recorded signals."""

from collections.abc import Mapping

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.loss import CLIP
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.stages import Comparison
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask
from ehls_ros.trajectory import OF_CHAMBERS

KNOTS = 12
"""Knots of the piecewise linear curve that relates a residual to a signal."""

RIDGE = 1e-3
"""Ridge of that regression, as a fraction of the mean curvature, for knots without data."""


def depends_on(e: Array, signals: Mapping[str, Array], even: Mask) -> tuple[str, ...]:
    """Return the names of the signals that predict a residual on held-out blocks, strongest first.

    Args:
        e: the whitened residual, shape (n,).
        signals: mean of each signal over the same windows, shape (n,).
        even: the windows in even blocks, shape (n,); each half is predicted from the other.
    """
    clipped = np.clip(e, -CLIP, CLIP)
    explained = {name: explained_fraction(means, clipped, even) for name, means in signals.items() if np.ptp(means) > 0.0}
    least = max(rules.DEPENDS, rules.DEPENDS_BESIDE * max(explained.values(), default=0.0))
    order = sorted(explained, key=lambda name: -explained[name])
    return tuple(name for name in order if explained[name] >= least)


def signals_along(comparison: Comparison, rig: Rig) -> dict[str, Array]:
    """Return the signals on which a residual may depend, and rates, by the names of the data contract, shape (samples,)."""
    record = comparison.record
    signals = {
        name: record.signals[name]
        for name in (COMMAND, SPOOL, PRESSURE, SUPPLY, POSITION, LOAD, TEMPERATURE, *OF_CHAMBERS)
        if name in record
    }
    if POSITION in record or VELOCITY in record:
        velocity = comparison.motion(rig.effective()).velocity
        signals[VELOCITY] = velocity
        signals["acceleration_m_s2"] = np.gradient(velocity, record.period)
    if PRESSURE in record:
        signals["load_pressure_rate_pa_s"] = comparison.local_fit(record.signals[PRESSURE], 1)
    signals["time_s"] = record.time
    return signals


def explained_fraction(signal: Array, e: Array, even: Mask) -> float:
    """Return the fraction of a residual's held-out variance explained by a piecewise linear function of a signal."""
    return explained_by(_basis(signal), e, even)


def explained_by(basis: Array, e: Array, even: Mask) -> float:
    """Return the fraction of a residual's held-out variance explained by a regression on some columns.

    Args:
        basis: the columns, shape (n, columns).
        e: the residual, shape (n,).
        even: the windows in even blocks, shape (n,); each half is predicted from the other.
    """
    rest, total = 0.0, 0.0
    for train in (even, ~even):
        a = basis[train]
        if not np.any(a) or np.all(train):
            return 0.0
        normal = a.T @ a
        normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        weights = np.linalg.solve(normal, a.T @ e[train])
        rest += float(np.sum((e[~train] - basis[~train] @ weights) ** 2))
        total += float(np.sum(e[~train] ** 2))
    return max(0.0, 1.0 - rest / total) if total > 0.0 else 0.0


def _basis(values: Array) -> Array:
    """Return hat functions over a signal with knots at its quantiles, shape (n, knots)."""
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, KNOTS)))
    if len(knots) < 2:
        return np.ones((len(values), 1))
    return np.column_stack([np.interp(values, knots, row) for row in np.eye(len(knots))])
