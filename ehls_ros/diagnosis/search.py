"""Looking for the causes: all effects one by one, then what has to act beside the best of them."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis.evidence import Evidence, loss, noise_power, power
from ehls_ros.diagnosis.fit import Begin, Fit, Worker, base_loss, begin_of, predicted_loss
from ehls_ros.diagnosis.hypotheses import Candidate, parts
from ehls_ros.diagnosis.judged import Judged, held_out, inflation_of
from ehls_ros.diagnosis.pool import Pool
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.diagnosis.starts import MENDED, PROMISING, Progress, Starts

NEEDED = 20.0
"""Gain on held-out data that another cause has to bring, beyond the penalty [nats]; noise alone does not reach it."""

RELEVANT = 5e-4
"""Part of a balance's largest term below which a difference matters to nobody, however sure it is."""

MATTERS = 1e-3
"""The same where another cause acts in the balance already, whose form need not be quite that of the effect's file."""

SHOWN = 0.5
"""Size of a difference, in that of the noise, below which it may be what the noise floor leaves out, however sure it is."""

SURE = 4.5
"""Standard errors that a cause's surest parameter has to be from its neutral value."""

CLOSED = 0.95
"""Part of the removable error that a named cause has to close; what closes less is named by nobody."""

ALL_BUT_FORM = 0.999
"""Part of the removable error that causes close which lack nothing but the form an effect has: 3 % of its size."""

SIMPLER = 5e-3
"""Part of a cause's gain that it may lose for another, or another form of it, with fewer parameters."""

BEAM = 3
"""Hypotheses that are carried on to the next number of causes."""

FITTED = 5
"""Hypotheses that are fitted to the end, of those tried together."""

MOST_POLISHED, POLISHED = 3, 25
"""Hypotheses of them that are fitted on if their fit has not settled, and the steps they get."""

REACH = 0.9
"""Part of the best one's gain that a fit which has not settled has to promise to be fitted on."""

REFINED_SINGLES, FITTED_SINGLES = 24, 10
"""Single causes that are tried, and fitted to the end."""

MOST_CAUSES = 3
"""Most causes that are looked for together."""


class Searched(NamedTuple):
    """What a search found.

    Attributes:
        best: the hypothesis that explains most, without causes where none is needed.
        rests: for each of its causes, the best hypothesis that does without it.
        rivals: for each of its causes, the hypotheses with another cause in its place, best first.
        singles: every cause by itself that was fitted, best first.
        screened: every cause where its fit starts, with its derivatives.
        inflation: by which each channel's losses are divided.
    """

    best: Judged
    rests: tuple[Judged, ...]
    rivals: tuple[tuple[Judged, ...], ...]
    singles: tuple[Judged, ...]
    screened: tuple[Fit, ...]
    inflation: dict[Channel, float]


def search(evidence: Evidence, found: Sequence[Candidate], threads: int, progress: Progress) -> Searched:
    """Find the causes that explain a recording.

    Args:
        evidence: the recording beside the model as it was given.
        found: the causes to try.
        threads: how many to try at once.
        progress: told how far it is.
    """
    pool = Pool(evidence, threads)
    try:
        return _search(evidence, found, pool, progress)
    finally:
        pool.close()


def _search(evidence: Evidence, found: Sequence[Candidate], pool: Pool, progress: Progress) -> Searched:
    starts = Starts(evidence, pool, found, progress)
    screened = starts.alone
    fit = _nothing(evidence)
    nothing = Judged(fit, held_out(evidence, fit))
    gains = np.array([base_loss(evidence, f) - predicted_loss(f) for f in screened])
    order = [int(i) for i in np.argsort(-gains) if gains[i] > PROMISING][:REFINED_SINGLES]
    singles = _fitted(evidence, pool, [begin_of(screened[i]) for i in order], FITTED_SINGLES)
    progress("causes together", 0.55)

    best = nothing
    inflation = _inflation(evidence, [nothing, *singles])
    level = singles
    for count in range(1, MOST_CAUSES + 1):
        inflation = _inflation(evidence, [best, *level])
        ranked = sorted(level, key=lambda j: -j.score(inflation))
        ranked = [j for j in ranked if _needed(evidence, j, best, inflation)]
        if not ranked:
            break
        best = ranked[0]
        beam = _distinct(ranked)[:BEAM]
        if count == MOST_CAUSES:
            break
        begins = [b for member in beam for b in starts.extensions(member)]
        level = _fitted(evidence, pool, begins)
        progress("causes together", 0.55 + 0.1 * count)
    best, rests, rivals = _settled(evidence, pool, best, starts, nothing, singles, inflation)
    inflation = _inflation(evidence, [best, *[j for js in rivals for j in js]])
    progress("causes together", 1.0)
    return Searched(best, rests, rivals, tuple(sorted(singles, key=lambda j: -j.score(inflation))), tuple(screened), inflation)


def _nothing(evidence: Evidence) -> Fit:
    return Fit((), np.empty(0), (), evidence.base, np.empty((0, 0)), 0.0, np.empty(0))


def _gain(evidence: Evidence, fit: Fit) -> float:
    return base_loss(evidence, fit) - fit.loss


def _fitted(
    evidence: Evidence, pool: Pool, begins: Sequence[Begin], keep: int = FITTED, rival: Judged | None = None
) -> list[Judged]:
    """Fit hypotheses: the first step of each, and to the end those that are best after it.

    Args:
        evidence: the recording beside the model as it was given.
        pool: the threads.
        begins: where the fits start.
        keep: how many are fitted to the end.
        rival: what they have to come near to be fitted on; the best of themselves where nothing is said.
    """

    def go(worker: Worker, pair: tuple[Begin, Fit]) -> Fit:
        begin, after = pair
        if after is not begin.fit and after.costly and not after.hypothesis[-1].parts_load:
            return worker.fit(after, fresh=begin.fit)
        return worker.fit(worker.again(begin.fit, worker.nearer(begin.fit, after.values)))

    def finish(worker: Worker, begin: Fit) -> Judged:
        fit = begin if begin.settled else worker.fit(begin, POLISHED)
        return Judged(fit, held_out(evidence, fit, worker))

    stepped = pool.map(Worker.first, begins)
    order = sorted(range(len(begins)), key=lambda i: -_gain(evidence, stepped[i]))
    gone = pool.map(go, [(begins[i], stepped[i]) for i in order[:keep]])
    gone.sort(key=lambda f: -_gain(evidence, f))
    wanted = REACH * max([_gain(evidence, f) for f in [*gone[:1], *([rival.fit] if rival is not None else [])]], default=0.0)

    def hopeful(fit: Fit) -> bool:
        return base_loss(evidence, fit) - predicted_loss(fit) >= wanted

    return pool.map(finish, [f._replace(settled=f.settled or i >= MOST_POLISHED or not hopeful(f)) for i, f in enumerate(gone)])


def _inflation(evidence: Evidence, judged: Sequence[Judged]) -> dict[Channel, float]:
    """Return each channel's inflation under the hypothesis that explains the channel best."""
    best = {c: min((j.fit.errors.values[c] for j in judged), key=lambda e: float(np.sum(loss(e)))) for c in evidence.channels}
    return {c: inflation_of(e) for c, e in best.items()}


def _distinct(ranked: Sequence[Judged]) -> list[Judged]:
    """Keep one hypothesis for each set of names, the best."""
    seen, out = set[frozenset[str]](), []
    for judged in ranked:
        names = frozenset(judged.names)
        if names not in seen:
            seen.add(names)
            out.append(judged)
    return out


def _settled(
    evidence: Evidence,
    pool: Pool,
    best: Judged,
    starts: Starts,
    nothing: Judged,
    singles: list[Judged],
    inflation: dict[Channel, float],
) -> tuple[Judged, tuple[Judged, ...], tuple[tuple[Judged, ...], ...]]:
    """Try another cause in the place of each, and do without each, until nothing better is found."""
    rests: list[Judged] = []
    rivals: tuple[tuple[Judged, ...], ...] = ()
    # What is left when one cause goes is the same for whatever had taken its place.
    known = dict[frozenset[tuple[str, int]], tuple[Judged, list[Judged]]]({frozenset(): (nothing, singles)})

    def other_places(best: Judged, index: int) -> tuple[Judged, list[Judged]]:
        rest = _without(evidence, pool, best, index, nothing)
        return rest, _fitted(evidence, pool, starts.extensions(rest), rival=best)

    for _ in range(4):
        keys = [frozenset((c.name, c.number) for c in best.hypothesis if c is not gone) for gone in best.hypothesis]
        missing = [i for i, key in enumerate(keys) if key not in known]
        known.update(zip([keys[i] for i in missing], pool.lead(partial(other_places, best), missing), strict=True))
        rests = [known[key][0] for key in keys]
        others = [known[key][1] for key in keys]
        rivals = tuple(tuple(sorted(js, key=lambda j: -j.score(inflation))) for js in others)
        inflation = _inflation(evidence, [best, *[j for js in rivals for j in js]])
        simple = _simpler(best, rests, rivals, inflation)
        if simple is not None:
            best = simple
            continue
        better = [rest for rest in rests if not _needed(evidence, best, rest, inflation)]
        better += [js[0] for js in rivals if js and js[0].score(inflation) > best.score(inflation) + 1.0]
        if not better:
            break
        best = max(better, key=lambda j: j.score(inflation))
    return best, tuple(rests), rivals


def _simpler(
    best: Judged, rests: Sequence[Judged], rivals: Sequence[Sequence[Judged]], inflation: dict[Channel, float]
) -> Judged | None:
    """Return the hypothesis with a cause or a form of fewer parameters in a place that is all but as good, if there is one."""
    for index, candidate in enumerate(best.hypothesis):
        whole = best.score(inflation) - rests[index].score(inflation)
        for judged in rivals[index]:
            other = judged.hypothesis[-1]
            behind = best.score(inflation) - judged.score(inflation)
            fewer = len(other.free) < len(candidate.free)
            if fewer and behind < max(NEEDED if other.name == candidate.name else 0.0, SIMPLER * whole):
                return judged
    return None


def _needed(evidence: Evidence, more: Judged, less: Judged, inflation: dict[Channel, float]) -> bool:
    """Tell whether a hypothesis with a cause more is surer than chance allows, and different enough to matter."""
    gain = more.score(inflation) - less.score(inflation)
    further = mostly_in(more, less) in less.fit.channels
    if gain < NEEDED or relevance(evidence, more, less) < (MATTERS if further else RELEVANT):
        return False
    if not further and not shows(evidence, more, less):
        return False
    # A cause that mends little of what is left beside it mends the form of another, not the model.
    left = sum(more.excess(evidence, c) / inflation[c] for c in more.held.gain)
    if mends_form(evidence, more, less):
        return False
    # What averages the noise away more than it explains is an average, and no cause.
    quieted = more.held.quieted - less.held.quieted
    return gain >= MENDED * left and gain >= quieted and _surest(more, less) >= SURE


def mends_form(evidence: Evidence, more: Judged, less: Judged) -> bool:
    """Tell whether a cause finds little but what the form of the others leaves over, and does not close that either."""
    main = mostly_in(more, less)
    if main not in less.fit.channels:
        return False
    noise, before, after = noise_power(evidence, main), *(power(j.held.errors.values[main]) for j in (less, more))
    little = before - noise < (1.0 - ALL_BUT_FORM) * (power(evidence.base.values[main]) - noise)
    return little and before - after < CLOSED * (before - noise)


def mostly_in(more: Judged, less: Judged) -> Channel:
    """Return the channel in which a hypothesis explains most beyond another."""
    before, after = less.held.errors.values, more.held.errors.values
    return max(after, key=lambda c: float(np.sum(before[c] ** 2 - after[c] ** 2)))


def _surest(more: Judged, less: Judged) -> float:
    """Return how many standard errors a cause's surest parameter is from its neutral value, by the blocks' disagreement."""
    return max((more.sigmas(i) for i, name in enumerate(more.names) if name not in less.names), default=0.0)


def relevance(evidence: Evidence, more: Judged, less: Judged) -> float:
    """Return how far two hypotheses differ, as a part of the largest term of the balance they differ most in."""
    largest = 0.0
    for c in evidence.channels:
        apart = np.abs(more.fit.errors.values[c] - less.fit.errors.values[c]) * evidence.floor[c]
        size = max(evidence.sizes[c], 1e-300)
        # What acts seldom has a small mean; where it acts it counts.
        largest = max(largest, float(np.sqrt(np.mean(apart**2))) / size, float(np.quantile(apart, 0.99)) / 5.0 / size)
    return largest


def shows(evidence: Evidence, more: Judged, less: Judged) -> bool:
    """Tell whether two hypotheses differ by a size that stands beside the noise's."""
    apart = (more.fit.errors.values[c] - less.fit.errors.values[c] for c in evidence.channels)
    return any(float(np.sqrt(np.mean(a * a))) >= SHOWN for a in apart)


def _without(evidence: Evidence, pool: Pool, best: Judged, index: int, nothing: Judged) -> Judged:
    hypothesis = tuple(c for i, c in enumerate(best.hypothesis) if i != index)
    if not hypothesis:
        return nothing
    keep = np.ones(len(best.fit.values), dtype=np.bool_)
    keep[parts(best.hypothesis)[index]] = False
    begin = Fit(hypothesis, best.fit.values[keep], (), best.fit.errors, np.empty((0, 0)), 0.0, best.fit.steps[keep])
    return _fitted(evidence, pool, [Begin(begin)])[0]
