"""When a further cause is accepted: it must gain enough, be sure enough and matter enough."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, Residuals, noise_power
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.hypotheses import extended
from ehls_ros.diagnosis.loss import closed, loss, power, weights
from ehls_ros.diagnosis.stages import Channel


def accepted(evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Tell whether a further cause is accepted: it explains the recording, and no baseline allows it as well."""
    return explains(evidence, more, less, inflation) and is_new(evidence, more, less, inflation)


def explains(evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Tell whether a hypothesis with one more cause is surer than chance allows, and different enough to matter.

    Args:
        evidence: the recording compared with the given model.
        more: the hypothesis with the cause.
        less: the hypothesis without it.
        inflation: by which each channel's losses are divided.
    """
    gain = more.score(inflation) - less.score(inflation)
    if evidence.form is not None:
        return gain > 0.0 and _stands_out(evidence, evidence.form, more, less)
    main = mostly_in(more, less)
    beside = main in less.fit.channels
    apart = differences(evidence, more, less)
    before, after = (j.held_out.residuals.values[main] for j in (less, more))
    matters = relevance(evidence, apart) >= (rules.RELEVANT_BESIDE if beside else rules.RELEVANT)
    clear = not less.names and shows(apart, rules.CLEAR)
    if gain < rules.NEEDED_GAIN or not (matters or clear) or not (beside or shows(apart)):
        return False
    if earned(evidence, more, less) < rules.EARNED or not recurs(more, less, inflation):
        return False
    if beside and corrects_form(evidence.base.values[main], before, after, noise_power(evidence, main)):
        return False
    # A cause that removes little of what remains beside it corrects the form of another, not the model.
    excess = sum(more.excess(evidence, c) / inflation[c] for c in more.held_out.gain)
    much = share_closed(evidence, more, less) >= rules.NEEDED_SHARE
    # A rig's own remainder is never known so well that a small fraction of it could be told from a change.
    much = much or (gain >= rules.REMOVED_EXCESS * excess and not evidence.baselines)
    # A cause that gains more by averaging noise than by explaining is an average.
    averaged = more.held_out.averaged - less.held_out.averaged
    return much and gain >= averaged and _surest(more, less) >= rules.SURE


def _stands_out(evidence: Evidence, form: float, more: Assessment, less: Assessment) -> bool:
    """Tell whether a further cause stands out of errors of the model's form."""
    share = share_closed(evidence, more, less)
    # What closes all but a little of what the others leave is no error of form, however small it is.
    needed = rules.RELEVANT if share >= rules.CLOSED else rules.FORM_ERROR if less.names else form
    if share < rules.WORTHWHILE or relevance(evidence, differences(evidence, more, less)) < needed:
        return False
    # Standard errors hold the form of what remains. Whether there is anything at all is judged by the scatter.
    return _surest(assess(replace(evidence, correlation={}), more.fit), less) >= rules.SURE


def differences(evidence: Evidence, more: Assessment, less: Assessment) -> list[Array]:
    """Return the difference between two hypotheses' residuals in each channel, in units of the noise floor.

    Of a difference that the measurement may add, only what exceeds that matters. A rig's natural spread can make a change less
    sure, but not smaller.
    """
    one, other = more.fit.residuals.values, less.fit.residuals.values
    if evidence.baselines:
        return [evidence.whole(c, one[c]) - evidence.whole(c, other[c]) for c in evidence.channels]
    return [one[c] - other[c] for c in evidence.channels]


def relevance(evidence: Evidence, apart: Sequence[Array]) -> float:
    """Return how far two hypotheses differ, as a fraction of the largest term of the balance they differ most in.

    Args:
        evidence: the recording compared with the given model.
        apart: result of :func:`differences`.
    """
    largest = 0.0
    for c, difference in zip(evidence.channels, apart, strict=True):
        change = np.abs(difference) * evidence.floor[c]
        size = max(evidence.sizes[c], 1e-300)
        # What acts seldom has a small rms; where it acts it matters.
        rare = float(np.quantile(change, rules.RARE_QUANTILE)) / rules.RARE_FACTOR
        largest = max(largest, float(np.sqrt(np.mean(change**2))) / size, rare / size)
    return largest


def earned(evidence: Evidence, more: Assessment, less: Assessment) -> float:
    """Return what a hypothesis gains beyond another, as a fraction of what its change of the residuals could gain.

    A change that is fitted to the residuals gains half its square. One that moves noise from window to window, as a delay does
    that skews within their bounds make up for, gains or loses by chance, and little of that.
    """
    gained, changed = 0.0, 0.0
    for c in evidence.channels:
        before, after = (j.fit.residuals.values[c] for j in (less, more))
        gained += float(np.sum(loss(before) - loss(after)))
        changed += 0.5 * float(np.sum(weights(before) * (after - before) ** 2))
    return gained / changed if changed > 0.0 else 0.0


def recurs(more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Tell whether a hypothesis gains in more than one block of the recording, or at least loses no more than chance does.

    An error of the model repeats. What explains an incident at the cost of the rest of the recording is none. Beside another
    cause, what explains an incident alone is none either: that a friction started in a wrong state, say.
    """
    blocks = more.per_block(inflation) - less.per_block(inflation)
    elsewhere = float(np.sum(blocks) - np.max(blocks))
    return elsewhere > (rules.RECURRING * float(np.sum(blocks)) if less.names else -rules.NEEDED_GAIN)


def shows(apart: Sequence[Array], least: float = rules.SHOWN) -> bool:
    """Tell whether the difference between two hypotheses is comparable with the noise in any channel.

    Args:
        apart: difference of their whitened residuals, one array a channel.
        least: its least rms.
    """
    return any(float(np.sqrt(np.mean(a * a))) >= least for a in apart)


def is_new(evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Tell whether the baselines, if there are any, speak against a cause: what they allow as well may always have been so."""
    if not evidence.baselines:
        return True
    added = more.fit.only(next(i for i, name in enumerate(more.names) if name not in less.names))
    against = 0.0
    for healthy in evidence.baselines:
        always = extended(healthy.rig, added.hypothesis, added.values)
        before, after = healthy.base.values, healthy.residuals(healthy.comparison(), always).values
        against += sum(float(np.sum(loss(after[c]) - loss(before[c]))) / inflation[c] for c in before if c in inflation)
    return against >= rules.NEEDED_GAIN


def corrects_form(given: Array, before: Array, after: Array, noise: float) -> bool:
    """Tell whether a cause finds only what the others' inexact form leaves, and does not close that either.

    Args:
        given: whitened residual of the given model in the channel.
        before: the same with the other causes.
        after: the same with the cause as well.
        noise: mean square due to noise.
    """
    removed_before = power(before) - noise < (1.0 - rules.ALL_BUT_FORM) * (power(given) - noise)
    return removed_before and power(before) - power(after) < rules.CLOSED * (power(before) - noise)


def mostly_in(more: Assessment, less: Assessment) -> Channel:
    """Return the channel in which a hypothesis explains most beyond another."""
    return most_explained(less.held_out.residuals, more.held_out.residuals)


def most_explained(before: Residuals, after: Residuals) -> Channel:
    """Return the channel in which most of some residuals is gone in others."""
    return max(after.values, key=lambda c: float(np.sum(before.values[c] ** 2 - after.values[c] ** 2)))


def share_closed(evidence: Evidence, more: Assessment, less: Assessment) -> float:
    """Return the fraction of what one hypothesis leaves that is gone with another, where that explains most.

    Of a change in what varies without fault, all counts: measured by what exceeds the spread, it would be small beside the
    scatter of a long recording however large it is. What another cause leaves is mostly spread; there only the excess counts.
    """
    main = mostly_in(more, less)
    before, after = (j.held_out.residuals.values[main] for j in (less, more))
    if evidence.baselines and not less.names:
        before = evidence.whole(main, before) - (evidence.whole(main, after) - after)
    return closed(before, after, evidence.noise[main])


def _surest(more: Assessment, less: Assessment) -> float:
    """Return how many standard errors the best determined parameter of the further cause is from its neutral value."""
    return max((more.sigmas(i) for i, name in enumerate(more.names) if name not in less.names), default=0.0)
