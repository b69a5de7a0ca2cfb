"""Arguments of a term that predict a remainder: one of the stage's own signals, with a memory or a factor where that is needed.

In each place where a term can act, its value over each argument is regressed on the remainder, and judged by the fraction of
the variance that it predicts on held-out blocks. A term of two signals, or with a memory, is proposed only if it predicts a
worthwhile part of the rest.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.dependence import explained_by, explained_shares, kept_by_play, powers, signals_along
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.loss import power
from ehls_ros.diagnosis.record import COMMAND, FORCE, LOAD, POSITION, PRESSURE, SPOOL, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.diagnosis.starts import spectral_lines
from ehls_ros.physics.effects._table import KNOTS
from ehls_ros.samples import Mask

ERROR, DISPLACEMENT = "error", "displacement"
"""Command less spool displacement, and spool displacement, as arguments at the valve's input."""

FRICTION = "empirical_friction"
"""The term whose level friction approaches while it slides."""


class Place(NamedTuple):
    """Arguments of the terms in a place.

    Attributes:
        single: signals on which a term may depend alone.
        products: pairs of an argument and a factor to which the term is proportional.
        lags: time constants of the lag subtracted from a signal, by the signal [s].
        plays: signals of which a term may be what a play keeps.
    """

    single: tuple[str, ...]
    products: tuple[tuple[str, str], ...] = ()
    lags: Mapping[str, tuple[float, ...]] = {}
    plays: tuple[str, ...] = ()


OPENING = Place(("spool", "position", "pressure", "time"), (("spool", "pressure"),), {}, ("spool",))
"""Arguments of a term at the metering edges."""

PLACES: Mapping[Channel, Mapping[str, Place]] = {
    "force": {
        "empirical_force": Place(
            ("position", "velocity", "pressure", "load", "time"),
            (("position", "velocity"), ("position", "pressure"), ("position", "load"), ("time", "velocity")),
            {"position": (0.1, 0.5, 2.0), "velocity": (0.005, 0.05)},
            ("position",),
        ),
        FRICTION: Place(
            ("position", "speed", "pressure", "time", "temperature"), (("position", "pressure"), ("speed", "pressure"))
        ),
    },
    "volume": {
        "empirical_opening": OPENING,
        "empirical_leakage": Place(
            ("pressure", "speed", "position", "time"),
            (("speed", "pressure"), ("position", "pressure")),
            {"pressure": (0.005, 0.05, 0.2, 1.0)},
        ),
    },
    "volume_a": {"empirical_opening": OPENING},
    "volume_b": {"empirical_opening": OPENING},
    "spool": {
        "empirical_spool": Place(
            ("spool", ERROR, "time"), (("spool", "pressure"), (DISPLACEMENT, ERROR), (DISPLACEMENT, "pressure"))
        )
    },
    "cell": {
        "empirical_pressure_reading": Place(
            ("pressure", "position", "velocity", "temperature", "time"), (("position", "pressure"),), {}, ("pressure",)
        ),
        "empirical_force_reading": Place(
            ("pressure", "position", "velocity", "temperature", "time"), (("position", "pressure"),)
        ),
    },
    "velocity": {"empirical_position_reading": Place(("position", "pressure", "time"))},
}
"""Arguments of a term in each channel, by the effect that has it."""

SIGNAL_OF = {
    "position": POSITION, "velocity": VELOCITY, "speed": VELOCITY, "pressure": PRESSURE, "spool": SPOOL, "load": LOAD,
    "time": "time_s", "temperature": TEMPERATURE, ERROR: SPOOL, DISPLACEMENT: SPOOL,
}  # fmt: skip
"""Signal that an argument is formed of, by the names of the data contract."""

PLAYS = (0.01, 0.03, 0.1, 0.3)
"""Widths of a play that are tried, as fractions of the signal's range."""

SIMPLE, FURTHER = 3, 2
"""Terms that are fitted, of those of one signal, and of those of two signals or with a memory."""

REACHED = 3
"""Number of blocks that reach both ends of a table."""

FINENESS, PLAY_KNOTS, TIME_KNOTS = (8, KNOTS), 4, 6
"""Numbers of knots that are tried; over time there are few, as held-out blocks are gaps that a table must bridge."""

SKETCHED = 33
"""Places at which a table is estimated in order to find formulas for it."""

FINER_GAIN = 0.01
"""Fraction of a remainder's variance that the finer table must predict beyond the coarser one."""

TURNING = 0.1
"""Speed within which a force turns round with the motion, over the rms speed."""

CELLS = 48
"""Parts of a signal's range in which the remainder may be concentrated."""

TAIL = 0.99
"""Quantile of a remainder at which it is clipped while arguments are chosen."""

WAVES, WAVE_STEP, HARMONICS = (2.5, 150.0), 0.25, 2
"""Least and largest number of periods along the stroke that are looked for, their spacing, and harmonics of each."""

HARMONIC_LOSS = 0.05
"""Fraction of its share that a wave may lose to one of a whole fraction of its period."""

Respond = Callable[[Array], Array]
"""Returns a channel's windows for a term's value at each sample."""


class Waves(NamedTuple):
    """Waves along a signal's range.

    Attributes:
        numbers: of periods along it, shape (waves,).
        columns: each wave, its harmonics and a constant, in the windows, shape (waves, columns, windows).
        even: the windows in even blocks, shape (windows,); each half is predicted from the other.
        normals: products of the columns with each other in even and odd blocks, shape (2, waves, columns, columns).
    """

    numbers: Array
    columns: Array
    even: Mask
    normals: Array

    def strongest(self, target: Array) -> tuple[float, float]:
        """Return the number of periods that predicts a remainder best, and the fraction it explains.

        Args:
            target: the remainder, shape (windows,).
        """
        moments = np.array([self.columns @ np.where(half, target, 0.0) for half in (self.even, ~self.even)])
        shares = explained_shares(self.normals, moments, powers(target, self.even))
        best = int(np.argmax(shares))
        # A wave and its harmonics are also harmonics of a longer wave.
        shorter = [k for k in range(best, len(shares)) if shares[k] >= (1.0 - HARMONIC_LOSS) * shares[best]]
        whole = [k for k in shorter if abs(self.numbers[k] / self.numbers[best] % 1.0) < 1e-9]
        best = whole[-1]
        return float(self.numbers[best]), float(shares[best])


class Proposal(NamedTuple):
    """A table that predicts a remainder.

    Attributes:
        share: fraction of the remainder's held-out variance that it predicts.
        effect: the effect that has it.
        argument: name of the signal of its argument.
        low, high: the argument at the first and at the last knot; of a periodic table, a period apart.
        reach: range of the argument in the data.
        knots: number of values.
        periodic: whether it repeats.
        direction: speed within which its sign follows the direction of motion [m/s]; 0: it does not.
        factor: signal to which it is proportional; empty if there is none.
        factor_reach: largest magnitude of that signal in the data.
        lag: time constant of the lag subtracted from the argument [s]; 0: none.
        play: width of the play in whose gap the argument is taken, in the signal's unit; 0: none.
        start: its values at the knots, if it must be near them to be fitted.
        sketch: in that case also its values at :data:`SKETCHED` places from the first knot to the last.
        sketch_std: their standard errors.
    """

    share: float
    effect: str
    argument: str
    low: float = 0.0
    high: float = 0.0
    reach: tuple[float, float] = (0.0, 0.0)
    knots: int = FINENESS[0]
    periodic: bool = False
    direction: float = 0.0
    factor: str = ""
    factor_reach: float = 1.0
    lag: float = 0.0
    play: float = 0.0
    start: tuple[float, ...] = ()
    sketch: tuple[float, ...] = ()
    sketch_std: tuple[float, ...] = ()

    @property
    def simple(self) -> bool:
        """Whether it is a function of one signal without a memory."""
        return not self.factor and self.lag == 0.0 and self.play == 0.0

    @property
    def key(self) -> tuple[object, ...]:
        """What it is, apart from its values."""
        return self[1:-3]


class Asked(NamedTuple):
    """A channel whose remainders are to be predicted.

    Attributes:
        evidence: the recording compared with the given model.
        channel: the channel.
        respond: its windows for a term's value at each sample.
        signals: by the names of arguments and factors, one value a sample.
        direction: direction of motion in the windows; None without a motion.
        turning: speed within which it turns [m/s].
        waves: waves along the stroke; None where no term repeats along it.
        friction: returns the windows for each value of a table of friction, which follows its level only while it slides.
    """

    evidence: Evidence
    channel: Channel
    respond: Respond
    signals: Mapping[str, Array]
    direction: Array | None
    turning: float
    waves: Waves | None
    friction: Callable[[Proposal], Array]


def asked_in(evidence: Evidence, channel: Channel, friction: Callable[[Proposal], Array]) -> Asked:
    """Return a channel prepared for proposals of its terms.

    Args:
        evidence: the recording compared with the given model.
        channel: the channel.
        friction: returns the windows for each value of a table of friction, shape (windows, knots).
    """
    along, respond = signals_along(evidence.comparison(), evidence.rig), _respond(evidence, channel)
    signals = {name: along[signal] for name, signal in SIGNAL_OF.items() if signal in along}
    if "speed" in signals:
        signals["speed"] = np.abs(signals["speed"])
    if channel == "spool":
        signals["spool"], signals[ERROR] = along[COMMAND], along[COMMAND] - along[SPOOL]
    if channel == "cell":
        # Inside a hysteresis of the pressure sensor, its reading stays where it was.
        signals["pressure"] = evidence.record.values(FORCE) / evidence.rig.effective().plant.piston_area
    velocity = signals.get("velocity")
    turning, direction = (0.0, None) if velocity is None else turns(evidence, channel, velocity)
    repeats = any("position" in place.single for place in PLACES[channel].values())
    position = signals.get("position")
    even = evidence.half(channel)
    waves = waves_along(respond, position, even) if repeats and position is not None and np.ptp(position) > 0.0 else None
    return Asked(evidence, channel, respond, signals, direction, turning, waves, friction)


def turns(evidence: Evidence, channel: Channel, velocity: Array) -> tuple[float, Array | None]:
    """Return the speed within which the direction of motion turns [m/s], and the direction in a channel's windows.

    Args:
        evidence: the recording compared with the given model.
        channel: the channel.
        velocity: one value a sample [m/s]; without any motion there is no direction.
    """
    speed = TURNING * float(np.sqrt(np.mean(velocity**2)))
    return speed, np.tanh(evidence.means(channel, velocity) / speed) if speed > 0.0 else None


def without_tail(e: Array) -> Array:
    """Return a remainder with its largest values limited, which single events would otherwise rule."""
    limit = float(np.quantile(np.abs(e), TAIL))
    return np.clip(e, -limit, limit)


def _respond(evidence: Evidence, channel: Channel) -> Respond:
    """Return a channel's windows for a term's value at each sample, up to their sign and scale."""
    window, mask, record = evidence.setup.window_of(channel), evidence.masks[channel], evidence.record
    if channel == "velocity":
        return lambda values: window.rate(values)[mask]
    if channel != "spool":
        return lambda values: window.mean(values)[mask]
    plant = evidence.rig.effective().plant

    def followed(values: Array) -> Array:
        spool = record.by_stretch(lambda part: lag_of(part, 1.0 / plant.valve_bandwidth, record.period), values)
        return plant.valve_gain * window.mean(spool)[mask]

    return followed


def proposals(asked: Asked, e: Array) -> list[Proposal]:
    """Return the tables of a channel whose arguments predict a remainder best.

    Args:
        asked: the channel.
        e: its whitened remainder, shape (windows,).
    """
    e = _comparable(asked, e * asked.evidence.floor[asked.channel])
    clipped = without_tail(e)
    simple, further = list[Proposal](), list[Proposal]()
    for effect, place in PLACES[asked.channel].items():
        for argument in place.single:
            for directed in _variants(asked, effect, argument):
                simple += _along(asked, Proposal(0.0, effect, argument, direction=directed), clipped)
        further += [p for alike in _further(asked, effect, place) for p in _along(asked, alike, clipped)]
    simple = sorted((p for p in simple if p.share >= rules.DEPENDS), key=lambda p: -p.share)
    best = simple[0].share if simple else 0.0
    most = max(1.0 - power(asked.evidence.noise[asked.channel]) / max(power(e), 1e-300), best)
    least = max(best + rules.WORTHWHILE * (most - best), rules.DEPENDS)
    distinct = dict[tuple[str, str, str], Proposal]()
    for p in sorted((p for p in further if p.share >= least), key=lambda p: -p.share):
        distinct.setdefault((p.effect, p.argument, p.factor), p)
    chosen = [*simple[:SIMPLE], *list(distinct.values())[:FURTHER]]
    if asked.channel != "spool":
        return chosen
    # The spool's error feeds back, so that a table far from the right one may not lead to it.
    return [_estimated(asked, p, e) for p in chosen]


def _variants(asked: Asked, effect: str, argument: str) -> tuple[float, ...]:
    """Return the speeds within which a term's sign turns with the motion, 0 where it does not."""
    turns = effect == "empirical_force" and argument not in ("velocity", "speed") and asked.turning > 0.0
    return (0.0, asked.turning) if turns else (0.0,)


def _further(asked: Asked, effect: str, place: Place) -> Iterator[Proposal]:
    """Yield the terms of two signals, or with a memory, in a place."""
    signals = asked.signals
    for argument, factor in place.products:
        if argument in signals and factor in signals:
            yield Proposal(0.0, effect, argument, factor=factor, factor_reach=float(np.max(np.abs(signals[factor]))) or 1.0)
    for argument, lags in place.lags.items():
        yield from (Proposal(0.0, effect, argument, lag=lag) for lag in lags if argument in signals)
    for argument in place.plays:
        if argument in signals:
            yield from (Proposal(0.0, effect, argument, play=part * float(np.ptp(signals[argument]))) for part in PLAYS)


def _argument(asked: Asked, p: Proposal) -> Array:
    """Return the argument of a term at each sample."""
    values, record = asked.signals[p.argument], asked.evidence.record
    if p.lag > 0.0:
        return values - record.by_stretch(lambda part: lag_of(part, p.lag, record.period), values)
    return kept_by_play(record, values, p.play) if p.play > 0.0 else values


def _columns(asked: Asked, p: Proposal, values: Array, knots: int) -> Array:
    """Return the windows for each value of a table, shape (windows, knots)."""
    if p.effect == FRICTION:
        return _comparable(asked, asked.friction(p._replace(knots=knots)))
    times = asked.signals[p.factor] / p.factor_reach if p.factor else 1.0
    columns = np.stack([asked.respond(hat * times) for hat in hats(p, values, knots)], axis=1)
    turned = columns * asked.direction[:, np.newaxis] if p.direction > 0.0 and asked.direction is not None else columns
    return _comparable(asked, turned)


def _comparable(asked: Asked, windows: Array) -> Array:
    """Return windows, one or more columns, in units of the noise and without the variation that the standard allows.

    A remainder lacks most of that variation, such as a skew between two signals; a column with it would not resemble it.
    """
    floor, allowed = asked.evidence.floor[asked.channel], asked.evidence.allowed.get(asked.channel)
    relative: Array = (windows.T / floor).T
    return relative if allowed is None else allowed.outside(relative)


def hats(p: Proposal, values: Array, knots: int) -> Iterator[Array]:
    """Yield the weight of each value of a table in the term at each sample, shape (samples,)."""
    if p.periodic:
        along, numbers = (values - p.low) / (p.high - p.low) % 1.0 * knots, np.arange(knots + 1)
        yield from (np.interp(along, numbers, np.append(row, row[0])) for row in np.eye(knots))
        return
    # Beyond its ends a table goes on as it began, mirrored there.
    at, inside = np.linspace(p.low, p.high, knots), np.clip(values, p.low, p.high)
    yield from (2.0 * np.interp(inside, at, row) - np.interp(2.0 * inside - values, at, row) for row in np.eye(knots))


def _estimated(asked: Asked, p: Proposal, e: Array) -> Proposal:
    """Return a proposal with the values of its table, and with those of a finer one unless it repeats."""
    start, _ = _values(asked, p, e, p.knots)
    sketch, std = (np.empty(0), np.empty(0)) if p.periodic else _values(asked, p, e, SKETCHED)
    return p._replace(start=tuple(start.tolist()), sketch=tuple(sketch.tolist()), sketch_std=tuple(std.tolist()))


def _values(asked: Asked, p: Proposal, e: Array, knots: int) -> tuple[Array, Array]:
    """Return a table's values at a number of knots by regression on a remainder, and their standard errors."""
    columns = _columns(asked, p, _argument(asked, p), knots)
    normal = columns.T @ columns
    normal += 1e-6 * np.trace(normal) / len(normal) * np.eye(len(normal))
    inverse = np.linalg.inv(normal)
    values = inverse @ (columns.T @ e)
    return values, np.sqrt(np.diag(inverse) * power(e - columns @ values))


def _along(asked: Asked, alike: Proposal, target: Array) -> list[Proposal]:
    """Return tables over an argument: over its range, over a part in which the remainder is concentrated, and a periodic one.

    Args:
        asked: the channel.
        alike: effect, argument, factor, memory and direction.
        target: the remainder, shape (windows,).
    """
    # Friction opposes the motion.
    turned = alike.direction > 0.0 or alike.effect == FRICTION
    if alike.argument not in asked.signals or (turned and asked.direction is None):
        return []
    evidence, channel = asked.evidence, asked.channel
    values, block = _argument(asked, alike), asked.evidence.block[channel]
    means, even = evidence.means(channel, values), evidence.half(channel)
    low, high = _covered(means, block)
    if not high > low:
        return []
    alike = alike._replace(reach=(float(np.min(values)), float(np.max(values))), low=low, high=high)
    if alike.play > 0.0:
        alike = alike._replace(low=-0.5 * alike.play, high=0.5 * alike.play)
    coarse, fine = FINENESS
    if alike.play > 0.0 or alike.argument == "time":
        coarse, fine = (PLAY_KNOTS, PLAY_KNOTS) if alike.play > 0.0 else (TIME_KNOTS, FINENESS[0])
    coarse, fine = (supported(values, alike.low, alike.high, n) for n in (coarse, fine))
    shares = {n: explained_by(_columns(asked, alike, values, n), target, even) for n in dict.fromkeys((coarse, fine))}
    knots = fine if shares[fine] > shares[coarse] + FINER_GAIN else coarse
    out = [alike._replace(share=shares[knots], knots=knots)]
    if not alike.simple:
        return out
    along = target * asked.direction if turned and asked.direction is not None else target
    seen = along
    if alike.effect == FRICTION:
        # Friction keeps the level of one place until it has slid on: the remainder itself is not concentrated there.
        means = np.linspace(low, high, 2 * CELLS)
        seen = np.interp(means, np.linspace(low, high, fine), _values(asked, alike, target, fine)[0])
    part = concentrated(means, seen, low, high)
    if part is not None and alike.argument != "time":
        narrow = alike._replace(low=part[0], high=part[1], knots=supported(values, *part, fine))
        share = explained_by(_columns(asked, narrow, values, narrow.knots), target, even)
        out.append(narrow._replace(share=max(share, rules.DEPENDS)))
    if alike.argument == "position" and asked.waves is not None:
        number, share = asked.waves.strongest(along)
        repeating = alike._replace(low=0.0, high=float(np.ptp(values)) / number, periodic=True, knots=fine)
        if alike.effect == FRICTION:
            share = explained_by(_columns(asked, repeating, values, fine), target, even)
        out.append(repeating._replace(share=share))
    elif alike.argument == "time":
        size = float(np.sqrt(np.mean(along**2))) or 1.0
        for frequency in spectral_lines(along / size, evidence.times[channel], 1):
            share = explained_by(_comparable(asked, _repeating(asked.respond, frequency * values)), along, even)
            out.append(alike._replace(share=share, low=0.0, high=1.0 / frequency, periodic=True, knots=FINENESS[0]))
    return out


def supported(values: Array, low: float, high: float, knots: int) -> int:
    """Return the most values, up to a number, of which a table over a range has data within half a step of each.

    A value between two groups of data far apart would follow from nothing.
    """
    for number in range(knots, 2, -1):
        step = (high - low) / (number - 1)
        nearest = np.rint((values[(values >= low - 0.5 * step) & (values <= high + 0.5 * step)] - low) / step)
        if len(np.unique(nearest)) == number:
            return number
    return 2


def concentrated(means: Array, target: Array, low: float, high: float) -> tuple[float, float] | None:
    """Return the part of a signal's range in which a remainder is concentrated; None if that is not much smaller."""
    cell = np.clip(((means - low) / (high - low) * CELLS).astype(np.intp), 0, CELLS - 1)
    count = np.bincount(cell, minlength=CELLS)
    level = np.bincount(cell, target, CELLS) / np.maximum(count, 1)
    level = np.abs(np.where(count > 0, level - np.median(level[count > 0]), 0.0))
    strong = np.flatnonzero(level > 0.5 * np.max(level))
    first, last = int(strong[0]), int(strong[-1]) + 1
    around = last - first
    first, last = max(first - around - 1, 0), min(last + around + 1, CELLS)
    if last - first > CELLS // 2:
        return None
    step = (high - low) / CELLS
    return low + first * step, low + last * step


def _covered(means: Array, block: NDArray[np.intp]) -> tuple[float, float]:
    """Return the range of a signal that so many blocks reach that the rest tells its ends when one is left out."""
    members = [means[block == b] for b in np.unique(block)]
    lows, highs = (np.sort([end(part) for part in members]) for end in (np.min, np.max))
    reached = min(REACHED, len(members))
    return float(lows[reached - 1]), float(highs[-reached])


def waves_along(respond: Respond, values: Array, even: Mask) -> Waves:
    """Return the waves that are looked for along a signal's range.

    Args:
        respond: returns a channel's windows for a term's value at each sample.
        values: the signal, one value a sample.
        even: the windows in even blocks, shape (windows,).
    """
    along, numbers = (values - np.min(values)) / np.ptp(values), np.arange(*WAVES, WAVE_STEP)
    columns = np.stack([_repeating(respond, number * along).T for number in numbers])
    normals = np.stack([(columns * half) @ columns.transpose(0, 2, 1) for half in (even, ~even)])
    return Waves(numbers, columns, even, normals)


def _repeating(respond: Respond, cycles: Array) -> Array:
    """Return a wave, its harmonics and a constant in the windows, shape (windows, columns).

    Args:
        respond: returns a channel's windows for a term's value at each sample.
        cycles: number of periods up to each sample.
    """
    angles = [2.0 * math.pi * harmonic * cycles for harmonic in range(1, HARMONICS + 1)]
    columns = [respond(wave(angle)) for angle in angles for wave in (np.sin, np.cos)]
    return np.stack((*columns, np.ones(len(columns[0]))), axis=1)


def lag_of(values: Array, time_constant: float, period: float) -> Array:
    """Return a first-order lag of a signal, from zero, shape (n,).

    Args:
        values: the signal, shape (n,).
        time_constant: of the lag [s].
        period: of the samples [s].
    """
    kept = math.exp(-period / time_constant)
    states = accumulate(values.tolist(), lambda state, value: kept * state + (1.0 - kept) * value, initial=0.0)
    return np.array(list(states)[:-1])
