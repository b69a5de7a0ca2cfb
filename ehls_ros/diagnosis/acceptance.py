"""Acceptance of a further cause, which must have sufficient gain, significance and relevance."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import singledispatch

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, Residuals, Standard, noise_power
from ehls_ros.diagnosis.held_out import Assessment, assess
from ehls_ros.diagnosis.loss import closed, loss, power, rms, weights
from ehls_ros.diagnosis.measurement import BesideForm
from ehls_ros.diagnosis.stages import Channel


def accepted(evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Return whether a further cause is accepted: it explains the recording, and the standard does not allow it as well."""
    return explains(evidence, more, less, inflation) and is_new(evidence, more, less, inflation)


def explains(evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Return whether one more cause improves a hypothesis significantly and by a relevant amount.

    Args:
        evidence: the recording compared with the given model.
        more: the hypothesis with the cause.
        less: the hypothesis without it.
        inflation: divisor of each channel's losses.
    """
    return _explains(evidence.standard, evidence, more, less, inflation)


@singledispatch
def _explains(
    standard: Standard, evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]
) -> bool:
    gain = more.score(inflation) - less.score(inflation)
    main = mostly_in(more, less)
    beside = main in less.fit.channels
    apart = differences(evidence, more, less)
    before, after = (j.held_out.residuals.values[main] for j in (less, more))
    beyond = beyond_form(evidence, apart)
    matters = relevance(evidence, beyond) >= (standard.relevant_beside if beside else rules.RELEVANT)
    # Clear of the noise, but too small to matter: beside errors of form, that is one of these.
    clear = not beside and not standard.form_is_noise and shows(beyond.values(), rules.CLEAR)
    if gain < standard.needed_gain or not (matters or clear) or not (beside or shows(apart.values())):
        return False
    if gain_ratio(evidence, more, less) < standard.min_gain_ratio or not recurs(more, less, inflation):
        return False
    if beside and corrects_form(evidence.base.values[main], before, after, noise_power(evidence, main)):
        return False
    # A cause that removes little of the remainder corrects the form of another cause, not the model.
    excess = sum(more.excess(evidence, c) / inflation[c] for c in more.held_out.gain)
    much = share_closed(evidence, more, less) >= rules.NEEDED_SHARE
    # A rig's remainder is never known accurately enough to distinguish a small fraction of it from a change.
    much = much or (gain >= rules.REMOVED_EXCESS * excess and not standard.form_is_noise)
    # A cause must not gain more by averaging noise than by explaining.
    averaged = more.held_out.averaged - less.held_out.averaged
    # Standard errors tell how sure a size is; a change far beyond what is allowed may be sure, and its size not. Beside another
    # cause, the remainder of that one's form gains steadily, too.
    by_gain = standard.bounds_are_of_chance or not beside
    sure = max(_surest(more, less), steadiness(more, less, inflation) if by_gain else 0.0)
    return much and gain >= averaged and sure >= rules.MIN_SIGMAS


@_explains.register
def _stands_out(
    standard: BesideForm, evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]
) -> bool:
    """Return whether a further cause exceeds errors of the model's form."""
    if more.score(inflation) <= less.score(inflation):
        return False
    share = share_closed(evidence, more, less)
    # A cause that closes nearly all of the others' remainder is no error of form, however small.
    needed = rules.RELEVANT if share >= rules.CLOSED else standard.relevant_beside if less.names else standard.form
    if share < rules.WORTHWHILE or relevance(evidence, differences(evidence, more, less)) < needed:
        return False
    # Standard errors include the form of the remainder; significance is therefore judged by the scatter alone.
    surest = _surest(assess(replace(evidence, correlation={}), more.fit), less)
    return max(surest, 0.0 if less.names else steadiness(more, less, inflation)) >= rules.MIN_SIGMAS


def differences(evidence: Evidence, more: Assessment, less: Assessment) -> dict[Channel, Array]:
    """Return the difference between two hypotheses' residuals by channel, in units of the noise floor.

    Only the part beyond possible measurement errors counts.
    """
    one, other = more.fit.residuals.values, less.fit.residuals.values
    whole = {c: evidence.whole(c, one[c]) - evidence.whole(c, other[c]) for c in evidence.channels}
    return {c: evidence.standard.counted(evidence, c, change) for c, change in whole.items()}


def beyond_form(evidence: Evidence, apart: Mapping[Channel, Array]) -> dict[Channel, Array]:
    """Return the differences in the channels where they exceed the form errors that cannot be told from a change."""
    of = evidence.standard
    return {c: e for c, e in apart.items() if relevance(evidence, {c: of.beyond(evidence, c, e)}) > of.form_error(c)}


def within_form(evidence: Evidence, more: Assessment, less: Assessment) -> bool:
    """Return whether two hypotheses differ in no channel by more than errors of the model's form."""
    return not beyond_form(evidence, differences(evidence, more, less))


def relevance(evidence: Evidence, apart: Mapping[Channel, Array]) -> float:
    """Return the difference of two hypotheses, as a fraction of the largest term of the balance in which they differ most.

    Args:
        evidence: the recording compared with the given model.
        apart: result of :func:`differences`.
    """
    largest = 0.0
    for c, difference in apart.items():
        change = np.abs(difference) * evidence.floor[c]
        size = max(evidence.sizes[c], 1e-300)
        # A rare error has a small rms, but is relevant where it acts.
        rare = float(np.quantile(change, rules.RARE_QUANTILE)) / rules.RARE_FACTOR
        largest = max(largest, rms(change) / size, rare / size)
    return largest


def gain_ratio(evidence: Evidence, more: Assessment, less: Assessment) -> float:
    """Return the gain of one hypothesis over another, as a fraction of the possible gain of its change of the residuals.

    A change fitted to the residuals gains half its square. A change that only shifts noise between windows gains or loses
    little of that, by chance; an example is a delay compensated by skews within their bounds.
    """
    gained, changed = 0.0, 0.0
    for c in evidence.channels:
        before, after = (j.fit.residuals.values[c] for j in (less, more))
        gained += float(np.sum(loss(before) - loss(after)))
        changed += 0.5 * float(np.sum(weights(before) * (after - before) ** 2))
    return gained / changed if changed > 0.0 else 0.0


def recurs(more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Return whether a hypothesis gains in more than one block, or at least loses no more elsewhere than by chance.

    An error of the model recurs. A cause that explains one incident at the cost of the rest of the recording is not an error of
    the model. Beside another cause, nor is one that explains an incident only, such as a wrong initial state of the friction.
    """
    blocks = more.per_block(inflation) - less.per_block(inflation)
    elsewhere = float(np.sum(blocks) - np.max(blocks))
    return elsewhere > (rules.RECURRING * float(np.sum(blocks)) if less.names else -rules.NEEDED_GAIN)


def shows(apart: Iterable[Array], least: float = rules.SHOWN) -> bool:
    """Return whether the difference between two hypotheses is comparable with the noise in any channel.

    Args:
        apart: difference of their whitened residuals, one array a channel.
        least: its least rms.
    """
    return any(rms(a) >= least for a in apart)


def is_new(evidence: Evidence, more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> bool:
    """Return whether the standard does not allow a further cause, which may otherwise have been present all along."""
    added = more.fit.only(next((i for i, name in enumerate(more.names) if name not in less.names), -1))
    return not evidence.standard.allows(added.hypothesis, added.values, inflation)


def corrects_form(given: Array, before: Array, after: Array, noise: float) -> bool:
    """Return whether a cause only fits the remainder of the others' inexact form, without closing that either.

    Args:
        given: whitened residual of the given model in the channel.
        before: the same with the other causes.
        after: the same with the cause as well.
        noise: mean square due to noise.
    """
    removed_before = power(before) - noise < (1.0 - rules.ALL_BUT_FORM) * (power(given) - noise)
    return removed_before and power(before) - power(after) < rules.CLOSED * (power(before) - noise)


def mostly_in(more: Assessment, less: Assessment) -> Channel:
    """Return the channel in which a hypothesis improves most on another."""
    return most_explained(less.held_out.residuals, more.held_out.residuals)


def most_explained(before: Residuals, after: Residuals) -> Channel:
    """Return the channel with the largest decrease from one set of residuals to another."""
    return max(after.values, key=lambda c: float(np.sum(before.values[c] ** 2 - after.values[c] ** 2)))


def share_closed(evidence: Evidence, more: Assessment, less: Assessment) -> float:
    """Return the fraction of one hypothesis' remainder that another closes, in the channel where it explains most."""
    main = mostly_in(more, less)
    before, after = (j.held_out.residuals.values[main] for j in (less, more))
    if not less.names:
        before = evidence.standard.before(evidence, main, before, after)
    return closed(before, after, evidence.noise[main])


def steadiness(more: Assessment, less: Assessment, inflation: Mapping[Channel, float]) -> float:
    """Return the mean gain of a hypothesis over another in a block, in standard errors by the scatter of the blocks."""
    blocks = more.per_block(inflation) - less.per_block(inflation)
    if len(blocks) < 2:
        return 0.0
    return float(np.sum(blocks)) / max(float(np.std(blocks, ddof=1)) * math.sqrt(len(blocks)), 1e-300)


def _surest(more: Assessment, less: Assessment) -> float:
    """Return the distance of the further cause's best-determined parameter from its neutral value, in standard errors."""
    return max((more.sigmas(i) for i, name in enumerate(more.names) if name not in less.names), default=0.0)
