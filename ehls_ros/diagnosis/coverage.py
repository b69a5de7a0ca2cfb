"""Coverage of a new recording's operating points by the baselines."""

from collections.abc import Mapping, Sequence

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.dependence import signals_along
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, VELOCITY
from ehls_ros.diagnosis.result import Coverage
from ehls_ros.trajectory import OF_CHAMBERS

COVERED = (POSITION, VELOCITY, PRESSURE, SPOOL, COMMAND, LOAD, *OF_CHAMBERS)
"""Signals that define an operating point; oil temperature is omitted, since it varies from day to day anyway."""


Range = tuple[float, float]
"""Smallest and largest value, apart from a few samples."""


def ranges(healthy: Sequence[Evidence]) -> dict[str, Range]:
    """Return the range of each signal over recordings of the healthy rig."""
    out = dict[str, Range]()
    for evidence in healthy:
        for name, (low, high) in _ranges(evidence).items():
            before = out.get(name, (low, high))
            out[name] = min(before[0], low), max(before[1], high)
    return out


def covered(known: Mapping[str, Range], new: Evidence) -> tuple[Coverage, ...]:
    """Return the fraction of a new recording outside the baselines' range, signal by signal.

    Args:
        known: ranges covered by the baselines, from :func:`ranges`.
        new: the recording compared with the model.
    """
    along, here = signals_along(new.comparison(), new.rig), _ranges(new)
    out = []
    for name in here:
        if name not in known:
            continue
        low, high = known[name]
        margin = rules.MARGIN * (high - low) + rules.NOISE_MARGIN * new.record.noise.get(name, 0.0)
        values = along[name]
        beyond = float(np.mean((values < low - margin) | (values > high + margin)))
        out.append(Coverage(name, (low, high), here[name], beyond))
    return tuple(out)


def _ranges(evidence: Evidence) -> dict[str, Range]:
    ends = (rules.SEEN, 1.0 - rules.SEEN)
    along = signals_along(evidence.comparison(), evidence.rig)
    found = {name: np.quantile(values, ends) for name, values in along.items() if name in COVERED}
    return {name: (float(low), float(high)) for name, (low, high) in found.items()}


def remarks(coverage: Sequence[Coverage]) -> list[str]:
    """Return a remark for each signal that leaves the range covered by the baselines."""
    return [
        f"{100.0 * item.beyond:.0f} % of the recording lie outside the baseline's range: {item.signal} from"
        f" {item.new[0]:.3g} to {item.new[1]:.3g}, in the baseline from {item.baseline[0]:.3g} to {item.baseline[1]:.3g};"
        " a change that shows only there cannot be distinguished from the rig's remainder"
        for item in coverage
        if item.beyond > rules.MENTIONED_UNSEEN
    ]
