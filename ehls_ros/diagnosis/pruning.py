"""Pruning of improbable causes, with the remainder counted as noise.

If only the sensors' noise counts as noise, a search adds causes that fit the form of the remainder, and prefers causes with
many parameters. With the remainder counted as noise, each cause has to exceed such errors of form.
"""

from collections.abc import Mapping
from contextlib import closing
from typing import NamedTuple

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import differences, most_explained, mostly_in, relevance
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import Assessment, assess, probabilities
from ehls_ros.diagnosis.hypotheses import Candidate
from ehls_ros.diagnosis.pool import Pool
from ehls_ros.diagnosis.remainder import remainder_as_noise
from ehls_ros.diagnosis.search import FITTED, Place, Searched, inflations
from ehls_ros.diagnosis.starts import Starts

Rivals = Mapping[str, tuple[Fit, ...]]
"""Possible replacements, by the name of the sought cause."""


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
        starts = [less.fit.beside(other) for other in others[: FITTED]]
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
