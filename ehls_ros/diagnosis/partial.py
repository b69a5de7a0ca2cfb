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
from ehls_ros.diagnosis.evidence import Evidence, Residuals, sections
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.hypotheses import Candidate, Hypothesis, parts
from ehls_ros.diagnosis.loss import closed, power
from ehls_ros.diagnosis.pool import Progress
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
    worker = Worker(evidence)
    few = _beside_form(evidence, found, tried, threads, progress)
    values = wrong_values(worker, found.screened)
    if few is not None and (values is None or not _explains_more(evidence, values.residuals, few)):
        return few
    many = found if values is None else search(evidence, tried, threads, progress, values)
    if not many.best.names or not worthwhile(evidence, many.best):
        return few
    refitted = () if values is None else tuple(c.name for c in values.hypothesis)
    return PartialAnswer(*_assessed_again(worker, many), refitted)


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


def wrong_values(worker: Worker, alone: Sequence[Fit]) -> Fit | None:
    """Fit all values of the rig file that a cause of the list corrects; None unless several are off by more than form.

    Args:
        worker: of the recording compared with the given model.
        alone: every cause alone, with its derivatives.
    """
    evidence = worker.evidence
    found = {c.name: c for fit in reversed(alone) for c in fit.hypothesis if corrects_value(c.name)}
    fit = _together(worker, tuple(found.values()))
    before = assess(evidence, fit)
    here = sections(evidence.block, fit.channels)
    wrong = []
    for index, (candidate, part) in enumerate(zip(fit.hypothesis, parts(fit.hypothesis), strict=True)):
        moved = fit.jacobian[:, part] @ (fit.values[part] - candidate.neutral)
        changes = [
            float(np.sqrt(np.mean((moved[rows] * evidence.floor[c]) ** 2))) / max(evidence.sizes[c], 1e-300)
            for c, rows in here.items()
        ]
        if max(changes, default=0.0) >= rules.FORM_ERROR and before.sigmas(index) >= rules.SURE:
            wrong.append(candidate)
    return _together(worker, tuple(wrong)) if len(wrong) > 1 else None


def corrects_value(name: str) -> bool:
    """Tell whether an effect corrects a value of the rig file, rather than add what the model lacks."""
    effect = EFFECTS.load(name)
    return not effect.WORDS.lacking and effect.GROUP != "sensors"


def _together(worker: Worker, hypothesis: Hypothesis) -> Fit:
    neutral = np.concatenate([np.empty(0), *(c.neutral for c in hypothesis)])
    return worker.fit(worker.linearise(hypothesis, neutral), rules.POLISHING_STEPS)


def _explains_more(evidence: Evidence, residuals: Residuals, few: PartialAnswer) -> bool:
    """Tell whether residuals are so much smaller than what a few causes leave that these miss something worthwhile."""
    best = few.found.best
    main = max(best.held_out.gain, key=lambda c: float(np.sum(best.held_out.gain[c])))
    left = best.held_out.residuals.values[main] * few.evidence.floor[main] / evidence.floor[main]
    return closed(left, residuals.values[main], power(evidence.noise[main])) >= rules.WORTHWHILE


def _assessed_again(worker: Worker, found: Searched) -> tuple[Evidence, Searched]:
    """Return what was found with what it leaves counted as noise."""
    known = remainder_as_noise(worker.evidence, found.best.held_out.residuals.values)
    beside = Worker(known)

    def again(known_as: Assessment) -> Assessment:
        fit = known_as.fit
        if not fit.hypothesis:
            return assess(known, fit._replace(residuals=known.base))
        return assess(known, beside.fit(beside.linearise(fit.hypothesis, fit.values, fit.steps), 2))

    best = again(found.best)
    places = tuple(Place(again(p.without), tuple(again(r) for r in p.rivals[: rules.RIVALS])) for p in found.places)
    scale = inflations(known, [best, *(rival for place in places for rival in place.rivals)])
    return known, found._replace(best=best, places=places, inflation=scale)


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
