"""The evidence: whitened residuals of the given model, window by window, with their noise floor and their blocks.

Each window's residual is divided by its noise floor: the scatter due to the sensors' noise, and a tolerance for the accuracy
no model of a rig reaches. Windows are grouped into blocks of a few seconds; a model is assessed on each block with the
coefficients fitted to the others.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.loss import loss
from ehls_ros.diagnosis.noise import largest_terms, scatter, with_noise
from ehls_ros.diagnosis.record import POSITION, VELOCITY, Record
from ehls_ros.diagnosis.resolution import coarseness
from ehls_ros.diagnosis.stages import Channel, Comparison, Setup, formed_of, usable
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


class Allowance(NamedTuple):
    """What a channel's residual is expected to be without any fault, and how far it may vary around that.

    Attributes:
        mean: expected residual of each usable window, in the channel's unit, shape (n,).
        directions: factor of the covariance of what may vary for all windows together, in the channel's unit, shape (n, m).
        variance: of what varies beside that from window to window, in the square of the channel's unit, shape (n,).
    """

    mean: Array
    directions: Array
    variance: Array


class Allowed(NamedTuple):
    """An allowance as whitened residuals need it.

    Attributes:
        mean: expected residual, in the channel's unit, shape (n,).
        basis: orthonormal directions that may vary, of residuals divided by their floor, shape (n, m).
        reduced: fraction by which a residual is reduced along each, so that its variance is 1, shape (m,).
    """

    mean: Array
    basis: Array
    reduced: Array

    def whitened(self, e: Array) -> Array:
        """Return residuals divided by their floor with less weight on the directions that may vary."""
        return e - self.basis @ (self.reduced * (self.basis.T @ e))


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
        noisy_record: the recording with that noise.
        travel: range of the piston's motion [m].
        correlation: by channel, the number of windows over which residuals are alike; their losses count as those of so many
            fewer. Windows of noise alone count one by one.
        imperfect: whether every stage of the model is taken to be off in its form, not only where causes act.
        allowed: what is allowed for without any fault, by channel; empty where a recording is judged by itself.
        judge: makes the same allowances for evidence from a part of the recording.
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
    correlation: Mapping[Channel, float] = field(default_factory=dict)
    imperfect: bool = False
    allowed: Mapping[Channel, Allowed] = field(default_factory=dict, repr=False)
    judge: "Callable[[Evidence], Evidence] | None" = field(default=None, repr=False)

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

    def means(self, channel: Channel, values: Array) -> Array:
        """Return the mean of a signal over each usable window."""
        return self.setup.window_of(channel).mean(values)[self.masks[channel]]


def gather(record: Record, rig: Rig, setup: Setup, seed: int) -> Evidence:
    """Compare the given model with a recording and find the noise floor.

    Args:
        record: the recording.
        rig: the given model.
        setup: what of the model can be compared.
        seed: of the noise that is added.
    """
    comparison = Comparison(record, setup)
    masks = {channel: usable(comparison, channel) for channel in setup.channels}
    channels: tuple[Channel, ...] = tuple(c for c in setup.channels if np.any(masks[c]))
    raw = comparison.residuals(rig, channels)
    deviation = scatter(comparison, rig, raw, seed)
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
    noisy_record = with_noise(record, np.random.default_rng(seed + 1))
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
    allowed, floor = dict[Channel, Allowed](), dict[Channel, Array]()
    for c in channels:
        given = allowances[c]
        floor[c] = np.sqrt(evidence.floor[c] ** 2 + given.variance)
        directions = given.directions / floor[c][:, None]
        squares, along = np.linalg.eigh(directions.T @ directions)
        kept = squares > rules.LEAST_ALLOWED
        basis = directions @ along[:, kept] / np.sqrt(squares[kept])
        allowed[c] = Allowed(given.mean, basis, 1.0 - 1.0 / np.sqrt(1.0 + squares[kept]))
    before = {c: evidence.base.values[c] * evidence.floor[c] for c in channels}
    base = {c: allowed[c].whitened((before[c] - allowed[c].mean) / floor[c]) for c in channels}
    noise = {c: allowed[c].whitened(evidence.noise[c] * evidence.floor[c] / floor[c]) for c in channels}
    return replace(
        evidence,
        channels=channels,
        floor=floor,
        base=Residuals(base, evidence.base.depends),
        noise=noise,
        allowed=allowed,
        judge=judge,
    )


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


def sections(block: Mapping[Channel, NDArray[np.intp]], channels: Sequence[Channel]) -> dict[Channel, slice]:
    """Return the rows of each channel when the windows of some channels are joined.

    Args:
        block: of :class:`Evidence`.
        channels: the channels, in their order.
    """
    ends = np.cumsum([0, *[len(block[c]) for c in channels]])
    return {c: slice(int(begin), int(end)) for c, begin, end in zip(channels, ends[:-1], ends[1:], strict=True)}


def noise_power(evidence: Evidence, channel: Channel) -> float:
    """Return the mean square that noise gives a channel's whitened residual."""
    e = evidence.noise[channel]
    return max(float(np.mean(e * e)), rules.LEAST_NOISE_POWER)
