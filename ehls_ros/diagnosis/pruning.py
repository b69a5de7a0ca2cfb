"""What is needed of a hypothesis: the causes without which clearly more remains."""

from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import most_explained, mostly_in, relevance, share_closed
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.hypotheses import parts
from ehls_ros.diagnosis.search import Place, Searched, inflations


class Pruned(NamedTuple):
    """A hypothesis of which nothing can be left out.

    Attributes:
        best: the hypothesis.
        without: the same without each of its causes.
        rivals: by the name of a cause that was sought, hypotheses with another in its place.
    """

    best: Assessment
    without: tuple[Assessment, ...]
    rivals: dict[str, tuple[Assessment, ...]]


def pruned(worker: Worker, found: Searched) -> Pruned:
    """Leave out the causes without which hardly more remains, the least needed first.

    Args:
        worker: of the recording compared with the given model.
        found: the causes, of which the places of the last are known.
    """
    evidence, names = worker.evidence, found.best.names[len(found.best.names) - len(found.places) :]
    rivals = {name: place.rivals for name, place in zip(names, found.places, strict=True)}
    # What more parameters explain beyond that is an error of form.
    alike = [
        (other, name)
        for name in names
        for other in rivals[name]
        if share_closed(evidence, found.best, other) < rules.REMOVED_EXCESS
    ]
    best, instead = min([(found.best, ""), *alike], key=lambda pair: len(pair[0].fit.values))
    if instead:
        rivals[best.names[-1]] = rivals.pop(instead)
    while True:
        without = tuple(fitted(worker, best.fit.without(index)) for index in range(len(best.names)))
        worth = [share_closed(evidence, best, other) if _matters(evidence, best, other) else 0.0 for other in without]
        least = int(np.argmin(worth))
        if worth[least] >= rules.NEEDED_SHARE or len(without) == 1:
            return Pruned(best, without, rivals)
        best = without[least]


def assessed_again(worker: Worker, found: Searched, best: Pruned) -> Searched:
    """Return a pruned hypothesis and the rivals of its causes as assessed beside another noise floor.

    Args:
        worker: of the recording beside that noise floor.
        found: what was pruned.
        best: the pruned hypothesis.
    """
    places = []
    for name, without in zip(best.best.names, best.without, strict=True):
        others = [r for r in best.rivals.get(name, ()) if r.names[-1] not in best.best.names]
        rivals = tuple(fitted(worker, _beside(without.fit, other.fit)) for other in others[: rules.RIVALS])
        places.append(Place(fitted(worker, without.fit), rivals))
    now = fitted(worker, best.best.fit)
    scale = inflations(worker.evidence, [now, *(rival for place in places for rival in place.rivals)])
    return Searched(now, tuple(places), found.screened, scale)


def fitted(worker: Worker, start: Fit) -> Assessment:
    """Fit a hypothesis from its values and assess it.

    Args:
        worker: of the recording.
        start: the hypothesis; its residuals and derivatives need not be the recording's.
    """
    fit = worker.linearise(start.hypothesis, start.values, start.steps)
    return assess(worker.evidence, worker.fit(fit) if fit.hypothesis else fit)


def _beside(fit: Fit, other: Fit) -> Fit:
    """Return a hypothesis with the last cause of another, to be fitted."""
    part = parts(other.hypothesis)[-1]
    return fit._replace(
        hypothesis=(*fit.hypothesis, other.hypothesis[-1]),
        values=np.concatenate([fit.values, other.values[part]]),
        steps=np.concatenate([fit.steps, other.steps[part]]),
    )


def _matters(evidence: Evidence, best: Assessment, less: Assessment) -> bool:
    """Tell whether a cause acts where the hypothesis explains most, or is larger than an error of form."""
    main = most_explained(evidence.base, best.held_out.residuals)
    return mostly_in(best, less) == main or relevance(evidence, best, less) >= rules.FORM_ERROR
