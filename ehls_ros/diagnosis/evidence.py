"""Residuals in units of their noise, and the loss by which one model is preferred to another.

Every window's residual is divided by its noise floor: the scatter that the sensors' noise gives it, found by adding more
noise of the same size to the recording, and a tolerance for what no model of a rig reaches. Windows lie in blocks of a few
seconds; a model is judged on each block with the coefficients fitted to the others.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, SERVO_POSITION, SERVO_VELOCITY, VELOCITY, Record
from ehls_ros.diagnosis.stages import Channel, Comparison, Setup, usable
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask

REALISATIONS = 8
"""How often noise is added to find what it does."""

TOLERANCE = 1e-4
"""What no model reaches, as a part of the largest term in a channel's balance."""

RESOLVED = 1e-3
"""Sampling period from which on the motion between two samples counts [s]."""

SLOWER = 1.2
"""Periods in that from which on commands may have changed between two samples."""

WIDER = 0.2
"""Part of its length by which the local fit of the motion is made wider at either end, to see what it leaves out."""

HUBER = 3.0
"""Whitened residual from which on the loss grows linearly, so that a few windows do not decide."""

FLOOR = 0.8
"""Power of a whitened residual that the floor, noise and tolerance together, makes at least."""

FARTHEST = 1e6
"""Whitened residual that stands for any larger one, and for none where a hypothesis diverges."""

BLOCK = 2.5
"""Length of a block [s]."""

FEWEST_BLOCKS, MOST_BLOCKS = 6, 60
"""Limits of the number of blocks."""

MOST_LEFT = 2.0
"""How much larger than thought noise may be that a model saves."""

EXACT = (COMMAND, LOAD, SERVO_POSITION, SERVO_VELOCITY)
"""Signals that are commanded, not measured: they have no noise of their own."""


class Errors(NamedTuple):
    """Whitened residuals of the usable windows, by channel.

    Attributes:
        values: the residuals.
        depends: what each depends on, as :meth:`Comparison.relevant` has it; nothing for what no model has.
    """

    values: Mapping[Channel, Array]
    depends: Mapping[Channel, Any] = {}

    def together(self, channels: Sequence[Channel]) -> Array:
        """Return those of some channels one after another."""
        return np.concatenate([self.values[c] for c in channels]) if channels else np.empty(0)


class Evidence:
    """One recording beside models, in units of the noise.

    Attributes:
        rig: the model as it was given.
        channels: the channels with usable windows.
        floor: noise floor of each usable window, by channel, in the channel's unit.
        noise: the part of it that the sensors' noise makes, rms, by channel.
        block: number of the block each usable window lies in, by channel.
        blocks: how many blocks there are.
        base: whitened residuals of the model as it was given.
        travel: how far the piston goes [m].
    """

    def __init__(self, record: Record, rig: Rig, setup: Setup, seed: int) -> None:
        """Lay the given model beside the recording and find the noise floor."""
        self.record = record
        self.rig = rig
        self.setup = setup
        comparison = Comparison(record, setup)
        masks = {channel: usable(comparison, channel) for channel in setup.channels}
        self.channels: tuple[Channel, ...] = tuple(c for c in setup.channels if np.any(masks[c]))
        self.masks: dict[Channel, Mask] = masks
        raw = comparison.residuals(rig, self.channels)
        scatter = _scatter(comparison, rig, raw, self.channels, seed)
        sizes = sizes_of(comparison, rig)
        self.noise = {c: float(np.sqrt(np.mean(scatter[c][masks[c]] ** 2))) for c in self.channels}
        self.sizes = {c: sizes[c] for c in self.channels}
        # What lies between two samples is taken as straight, which is wrong by the square of their distance.
        tolerance = TOLERANCE * max(1.0, (record.period / RESOLVED) ** 2)
        self.floor: dict[Channel, Array] = {
            c: np.sqrt(scatter[c][masks[c]] ** 2 + (tolerance * sizes[c]) ** 2) for c in self.channels
        }
        self.blocks = int(np.clip(round(len(record.time) * record.period / BLOCK), FEWEST_BLOCKS, MOST_BLOCKS))
        self.block = {c: self._block_of(c) for c in self.channels}
        self.base = self._whitened(raw)._replace(depends=comparison.relevant(rig))
        self.noisy_record = _noisy(record, np.random.default_rng(seed + 1))
        self.noisy_base = self._whitened(Comparison(self.noisy_record, setup).residuals(rig, self.channels))
        moving = POSITION in record or VELOCITY in record
        self.travel = float(np.ptp(comparison.motion(rig.effective()).position)) if moving else 0.0

    def comparison(self) -> Comparison:
        """Return a fresh comparison, for another thread to use."""
        return Comparison(self.record, self.setup)

    def quieted(self, comparison: Comparison, rig: Rig, errors: Errors, channels: Sequence[Channel]) -> dict[Channel, float]:
        """Return the loss that a model saves in each channel by averaging noise, rather than by being right [nats].

        Args:
            comparison: the thread's own, of the record with noise added.
            rig: the model.
            errors: its whitened residuals without the noise.
            channels: where it differs from the given model.
        """
        noisy = self._whitened(comparison.residuals(rig, tuple(channels)))
        saved = {}
        for c in channels:
            before = float(np.sum(loss(noise_of(self, c))))
            after = float(np.sum(loss(noisy.values[c] - errors.values[c])))
            # Where more than the noise added is left, the noise is that much larger than thought.
            left = float(np.sum(loss(errors.values[c]))) / max(after, 1e-300)
            saved[c] = (before - after) * float(np.clip(left, 1.0, MOST_LEFT))
        return saved

    def times(self, channel: Channel) -> Array:
        """Return the middle of each usable window [s]."""
        window = self.setup.window_of(channel)
        starts = window.starts(len(self.record.time))
        middle = np.minimum(starts + window.weights.size // 2, len(self.record.time) - 1)
        return self.record.time[middle][self.masks[channel]]

    def nrmse(self, channel: Channel, e: Array) -> float:
        """Return the rms of whitened residuals in the channel's unit, as a part of the largest term of its balance."""
        return float(np.sqrt(np.mean((e * self.floor[channel]) ** 2))) / max(self.sizes[channel], 1e-300)

    def means(self, channel: Channel, values: Array) -> Array:
        """Return the mean of a signal over each usable window."""
        return self.setup.window_of(channel).mean(values)[self.masks[channel]]

    def errors(self, comparison: Comparison, rig: Rig, known: Errors | None = None) -> Errors:
        """Return the whitened residuals of a model.

        Args:
            comparison: the thread's own.
            rig: the model.
            known: residuals of another model, of which those that must be equal are taken over; the given model's where
                nothing is said.
        """
        taken = self.base if known is None else known
        now = comparison.relevant(rig)
        changed = tuple(c for c in self.channels if now[c] != taken.depends[c])
        fresh = self._whitened(comparison.residuals(rig, changed)).values if changed else {}
        return Errors({c: fresh[c] if c in changed else taken.values[c] for c in self.channels}, now)

    def _whitened(self, raw: Mapping[Channel, Array]) -> Errors:
        out = {}
        for channel, values in raw.items():
            e = values[self.masks[channel]] / self.floor[channel]
            out[channel] = np.clip(np.nan_to_num(e, nan=FARTHEST, posinf=FARTHEST, neginf=-FARTHEST), -FARTHEST, FARTHEST)
        return Errors(out)

    def _block_of(self, channel: Channel) -> NDArray[np.intp]:
        # By sample, not by time: the stretches of a long recording follow each other.
        window = self.setup.window_of(channel)
        starts = window.starts(len(self.record.time))[self.masks[channel]]
        return np.minimum(starts * self.blocks // len(self.record.time), self.blocks - 1)


def sections(block: Mapping[Channel, NDArray[np.intp]], channels: Sequence[Channel]) -> dict[Channel, slice]:
    """Return where each channel's windows stand when those of some channels follow one another.

    Args:
        block: of :class:`Evidence`.
        channels: the channels, in their order.
    """
    ends = np.cumsum([0, *[len(block[c]) for c in channels]])
    return {c: slice(int(begin), int(end)) for c, begin, end in zip(channels, ends[:-1], ends[1:], strict=True)}


def noise_of(evidence: Evidence, channel: Channel) -> Array:
    """Return what noise like the sensors' adds to a channel's whitened residuals of the given model."""
    return evidence.noisy_base.values[channel] - evidence.base.values[channel]


def power(e: Array) -> float:
    """Return the mean square of whitened residuals."""
    return float(np.mean(e * e))


def noise_power(evidence: Evidence, channel: Channel) -> float:
    """Return the power of what noise makes of a channel's whitened residual."""
    return max(power(noise_of(evidence, channel)), FLOOR)


def worst_block(evidence: Evidence, channel: Channel, e: Array) -> int:
    """Return the block in which whitened residuals are largest."""
    return int(np.argmax(np.bincount(evidence.block[channel], e * e, evidence.blocks)))


def elsewhere(evidence: Evidence, channel: Channel, e: Array) -> Array:
    """Return whitened residuals without the block in which they are largest, if that is not most of them.

    An error of the model shows again. What shows once may be an incident, or a reversal that noise hides, after which the
    friction's elements stand otherwise than the rig's until the next.
    """
    others: Array = e[evidence.block[channel] != worst_block(evidence, channel, e)]
    return others if 2 * len(others) >= len(e) else e


def loss(e: Array) -> Array:
    """Return Huber's loss of whitened residuals, a negative log-likelihood up to a constant."""
    size = np.abs(e)
    return np.where(size <= HUBER, 0.5 * e * e, HUBER * size - 0.5 * HUBER**2)


def weights(e: Array) -> Array:
    """Return the weights by which a quadratic loss stands in for Huber's."""
    return np.minimum(1.0, HUBER / np.maximum(np.abs(e), 1e-12))


def sizes_of(comparison: Comparison, rig: Rig) -> dict[Channel, float]:
    """Return the rms of the largest term in each channel's balance, in the channel's unit."""
    plant, record = rig.effective().plant, comparison.record
    rms = {name: float(np.sqrt(np.mean(record.signals[name] ** 2))) for name in record.signals}
    flow = (
        float(np.sqrt(np.mean(comparison.flow_terms(rig.effective())[:, 0] ** 2)))
        if "volume" in comparison.setup.channels
        else 0.0
    )
    speed = comparison.motion(rig.effective()).velocity if "force" in comparison.setup.channels else np.zeros(1)
    swept = plant.piston_area * float(np.sqrt(np.mean(speed**2)))
    driving = plant.piston_area * rms["load_pressure_pa"] if "load_pressure_pa" in rms else rms.get("force_n", 0.0)
    return {
        "spool": rms.get("spool_m", 0.0),
        "volume": max(flow, swept),
        "supply": rms.get("supply_pressure_pa", 0.0),
        "force": max(driving, rms.get("disturbance_force_n", 0.0)),
        "cell": driving,
        "velocity": float(np.sqrt(np.mean(speed**2))),
    }


def _noisy(record: Record, rng: np.random.Generator) -> Record:
    """Return the record with as much noise again as its sensors have."""
    noisy = {
        name: values if name in EXACT else values + record.noise[name] * rng.standard_normal(len(values))
        for name, values in record.signals.items()
    }
    return record._replace(signals=noisy)


def _scatter(
    comparison: Comparison, rig: Rig, raw: Mapping[Channel, Array], channels: Sequence[Channel], seed: int
) -> dict[Channel, Array]:
    """Return the standard deviation that the sensors' noise gives each window's residual."""
    rng = np.random.default_rng(seed)
    record = comparison.record
    squares = {c: np.zeros(len(raw[c])) for c in channels}
    for _ in range(REALISATIONS):
        again = Comparison(_noisy(record, rng), comparison.setup).residuals(rig, tuple(channels))
        for c in channels:
            squares[c] += (again[c] - raw[c]) ** 2
    led: Mapping[Channel, Array] = raw
    if record.period > SLOWER * RESOLVED and COMMAND in record:
        # What was commanded between two samples is not known: as much as a sample's lead.
        early = dict(record.signals) | {COMMAND: np.append(record.signals[COMMAND][1:], record.signals[COMMAND][-1])}
        led = Comparison(record._replace(signals=early), comparison.setup).residuals(rig, tuple(channels))
    fit = comparison.setup.fit
    wider = comparison.setup._replace(fit=fit + 2 * max(1, round(WIDER * fit)))
    smeared = Comparison(record, wider).residuals(rig, tuple(channels))
    out = {}
    for c in channels:
        variance = squares[c] / REALISATIONS
        typical = float(np.median(variance))
        local = uniform_filter1d(variance, 9, mode="nearest")
        # Where a wider fit of the motion says something else, the fit is as uncertain as that.
        unresolved = uniform_filter1d((smeared[c] - raw[c]) ** 2, 3, mode="nearest")
        # A spool that lags remembers it for a while.
        unresolved += uniform_filter1d((led[c] - raw[c]) ** 2, 9, mode="nearest")
        out[c] = np.sqrt(np.maximum(local, 0.5 * typical) + unresolved)
    return out
