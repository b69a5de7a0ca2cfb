"""Dependence of a remaining residual on the recorded signals."""

from collections.abc import Mapping
from functools import partial
from itertools import accumulate

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.loss import CLIP
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY, Record
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


def kept_by_play(record: Record, values: Array, width: float) -> Array:
    """Return the distance of a signal from the output of a play that follows it, shape (samples,): its recent direction.

    Args:
        record: the recording.
        values: the signal, shape (samples,).
        width: of the play, in the signal's unit.
    """
    return values - record.by_stretch(partial(play_of, width=width), values)


def play_of(values: Array, width: float) -> Array:
    """Return the output of a play that follows a signal, from zero, shape (n,).

    Args:
        values: the signal, shape (n,).
        width: of the play, in the signal's unit.
    """
    half = 0.5 * width
    states = accumulate(values.tolist(), lambda state, value: min(max(state, value - half), value + half), initial=0.0)
    return np.array(list(states)[1:])


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
    halves = basis[even], basis[~even]
    normals, moments = [a.T @ a for a in halves], [a.T @ e[half] for a, half in zip(halves, (even, ~even), strict=True)]
    return float(explained_shares(np.array(normals), np.array(moments), powers(e, even)))


def powers(e: Array, even: Mask) -> Array:
    """Return the sums of squares of a residual in even and odd blocks, shape (2,)."""
    return np.array([float(np.sum(e[half] ** 2)) for half in (even, ~even)])


def explained_shares(normals: Array, moments: Array, squares: Array) -> Array:
    """Return the fractions of a residual's held-out variance explained by regressions on sets of columns, shape (...).

    Args:
        normals: products of each set's columns with each other in even and odd blocks, shape (2, ..., columns, columns).
        moments: products of the columns with the residual there, shape (2, ..., columns).
        squares: sums of squares of the residual there, shape (2,); each half is predicted from the other.
    """
    count = normals.shape[-1]
    ridge = RIDGE * np.trace(normals, axis1=-2, axis2=-1) / count + np.finfo(np.float64).tiny
    # A half without any of the columns predicts nothing.
    weights = np.linalg.solve(normals + ridge[..., None, None] * np.eye(count), moments[..., None])[..., 0]
    others = weights[::-1]
    removed = 2.0 * np.sum(others * moments, axis=-1) - np.einsum("...i,...ij,...j->...", others, normals, others)
    total = float(np.sum(squares))
    shares: Array = np.maximum(0.0, np.sum(removed, axis=0) / total) if total > 0.0 else np.zeros(normals.shape[1:-2])
    return shares


def _basis(values: Array) -> Array:
    """Return hat functions over a signal with knots at its quantiles, shape (n, knots)."""
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, KNOTS)))
    if len(knots) < 2:
        return np.ones((len(values), 1))
    return np.column_stack([np.interp(values, knots, row) for row in np.eye(len(knots))])
