"""Partial answer: causes named although an unexplained remainder is left, which is counted as noise.

If only the sensors' noise counts as noise, a search finds ever more causes in the errors of a model's form, each seemingly
certain. Here the remainder of the best hypothesis counts as noise too, with little information however long the recording (a
coarsened posterior: Miller, Dunson 2019), and a cause must exceed the errors of form that any model has. If none does, or if
several values of the rig file are wrong, these are fitted first and the causes sought beside them. Such a search prefers causes
with many parameters; those that are improbable beside the remainder are dropped or exchanged.
"""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import differences, most_explained, mostly_in, relevance
from ehls_ros.diagnosis.evidence import Evidence, Residuals, sections
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import Assessment, assess, probabilities
from ehls_ros.diagnosis.hypotheses import Candidate, parts
from ehls_ros.diagnosis.loss import closed, rms
from ehls_ros.diagnosis.measurement import BesideForm
from ehls_ros.diagnosis.pool import Pool, Progress
from ehls_ros.diagnosis.remainder import at_a_bound, remainder_as_noise, with_allowances
from ehls_ros.diagnosis.search import POLISHING_STEPS, Place, Searched, inflations, search
from ehls_ros.diagnosis.starts import FITTED, Starts
from ehls_ros.physics.effects import EFFECTS

Rivals = Mapping[str, tuple[Fit, ...]]
"""Possible replacements, by the name of the sought cause."""


class PartialAnswer(NamedTuple):
    """Causes that explain a fraction of the error.

    Attributes:
        evidence: the recording compared with the given model, with the remainder counted as noise.
        found: the causes that are significant beside it.
        refitted: names of those that correct a value of the rig file, if several of its values are wrong.
    """

    evidence: Evidence
    found: Searched
    refitted: tuple[str, ...] = ()


def partial_answer(found: Searched, starts: Starts, progress: Progress, seed: int) -> PartialAnswer | None:
    """Return the causes that are significant despite an unexplained remainder; None if there is none.

    Args:
        found: result of the search with only the sensors' noise counted as noise.
        starts: starting points of its fits.
        progress: called with the progress.
        seed: of the resampling.
    """
    evidence = starts.pool.evidence
    if evidence.standard.form_is_noise:
        full, found_in_full = with_allowances(evidence, found)
        return PartialAnswer(full, found_in_full) if found_in_full.best.names and worthwhile(full, found_in_full.best) else None
    few = _beside_form(found, starts, progress)
    values = fitted_values(Worker(evidence), found.screened)
    # One cause is simpler than several values that are wrong together.
    simple = few is not None and len(few.found.best.names) == 1
    if few is not None and (values is None or (simple and not _explains_more(evidence, values.residuals, few))):
        return few
    many = found if values is None else search(starts, progress, values)
    if not many.best.names or not worthwhile(evidence, many.best):
        return few
    if few is not None and not _explains_more(evidence, many.best.held_out.residuals, few):
        return few
    known, again = needed(starts, many, seed)
    best = again.best
    # A cause at a bound of its range imitates another one.
    if any(at_a_bound(c, best.fit.values[p]) for c, p in zip(best.hypothesis, parts(best.hypothesis), strict=True)):
        return few
    given = () if values is None else values.hypothesis
    refitted = tuple(name for name in best.names if name in {c.name for c in given})
    return PartialAnswer(*with_allowances(known, again), refitted)


def _beside_form(found: Searched, starts: Starts, progress: Progress) -> PartialAnswer | None:
    """Return the few causes that exceed errors of form, if there are any."""
    remains = remainder_as_noise(starts.pool.evidence, found.best.held_out.residuals.values)
    known = replace(remains, standard=BesideForm())
    with closing(starts.pool.beside(known)) as pool:
        known, again = with_allowances(known, search(Starts(pool, starts.tried), progress))
    return PartialAnswer(known, again) if again.best.names and worthwhile(known, again.best) else None


def _explains_more(evidence: Evidence, residuals: Residuals, few: PartialAnswer) -> bool:
    """Return whether residuals are so much smaller than those of a few causes that these miss a worthwhile part."""
    best = few.found.best
    main = max(best.held_out.gain, key=lambda c: float(np.sum(best.held_out.gain[c])))
    left = best.held_out.residuals.values[main] * few.evidence.floor[main] / evidence.floor[main]
    return closed(left, residuals.values[main], evidence.noise[main]) >= rules.WORTHWHILE


def worthwhile(evidence: Evidence, best: Assessment) -> bool:
    """Return whether a hypothesis closes most of the error in its main channel and leaves a small one there."""
    after, main = best.held_out.residuals.values, most_explained(evidence.base, best.held_out.residuals)
    little = evidence.nrmse(main, after[main]) <= rules.FORM_LEFT
    return little and closed(evidence.base.values[main], after[main], evidence.noise[main]) >= rules.WORTHWHILE


def fitted_values(worker: Worker, alone: Sequence[Fit]) -> Fit | None:
    """Fit all rig-file values that some effect corrects; None unless several are wrong.

    Args:
        worker: of the recording compared with the given model.
        alone: every cause alone, with its derivatives.
    """
    hypothesis = tuple({c.name: c for fit in reversed(alone) for c in fit.hypothesis if corrects_value(c.name)}.values())
    if not hypothesis:
        return None
    neutral = np.concatenate([c.neutral for c in hypothesis])
    values = worker.fit(worker.linearise(hypothesis, neutral), POLISHING_STEPS)
    return values if len(wrong(worker.evidence, values)) > 1 else None


def wrong(evidence: Evidence, values: Fit) -> list[str]:
    """Return the names of the corrections that change a balance by more than an error of form.

    Args:
        evidence: the recording compared with the given model.
        values: the fitted values.
    """
    assessed = assess(evidence, values)
    here = sections(evidence.block, values.channels)
    out = []
    for index, (candidate, part) in enumerate(zip(values.hypothesis, parts(values.hypothesis), strict=True)):
        moved = values.jacobian[:, part] @ (values.values[part] - candidate.neutral)
        sizes = {c: max(evidence.sizes[c], 1e-300) for c in here}
        changes = [rms(moved[rows] * evidence.floor[c]) / sizes[c] for c, rows in here.items()]
        if max(changes, default=0.0) >= rules.FORM_ERROR and assessed.sigmas(index) >= rules.MIN_SIGMAS:
            out.append(candidate.name)
    return out


def corrects_value(name: str) -> bool:
    """Return whether an effect corrects a value of the rig file rather than adding a missing mechanism."""
    effect = EFFECTS.load(name)
    return not effect.WORDS.lacking and effect.GROUP != "sensors"


class Changed(NamedTuple):
    """A hypothesis with one cause dropped or replaced."""

    best: Assessment
    rivals: Rivals


def needed(starts: Starts, found: Searched, seed: int) -> tuple[Evidence, Searched]:
    """Drop and exchange causes of a hypothesis until each is probable enough.

    Args:
        starts: starting points of the search's fits.
        found: result of the search; places are known for the last causes.
        seed: of the resampling.

    Returns:
        The evidence with the remainder counted as noise, and the causes assessed on it, with a place for each.
    """
    pool, best, left = starts.pool, found.best.fit, found.best.held_out.residuals.values
    sought = best.hypothesis[len(best.hypothesis) - len(found.places) :]
    rivals: Rivals = {c.name: _rivals(starts, place, c) for c, place in zip(sought, found.places, strict=True)}
    tried = set[frozenset[str]]()
    while True:
        known = remainder_as_noise(pool.evidence, left)
        with closing(pool.beside(known)) as threads:
            now = _assessed(threads, best, rivals, found)
        tried.add(frozenset(now.best.names))
        changed = [c for c in _changes(known, now, rivals, seed) if frozenset(c.best.names) not in tried]
        if not changed:
            return known, now
        after, rivals = max(changed, key=lambda c: c.best.score(now.inflation))
        best = after.fit
        left = {c: e * known.floor[c] / pool.evidence.floor[c] for c, e in after.held_out.residuals.values.items()}


def _rivals(starts: Starts, place: Place, cause: Candidate) -> tuple[Fit, ...]:
    """Return replacements for a cause, those with fewer parameters first, which a search may not have reached."""
    simple = [start.fit for start in starts.extensions(place.without, len(cause.free) - 1)]
    others = {fit.hypothesis[-1].name: fit.only(-1) for fit in (*simple, *(rival.fit for rival in place.rivals))}
    others.pop(cause.name, None)
    return tuple(sorted(others.values(), key=lambda fit: len(fit.values)))


def _assessed(pool: Pool, best: Fit, rivals: Rivals, found: Searched) -> Searched:
    """Fit a hypothesis, each variant without one cause, and each with a rival in that cause's place."""
    (now,) = pool.map(_fitted, [best])
    without = pool.map(_fitted, [now.fit.without(i) for i in range(len(now.names))])
    places = []
    for name, less in zip(now.names, without, strict=True):
        others = [other for other in rivals.get(name, ()) if other.hypothesis[0].name not in now.names]
        starts = [less.fit.beside(other) for other in others[:FITTED]]
        places.append(Place(less, tuple(pool.map(_fitted, starts))))
    scale = inflations(pool.evidence, [now, *(rival for place in places for rival in place.rivals)])
    return Searched(now, tuple(places), found.screened, scale)


def _changes(evidence: Evidence, now: Searched, rivals: Rivals, seed: int) -> list[Changed]:
    """Return the hypotheses without an improbable or irrelevant cause, and those with a better one in a cause's place."""
    best, scale, out = now.best, now.inflation, list[Changed]()
    for index, (name, place) in enumerate(zip(best.names, now.places, strict=True)):
        rest = {n: causes for n, causes in rivals.items() if n != name}
        for other in place.rivals:
            if other.score(scale) > best.score(scale) + rules.BETTER:
                cause = best.fit.only(index), *(r for r in rivals[name] if r.hypothesis[0].name != other.names[-1])
                out.append(Changed(other, {**rest, other.names[-1]: cause}))
        compared = [place.without, best, *place.rivals]
        absent = probabilities([j.per_block(scale) for j in compared], [len(j.fit.values) for j in compared], seed)[0]
        if len(best.names) > 1 and (1.0 - absent < rules.MIN_PROBABILITY or not _matters(evidence, best, place.without)):
            out.append(Changed(place.without, rest))
    return out


def _fitted(worker: Worker, start: Fit) -> Assessment:
    """Fit a hypothesis from its values and assess it; its residuals and derivatives are evaluated afresh."""
    fit = worker.linearise(start.hypothesis, start.values, start.steps)
    return assess(worker.evidence, worker.fit(fit) if fit.hypothesis else fit)


def _matters(evidence: Evidence, best: Assessment, less: Assessment) -> bool:
    """Return whether a cause acts in the hypothesis' main channel or exceeds an error of form."""
    main = most_explained(evidence.base, best.held_out.residuals)
    return mostly_in(best, less) == main or relevance(evidence, differences(evidence, best, less)) >= rules.FORM_ERROR
