"""Search for causes: all effects one by one, then further causes beside the best of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import accepted, explains, is_new, steadiness, within_form
from ehls_ros.diagnosis.attenuation import corrected
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Fit, Start, Worker, base_loss, newton_start, predicted_loss
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.hypotheses import Candidate, Hypothesis
from ehls_ros.diagnosis.loss import inflation, loss
from ehls_ros.diagnosis.pool import Pool, Progress
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.diagnosis.starts import FITTED, PROMISING, Starts, leading

MAX_CAUSES = 3
"""Most causes that are sought together."""

TOLD_SIGMAS = 2.0
"""Standard errors of its estimate by which a cause must differ from none to be told, unless it gains steadily."""

BEAM = 3
"""Hypotheses carried on to the next number of causes."""

POLISHED = 3
"""Hypotheses of these that are fitted further if they have not settled."""

POLISHING_STEPS = 25
"""Gauss-Newton steps of such a further fit."""

REACH = 0.9
"""Fraction of the best gain that an unsettled fit must predict to be fitted further."""

TRIED_SINGLES = 24
"""Single causes that are tried."""

FITTED_SINGLES = 10
"""Single causes that are fitted to the end."""

MAX_EXCHANGES = 4
"""Most rounds in which causes are exchanged or dropped."""


class Place(NamedTuple):
    """One cause's place in a hypothesis, with alternatives.

    Attributes:
        without: the best hypothesis with the other causes only.
        rivals: the hypotheses with another cause in this place, best first.
    """

    without: Assessment
    rivals: tuple[Assessment, ...]


class Searched(NamedTuple):
    """Result of a search.

    Attributes:
        best: the hypothesis that explains most; without causes if none is needed.
        places: one for each sought cause, in their order; these come last in the hypothesis.
        screened: every cause alone at its starting values, with its derivatives.
        inflation: divisor of each channel's losses.
        always: the hypothesis with a cause that would explain the recording but that the baselines allow as well; only if no
            cause is found.
    """

    best: Assessment
    places: tuple[Place, ...]
    screened: tuple[Fit, ...]
    inflation: Mapping[Channel, float]
    always: Assessment | None = None


def search(starts: Starts, progress: Progress, begin: Fit | None = None) -> Searched:
    """Find the causes that explain a recording.

    Args:
        starts: starting points of the fits.
        progress: called with the progress.
        begin: a hypothesis to which causes are added; its causes stay and have no place. By default the given model.
    """
    pool = starts.pool
    evidence = pool.evidence
    progress("causes one by one", 0.35)
    base = given_model(evidence) if begin is None else assess(evidence, begin)
    level = fitted(evidence, pool, starts.extensions(base)) if base.names else _alone(evidence, pool, starts.alone)
    progress("causes together", 0.55)
    best, scale = _added(evidence, pool, starts, base, level, progress)
    lenient = evidence.standard.lenient()
    if lenient is not None and not best.names:
        evidence = replace(evidence, standard=lenient)
        best, scale = _added(evidence, pool, starts, base, level, progress)
    always = None if best.names else explaining(evidence, base, level, scale)
    best, places = _told(evidence, pool, best, starts, Place(base, tuple(level)), scale)
    scale = inflations(evidence, [best, *[rival for place in places for rival in place.rivals]])
    progress("causes together", 1.0)
    return Searched(best, places, tuple(starts.alone), scale, always)


def _told(
    evidence: Evidence, pool: Pool, best: Assessment, starts: Starts, alone: Place, scale: Mapping[Channel, float]
) -> tuple[Assessment, tuple[Place, ...]]:
    """Return a hypothesis with each cause exchanged or dropped as long as that is better, its estimates, and its places.

    A cause whose size cannot be told from none is dropped, unless it gains steadily.
    """
    best, places = _exchanged(evidence, pool, best, starts, alone, scale)
    while places:
        estimates = _estimated(evidence, best)
        kept = len(best.hypothesis) - len(places)
        vague = [
            place
            for i, place in enumerate(places)
            if estimates.sigmas(kept + i) < TOLD_SIGMAS and steadiness(best, place.without, scale) < rules.MIN_SIGMAS
        ]
        if not vague:
            return estimates, places
        best, places = _exchanged(evidence, pool, vague[0].without, starts, alone, scale)
    return best, places


def _estimated(evidence: Evidence, best: Assessment) -> Assessment:
    """Return a hypothesis at its optimum without bounds of the allowed variation, with estimates and standard errors there.

    At a bound, the slope of the loss changes by orders of magnitude: a fit stops there, and difference quotients across the
    bound make a size seem surer than the variation allows. The estimates are corrected for noise.
    """
    free = Worker(evidence.unbounded())
    start = free.linearise(best.hypothesis, best.fit.values, best.fit.steps)
    fit = free.fit(start)
    bounded = Worker(evidence)
    again = bounded.linearise(best.hypothesis, fit.values, best.fit.steps)
    if again.loss > best.fit.loss + again.negligible(best.fit.loss, len(again.residuals.joined(again.channels))):
        again, fit = best.fit, start
    values, covariance = corrected(free.evidence, fit, assess(free.evidence, fit).held_out.covariance)
    if not fit.costly:
        covariance = covariance + evidence.standard.sizes_by_chance(fit.hypothesis, fit.values, fit.steps)
    found = assess(evidence, again, bounded)
    return found._replace(held_out=found.held_out._replace(covariance=covariance), corrected=values)


def given_model(evidence: Evidence) -> Assessment:
    """Return the hypothesis without causes."""
    return assess(evidence, _afresh(evidence, (), np.empty(0), np.empty(0)))


def _alone(evidence: Evidence, pool: Pool, screened: Sequence[Fit]) -> list[Assessment]:
    """Fit the most promising single causes."""
    gains = np.array([base_loss(evidence, f) - predicted_loss(f) for f in screened])
    order = [int(i) for i in np.argsort(-gains) if gains[i] > PROMISING][:TRIED_SINGLES]
    return fitted(evidence, pool, [newton_start(screened[i]) for i in order], FITTED_SINGLES)


def _added(
    evidence: Evidence, pool: Pool, starts: Starts, best: Assessment, level: list[Assessment], progress: Progress
) -> tuple[Assessment, dict[Channel, float]]:
    """Add causes to a hypothesis while each gains enough; return the best hypothesis and the inflation.

    Args:
        evidence: the recording compared with the given model.
        pool: the threads.
        starts: starting points of the fits.
        best: the hypothesis to begin with.
        level: the same with one more cause.
        progress: called with the progress.
    """
    given, beam = best, [best]
    for count in range(1, MAX_CAUSES + 1):
        ranked, scale = _improving(evidence, level, best, given, beam)
        if not ranked and best is not given:
            level = [*level, *fitted(evidence, pool, starts.anew(best))]
            ranked, scale = _improving(evidence, level, best, given, beam)
        if not ranked:
            break
        best = ranked[0]
        if count == MAX_CAUSES:
            break
        beam = _distinct(ranked)[:BEAM]
        level = fitted(evidence, pool, [start for member in beam for start in starts.extensions(member)])
        progress("causes together", 0.55 + 0.1 * count)
    return best, scale


def _improving(
    evidence: Evidence, level: Sequence[Assessment], best: Assessment, given: Assessment, beam: Sequence[Assessment]
) -> tuple[list[Assessment], dict[Channel, float]]:
    """Return the hypotheses with a further cause that is accepted, best first, and the inflation.

    Args:
        evidence: the recording compared with the given model.
        level: hypotheses with one more cause than those of the beam.
        best: the best one so far.
        given: the one to which all causes are added.
        beam: the hypotheses that the level extends.
    """
    scale = inflations(evidence, [best, *level])
    parents = {_key(member.hypothesis): member for member in beam}
    ranked = list[Assessment]()
    for j in _not_outdone(evidence, level, best, scale):
        parent = parents[_key(j.hypothesis[:-1])]
        others = parent is best or accepted(evidence, j, best, scale) or _leaner(j, best, given, scale)
        if others and accepted(evidence, j, parent, scale):
            ranked.append(j)
    return ranked, scale


def _not_outdone(
    evidence: Evidence, level: Sequence[Assessment], less: Assessment, scale: Mapping[Channel, float]
) -> tuple[Assessment, ...]:
    """Return the hypotheses, best first, that no change within errors of form outdoes by a needed gain.

    Otherwise a wrong cause would be named in place of the right one because it changes more.
    """
    form = [j.score(scale) for j in level if within_form(evidence, j, less)]
    least = max(form, default=-math.inf) - rules.NEEDED_GAIN
    return tuple(j for j in _ranked(level, scale) if j.score(scale) > least)


def _leaner(more: Assessment, best: Assessment, given: Assessment, scale: Mapping[Channel, float]) -> bool:
    """Return whether a hypothesis with more causes has fewer parameters, and explains nearly as much."""
    behind = best.score(scale) - more.score(scale)
    return len(more.fit.values) < len(best.fit.values) and behind < rules.SIMPLER * (best.score(scale) - given.score(scale))


def explaining(
    evidence: Evidence, base: Assessment, level: Sequence[Assessment], scale: Mapping[Channel, float]
) -> Assessment | None:
    """Return the best hypothesis that explains the recording, regardless of the baselines."""
    return next((j for j in _not_outdone(evidence, level, base, scale) if explains(evidence, j, base, scale)), None)


def _afresh(evidence: Evidence, hypothesis: Hypothesis, values: Array, steps: Array) -> Fit:
    """Return an unevaluated hypothesis, with steps for its derivatives."""
    return Fit(hypothesis, values, (), evidence.base, np.empty((0, 0)), 0.0, steps)


def _ranked(found: Sequence[Assessment], scale: Mapping[Channel, float]) -> tuple[Assessment, ...]:
    return tuple(sorted(found, key=lambda j: -j.score(scale)))


def _gain(evidence: Evidence, fit: Fit) -> float:
    return base_loss(evidence, fit) - fit.loss


def fitted(
    evidence: Evidence, pool: Pool, starts: Sequence[Start], keep: int = FITTED, rival: Assessment | None = None
) -> list[Assessment]:
    """Take the first step of every fit, complete the best ones and assess them.

    Args:
        evidence: the recording compared with the given model.
        pool: the threads.
        starts: starting points of the fits.
        keep: number of fits to complete, beside the first of each group of effects.
        rival: hypothesis a fit must come near, besides the best fit, to be continued beyond the usual steps.
    """

    def go(worker: Worker, pair: tuple[Start, Fit]) -> Fit:
        start, after = pair
        if after is not start.fit and after.costly and not after.hypothesis[-1].separates_load:
            return worker.fit(after, fresh=start.fit)
        return worker.fit(worker.linearise_again(start.fit, worker.closer(start.fit, after.values)))

    def finish(worker: Worker, fit: Fit) -> Assessment:
        return assess(evidence, fit if fit.settled else worker.fit(fit, POLISHING_STEPS), worker)

    stepped = pool.map(Worker.first_step, starts)
    order = sorted(range(len(starts)), key=lambda i: -_gain(evidence, stepped[i]))
    chosen = [order[i] for i in leading([stepped[i] for i in order], keep)]
    fits = pool.map(go, [(starts[i], stepped[i]) for i in chosen])
    fits.sort(key=lambda f: -_gain(evidence, f))
    reach = REACH * max([_gain(evidence, f) for f in [*fits[:1], *([rival.fit] if rival is not None else [])]], default=0.0)

    def hopeful(fit: Fit) -> bool:
        return base_loss(evidence, fit) - predicted_loss(fit) >= reach

    return pool.map(finish, [f._replace(settled=f.settled or i >= POLISHED or not hopeful(f)) for i, f in enumerate(fits)])


def inflations(evidence: Evidence, found: Sequence[Assessment]) -> dict[Channel, float]:
    """Return the inflation of each channel under the hypothesis that explains it best."""
    best = {c: min((j.fit.residuals.values[c] for j in found), key=lambda e: float(np.sum(loss(e)))) for c in evidence.channels}
    return {c: inflation(e) * evidence.correlation.get(c, 1.0) for c, e in best.items()}


def _distinct(ranked: Sequence[Assessment]) -> list[Assessment]:
    """Keep the best hypothesis of each set of causes."""
    out = dict[frozenset[str], Assessment]()
    for j in ranked:
        out.setdefault(frozenset(j.names), j)
    return list(out.values())


def _exchanged(
    evidence: Evidence, pool: Pool, best: Assessment, starts: Starts, alone: Place, scale: Mapping[Channel, float]
) -> tuple[Assessment, tuple[Place, ...]]:
    """Exchange or drop each cause of a hypothesis until nothing better is found.

    Args:
        evidence: the recording compared with the given model.
        pool: the threads.
        best: the hypothesis to start from.
        starts: starting points of the fits.
        alone: the place of a single cause; the causes beside it stay.
        scale: the inflation for ranking the first rivals.
    """
    places: tuple[Place, ...] = ()
    kept = len(alone.without.hypothesis)
    # The hypothesis without a cause is the same whichever cause is in its place.
    known = {_key(alone.without.hypothesis): alone}

    def place_of(best: Assessment, index: int) -> Place:
        without = _without(evidence, pool, best, index, alone.without)
        return Place(without, tuple(fitted(evidence, pool, starts.extensions(without), rival=best)))

    visited = set[frozenset[tuple[str, int]]]()
    for exchanges in range(MAX_EXCHANGES + 1):
        visited.add(_key(best.hypothesis))
        keys = {i: _key([c for j, c in enumerate(best.hypothesis) if j != i]) for i in range(kept, len(best.hypothesis))}
        missing = [i for i, key in keys.items() if key not in known]
        known.update(zip([keys[i] for i in missing], pool.lead(partial(place_of, best), missing), strict=True))
        places = tuple(Place(known[key].without, _rivals(evidence, best, known[key], scale)) for key in keys.values())
        scale = inflations(evidence, [best, *[rival for place in places for rival in place.rivals]])
        if exchanges == MAX_EXCHANGES:
            break
        simple = simpler(best, places, scale, beside_form=evidence.standard.form_is_noise)
        # Do not return to a simpler hypothesis that was already exchanged for this one.
        if simple is not None and _key(simple.hypothesis) not in visited:
            best = simple
            continue
        better = list[Assessment]()
        for place in places:
            acceptable = (rival for rival in place.rivals if accepted(evidence, rival, place.without, scale))
            if accepted(evidence, best, place.without, scale):
                # Only for an acceptable rival: another one would be dropped again, and the accepted cause with it.
                better += [rival for rival in islice(acceptable, 1) if rival.score(scale) > best.score(scale) + rules.BETTER]
            else:
                # A cause that is not accepted is dropped, or replaced by an acceptable one.
                better += [place.without, *islice(acceptable, 1)]
        if not better:
            break
        best = max(better, key=lambda j: j.score(scale))
    return best, places


def _rivals(evidence: Evidence, best: Assessment, place: Place, scale: Mapping[Channel, float]) -> tuple[Assessment, ...]:
    """Return the hypotheses with another cause in a place, best first.

    Beside errors of form, only those exceeding them are rivals, and those as good as the best hypothesis, which may just
    exceed a limit that they miss. Against baselines, one that would win although they allow it as well is none: it would
    explain a remainder that is no change.
    """
    without, wins = place.without, best.score(scale) - rules.NEEDED_GAIN

    def competes(rival: Assessment) -> bool:
        if evidence.standard.accepted_rivals_only:
            equal = rival.score(scale) > best.score(scale) - rules.EQUAL
            return equal or accepted(evidence, rival, without, scale)
        return rival.score(scale) < wins or is_new(evidence, rival, without, scale)

    return tuple(rival for rival in _ranked(place.rivals, scale) if competes(rival))


def _key(hypothesis: Sequence[Candidate]) -> frozenset[tuple[str, int]]:
    return frozenset((c.name, c.number) for c in hypothesis)


def simpler(
    best: Assessment, places: Sequence[Place], scale: Mapping[Channel, float], *, beside_form: bool = False
) -> Assessment | None:
    """Return a rival with fewer parameters that is nearly as good, if there is one.

    Args:
        best: the best hypothesis.
        places: one for each of its causes.
        scale: divisor of each channel's losses.
        beside_form: whether errors of the model's form count as noise: then more parameters must gain steadily, as they also
            describe such an error.
    """
    for candidate, place in zip(best.hypothesis[len(best.hypothesis) - len(places) :], places, strict=True):
        total = best.score(scale) - place.without.score(scale)
        for rival in place.rivals:
            other = rival.hypothesis[-1]
            behind = best.score(scale) - rival.score(scale)
            allowed = max(rules.NEEDED_GAIN if other.name == candidate.name else 0.0, rules.SIMPLER * total)
            if beside_form and steadiness(best, rival, scale) < rules.MIN_SIGMAS:
                allowed = max(allowed, rules.EQUAL_FRACTION * total)
            if len(other.free) < len(candidate.free) and behind < allowed:
                return rival
    return None


def _without(evidence: Evidence, pool: Pool, best: Assessment, index: int, nothing: Assessment) -> Assessment:
    """Return a hypothesis refitted without one of its causes."""
    left = best.fit.without(index)
    if not left.hypothesis:
        return nothing
    start = _afresh(evidence, left.hypothesis, left.values, left.steps)
    return fitted(evidence, pool, [Start(start._replace(residuals=best.fit.residuals))])[0]
