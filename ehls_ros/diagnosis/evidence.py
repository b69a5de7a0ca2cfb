"""The evidence: whitened residuals of the given model, window by window, with their noise floor and their blocks.

Each window's residual is divided by its noise floor: the scatter due to the sensors' noise, and a tolerance for the accuracy
no model of a rig reaches. Windows are grouped into blocks of a few seconds; a model is assessed on each block with the
coefficients fitted to the others.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.allowance import Allowance, Allowed
from ehls_ros.diagnosis.loss import loss
from ehls_ros.diagnosis.noise import deviations, largest_terms, scatter, with_noise
from ehls_ros.diagnosis.record import POSITION, VELOCITY, Record
from ehls_ros.diagnosis.resolution import coarseness
from ehls_ros.diagnosis.stages import Channel, Comparison, Setup, formed_of, usable
from ehls_ros.duals import tangents_of, value_of
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask


class Residuals(NamedTuple):
    """Whitened residuals of the usable windows, by channel.

    Attributes:
        values: the residuals.
        depends: what each depends on, as :meth:`Comparison.relevant` gives it; empty for residuals of no model.
    """

    values: Mapping[Channel, Array]
    depends: Mapping[Channel, object] = {}

    def joined(self, channels: Sequence[Channel]) -> Array:
        """Return the residuals of some channels in one array, channel after channel."""
        return np.concatenate([self.values[c] for c in channels]) if channels else np.empty(0)


@dataclass(frozen=True)
class Evidence:
    """One recording compared with the given model.

    Attributes:
        record: the recording.
        rig: the given model.
        setup: what of the model can be compared.
        channels: the channels with usable windows.
        masks: the usable ones of all windows, by channel.
        floor: noise floor of each usable window, in the channel's unit.
        sizes: rms of the largest term in each channel's balance, in the channel's unit.
        times: middle of each usable window [s].
        block: number of the block each usable window lies in.
        blocks: number of blocks.
        base: residuals of the given model.
        noise: what as much noise again as the sensors have adds to these.
        added: the same of each realisation that the noise floor comes from, nothing allowed for.
        noisy_record: the recording with that noise.
        travel: range of the piston's motion [m].
        correlation: by channel, the number of windows over which residuals are alike; their losses count as those of so many
            fewer. Windows of noise alone count one by one.
        form: change of a balance, as a fraction of its largest term, up to which a cause may be an error of the model's form;
            None where the model is taken to have none.
        allowances: what is allowed for without any fault, by channel.
        allowed: the same as whitened residuals need it.
        judge: makes the same allowances for evidence from a part of the recording.
        baselines: recordings of the rig from when it was well, compared with the same model and judged alike.
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
    form: float | None = None
    allowances: Mapping[Channel, Allowance] = field(default_factory=dict, repr=False)
    allowed: Mapping[Channel, Allowed] = field(default_factory=dict, repr=False)
    judge: "Callable[[Evidence], Evidence] | None" = field(default=None, repr=False)
    baselines: "tuple[Evidence, ...]" = field(default=(), repr=False)

    def comparison(self) -> Comparison:
        """Return a new comparison, one for each thread."""
        return Comparison(self.record, self.setup)

    def residuals(self, comparison: Comparison, rig: Rig, known: Residuals | None = None) -> Residuals:
        """Return the residuals of a model.

        Args:
            comparison: the thread's own.
            rig: the model.
            known: residuals of another model, reused in the channels where both depend on the same; by default those of the
                given model.
        """
        reused = self.base if known is None else known
        now = comparison.relevant(rig)
        changed = tuple(c for c in self.channels if now[c] != reused.depends[c])
        fresh = whitened(comparison.residuals(rig, changed), self.masks, self.floor, self.allowed) if changed else {}
        return Residuals({c: fresh[c] if c in changed else reused.values[c] for c in self.channels}, now)

    def whole(self, channel: Channel, e: Array) -> Array:
        """Return a channel's whitened residuals with what is allowed for in full, in units of the noise floor."""
        return self.allowed[channel].whole(e) if channel in self.allowed else e

    def averaged_noise(
        self, comparison: Comparison, rig: Rig, residuals: Residuals, channels: Sequence[Channel]
    ) -> dict[Channel, float]:
        """Return the loss a model saves in each channel by averaging noise rather than by being right [nats].

        Args:
            comparison: the thread's own, of the record with noise added.
            rig: the model.
            residuals: its residuals without the added noise.
            channels: where it differs from the given model.
        """
        noisy = whitened(comparison.residuals(rig, tuple(channels)), self.masks, self.floor, self.allowed)
        saved = {}
        for c in channels:
            before = float(np.sum(loss(self.noise[c])))
            after = float(np.sum(loss(noisy[c] - residuals.values[c])))
            # A remainder larger than the added noise says that the noise is larger than estimated.
            scale = float(np.sum(loss(residuals.values[c]))) / max(after, 1e-300)
            saved[c] = (before - after) * float(np.clip(scale, 1.0, rules.MOST_NOISE_SCALE))
        return saved

    def nrmse(self, channel: Channel, e: Array) -> float:
        """Return the rms of whitened residuals in the channel's unit, as a fraction of the largest term of its balance."""
        return float(np.sqrt(np.mean((e * self.floor[channel]) ** 2))) / max(self.sizes[channel], 1e-300)

    def noise_nrmse(self, channel: Channel) -> float:
        """Return the rms of the noise floor, as the same fraction."""
        return float(np.sqrt(np.mean(self.floor[channel] ** 2))) / max(self.sizes[channel], 1e-300)

    def means(self, channel: Channel, values: Array) -> Array:
        """Return the mean of a signal over each usable window."""
        return self.setup.window_of(channel).mean(values)[self.masks[channel]]


def gather(record: Record, rig: Rig, setup: Setup, seed: int, realisations: int = rules.REALISATIONS) -> Evidence:
    """Compare the given model with a recording and find the noise floor.

    Args:
        record: the recording.
        rig: the given model.
        setup: what of the model can be compared.
        seed: of the noise that is added.
        realisations: how often it is added to find the noise floor.
    """
    comparison = Comparison(record, setup)
    masks = {channel: usable(comparison, channel) for channel in setup.channels}
    channels: tuple[Channel, ...] = tuple(c for c in setup.channels if np.any(masks[c]))
    raw = comparison.residuals(rig, channels)
    noise = deviations(record)
    deviation, added = scatter(comparison, rig, raw, noise, seed, realisations)
    sizes = largest_terms(comparison, rig)
    coarse = {c: setup.window_of(c).mean(coarseness(record, formed_of(record, c)) ** 2) for c in channels}
    floor = {c: np.sqrt(deviation[c] ** 2 + coarse[c] * (rules.TOLERANCE * sizes[c]) ** 2)[masks[c]] for c in channels}
    blocks = int(np.clip(round(len(record.time) * record.period / rules.BLOCK), rules.FEWEST_BLOCKS, rules.MOST_BLOCKS))
    block, times = dict[Channel, NDArray[np.intp]](), dict[Channel, Array]()
    for c in channels:
        window = setup.window_of(c)
        starts = window.starts(len(record.time))[masks[c]]
        # By sample, not by time: the stretches of a long recording follow each other without a gap.
        block[c] = np.minimum(starts * blocks // len(record.time), blocks - 1)
        times[c] = record.time[np.minimum(starts + window.weights.size // 2, len(record.time) - 1)]
    base = whitened(raw, masks, floor)
    noisy_record = with_noise(record, noise, np.random.default_rng(seed + 1))
    noisy = whitened(Comparison(noisy_record, setup).residuals(rig, channels), masks, floor)
    moving = POSITION in record or VELOCITY in record
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
        travel=float(np.ptp(comparison.motion(rig.effective()).position)) if moving else 0.0,
    )


def allowing(evidence: Evidence, allowances: Mapping[Channel, Allowance], judge: Callable[[Evidence], Evidence]) -> Evidence:
    """Return evidence that is measured against what is expected and may vary without any fault.

    Args:
        evidence: the recording compared with the given model, nothing allowed for yet.
        allowances: by channel; channels without one are left out.
        judge: makes the same allowances for evidence from a part of the recording.
    """
    channels = tuple(c for c in evidence.channels if c in allowances)
    floor = {c: np.sqrt(evidence.floor[c] ** 2 + allowances[c].variance) for c in channels}
    unexpected = {c: evidence.base.values[c] - allowances[c].mean / evidence.floor[c] for c in channels}
    # A mean over windows that are alike scatters more than one over windows of noise.
    more = {c: (allowances[c].alike - 1.0) * allowances[c].variance / floor[c] ** 2 for c in channels}
    correlation = {c: 1.0 + float(np.median(more[c])) for c in channels}
    base = Residuals(unexpected, evidence.base.depends)
    return measured_in(replace(evidence, channels=channels, base=base, allowances=allowances, judge=judge), floor, correlation)


def part_of(evidence: Evidence, kept: Mapping[Channel, Mask]) -> Evidence:
    """Return evidence of some of its windows, nothing allowed for yet; a channel of which little is left is left out.

    Args:
        evidence: the recording compared with the given model.
        kept: which of the usable windows are kept, by channel.
    """
    channels = tuple(c for c in evidence.channels if c in kept and np.mean(kept[c]) >= rules.LEAST_SEEN)
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
    """Return evidence in units of another noise floor, with the same allowances.

    Args:
        evidence: the recording compared with the given model.
        floor: of each usable window, in the channel's unit.
        correlation: number of windows over which residuals are alike, by channel.
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
    """Return the residuals of the usable windows in units of their noise floor; a diverged model's are finite and large."""
    far = rules.FARTHEST
    out = {}
    for channel, values in raw.items():
        given = (allowed or {}).get(channel)
        e = (values[masks[channel]] - (0.0 if given is None else given.mean)) / floor[channel]
        e = np.clip(np.nan_to_num(e, nan=far, posinf=far, neginf=-far), -far, far)
        out[channel] = e if given is None else given.whitened(e)
    return out


def whitened_slopes(evidence: Evidence, raw: Mapping[Channel, Any], parameters: int) -> dict[Channel, Array]:
    """Return the derivatives of what :func:`whitened` returns where nothing is allowed for, by channel, shape (n, parameters).

    Args:
        evidence: the recording compared with a model.
        raw: residuals of all windows, as :meth:`Comparison.residuals` returns them, of duals.
        parameters: how many there are.
    """
    out = {}
    for channel, values in raw.items():
        mask, floor = evidence.masks[channel], evidence.floor[channel]
        out[channel] = np.zeros((len(floor), parameters))
        far = ~(np.abs(value_of(values)[mask] / floor) < rules.FARTHEST)
        for parameter, tangent in tangents_of(values).items():
            column = np.broadcast_to(tangent, mask.shape)[mask] / floor
            out[channel][:, parameter] = np.where(far, 0.0, np.nan_to_num(column))
    return out


def sections(block: Mapping[Channel, NDArray[np.intp]], channels: Sequence[Channel]) -> dict[Channel, slice]:
    """Return the rows of each channel when the windows of some channels are joined.

    Args:
        block: of :class:`Evidence`.
        channels: the channels, in their order.
    """
    ends = np.cumsum([0, *[len(block[c]) for c in channels]])
    return {c: slice(int(begin), int(end)) for c, begin, end in zip(channels, ends[:-1], ends[1:], strict=True)}


def noise_power(evidence: Evidence, channel: Channel) -> float:
    """Return the mean square of a channel's whitened residual without a fault: due to noise, or to all that is allowed for."""
    if evidence.baselines:
        return 1.0
    e = evidence.noise[channel]
    return max(float(np.mean(e * e)), rules.LEAST_NOISE_POWER)
