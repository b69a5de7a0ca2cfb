"""Excitation of each stage: whether the data suffice to show an error in it."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import shows
from ehls_ros.diagnosis.evidence import Evidence, sections
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.hypotheses import extended
from ehls_ros.diagnosis.result import Sensitivity
from ehls_ros.diagnosis.stages import Channel, Comparison, Stage

NINE_OF_TEN = 1.2816
"""Standard deviations below which a normal variable lies in nine of ten cases.

Origin: a quantile.
"""

GROWTH, MAX_GROWTHS = 1.2, 100
"""Factor by which a size is enlarged until it shows beyond the allowances, and how often at most.

Origin: numerical; sizes are told to a fifth.
"""

KEYS: Mapping[Stage, tuple[str, str]] = {
    "valve": ("valve_gain_shift", "gain"),
    "flow": ("valve_gain_shift", "flow_gain"),
    "force_balance": ("coulomb_shift", "offset"),
}
"""Stages that need excitation, with the effect and its parameter by which it is judged; the sensors' stage needs none."""


def sensitivities(
    evidence: Evidence, screened: Sequence[Fit], inflation: Mapping[Channel, float], *, beside_form: bool = True
) -> tuple[Sensitivity, ...]:
    """Return the smallest detectable size of every effect with one parameter and a smooth response at its neutral value.

    The size may be outside the parameter's range: no such effect would have shown.

    Args:
        evidence: the recording compared with the given model.
        screened: every cause alone at its starting values, with its derivatives.
        inflation: divisor of each channel's losses.
        beside_form: whether an effect must exceed the errors of form that cannot be told from a change.
    """
    out, comparison = [], evidence.comparison()
    for fit in screened:
        candidate = fit.hypothesis[0]
        if len(candidate.free) != 1 or not np.array_equal(fit.values, candidate.neutral):
            continue
        columns = {c: fit.jacobian[rows, 0] for c, rows in sections(evidence.block, fit.channels).items()}
        informed = {c: float(column @ column) / inflation.get(c, 1.0) for c, column in columns.items()}
        # By the channel in which it shows most.
        main = max(fit.channels, key=informed.__getitem__)
        # At the size of one standard deviation of the noise, within the bounds of the allowances.
        length = max(float(np.linalg.norm(columns[main])), 1e-300)
        effect = length * evidence.nrmse(main, evidence.whole(main, columns[main] / length))
        least = max(rules.RELEVANT, evidence.standard.form_error(main) if beside_form else 0.0)
        smallest = smallest_detectable(sum(informed.values()), effect, least, evidence.standard.needed_gain)
        if smallest is not None:
            smallest = beyond_allowances(evidence, comparison, fit, smallest, least, inflation)
            out.append(Sensitivity(candidate.name, candidate.free[0], smallest, candidate.units[0]))
    return tuple(out)


def beyond_allowances(
    evidence: Evidence, comparison: Comparison, fit: Fit, smallest: float, least: float, inflation: Mapping[Channel, float]
) -> float:
    """Return the size that shows beyond the variation that is allowed within bounds.

    The residuals are not linear in it: within the bounds a change hardly counts, beyond them it does.

    Args:
        evidence: the recording compared with the given model.
        comparison: comparison of the calling thread.
        fit: the cause alone at its neutral value, with its derivative.
        smallest: size that would show if residuals were linear.
        least: relevant rms, as a fraction of the largest term.
        inflation: divisor of each channel's losses.
    """
    allowed = {c: evidence.allowed[c] for c in fit.channels if c in evidence.allowed}
    if not any(given.is_bounded for given in allowed.values()):
        return smallest
    candidate = fit.hypothesis[0]
    step = float(np.clip(smallest, candidate.lower[0] - fit.values[0], candidate.upper[0] - fit.values[0]))
    if step == 0.0:
        return smallest
    changed = extended(evidence.rig, fit.hypothesis, fit.values + step)
    moved = evidence.residuals(comparison, changed).values
    per_size = {c: (evidence.whole(c, moved[c]) - evidence.whole(c, evidence.base.values[c])) / step for c in fit.channels}

    needed = needed_sigmas(evidence.standard.needed_gain)

    def shows_at(size: float) -> bool:
        information, relevant = 0.0, 0.0
        for c, column in per_size.items():
            change = size * column
            seen, beyond = (allowed[c].whitened(change), allowed[c].beyond(change)) if c in allowed else (change, change)
            information += float(seen @ seen) / inflation.get(c, 1.0)
            relevant = max(relevant, evidence.nrmse(c, beyond))
        return information >= needed**2 and relevant >= least

    # From the size that would show if nothing were allowed.
    certain = sum(float(column @ column) / inflation.get(c, 1.0) for c, column in per_size.items())
    size = smallest if certain == 0.0 else needed / math.sqrt(certain)
    for _ in range(MAX_GROWTHS):
        if shows_at(size):
            break
        size *= GROWTH
    return size


def needed_sigmas(gain: float) -> float:
    """Return the standard errors from which a parameter is significant and gains enough, in nine of ten recordings.

    At the threshold itself, the scatter would hide every other one.
    """
    return max(rules.MIN_SIGMAS, math.sqrt(2.0 * gain)) + NINE_OF_TEN


def smallest_detectable(
    information: float, effect: float, least: float = rules.RELEVANT, gain: float = rules.NEEDED_GAIN
) -> float | None:
    """Return the smallest parameter that is significant, gains enough and is relevant, in nine of ten recordings.

    Args:
        information: sum of squared derivatives of the whitened residuals.
        effect: derivative of the balance's rms, as a fraction of its largest term.
        least: relevant rms, as the same fraction.
        gain: needed gain [nat].

    Returns:
        The parameter; None without information.
    """
    if information <= 0.0:
        return None
    smallest = needed_sigmas(gain) / math.sqrt(information)
    return max(smallest, least / effect) if effect > 0.0 else smallest


def mass_observable(evidence: Evidence) -> bool:
    """Return whether the moving mass is observable: whether doubling it changes a balance noticeably.

    A piston that hardly accelerates moves the same with any mass. A separate mass would then have to be far larger, or be a
    load of unknown mass, indistinguishable from friction.
    """
    plant = evidence.rig.plant
    heavier = evidence.rig._replace(plant=plant._replace(moving_mass=2.0 * plant.moving_mass))
    changed = evidence.residuals(evidence.comparison(), heavier).values
    return shows(evidence.whole(c, changed[c]) - evidence.whole(c, evidence.base.values[c]) for c in evidence.channels)


class Sliding(NamedTuple):
    """Quantities that decide whether the piston slides.

    Attributes:
        travel: range of the piston's motion [m].
        presliding: travel over which static friction builds up [m].
        coulomb: friction of steady sliding in the given model [N].
    """

    travel: float
    presliding: float
    coulomb: float


def sliding(evidence: Evidence) -> Sliding:
    """Compare the recorded travel with the given model's friction."""
    rig = evidence.rig.effective()
    presliding = rig.friction_level(0.0) / rig.friction_law.stiffness(rig.friction)
    return Sliding(evidence.travel, presliding, rig.friction_level(math.inf))


def excited(stage: Stage, found: Sequence[Sensitivity], slid: Sliding, largest: float = rules.MAX_UNDETECTED) -> bool:
    """Return whether the data could show an error of a stage's key parameter; for friction, the piston must also slide.

    Args:
        stage: the stage.
        found: the smallest detectable sizes.
        slid: travel and friction of the piston.
        largest: largest change that may remain undetected, as a fraction of the parameter's nominal value.
    """
    if stage not in KEYS:
        return True
    if stage == "force_balance" and slid.travel < rules.SLIDING * slid.presliding:
        return False
    nominal = slid.coulomb if stage == "force_balance" else 1.0
    return any(s.smallest < largest * nominal for s in found if (s.name, s.parameter) == KEYS[stage])
