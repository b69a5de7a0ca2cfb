"""What is left unexplained: whether there is anything but noise, and on which signals it depends."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import HUBER, Evidence
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.stages import Channel, Comparison
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask

KNOTS = 12
"""Knots of the piecewise linear curve over a signal."""

RIDGE = 1e-3
"""Part of the mean curvature added to the diagonal, so that empty stretches of a signal do no harm."""

DEPENDS = 0.05
"""Part of a residual's variance that a signal has to explain on held-out data to be said to matter."""

SHARE = 0.4
"""Part of what the strongest signal explains that another has to reach to be named beside it."""


class Structure(NamedTuple):
    """What a residual depends on.

    Attributes:
        explained: part of its variance that each signal explains on data held out, by signal.
        depends_on: the signals that matter, strongest first.
    """

    explained: Mapping[str, float]
    depends_on: tuple[str, ...]


def structure(evidence: Evidence, comparison: Comparison, rig: Rig, channel: Channel, e: Array) -> Structure:
    """Find the signals that predict a residual on blocks it was not fitted to.

    Args:
        evidence: of the recording.
        comparison: to take velocities from.
        rig: the model the residual belongs to.
        channel: the residual's channel.
        e: the whitened residual, one a window.
    """
    clipped = np.clip(e, -5.0 * HUBER, 5.0 * HUBER)
    even = evidence.block[channel] % 2 == 0
    found = {}
    for name, values in signals_of(evidence, comparison, rig).items():
        means = evidence.means(channel, values)
        if np.ptp(means) <= 0.0:
            continue
        found[name] = _held_out_r2(_basis(means), clipped, even)
    strongest = max(found.values(), default=0.0)
    order = sorted(found, key=lambda name: -found[name])
    depends = tuple(name for name in order if found[name] >= max(DEPENDS, SHARE * strongest))
    return Structure(found, depends)


def signals_of(evidence: Evidence, comparison: Comparison, rig: Rig) -> dict[str, Array]:
    """Return the signals a residual may depend on, by the names of the data contract and with their rates, shape (n,)."""
    record = evidence.record
    signals = {
        name: record.signals[name] for name in (COMMAND, SPOOL, PRESSURE, SUPPLY, POSITION, LOAD, TEMPERATURE) if name in record
    }
    if POSITION in record or VELOCITY in record:
        velocity = comparison.motion(rig.effective()).velocity
        signals[VELOCITY] = velocity
        signals["acceleration_m_s2"] = np.gradient(velocity, record.period)
    if PRESSURE in record:
        signals["load_pressure_rate_pa_s"] = comparison.local_fit(record.signals[PRESSURE], 1)
    signals["time_s"] = record.time
    return signals


def _basis(values: Array) -> Array:
    """Return hat functions over a signal, knots at its quantiles, shape (n, knots)."""
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, KNOTS)))
    if len(knots) < 2:
        return np.ones((len(values), 1))
    return np.column_stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def _held_out_r2(basis: Array, e: Array, even: Mask) -> float:
    rest, total = 0.0, 0.0
    for train in (even, ~even):
        if not np.any(train) or np.all(train):
            return 0.0
        a = basis[train]
        normal = a.T @ a
        normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        weights = np.linalg.solve(normal, a.T @ e[train])
        rest += float(np.sum((e[~train] - basis[~train] @ weights) ** 2))
        total += float(np.sum(e[~train] ** 2))
    return max(0.0, 1.0 - rest / total) if total > 0.0 else 0.0
