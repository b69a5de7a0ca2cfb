"""Causes named while something remains: no rig is its model, and what no effect describes is counted as noise.

A search that takes for noise only what the sensors have finds ever more causes in what a model's form leaves, and holds each
for certain. Here what the best hypothesis leaves is counted as noise too, correlated as it is (a coarsened posterior: Miller,
Dunson 2019), and its causes are exchanged or dropped once more. Those that still matter are named.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, measured_in
from ehls_ros.diagnosis.held_out import Assessment
from ehls_ros.diagnosis.hypotheses import Candidate
from ehls_ros.diagnosis.loss import closed, power
from ehls_ros.diagnosis.pool import Progress
from ehls_ros.diagnosis.remainder import in_full
from ehls_ros.diagnosis.search import Searched, search
from ehls_ros.diagnosis.stages import Channel


class PartialAnswer(NamedTuple):
    """Causes that explain a fraction of the error.

    Attributes:
        evidence: the recording compared with the given model, with what remains counted as noise.
        found: the causes that matter beside it.
    """

    evidence: Evidence
    found: Searched


def partial_answer(
    evidence: Evidence, found: Searched, tried: Sequence[Candidate], threads: int, progress: Progress
) -> PartialAnswer | None:
    """Return the causes that matter although something remains; None if none does.

    Args:
        evidence: the recording compared with the given model.
        found: what the search found while only the sensors' noise counted as noise.
        tried: the causes to try.
        threads: how many to try at once.
        progress: called with the progress.
    """
    if not found.best.names:
        return None
    if evidence.against_baselines:
        # Beside baselines, what the rig's own form leaves counted as noise from the beginning.
        return PartialAnswer(*in_full(evidence, found)) if worthwhile(evidence, found.best) else None
    known = remainder_as_noise(evidence, found.best.held_out.residuals.values)
    known, again = in_full(known, search(known, tried, threads, progress, found.best.fit))
    return PartialAnswer(known, again) if again.best.names and worthwhile(known, again.best) else None


def remainder_as_noise(evidence: Evidence, left: Mapping[Channel, Array]) -> Evidence:
    """Return the comparison with what a hypothesis leaves counted as noise, channel by channel.

    Args:
        evidence: the comparison.
        left: held-out residuals of the hypothesis, whitened with the comparison's own noise floor.
    """
    floor, correlation = dict[Channel, Array](), dict[Channel, float]()
    for c in evidence.channels:
        remains, noise = left[c] * evidence.floor[c], evidence.noise[c] * evidence.floor[c]
        beyond = max(0.0, power(remains) - power(noise))
        floor[c] = np.sqrt(evidence.floor[c] ** 2 + beyond)
        correlation[c] = correlated(remains) if beyond > power(noise) else 1.0
    return replace(measured_in(evidence, floor, correlation), imperfect=True)


def correlated(e: Array) -> float:
    """Return the number of successive residuals that are alike: the integrated autocorrelation time, at least 1.

    The sum ends where it is shorter than a fifth of the lags summed (Sokal's window).
    """
    n, centred = len(e), e - np.mean(e)
    spectrum = np.fft.rfft(centred, 2 * n)
    covariance = np.fft.irfft(spectrum * np.conj(spectrum))[:n]
    if not covariance[0] > 0.0:
        return 1.0
    times = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
    ended = np.flatnonzero(np.arange(n) >= rules.SOKAL_WINDOW * times)
    return max(1.0, float(times[ended[0]] if ended.size else times[-1]))


def worthwhile(evidence: Evidence, best: Assessment) -> bool:
    """Tell whether a hypothesis is worth naming: where it explains most it closes most of the error, and leaves a small one."""
    after = best.held_out.residuals.values
    main = max(evidence.channels, key=lambda c: float(np.sum(evidence.base.values[c] ** 2 - after[c] ** 2)))
    little = evidence.nrmse(main, after[main]) <= rules.FORM_LEFT
    return little and closed(evidence.base.values[main], after[main], evidence.noise[main]) >= rules.WORTHWHILE
