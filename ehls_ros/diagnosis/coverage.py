"""How far baselines cover the operating points of a new recording."""

from collections.abc import Sequence

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.dependence import signals_along
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, VELOCITY
from ehls_ros.diagnosis.result import Coverage

COVERED = (POSITION, VELOCITY, PRESSURE, SPOOL, COMMAND, LOAD)
"""Signals that tell an operating point; the oil's temperature moves from day to day anyway."""


def covered(healthy: Sequence[Evidence], new: Evidence) -> tuple[Coverage, ...]:
    """Tell how much of the new recording lies where no baseline has been, signal by signal."""
    ends = (rules.SEEN, 1.0 - rules.SEEN)
    known = [signals_along(e.comparison(), e.rig) for e in healthy]
    out = []
    for name, values in signals_along(new.comparison(), new.rig).items():
        ranges = [np.quantile(k[name], ends) for k in known if name in k]
        if name not in COVERED or not ranges:
            continue
        low, high = min(float(r[0]) for r in ranges), max(float(r[1]) for r in ranges)
        margin = rules.MARGIN * (high - low) + rules.NOISE_MARGIN * new.record.noise.get(name, 0.0)
        beyond = float(np.mean((values < low - margin) | (values > high + margin)))
        here = np.quantile(values, ends)
        out.append(Coverage(name, (low, high), (float(here[0]), float(here[1])), beyond))
    return tuple(out)


def remarks(coverage: Sequence[Coverage]) -> list[str]:
    """Say where a recording leaves what the baselines cover, one sentence for each signal."""
    return [
        f"{100.0 * item.beyond:.0f} % of the recording lie outside what the baseline covers: {item.signal} from"
        f" {item.new[0]:.3g} to {item.new[1]:.3g}, in the baseline from {item.baseline[0]:.3g} to {item.baseline[1]:.3g};"
        " a change that shows there only is not told from the rig's own remainder"
        for item in coverage
        if item.beyond > rules.MENTIONED_UNSEEN
    ]
