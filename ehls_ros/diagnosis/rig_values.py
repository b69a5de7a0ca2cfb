"""Wrong values in the rig file: if several are off, they are fitted together before other causes are sought."""

import math
from collections.abc import Sequence

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, sections
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import assess
from ehls_ros.diagnosis.hypotheses import parts
from ehls_ros.diagnosis.loss import power
from ehls_ros.physics.effects import EFFECTS


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
    values = worker.fit(worker.linearise(hypothesis, neutral), rules.POLISHING_STEPS)
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
        changes = [math.sqrt(power(moved[rows] * evidence.floor[c])) / sizes[c] for c, rows in here.items()]
        if max(changes, default=0.0) >= rules.FORM_ERROR and assessed.sigmas(index) >= rules.MIN_SIGMAS:
            out.append(candidate.name)
    return out


def corrects_value(name: str) -> bool:
    """Return whether an effect corrects a value of the rig file rather than adding a missing mechanism."""
    effect = EFFECTS.load(name)
    return not effect.WORDS.lacking and effect.GROUP != "sensors"
