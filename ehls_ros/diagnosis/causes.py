"""Causes of the best hypothesis as listed in the result, with their rivals and equivalents; their gain, and advice."""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import mostly_in, within_form
from ehls_ros.diagnosis.empirical import drifts
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.held_out import RESAMPLED, Assessment, probabilities
from ehls_ros.diagnosis.hypotheses import parts
from ehls_ros.diagnosis.loss import closed, power
from ehls_ros.diagnosis.missing_signals import deciding, untried
from ehls_ros.diagnosis.remainder import remainder_in
from ehls_ros.diagnosis.result import Cause, ChannelGain, Gain, Rival
from ehls_ros.diagnosis.search import Place, Searched
from ehls_ros.diagnosis.stages import Channel, Stage
from ehls_ros.diagnosis.starts import FITTED
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Words, side_of
from ehls_ros.physics.rig import Rig

STAGE_OF_GROUP: Mapping[str, Stage] = {
    "valve": "valve",
    "flow": "flow",
    "friction": "force_balance",
    "mechanics": "force_balance",
    "sensors": "sensors",
    "environment": "force_balance",
}
"""Model stage of an effect, by the group given in its file."""

SPRING, ADDED = "spring_rate_shift", "added"
"""The effect that changes the spring's stiffness, and its parameter."""


def causes(evidence: Evidence, found: Searched, seed: int, right: float = 1.0, last: Collection[str] = ()) -> tuple[Cause, ...]:
    """Describe the causes of the best hypothesis, largest gain first.

    Args:
        evidence: the recording compared with the given model.
        found: the result of the search.
        seed: of the resampling.
        right: factor on the probability of each cause: how often causes named in this way are right.
        last: names of causes to list after all others.
    """
    best, scale = found.best, found.inflation
    groups = [EFFECTS.load(candidate.name).GROUP for candidate in best.hypothesis]
    stages = [STAGE_OF_GROUP[group] for group in groups]
    out = []
    for index, (candidate, place) in enumerate(zip(best.hypothesis, found.places, strict=True)):
        gain = best.score(scale) - place.without.score(scale)
        others = _other_effects(best, place, scale)
        main = mostly_in(best, place.without)
        # A gain over a hypothesis that differs by no more than the form of the model tells nothing.
        alike = frozenset(j.hypothesis[-1].name for j in others if _within_form(evidence, best, j, gain, scale))
        # One that explains more and was not named is too vague, such as a mass on a joint of nearly any stiffness.
        sure = [j for j in others if j.score(scale) <= best.score(scale) or j.sigmas(-1) >= rules.MIN_SIGMAS]
        told = [best if j.hypothesis[-1].name in alike else j for j in sure]
        gains = [j.per_block(scale) for j in (best, *told, place.without)]
        alone = probabilities(gains, [len(j.fit.values) for j in (best, *sure, place.without)], seed)
        probability = float(alone[0])
        if stages.count(stages[index]) > 1:
            probability *= rules.BOTH_RIGHT
        if remainder_in(evidence, best, main).doubtful:
            probability *= rules.FORM_RIGHT
        probability *= right
        equivalent = _indistinguishable(evidence, best, others, alike, gain, scale)
        equivalent |= untried(evidence, best.fit, place.without.fit)
        if getattr(EFFECTS.load(candidate.name), "NEEDS", ()):
            # The signal that it needs may have changed only with time.
            equivalent |= dict.fromkeys(drifts(evidence, best.fit, place.without.fit), ())
        out.append(
            Cause(
                name=candidate.name,
                probability=probability,
                equivalent_to=tuple(equivalent),
                stage=stages[index],
                group=groups[index],
                parameters=_estimates(best, index),
                fixed=dict(candidate.fixed),
                gain=gain,
                sigmas=best.sigmas(index),
                rivals=tuple(_rival(evidence, found, place.without, j) for j in others[:FITTED]),
                channel=main,
                share=_share(evidence, best, place.without, main),
                deciding=tuple(dict.fromkeys(signal for signals in equivalent.values() for signal in signals)),
                side=side_of(
                    EFFECTS.load(candidate.name), candidate.use(best.values[parts(best.hypothesis)[index]]).parameters
                ),
            )
        )
    return tuple(sorted(out, key=lambda cause: (cause.name in last, -cause.gain)))


def _indistinguishable(
    evidence: Evidence,
    best: Assessment,
    others: Sequence[Assessment],
    alike: Collection[str],
    gain: float,
    scale: Mapping[Channel, float],
) -> dict[str, tuple[str, ...]]:
    """Return the effects indistinguishable from a cause in the recording, with the missing signals that would separate them.

    If a missing signal would separate them, every rival that explains enough of the error to be reported counts as equivalent.
    The small advantage of the cause may be due to its form, which no rig has exactly.

    Args:
        evidence: the recording compared with the given model.
        best: the hypothesis with the cause.
        others: the same with another effect in its place.
        alike: names of the effects that differ from the cause by no more than errors of form.
        gain: of the cause [nats].
        scale: divisor of each channel's losses.
    """
    out = dict[str, tuple[str, ...]]()
    for j in others:
        behind = best.score(scale) - j.score(scale)
        near = behind < max(rules.EQUAL, rules.EQUAL_FRACTION * gain) or j.hypothesis[-1].name in alike
        equal = near and len(j.fit.values) <= len(best.fit.values)
        if not equal and behind >= (1.0 - rules.CLOSED) * gain:
            continue
        signals = deciding(evidence, best.fit, j.fit)
        if equal or signals:
            out[j.hypothesis[-1].name] = signals
    return out


def _within_form(evidence: Evidence, best: Assessment, rival: Assessment, gain: float, scale: Mapping[Channel, float]) -> bool:
    """Return whether a rival that explains most of a cause's gain differs by no more than errors of the model's form."""
    worthwhile = rival.score(scale) >= best.score(scale) - (1.0 - rules.WORTHWHILE) * gain
    return worthwhile and within_form(evidence, best, rival)


def _share(evidence: Evidence, best: Assessment, without: Assessment, channel: Channel) -> float:
    """Return the fraction of a channel's removable error that returns when a cause is dropped."""
    before, noise = evidence.base.values[channel], evidence.noise[channel]
    with_it, without_it = (min(closed(before, j.held_out.residuals.values[channel], noise), 1.0) for j in (best, without))
    return with_it - without_it


def _other_effects(best: Assessment, place: Place, scale: Mapping[Channel, float]) -> list[Assessment]:
    """Return the best hypothesis with a cause replaced by each effect not already named, best first."""
    seen, out = set(best.names), []
    for rival in sorted(place.rivals, key=lambda j: -j.score(scale)):
        name = rival.hypothesis[-1].name
        if name not in seen:
            seen.add(name)
            out.append(rival)
    return out


def _estimates(assessed: Assessment, index: int) -> dict[str, Estimate]:
    part, candidate = parts(assessed.hypothesis)[index], assessed.hypothesis[index]
    deviation = np.sqrt(np.maximum(np.diag(assessed.held_out.covariance)[part], 0.0))
    used = candidate.use(assessed.values[part]).parameters._asdict()
    return {
        name: estimate(float(used[name]), float(candidate.neutral[i]), float(deviation[i]), candidate.units[i])
        for i, name in enumerate(candidate.free)
    }


def estimate(value: float, neutral: float, deviation: float, unit: str) -> Estimate:
    """Return a parameter with its standard error, which combines the errors of the fit and of the effect's inexact form."""
    form = rules.FORM * min(abs(value - neutral), abs(value))
    return Estimate(value, math.hypot(deviation, form), unit)


def _rival(evidence: Evidence, found: Searched, without: Assessment, rival: Assessment) -> Rival:
    before = after = noise = 0.0
    for c in found.best.held_out.gain:
        before += float(np.sum(without.held_out.residuals.values[c] ** 2))
        after += float(np.sum(rival.held_out.residuals.values[c] ** 2))
        noise += float(np.sum(evidence.noise[c] ** 2))
    closed = (before - after) / (before - noise) if before > noise else 0.0
    behind = found.best.score(found.inflation) - rival.score(found.inflation)
    return Rival(rival.hypothesis[-1].name, behind, closed, _estimates(rival, len(rival.hypothesis) - 1))


def gain(evidence: Evidence, best: Assessment, noise: Mapping[Channel, float], seed: int) -> Gain | None:
    """Return the gain of the causes on held-out data; None if they change nothing.

    Args:
        evidence: the recording compared with the given model.
        best: the causes.
        noise: rms noise in each channel, as a fraction of the largest term.
        seed: of the resampling.
    """
    channels = tuple(best.held_out.gain)
    if not channels:
        return None
    base, held_out = evidence.base.values, best.held_out.residuals.values

    def removed(c: Channel) -> float:
        return float(np.sum(base[c] ** 2 - held_out[c] ** 2))

    main = max(channels, key=removed)
    # A channel without removable error holds no information on the fraction removed.
    counted = tuple(c for c in channels if power(base[c]) > rules.REMOVABLE * power(evidence.noise[c])) or (main,)
    before, after, chance = (
        np.sum([np.bincount(evidence.block[c], e[c] ** 2, evidence.blocks) for c in counted], axis=0)
        for e in (base, held_out, evidence.noise)
    )
    fraction, ci95 = closed_fraction(before, after, chance, seed)
    return Gain(
        channel=main,
        heldout_nrmse_before=evidence.nrmse(main, base[main]),
        heldout_nrmse_after=evidence.nrmse(main, held_out[main]),
        noise_floor=noise[main],
        closed_fraction=fraction,
        ci95=ci95,
        channels={c: _channel_gain(evidence, held_out[c], c) for c in counted},
    )


def _channel_gain(evidence: Evidence, after: Array, channel: Channel) -> ChannelGain:
    before, noise = evidence.base.values[channel], evidence.noise[channel]
    removable = max(power(before) - power(noise), 1e-300)
    return ChannelGain(min(closed(before, after, noise), 1.0), power(noise) / removable)


def closed_fraction(before: Array, after: Array, noise: Array, seed: int) -> tuple[float, tuple[float, float]]:
    """Return the fraction of the removable power that was removed, and its 95 % interval from a bootstrap of the blocks.

    Args:
        before: sum of squares of the given model's whitened residuals, by block.
        after: the same of the extended model.
        noise: the same of noise alone.
        seed: of the resampling.
    """
    blocks = len(before)
    weights = np.random.default_rng(seed).multinomial(blocks, np.ones(blocks) / blocks, RESAMPLED)
    with np.errstate(divide="ignore", invalid="ignore"):
        fractions = (weights @ (before - after)) / (weights @ (before - noise))
    fractions = fractions[np.isfinite(fractions)]
    low, high = np.quantile(fractions, [0.025, 0.975]) if fractions.size else (0.0, 0.0)
    removable = float(before.sum() - noise.sum())
    enough = removable > (rules.REMOVABLE - 1.0) * float(noise.sum())
    closed = float(before.sum() - after.sum()) / removable if enough else 0.0
    return min(closed, 1.0), (float(min(low, 1.0)), float(min(high, 1.0)))


def advice(rig: Rig, cause: Cause) -> Words:
    """Return the terms and the advice for a cause.

    Args:
        rig: the given model.
        cause: the cause.
    """
    words: Words = EFFECTS.load(cause.name).WORDS
    if not spring_in_force(rig, cause):
        return words
    return words._replace(
        inspect="check where the load cell sits: behind the spring, its reading contains the spring's force already",
        measure="hold the piston at two positions without load and compare the readings",
        change="map the cell as `load_cell_n`, with the mass before it as `moving_mass`, or set `spring_stiffness` to 0",
    )


def spring_in_force(rig: Rig, cause: Cause) -> bool:
    """Return whether a cause removes the spring of the rig file: the recorded force contains it already, or none is mounted."""
    stiffness, added = rig.plant.spring_stiffness, cause.parameters.get(ADDED)
    if cause.name != SPRING or added is None or not stiffness > 0.0:
        return False
    # A fit beyond zero stiffness has no effect.
    return added.value + stiffness <= max(rules.SPRING_LEFT * stiffness, rules.MAX_ALLOWED * added.std)
