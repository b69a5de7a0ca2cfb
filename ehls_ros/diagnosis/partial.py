"""Causes named while something remains: no rig is its model, and what no effect describes is counted as noise.

A search that takes for noise only what the sensors have finds ever more causes in what a model's form leaves, and holds each
for certain. Here what the best hypothesis leaves is counted as noise too, correlated as it is (a coarsened posterior: Miller,
Dunson 2019), and its causes are exchanged or dropped once more. Those that still matter are named.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import mostly_in
from ehls_ros.diagnosis.evidence import Evidence, Residuals, sections
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.hypotheses import Candidate, parts
from ehls_ros.diagnosis.loss import closed, power
from ehls_ros.diagnosis.pool import Progress
from ehls_ros.diagnosis.remainder import at_a_bound
from ehls_ros.diagnosis.search import Place, Searched, inflations, search
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.physics.effects import EFFECTS


class PartialAnswer(NamedTuple):
    """Causes that explain a fraction of the error.

    Attributes:
        evidence: the recording compared with the given model, with what remains counted as noise.
        found: the causes that matter beside it.
        refitted: names of those that stand for a wrong value in the rig file, where several of its values are wrong.
    """

    evidence: Evidence
    found: Searched
    refitted: tuple[str, ...] = ()


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
    few = _beside_form(evidence, found, tried, threads, progress)
    worker = Worker(evidence)
    values = fitted_values(worker, found.screened)
    if few is not None and (values is None or not _explains_more(evidence, values, few)):
        return few
    many = found if values is None else search(evidence, tried, threads, progress, values)
    if not many.best.names or not worthwhile(evidence, many.best):
        return few
    answer = _needed(worker, many)
    best = answer.found.best
    # What is stretched as far as it goes stands for something else.
    stretched = any(at_a_bound(c, best.fit.values[p]) for c, p in zip(best.hypothesis, parts(best.hypothesis), strict=True))
    return few if stretched else answer


def _beside_form(
    evidence: Evidence, found: Searched, tried: Sequence[Candidate], threads: int, progress: Progress
) -> PartialAnswer | None:
    """Return the few causes that stand out of errors of form, if there are any."""
    known = remainder_as_noise(evidence, found.best.held_out.residuals.values)
    # What is larger than an error of form is likelier a cause than what is not, however much of its own stage it explains.
    for form in (rules.FORM_ERROR, rules.RELEVANT):
        beside = replace(known, form=form)
        again = search(beside, tried, threads, progress)
        if again.best.names and worthwhile(beside, again.best):
            return PartialAnswer(beside, again)
    return None


def fitted_values(worker: Worker, alone: Sequence[Fit]) -> Fit | None:
    """Fit all values of the rig file that a cause of the list corrects; None unless several are off by more than form.

    Args:
        worker: of the recording compared with the given model.
        alone: every cause alone, with its derivatives.
    """
    hypothesis = tuple({c.name: c for fit in reversed(alone) for c in fit.hypothesis if corrects_value(c.name)}.values())
    if not hypothesis:
        return None
    neutral = np.concatenate([c.neutral for c in hypothesis])
    values = worker.fit(worker.linearise(hypothesis, neutral), rules.POLISHING_STEPS)
    return values if len(_wrong(worker.evidence, values)) > 1 else None


def _wrong(evidence: Evidence, values: Fit) -> list[str]:
    """Return the names of the values that change a balance by more than an error of form."""
    assessed = assess(evidence, values)
    here = sections(evidence.block, values.channels)
    wrong = []
    for index, (candidate, part) in enumerate(zip(values.hypothesis, parts(values.hypothesis), strict=True)):
        moved = values.jacobian[:, part] @ (values.values[part] - candidate.neutral)
        changes = [math.sqrt(power(moved[rows] * evidence.floor[c])) / evidence.sizes[c] for c, rows in here.items()]
        if max(changes) >= rules.FORM_ERROR and assessed.sigmas(index) >= rules.SURE:
            wrong.append(candidate.name)
    return wrong


def corrects_value(name: str) -> bool:
    """Tell whether an effect corrects a value of the rig file, rather than add what the model lacks."""
    effect = EFFECTS.load(name)
    return not effect.WORDS.lacking and effect.GROUP != "sensors"


def _explains_more(evidence: Evidence, values: Fit, few: PartialAnswer) -> bool:
    """Tell whether the fitted values leave so much less than a few causes that these miss something worthwhile."""
    best = few.found.best
    main = max(best.held_out.gain, key=lambda c: float(np.sum(best.held_out.gain[c])))
    left = best.held_out.residuals.values[main] * few.evidence.floor[main] / evidence.floor[main]
    return closed(left, values.residuals.values[main], power(evidence.noise[main])) >= rules.WORTHWHILE


def _needed(worker: Worker, found: Searched) -> PartialAnswer:
    """Return the causes without which clearly more remains, and what remains counted as noise.

    Args:
        worker: of the recording compared with the given model.
        found: the causes, of which the places of the last are known.
    """
    evidence = worker.evidence
    sought = {c.name: place.rivals for c, place in zip(found.best.hypothesis[-len(found.places) :], found.places, strict=True)}
    # What more parameters explain beyond that is an error of form.
    alike = [
        (rival, name)
        for name, rivals in sought.items()
        for rival in rivals
        if _worth(evidence, found.best, rival) < rules.REMOVED_EXCESS
    ]
    best, instead = min([(found.best, ""), *alike], key=lambda pair: len(pair[0].fit.values))
    if instead:
        sought[best.names[-1]] = sought.pop(instead)
    while True:
        without = [_without(worker, best, index) for index in range(len(best.names))]
        worth = [_worth(evidence, best, other) for other in without]
        least = int(np.argmin(worth))
        if worth[least] >= rules.REMOVED_EXCESS:
            break
        best = without[least]
    known = remainder_as_noise(evidence, best.held_out.residuals.values)
    beside = Worker(known)

    def again(assessed: Assessment) -> Assessment:
        fit = beside.linearise(assessed.hypothesis, assessed.fit.values, assessed.fit.steps)
        return assess(known, beside.fit(fit, rules.POLISHING_STEPS))

    places = []
    for candidate, other in zip(best.hypothesis, without, strict=True):
        rivals = [r for r in sought.get(candidate.name, ()) if r.names[-1] not in best.names][: rules.RIVALS]
        places.append(Place(again(other), tuple(again(_beside(other, rival)) for rival in rivals)))
    now = again(best)
    scale = inflations(known, [now, *(rival for place in places for rival in place.rivals)])
    refitted = tuple(name for name in best.names if name not in sought)
    return PartialAnswer(known, Searched(now, tuple(places), found.screened, scale), refitted)


def _without(worker: Worker, best: Assessment, index: int) -> Assessment:
    """Return a hypothesis fitted again without one of its causes."""
    hypothesis = tuple(c for i, c in enumerate(best.hypothesis) if i != index)
    kept = np.ones(len(best.fit.values), dtype=np.bool_)
    kept[parts(best.hypothesis)[index]] = False
    fit = worker.linearise(hypothesis, best.fit.values[kept], best.fit.steps[kept])
    return assess(worker.evidence, worker.fit(fit))


def _worth(evidence: Evidence, more: Assessment, less: Assessment) -> float:
    """Return the fraction of what a hypothesis with one cause fewer leaves that the cause closes."""
    main = mostly_in(more, less)
    before, after = (j.held_out.residuals.values[main] for j in (less, more))
    return closed(before, after, power(evidence.noise[main]))


def _beside(without: Assessment, rival: Assessment) -> Assessment:
    """Return a hypothesis with the last cause of another, at the values of both, yet to be fitted."""
    other, part = rival.hypothesis[-1], parts(rival.hypothesis)[-1]
    fit = without.fit._replace(
        hypothesis=(*without.hypothesis, other),
        values=np.concatenate([without.fit.values, rival.fit.values[part]]),
        steps=np.concatenate([without.fit.steps, rival.fit.steps[part]]),
    )
    return without._replace(fit=fit)


def remainder_as_noise(evidence: Evidence, left: Mapping[Channel, Array]) -> Evidence:
    """Return the comparison with what a hypothesis leaves counted as noise, channel by channel.

    The sensors' noise is independent from window to window. An error of form repeats wherever the rig comes by again: however
    long the recording, it tells no more than :data:`rules.FORM_FREEDOMS` independent windows would.

    Args:
        evidence: the comparison.
        left: held-out residuals of the hypothesis, whitened with the comparison's own noise floor.
    """
    floor, correlation = dict[Channel, Array](), dict[Channel, float]()
    for c in evidence.channels:
        remains, noise = (power(e * evidence.floor[c]) for e in (left[c], evidence.noise[c]))
        beyond = max(0.0, remains - noise)
        alike = max(1.0, len(left[c]) / rules.FORM_FREEDOMS)
        floor[c] = np.sqrt(evidence.floor[c] ** 2 + beyond)
        correlation[c] = (noise + alike * beyond) / max(noise + beyond, 1e-300)
    finer = {c: evidence.floor[c] / floor[c] for c in evidence.channels}
    return replace(
        evidence,
        floor=floor,
        base=Residuals({c: e * finer[c] for c, e in evidence.base.values.items()}, evidence.base.depends),
        noise={c: e * finer[c] for c, e in evidence.noise.items()},
        correlation=correlation,
    )


def worthwhile(evidence: Evidence, best: Assessment) -> bool:
    """Tell whether a hypothesis is worth naming: where it explains most it closes most of the error, and leaves a small one."""
    after = best.held_out.residuals.values
    main = max(evidence.channels, key=lambda c: float(np.sum(evidence.base.values[c] ** 2 - after[c] ** 2)))
    little = evidence.nrmse(main, after[main]) <= rules.FORM_LEFT
    return little and closed(evidence.base.values[main], after[main], power(evidence.noise[main])) >= rules.WORTHWHILE
