"""From what a search found to what may be said of it."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Errors, Evidence, elsewhere, noise_of, noise_power, power, sections, worst_block
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.hypotheses import Candidate, parts
from ehls_ros.diagnosis.judged import PENALTY, Judged
from ehls_ros.diagnosis.result import Cause, Gain, Rival, Sensitivity
from ehls_ros.diagnosis.search import CLOSED, MATTERS, NEEDED, RELEVANT, SURE, Searched, mostly_in
from ehls_ros.diagnosis.stages import CHANNELS, STAGES, Channel, Stage
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS

EQUAL, EQUAL_PART = 4.0, 2e-2
"""How much less than the best another cause may gain and still be as good: [nats], and as a part of the best's gain."""

LITTLE = 1.5
"""Power of a residual, in that of noise, up to which a cause that acts in the channel has left nothing."""

SCATTER = 2.5
"""Power of a residual, in that of noise, from which on something else than noise may be left."""

FORM = 1e-2
"""Part of a parameter's distance from neutral that is as uncertain as the form of the effect.

With half of it 195 of the 219 intervals of ``benchmarks/diagnosis`` (seed 550123) held the truth, with this 202, with twice
this 206.
"""

BOTH_RIGHT = 0.6
"""How often two causes named in one stage are both right: an effect that no file describes looks like two that are described.

5 of the 8 in 191 cases of ``benchmarks/diagnosis`` (seed 1426017875); in stages of their own they were in 26 of 28.
"""

LEAVES, STANDS_OUT = 0.01, 3.0
"""Part of the removable error that a cause may leave, and how far it may stand out of the noise, and be right as a rule."""

FORM_RIGHT = 0.5
"""How often a cause is right that leaves more: 3 of 6 in 290 cases of ``benchmarks/diagnosis`` (seeds 1601269076, 550123)."""

RESAMPLED = 1000
"""How often the blocks are resampled for probabilities and intervals."""

STAGE_OF_GROUP: Mapping[str, Stage] = {
    "valve": "valve",
    "flow": "flow",
    "friction": "force_balance",
    "mechanics": "force_balance",
    "sensors": "sensors",
    "environment": "force_balance",
}
"""The stage of the model that an effect belongs to, by what its file says."""

KEY: Mapping[Stage, tuple[str, str]] = {
    "valve": ("valve_gain_shift", "gain"),
    "flow": ("valve_gain_shift", "flow_gain"),
    "force_balance": ("coulomb_shift", "offset"),
}
"""The parameter by which it is told whether the data excite a stage."""

SLIDING = 6.0
"""Travel, in that over which static friction builds up, from which on a piston slides to and fro."""

TELLING = 0.3
"""Size of a key parameter, as a part of its nominal value, that the data have to be able to show."""


class Left(NamedTuple):
    """What is left of a channel's residual.

    Attributes:
        before, after: rms of the whitened residual of the given model, and with the causes on data held out.
        noise: rms that noise makes.
        closed: part of the removable power that is gone; 1 where there was none.
        exceeded: whether there was more than noise, by enough to matter.
        remains: whether there still is.
        incident: the stretch that alone stands out of the noise, if there is one [s].
        mended: whether the causes that act in the channel leave it no more than noise, or close most of it, each of them most
            of what the others leave.
    """

    before: float
    after: float
    noise: float
    closed: float
    exceeded: bool
    remains: bool
    incident: tuple[float, float] | None
    mended: bool


def left(evidence: Evidence, best: Judged, channel: Channel) -> Left:
    """Tell what is left of a channel's residual."""
    own = noise_power(evidence, channel)
    e, held = evidence.base.values[channel], best.held.errors.values[channel]
    before, after = power(e), power(held)
    removable = before - own
    closed = (before - after) / removable if removable > 0.0 else 1.0
    others = elsewhere(evidence, channel, held)
    remains = _more_than_noise(evidence, channel, others, own)
    once = not remains and _more_than_noise(evidence, channel, held, own)
    return Left(
        math.sqrt(before),
        math.sqrt(after),
        math.sqrt(own),
        closed,
        _more_than_noise(evidence, channel, elsewhere(evidence, channel, e), own),
        remains,
        _times_of(evidence, channel, worst_block(evidence, channel, held)) if once else None,
        channel not in best.held.gain or before < LITTLE * own or closed >= CLOSED or power(others) < LITTLE * own,
    )


def patched(evidence: Evidence, found: Searched) -> frozenset[Channel]:
    """Return the channels in which something is left and a cause closes too little, or is fitted as far as its range goes.

    What is really there closes nearly all of what the others leave. An effect that is not on the list is imitated by several
    that are, of which each mends a part of what the one before has left, or by one that is bent beyond what it stands for.
    """
    out = set[Channel]()
    best = found.best.held.errors.values
    for index, rest in enumerate(found.rests):
        main = mostly_in(found.best, rest)
        own, without, after = noise_power(evidence, main), power(rest.held.errors.values[main]), power(best[main])
        little = without - after < CLOSED * (without - own)
        if power(elsewhere(evidence, main, best[main])) >= LITTLE * own and (little or _at_an_end(found.best, index)):
            out.add(main)
    return frozenset(out)


def _times_of(evidence: Evidence, channel: Channel, block: int) -> tuple[float, float]:
    """Return between when the windows of a block lie [s]."""
    times = evidence.times(channel)[evidence.block[channel] == block]
    return float(times[0]), float(times[-1])


def leaves_much(item: Left) -> bool:
    """Tell whether more is left in a channel than the form of a right cause leaves as a rule."""
    return item.closed < 1.0 - LEAVES and item.after > STANDS_OUT * item.noise


def _at_an_end(judged: Judged, index: int) -> bool:
    """Tell whether a cause's fit ended at the end of a parameter's range; zero and neutral are no such ends."""
    candidate, values = judged.hypothesis[index], judged.fit.values[parts(judged.hypothesis)[index]]
    ends = ((values <= candidate.lower) | (values >= candidate.upper)) & (values != 0.0) & (values != candidate.neutral)
    return bool(np.any(ends))


def _more_than_noise(evidence: Evidence, channel: Channel, e: Array, noise: float) -> bool:
    # What acts seldom has a small mean; where it acts it counts.
    for square, part in ((power(e), 1.0), (float(np.quantile(e * e, 0.99)), 5.0)):
        excess = math.sqrt(max(square - SCATTER * noise * (1.0 if part == 1.0 else 7.0), 0.0))
        typical = float(np.sqrt(np.mean(evidence.floor[channel] ** 2)))
        if excess * typical / part > MATTERS * max(evidence.sizes[channel], 1e-300):
            return True
    return False


def causes(evidence: Evidence, found: Searched, seed: int) -> tuple[Cause, ...]:
    """Describe the causes of the best hypothesis, those that explain most first."""
    out = []
    groups = [EFFECTS.load(candidate.name).STAGE for candidate in found.best.hypothesis]
    stages = [STAGE_OF_GROUP[group] for group in groups]
    for index, candidate in enumerate(found.best.hypothesis):
        rest = found.rests[index]
        whole = found.best.score(found.inflation) - rest.score(found.inflation)
        others = _others(found, index, candidate)
        probability = _probability(found, [found.best, *others], rest, seed)
        if stages.count(stages[index]) > 1:
            probability *= BOTH_RIGHT
        if leaves_much(left(evidence, found.best, mostly_in(found.best, rest))):
            probability *= FORM_RIGHT
        equivalent = tuple(
            j.hypothesis[-1].name
            for j in others
            if found.best.score(found.inflation) - j.score(found.inflation) < max(EQUAL, EQUAL_PART * whole)
            and len(j.fit.values) <= len(found.best.fit.values)
        )
        out.append(
            Cause(
                name=candidate.name,
                probability=probability,
                equivalent_to=equivalent,
                stage=stages[index],
                group=groups[index],
                parameters=_estimates(found.best, index),
                fixed=dict(candidate.fixed),
                gain=whole,
                sigmas=found.best.sigmas(index),
                rivals=tuple(_rival(evidence, found, rest, j) for j in others[:5]),
            )
        )
    return tuple(sorted(out, key=lambda cause: -cause.gain))


def _others(found: Searched, index: int, candidate: Candidate) -> list[Judged]:
    """Return the best hypothesis with each other effect in the place of a cause."""
    seen, out = {candidate.name, *(c.name for i, c in enumerate(found.best.hypothesis) if i != index)}, []
    for judged in sorted(found.rivals[index], key=lambda j: -j.score(found.inflation)):
        name = judged.hypothesis[-1].name
        if name not in seen:
            seen.add(name)
            out.append(judged)
    return out


def _estimates(judged: Judged, index: int) -> dict[str, Estimate]:
    part, candidate = parts(judged.hypothesis)[index], judged.hypothesis[index]
    deviation = np.sqrt(np.maximum(np.diag(judged.held.covariance)[part], 0.0))
    used = candidate.use(judged.fit.values[part]).parameters._asdict()
    out = {}
    for i, name in enumerate(candidate.free):
        # The noise says how well the effect's form is fitted; no effect has quite the form its file gives it.
        form = FORM * min(abs(float(used[name]) - float(candidate.neutral[i])), abs(float(used[name])))
        out[name] = Estimate(float(used[name]), math.hypot(float(deviation[i]), form), candidate.units[i])
    return out


def _rival(evidence: Evidence, found: Searched, rest: Judged, judged: Judged) -> Rival:
    before = after = noise = 0.0
    for c in found.best.held.gain:
        own = noise_of(evidence, c)
        before += float(np.sum(rest.held.errors.values[c] ** 2))
        after += float(np.sum(judged.held.errors.values[c] ** 2))
        noise += float(np.sum(own**2))
    closed = (before - after) / (before - noise) if before > noise else 0.0
    behind = found.best.score(found.inflation) - judged.score(found.inflation)
    return Rival(judged.hypothesis[-1].name, behind, closed, _estimates(judged, len(judged.hypothesis) - 1))


def _probability(found: Searched, judged: Sequence[Judged], rest: Judged, seed: int) -> float:
    """Return how often the first of some hypotheses is preferred when the blocks are resampled.

    Bayesian bootstrap of the held-out gains (Yao, Vehtari, Simpson, Gelman 2018), the hypothesis without any cause included.
    """
    rng = np.random.default_rng(seed)
    rows = [_per_block(j, found.inflation) for j in [*judged, rest]]
    blocks = max((len(r) for r in rows), default=1)
    table = np.array([np.resize(r, blocks) if len(r) else np.zeros(blocks) for r in rows])
    penalty = PENALTY * np.array([len(j.fit.values) for j in [*judged, rest]])
    weights = rng.dirichlet(np.ones(blocks), RESAMPLED) * blocks
    scores = weights @ table.T - penalty
    scores -= scores.max(axis=1, keepdims=True)
    likely = np.exp(scores)
    return float(np.mean(likely[:, 0] / likely.sum(axis=1)))


def _per_block(judged: Judged, inflation: Mapping[Channel, float]) -> Array:
    parts = [gain / inflation[c] for c, gain in judged.held.gain.items()]
    return np.sum(parts, axis=0) if parts else np.empty(0)


def gain(evidence: Evidence, best: Judged, seed: int) -> Gain | None:
    """Measure what the causes gain on held-out data."""
    channels = tuple(best.held.gain)
    if not channels:
        return None

    def removed(errors: Errors, c: Channel) -> float:
        return float(np.sum(evidence.base.values[c] ** 2 - errors.values[c] ** 2))

    main = max(channels, key=lambda c: removed(best.held.errors, c))
    noise = {c: noise_of(evidence, c) for c in channels}
    # Only channels in which there was something to remove say what part of it is gone.
    telling = tuple(c for c in channels if power(evidence.base.values[c]) > 1.1 * power(noise[c])) or (main,)
    before, after, floor = (np.zeros(evidence.blocks) for _ in range(3))
    for c in telling:
        block = evidence.block[c]
        before += np.bincount(block, evidence.base.values[c] ** 2, evidence.blocks)
        after += np.bincount(block, best.held.errors.values[c] ** 2, evidence.blocks)
        floor += np.bincount(block, noise[c] ** 2, evidence.blocks)
    weights = np.random.default_rng(seed).multinomial(evidence.blocks, np.ones(evidence.blocks) / evidence.blocks, RESAMPLED)
    with np.errstate(divide="ignore", invalid="ignore"):
        fractions = (weights @ (before - after)) / (weights @ (before - floor))
    fractions = fractions[np.isfinite(fractions)]
    low, high = np.quantile(fractions, [0.025, 0.975]) if fractions.size else (0.0, 0.0)
    removable = float(before.sum() - floor.sum())
    closed = float(before.sum() - after.sum()) / removable if removable > 0.01 * float(floor.sum()) else 0.0
    return Gain(
        main,
        evidence.nrmse(main, evidence.base.values[main]),
        evidence.nrmse(main, best.held.errors.values[main]),
        evidence.nrmse(main, noise[main]),
        min(closed, 1.0),
        (float(min(low, 1.0)), float(min(high, 1.0))),
    )


def sensitivities(evidence: Evidence, screened: Sequence[Fit]) -> tuple[Sensitivity, ...]:
    """Return the smallest sizes that would have been named, of effects whose parameter enters smoothly at its neutral value."""
    out = []
    for fit in screened:
        candidate = fit.hypothesis[0]
        if len(candidate.free) != 1 or not np.array_equal(fit.values, candidate.neutral):
            continue
        column = fit.jacobian[:, 0]
        information = float(column @ column)
        if information <= 0.0:
            continue
        noticed = max(SURE, math.sqrt(2.0 * NEEDED)) / math.sqrt(information)
        # By the channel that has most windows.
        main = max(fit.channels, key=lambda c: len(evidence.block[c]))
        effect = evidence.nrmse(main, column[sections(evidence.block, fit.channels)[main]])
        if effect > 0.0:
            noticed = max(noticed, RELEVANT / effect)
        out.append(Sensitivity(candidate.name, candidate.free[0], noticed, candidate.units[0]))
    return tuple(out)


def excited(evidence: Evidence, found: Sequence[Sensitivity], stage: Stage) -> bool:
    """Tell whether the data could show an error of a stage's key parameter; for friction, whether the piston slides."""
    if stage not in KEY:
        return True
    rig = evidence.rig.effective()
    if stage == "force_balance" and evidence.travel < SLIDING * rig.friction_level(0.0) / rig.friction_law.stiffness(
        rig.friction
    ):
        return False
    name, parameter = KEY[stage]
    nominal = rig.friction_level(math.inf) if stage == "force_balance" else 1.0
    return any(s.smallest < TELLING * nominal for s in found if (s.name, s.parameter) == (name, parameter))


def left_in_stages(evidence: Evidence, found: Searched) -> dict[Stage, dict[Channel, Left]]:
    """Return what is left in each channel of each stage."""
    amiss = patched(evidence, found)
    out: dict[Stage, dict[Channel, Left]] = {stage: {} for stage in STAGES}
    for channel in evidence.channels:
        item = left(evidence, found.best, channel)
        out[CHANNELS[channel]][channel] = item._replace(mended=item.mended and channel not in amiss)
    return out
