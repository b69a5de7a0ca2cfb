"""Partial answer: causes named although an unexplained remainder is left, which is counted as noise.

If only the sensors' noise counts as noise, a search finds ever more causes in the errors of a model's form, each seemingly
certain. Here the remainder of the best hypothesis counts as noise too, with little information however long the recording (a
coarsened posterior: Miller, Dunson 2019), and a cause must exceed the errors of form that any model has. If none does, or if
several values of the rig file are wrong, these are fitted first and the causes sought beside them.
"""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import most_explained
from ehls_ros.diagnosis.evidence import Evidence, Residuals, sections
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.hypotheses import parts
from ehls_ros.diagnosis.loss import closed, rms
from ehls_ros.diagnosis.measurement import BesideForm
from ehls_ros.diagnosis.pool import Progress
from ehls_ros.diagnosis.pruning import needed
from ehls_ros.diagnosis.remainder import at_a_bound, remainder_as_noise, with_allowances
from ehls_ros.diagnosis.search import POLISHING_STEPS, Searched, search
from ehls_ros.diagnosis.starts import Starts
from ehls_ros.physics.effects import EFFECTS


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
