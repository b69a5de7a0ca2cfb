"""Evidence: whitened residuals of the given model, window by window, with their noise floor and blocks.

Each window's residual is divided by its noise floor, which combines the scatter due to the sensors' noise with a tolerance for
the accuracy no model of a rig exceeds. Windows are grouped into blocks of a few seconds; a model is assessed on each block
with the coefficients fitted to the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.allowance import Allowance, Allowed
from ehls_ros.diagnosis.hypotheses import Hypothesis
from ehls_ros.diagnosis.loss import loss, rms
from ehls_ros.diagnosis.noise import REALISATIONS, deviations, largest_terms, scatter, with_noise
from ehls_ros.diagnosis.record import POSITION, VELOCITY, Record
from ehls_ros.diagnosis.resolution import coarseness
from ehls_ros.diagnosis.stages import CHANNELS, Channel, Comparison, Setup, formed_of, usable
from ehls_ros.duals import tangents_of, value_of
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask

MAX_RESIDUAL = 1e6
"""Whitened residual that stands for any larger one and for a model that diverges."""


class Residuals(NamedTuple):
    """Whitened residuals of the usable windows, by channel.

    Attributes:
        values: the residuals.
        depends: dependencies of each, from :meth:`Comparison.relevant`; empty for residuals not computed from a model.
    """

    values: Mapping[Channel, Array]
    depends: Mapping[Channel, object] = {}

    def joined(self, channels: Sequence[Channel]) -> Array:
        """Return the residuals of some channels concatenated in one array."""
        return np.concatenate([self.values[c] for c in channels]) if channels else np.empty(0)


class Standard:
    """Standard by which residuals are judged: here the sensors' noise, for a model whose form is exact.

    Chosen once, before a diagnosis. Subclasses override the properties in which they differ.
    """

    excitation_needed = True
    """Whether a cause counts only in a stage that was excited."""

    largest_undetected = rules.MAX_UNDETECTED
    """Largest change of a balance that may stay unseen in an excited stage, as a fraction of its largest term."""

    form_is_noise = False
    """Whether the errors of the model's form count as noise from the beginning."""

    needed_gain = rules.NEEDED_GAIN
    """Gain on held-out data, less the penalty, that a cause must bring [nat]."""

    relevant_beside = rules.RELEVANT_BESIDE
    """Least change of a balance by a further cause, as a fraction of its largest term."""

    min_gain_ratio = rules.MIN_GAIN_RATIO
    """Minimum gain of a cause, as a fraction of the possible gain of its change of the residuals."""

    accepted_rivals_only = False
    """Whether only acceptable hypotheses compete for a cause's place."""

    bounds_are_of_chance = False
    """Whether the bounds of allowed variation only tell a change from chance, beyond which it gains steadily."""

    def judged(self, evidence: "Evidence") -> "Evidence":
        """Return evidence, so far without allowances, judged by this standard."""
        return replace(evidence, standard=self)

    def lenient(self) -> "Standard | None":
        """Return the standard by which a single small cause is accepted where nothing else is; None if there is none."""
        return None

    def noise_power(self, channel: Channel, e: Array) -> float:
        """Return the fault-free mean square of a channel's whitened residuals.

        Args:
            channel: the channel.
            e: change of the residuals by added noise, shape (n,).
        """
        return max(float(np.mean(e * e)), rules.MIN_NOISE_POWER)

    def rare_square(self, channel: Channel, noise: float) -> float:
        """Return the fault-free square of a channel's rare whitened residuals, at the quantile :data:`rules.RARE_QUANTILE`.

        Args:
            channel: the channel.
            noise: fault-free mean square.
        """
        return rules.RARE_SCATTER * noise

    def form_error(self, channel: Channel) -> float:
        """Return the error of a balance's form that cannot be told from a change, as a fraction of its largest term."""
        return 0.0

    def beyond(self, evidence: "Evidence", channel: Channel, change: Array) -> Array:
        """Return the part of a counted change that is compared with the error of form."""
        return change

    def scatter(self, windows: float) -> float:
        """Return the multiple of its mean that the mean square of so many independent windows may reach by noise."""
        return rules.SCATTER

    def counted(self, evidence: "Evidence", channel: Channel, change: Array) -> Array:
        """Return the part of a change of a channel's residuals, in units of the noise floor, that is relevant if large."""
        return change

    def before(self, evidence: "Evidence", channel: Channel, before: Array, after: Array) -> Array:
        """Return the residuals of the given model in which a first cause's share is closed, whitened like ``after``."""
        return before

    def sizes_by_chance(self, hypothesis: Hypothesis, values: Array, steps: Array) -> Array:
        """Return the covariance of a hypothesis' parameters as fault-free recordings tell them, shape (p, p).

        Args:
            hypothesis: the causes.
            values: of their free parameters, shape (p,).
            steps: of the difference quotients, shape (p,).
        """
        return np.zeros((len(values), len(values)))

    def allows(self, hypothesis: Hypothesis, values: Array, inflation: Mapping[Channel, float]) -> bool:
        """Return whether a cause may have been present all along.

        Args:
            hypothesis: the cause.
            values: of its free parameters.
            inflation: divisor of each channel's losses.
        """
        return False


@dataclass(frozen=True)
class Evidence:
    """One recording compared with the given model.

    Attributes:
        record: the recording.
        rig: the given model.
        setup: the parts of the model that can be compared.
        channels: the channels with usable windows.
        masks: mask of the usable windows, by channel.
        floor: noise floor of each usable window, in the channel's unit.
        sizes: rms of the largest term in each channel's balance, in the channel's unit.
        times: middle of each usable window [s].
        block: block number of each usable window.
        blocks: number of blocks.
        base: residuals of the given model.
        noise: change of these residuals by added noise of the sensors' level.
        added: the same for each realisation used for the noise floor, without allowances.
        noisy_record: the recording with that added noise.
        travel: range of the piston's motion [m].
        correlation: number of windows over which residuals are correlated, by channel; their losses are divided by it. Windows
            of noise alone count separately.
        allowances: fault-free variation allowed for, by channel.
        allowed: the same, prepared for whitened residuals.
        standard: the standard by which the residuals are judged.
    """

    record: Record
    rig: Rig
    setup: Setup
    channels: tuple[Channel, ...]
    masks: Mapping[Channel, Mask]
    floor: Mapping[Channel, Array]
    sizes: Mapping[Channel, float]
    times: Mapping[Channel, Array]
    block: Mapping[Channel, NDArray[np.intp]]
    blocks: int
    base: Residuals
    noise: Mapping[Channel, Array]
    noisy_record: Record = field(repr=False)
    travel: float
    added: tuple[Mapping[Channel, Array], ...] = field(default=(), repr=False)
    correlation: Mapping[Channel, float] = field(default_factory=dict)
    allowances: Mapping[Channel, Allowance] = field(default_factory=dict, repr=False)
    allowed: Mapping[Channel, Allowed] = field(default_factory=dict, repr=False)
    standard: Standard = field(default_factory=Standard, repr=False)

    def comparison(self) -> Comparison:
        """Return a new comparison, of which each thread needs one."""
        return Comparison(self.record, self.setup)

    def residuals(self, comparison: Comparison, rig: Rig, known: Residuals | None = None) -> Residuals:
        """Return the residuals of a model.

        Args:
            comparison: comparison of the calling thread.
            rig: the model.
            known: residuals of another model, reused in channels with equal dependencies; by default those of the given model.
        """
        reused = self.base if known is None else known
        now = comparison.relevant(rig)
        changed = tuple(c for c in self.channels if now[c] != reused.depends[c])
        fresh = whitened(comparison.residuals(rig, changed), self.masks, self.floor, self.allowed) if changed else {}
        return Residuals({c: fresh[c] if c in changed else reused.values[c] for c in self.channels}, now)

    def whole(self, channel: Channel, e: Array) -> Array:
        """Return a channel's whitened residuals with the allowed variation restored, in units of the noise floor."""
        return self.allowed[channel].whole(e) if channel in self.allowed else e

    def beyond(self, channel: Channel, change: Array) -> Array:
        """Return the part of a change of a channel's residuals, in units of the noise floor, that is not allowed variation."""
        return self.allowed[channel].beyond(change) if channel in self.allowed else change

    def unbounded(self) -> "Evidence":
        """Return the evidence with allowances of the same variation without bounds."""
        free = {c: allowed.unbounded() for c, allowed in self.allowed.items()}
        base = {c: free[c].whitened(self.whole(c, e)) if c in free else e for c, e in self.base.values.items()}
        return replace(self, allowed=free, base=self.base._replace(values=base))

    def averaged_noise(
        self, comparison: Comparison, rig: Rig, residuals: Residuals, channels: Sequence[Channel]
    ) -> dict[Channel, float]:
        """Return the loss a model saves in each channel by averaging noise rather than by being right [nats].

        Args:
            comparison: comparison of the calling thread, for the record with added noise.
            rig: the model.
            residuals: its residuals without the added noise.
            channels: channels in which it differs from the given model.
        """
        noisy = whitened(comparison.residuals(rig, tuple(channels)), self.masks, self.floor, self.allowed)
        saved = {}
        for c in channels:
            before = float(np.sum(loss(self.noise[c])))
            after = float(np.sum(loss(noisy[c] - residuals.values[c])))
            # A remainder larger than the added noise indicates underestimated noise.
            scale = float(np.sum(loss(residuals.values[c]))) / max(after, 1e-300)
            saved[c] = (before - after) * float(np.clip(scale, 1.0, rules.MAX_NOISE_SCALE))
        return saved

    def nrmse(self, channel: Channel, e: Array) -> float:
        """Return the rms of whitened residuals in the channel's unit, as a fraction of the largest term of its balance."""
        return rms(e * self.floor[channel]) / max(self.sizes[channel], 1e-300)

    def noise_nrmse(self, channel: Channel) -> float:
        """Return the rms of the noise floor, as the same fraction."""
        return rms(self.floor[channel]) / max(self.sizes[channel], 1e-300)

    def means(self, channel: Channel, values: Array) -> Array:
        """Return the mean of a signal over each usable window."""
        return self.setup.window_of(channel).mean(values)[self.masks[channel]]

    def half(self, channel: Channel) -> Mask:
        """Return whether each usable window is in every other block: one half tells what predicts the other."""
        every_other: Mask = self.block[channel] % 2 == 0
        return every_other


def gather(record: Record, rig: Rig, setup: Setup, seed: int, realisations: int = REALISATIONS) -> Evidence:
    """Compare the given model with a recording and estimate the noise floor.

    Args:
        record: the recording.
        rig: the given model.
        setup: the parts of the model that can be compared.
        seed: of the added noise.
        realisations: number of realisations of the added noise for the noise floor.
    """
    comparison = Comparison(record, setup)
    masks = {channel: usable(comparison, channel, rig) for channel in setup.channels}
    channels: tuple[Channel, ...] = tuple(c for c in setup.channels if np.any(masks[c]))
    raw = comparison.residuals(rig, channels)
    noise = deviations(record)
    deviation, added = scatter(comparison, rig, raw, noise, seed, realisations)
    sizes = largest_terms(comparison, rig)
    moving = tuple(c for c in channels if sizes[c] > 0.0)
    still = {CHANNELS[c] for c in channels} - {CHANNELS[c] for c in moving}
    channels, setup = moving, setup._replace(why_not={**dict.fromkeys(still, "its signals are 0 throughout"), **setup.why_not})
    coarse = {c: setup.window_of(c).mean(coarseness(record, formed_of(record, c)) ** 2) for c in channels}
    floor = {c: np.sqrt(deviation[c] ** 2 + coarse[c] * (rules.TOLERANCE * sizes[c]) ** 2)[masks[c]] for c in channels}
    blocks = max(round(len(record.time) * record.period / rules.BLOCK), rules.MIN_BLOCKS)
    block, times = dict[Channel, NDArray[np.intp]](), dict[Channel, Array]()
    for c in channels:
        window = setup.window_of(c)
        starts = window.starts(len(record.time))[masks[c]]
        # By sample, not by time, so that the stretches of a long recording count as contiguous.
        block[c] = np.minimum(starts * blocks // len(record.time), blocks - 1)
        times[c] = record.time[np.minimum(starts + window.weights.size // 2, len(record.time) - 1)]
    base = whitened({c: raw[c] for c in channels}, masks, floor)
    noisy_record = with_noise(record, noise, np.random.default_rng(seed + 1))
    noisy = whitened(Comparison(noisy_record, setup).residuals(rig, channels), masks, floor)
    moved = POSITION in record or VELOCITY in record
    return Evidence(
        record=record,
        rig=rig,
        setup=setup,
        channels=channels,
        masks=masks,
        floor=floor,
        sizes={c: sizes[c] for c in channels},
        times=times,
        block=block,
        blocks=blocks,
        base=Residuals(base, comparison.relevant(rig)),
        noise={c: noisy[c] - base[c] for c in channels},
        added=tuple({c: more[c][masks[c]] / floor[c] for c in channels} for more in added),
        noisy_record=noisy_record,
        travel=float(np.ptp(comparison.motion(rig.effective()).position)) if moved else 0.0,
    )


def allowing(evidence: Evidence, allowances: Mapping[Channel, Allowance], standard: Standard) -> Evidence:
    """Return evidence with allowances for the expected residual and its fault-free variation.

    Args:
        evidence: the recording compared with the given model, without allowances.
        allowances: by channel; channels without one are left out.
        standard: the standard that gives the allowances.
    """
    channels = tuple(c for c in evidence.channels if c in allowances)
    floor = {c: np.sqrt(evidence.floor[c] ** 2 + allowances[c].variance) for c in channels}
    unexpected = {c: evidence.base.values[c] - allowances[c].mean / evidence.floor[c] for c in channels}
    # A mean over correlated windows scatters more than one over windows of noise.
    more = {c: (allowances[c].correlated - 1.0) * allowances[c].variance / floor[c] ** 2 for c in channels}
    correlation = {c: 1.0 + float(np.median(more[c])) for c in channels}
    base = Residuals(unexpected, evidence.base.depends)
    judged = replace(evidence, channels=channels, base=base, allowances=allowances, standard=standard)
    return measured_in(judged, floor, correlation)


def part_of(evidence: Evidence, kept: Mapping[Channel, Mask]) -> Evidence:
    """Return the evidence of selected windows, without allowances; channels with few windows left are dropped.

    Args:
        evidence: the recording compared with the given model.
        kept: mask of the usable windows to keep, by channel.
    """
    channels = tuple(c for c in evidence.channels if c in kept and np.mean(kept[c]) >= rules.MIN_KEPT_WINDOWS)
    masks = dict(evidence.masks)
    for c in channels:
        masks[c] = evidence.masks[c].copy()
        masks[c][evidence.masks[c]] = kept[c]

    def left(of: Mapping[Channel, Array]) -> dict[Channel, Array]:
        return {c: of[c][kept[c]] for c in channels}

    return replace(
        evidence,
        channels=channels,
        masks=masks,
        floor=left(evidence.floor),
        times=left(evidence.times),
        block={c: evidence.block[c][kept[c]] for c in channels},
        noise=left(evidence.noise),
        added=tuple(left(more) for more in evidence.added),
        base=Residuals(left(evidence.base.values), evidence.base.depends),
    )


def measured_in(evidence: Evidence, floor: Mapping[Channel, Array], correlation: Mapping[Channel, float]) -> Evidence:
    """Return evidence rescaled to another noise floor, with the same allowances.

    Args:
        evidence: the recording compared with the given model.
        floor: of each usable window, in the channel's unit.
        correlation: number of windows over which residuals are correlated, by channel.
    """
    allowed = {c: a.whitening(floor[c], correlation[c]) for c, a in evidence.allowances.items() if c in evidence.channels}

    def again(values: Mapping[Channel, Array]) -> dict[Channel, Array]:
        whole = {c: evidence.whole(c, values[c]) * evidence.floor[c] / floor[c] for c in evidence.channels}
        return {c: allowed[c].whitened(e) if c in allowed else e for c, e in whole.items()}

    base = Residuals(again(evidence.base.values), evidence.base.depends)
    return replace(evidence, floor=floor, base=base, noise=again(evidence.noise), correlation=correlation, allowed=allowed)


def whitened(
    raw: Mapping[Channel, Array],
    masks: Mapping[Channel, Mask],
    floor: Mapping[Channel, Array],
    allowed: Mapping[Channel, Allowed] | None = None,
) -> dict[Channel, Array]:
    """Return the residuals of the usable windows in units of their noise floor; finite but large for a diverged model."""
    far = MAX_RESIDUAL
    out = {}
    for channel, values in raw.items():
        given = (allowed or {}).get(channel)
        # A diverged model may overflow even what is cut off next.
        with np.errstate(over="ignore"):
            e = (values[masks[channel]] - (0.0 if given is None else given.mean)) / floor[channel]
        e = np.clip(np.nan_to_num(e, nan=far, posinf=far, neginf=-far), -far, far)
        out[channel] = e if given is None else given.whitened(e)
    return out


def whitened_slopes(evidence: Evidence, raw: Mapping[Channel, Any], parameters: int) -> dict[Channel, Array]:
    """Return the derivatives of :func:`whitened` without allowances, by channel, shape (n, parameters).

    Args:
        evidence: the recording compared with a model.
        raw: dual residuals of all windows, from :meth:`Comparison.residuals`.
        parameters: number of parameters.
    """
    out = {}
    for channel, values in raw.items():
        mask, floor = evidence.masks[channel], evidence.floor[channel]
        out[channel] = np.zeros((len(floor), parameters))
        far = ~(np.abs(value_of(values)[mask] / floor) < MAX_RESIDUAL)
        for parameter, tangent in tangents_of(values).items():
            column = np.broadcast_to(tangent, mask.shape)[mask] / floor
            out[channel][:, parameter] = np.where(far, 0.0, np.nan_to_num(column))
    return out


def sections(block: Mapping[Channel, NDArray[np.intp]], channels: Sequence[Channel]) -> dict[Channel, slice]:
    """Return the rows of each channel in the concatenated windows of some channels.

    Args:
        block: of :class:`Evidence`.
        channels: the channels, in order.
    """
    ends = np.cumsum([0, *[len(block[c]) for c in channels]])
    return {c: slice(int(begin), int(end)) for c, begin, end in zip(channels, ends[:-1], ends[1:], strict=True)}


def noise_power(evidence: Evidence, channel: Channel) -> float:
    """Return the fault-free mean square of a channel's whitened residual."""
    return evidence.standard.noise_power(channel, evidence.noise[channel])
