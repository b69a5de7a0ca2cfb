"""A term found in the data: where no named cause explains a stage, a table over one of the stage's own signals does.

Each place where a term can act has an effect with a table (``ehls_ros/physics/effects/empirical_*.py``). Those whose argument
predicts the remainder on held-out blocks are fitted beside the named causes, as any other hypothesis; the best is offered if
it closes a worthwhile part of the remainder on held-out data. Its table is a parameter of the effect, so that simulator,
controllers and reports use it like any effect.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import explains, most_explained, share_closed
from ehls_ros.diagnosis.dependence import explained_by, explained_fraction, signals_along
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.held_out import Assessment
from ehls_ros.diagnosis.hypotheses import Candidate, parts
from ehls_ros.diagnosis.loss import power
from ehls_ros.diagnosis.partial import PartialAnswer
from ehls_ros.diagnosis.pool import Pool
from ehls_ros.diagnosis.reading import read
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.result import Term, argument_unit
from ehls_ros.diagnosis.search import Searched, fitted, given_model, inflations
from ehls_ros.diagnosis.stages import CHANNELS, Channel, Stage
from ehls_ros.diagnosis.starts import combined, spectral_lines
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects._table import KNOTS, VALUES, WEIGHTS
from ehls_ros.samples import Mask
from ehls_ros.schema import declarations

PLACES: Mapping[Channel, Mapping[str, tuple[str, ...]]] = {
    "force": {
        "empirical_force": ("position", "velocity", "pressure", "load", "time"),
        "empirical_friction": ("position", "speed", "pressure", "time", "temperature"),
    },
    "volume": {
        "empirical_opening": ("spool", "position", "pressure", "time"),
        "empirical_leakage": ("pressure", "speed", "position", "time"),
    },
    "spool": {"empirical_spool": ("spool", "time")},
}
"""Arguments of a term in each channel, by the effect that has the table."""

SIGNAL_OF = {
    "position": POSITION, "velocity": VELOCITY, "speed": VELOCITY, "pressure": PRESSURE, "spool": SPOOL, "load": LOAD,
    "time": "time_s", "temperature": TEMPERATURE,
}  # fmt: skip
"""Signal that a weight multiplies, by the names of the data contract."""

REACHED = 3
"""Number of blocks that reach both ends of a table."""

FINENESS, TIME_KNOTS = (8, KNOTS), 6
"""Numbers of knots that are tried; over time there are few, as held-out blocks are gaps that a table must bridge."""

TURNING = 0.1
"""Speed within which a force turns round with the motion, over the rms speed."""

CELLS = 48
"""Parts of a signal's range in which the remainder may be concentrated."""

PERIOD_RANGE = 0.05
"""Largest relative change of a period from that found first."""

TAIL = 0.99
"""Quantile of a remainder at which it is clipped while arguments are chosen."""

FITTED_TERMS = 4
"""Terms that are fitted, of those whose argument predicts the remainder."""

WAVES, WAVE_STEP, HARMONICS = (2.5, 150.0), 0.25, 2
"""Least and largest number of periods along the stroke that are looked for, their spacing, and harmonics of each."""

DEARER = 4.0
"""Factor by which less of the error must remain with a term than with named causes for it to be offered in their place."""


class Waves(NamedTuple):
    """Waves along a signal's range.

    Attributes:
        numbers: of periods along it, shape (waves,).
        columns: each wave, its harmonics and a constant, as means over the windows, shape (waves, windows, columns).
    """

    numbers: Array
    columns: Array

    def strongest(self, target: Array, even: Mask) -> tuple[float, float]:
        """Return the number of periods that predicts a remainder best, and the fraction it explains.

        Args:
            target: the remainder, shape (windows,).
            even: the windows in even blocks; each half is predicted from the other.
        """
        shares = [explained_by(columns, target, even) for columns in self.columns]
        best = int(np.argmax(shares))
        return float(self.numbers[best]), shares[best]


class Described(NamedTuple):
    """The named causes with a term beside them.

    Attributes:
        best: the hypothesis; the term comes last.
        without: the named causes alone.
        term: the term.
    """

    best: Assessment
    without: Assessment
    term: Term


def described(pool: Pool, found: Searched, stage: Stage) -> Described | None:
    """Return the term that describes what the named causes leave in a stage; None if none closes a worthwhile part.

    Named causes may only imitate the term: it is also sought without each of them, and without all.

    Args:
        pool: the threads.
        found: result of the search for named causes.
        stage: the stage with the unexplained remainder.
    """
    evidence = pool.evidence
    nothing = given_model(evidence)
    bases = {frozenset(j.names): j for j in (nothing, *(place.without for place in found.places), found.best)}
    signals = signals_along(evidence.comparison(), evidence.rig)
    inside = [channel for channel in evidence.channels if CHANNELS[channel] == stage and channel in PLACES]
    along = {channel: _waves_of(evidence, channel, signals) for channel in inside}
    pairs = list[tuple[Assessment, Assessment]]()
    for base in bases.values():
        proposed = [
            candidate
            for channel in inside
            for proposal in proposals(evidence, channel, base.held_out.residuals.values[channel], signals, along[channel])
            for candidate in candidates_of(proposal)
        ]
        alone = [fit for fit in pool.map(_linearised, proposed) if fit.channels and np.any(fit.jacobian)]
        pairs += [(base, more) for more in fitted(evidence, pool, [combined(evidence, base.fit, other) for other in alone])]
    if not pairs:
        return None
    scale = inflations(evidence, [more for _, more in pairs])
    best = max(more.score(scale) for _, more in pairs)
    # Of equally good ones, that with the fewest causes.
    enough = best - max(rules.EQUAL, rules.EQUAL_FRACTION * (best - nothing.score(scale)))
    base, more = min(
        ((base, more) for base, more in pairs if more.score(scale) >= enough),
        key=lambda pair: (len(pair[1].names), -pair[1].score(scale)),
    )
    if not explains(evidence, more, base, scale) or share_closed(evidence, more, base) < rules.WORTHWHILE:
        return None
    return Described(more, base, _term(evidence, more, base))


class Proposal(NamedTuple):
    """A table that predicts a remainder.

    Attributes:
        share: fraction of the remainder's held-out variance that its argument predicts.
        effect: the effect that has it.
        weight: name of the weight of its only signal.
        low, high: the signal at the first and at the last knot; of a periodic table, a period apart.
        reach: range of the signal in the data.
        periodic: whether it repeats.
        direction: speed within which its sign follows the direction of motion [m/s]; 0: it does not.
    """

    share: float
    effect: str
    weight: str
    low: float
    high: float
    reach: tuple[float, float] = (0.0, 0.0)
    periodic: bool = False
    direction: float = 0.0


def _waves_of(evidence: Evidence, channel: Channel, signals: Mapping[str, Array]) -> Waves | None:
    """Return the waves along the stroke in a channel's windows; None if no table there depends on the position, or it rests."""
    asked = any("position" in weights for weights in PLACES[channel].values())
    if not asked or POSITION not in signals or np.ptp(signals[POSITION]) == 0.0:
        return None
    return waves_along(partial(evidence.means, channel), signals[POSITION])


def proposals(
    evidence: Evidence, channel: Channel, e: Array, signals: Mapping[str, Array], waves: Waves | None
) -> list[Proposal]:
    """Return the tables of a channel whose arguments predict its remainder best.

    Args:
        evidence: the recording compared with the given model.
        channel: the channel.
        e: its whitened remainder, shape (n,).
        signals: signals on which it may depend, one value a sample.
        waves: waves along the stroke; None: a table is not sought to repeat along it.
    """
    limit = float(np.quantile(np.abs(e), TAIL))
    clipped, found = np.clip(e, -limit, limit), list[Proposal]()
    speed = float(np.sqrt(np.mean(signals[VELOCITY] ** 2))) if VELOCITY in signals else 0.0
    direction = np.tanh(evidence.means(channel, signals[VELOCITY]) / (TURNING * speed)) if speed > 0.0 else None
    turned = None if direction is None else clipped * direction
    for effect, weights in PLACES[channel].items():
        for weight in weights:
            if _signal(effect, weight) not in signals:
                continue
            values = signals[_signal(effect, weight)]
            values = np.abs(values) if weight == "speed" else values
            # Friction opposes the motion.
            variants = [(0.0, turned if effect == "empirical_friction" else clipped)]
            if effect == "empirical_force" and weight not in ("velocity", "speed"):
                variants.append((TURNING * speed, turned))
            for turning, target in variants:
                if target is not None:
                    alike = Proposal(0.0, effect, weight, 0.0, 0.0, direction=turning)
                    found += _along(evidence, channel, alike, values, target, waves if weight == "position" else None)
    likely = sorted((item for item in found if item.share >= rules.DEPENDS), key=lambda item: -item.share)
    return likely[:FITTED_TERMS]


def _along(
    evidence: Evidence, channel: Channel, alike: Proposal, values: Array, target: Array, waves: Waves | None
) -> list[Proposal]:
    """Return tables over a signal: over its range, over a part in which the remainder is concentrated, and a periodic one.

    Args:
        evidence: the recording compared with the given model.
        channel: the channel.
        alike: effect, weight and direction.
        values: the signal, one value a sample.
        target: the remainder to predict, shape (windows,).
        waves: waves along the signal; None: a table is not sought to repeat along it.
    """
    means, block = evidence.means(channel, values), evidence.block[channel]
    even = block % 2 == 0
    low, high = _covered(means, block)
    if not high > low:
        return []
    share = explained_fraction(means, target, even)
    alike = alike._replace(reach=(float(np.min(values)), float(np.max(values))))
    out = [alike._replace(share=share, low=low, high=high)]
    part = concentrated(means, target, low, high)
    if part is not None and alike.weight != "time":
        out.append(alike._replace(share=max(share, rules.DEPENDS), low=part[0], high=part[1]))
    if waves is not None:
        number, share = waves.strongest(target, even)
        out.append(alike._replace(share=share, low=0.0, high=float(np.ptp(values)) / number, periodic=True))
    elif alike.weight == "time":
        size = float(np.sqrt(np.mean(target**2))) or 1.0
        for frequency in spectral_lines(target / size, evidence.times[channel], 1):
            share = explained_by(_repeating(partial(evidence.means, channel), frequency * values), target, even)
            out.append(alike._replace(share=share, low=0.0, high=1.0 / frequency, periodic=True))
    return out


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


def _signal(effect: str, weight: str) -> str:
    """Return the signal that a weight multiplies; the spool's input is the command."""
    return COMMAND if (effect, weight) == ("empirical_spool", "spool") else SIGNAL_OF[weight]


def _covered(means: Array, block: NDArray[np.intp]) -> tuple[float, float]:
    """Return the range of a signal that so many blocks reach that the rest tells its ends when one is left out."""
    members = [means[block == b] for b in np.unique(block)]
    lows, highs = (np.sort([end(part) for part in members]) for end in (np.min, np.max))
    reached = min(REACHED, len(members))
    return float(lows[reached - 1]), float(highs[-reached])


def candidates_of(proposal: Proposal) -> list[Candidate]:
    """Return the hypotheses of a proposed table, with few and with many knots."""
    declared = {d.name: d for d in declarations(EFFECTS.load(proposal.effect).Parameters)}
    per, size = f"per_{proposal.weight}", 1.0 / (proposal.high - proposal.low)
    place = list(WEIGHTS).index(proposal.weight) + len(WEIGHTS) * proposal.periodic
    out = []
    for knots in FINENESS if proposal.periodic or proposal.weight != "time" else (TIME_KNOTS,):
        free = (per, *VALUES[:knots]) if proposal.periodic else VALUES[:knots]
        fixed = {"periodic": 1.0} if proposal.periodic else {per: size, "offset": -proposal.low * size}
        fixed |= {"direction": proposal.direction} if proposal.direction else {}
        if not proposal.periodic:
            lowest, highest = ((end - proposal.low) * size for end in proposal.reach)
            fixed |= {"lowest": float(np.clip(lowest, -10.0, 0.0)), "highest": float(np.clip(highest, 1.0, 11.0))}
        fixed |= {"knots": float(knots)} if knots < KNOTS else {}
        lower = np.array([declared[name].minimum for name in free], dtype=np.float64)
        upper = np.array([declared[name].maximum for name in free], dtype=np.float64)
        start = np.array([size if name == per else 0.0 for name in free])
        if proposal.periodic:
            # Another period would be another hypothesis.
            lower[0], upper[0] = (1.0 - PERIOD_RANGE) * size, (1.0 + PERIOD_RANGE) * size
        units = tuple(declared[name].unit for name in free)
        rows = start[np.newaxis]
        out.append(Candidate(proposal.effect, place, free, tuple(fixed.items()), rows, lower, upper, units, neutral=start))
    return out


def waves_along(means: Callable[[Array], Array], values: Array) -> Waves:
    """Return the waves that are looked for along a signal's range.

    Args:
        means: returns the mean of a signal over each window.
        values: the signal, one value a sample.
    """
    along, numbers = (values - np.min(values)) / np.ptp(values), np.arange(*WAVES, WAVE_STEP)
    return Waves(numbers, np.stack([_repeating(means, number * along) for number in numbers]))


def _repeating(means: Callable[[Array], Array], cycles: Array) -> Array:
    """Return a wave, its harmonics and a constant, as means over the windows, shape (windows, columns).

    Args:
        means: returns the mean of a signal over each window.
        cycles: number of periods up to each sample.
    """
    angles = [2.0 * math.pi * harmonic * cycles for harmonic in range(1, HARMONICS + 1)]
    columns = [means(wave(angle)) for angle in angles for wave in (np.sin, np.cos)]
    return np.stack((*columns, np.ones(len(columns[0]))), axis=1)


def _linearised(worker: Worker, candidate: Candidate) -> Fit:
    return worker.linearise((candidate,), candidate.starts[0])


def _term(evidence: Evidence, more: Assessment, less: Assessment) -> Term:
    """Return the result of a fitted term, the last cause of a hypothesis."""
    candidate, part = more.hypothesis[-1], parts(more.hypothesis)[-1]
    used = candidate.use(more.fit.values[part]).parameters._asdict()
    covariance = more.held_out.covariance[part, part]
    periodic = used["periodic"] > 0.0
    weight = next(name for name in WEIGHTS if used[f"per_{name}"] != 0.0)
    size = used[f"per_{weight}"]
    knots = round(used["knots"])
    places = np.arange(knots) / (knots if periodic else knots - 1)
    table = slice(len(candidate.free) - knots, None)
    argument = _signal(candidate.name, weight)
    error = math.sqrt(max(covariance[0, 0], 0.0)) / size**2
    period = Estimate(1.0 / size, error, argument_unit(argument)) if periodic else None
    values, std = more.fit.values[part][table], np.sqrt(np.maximum(np.diag(covariance)[table], 0.0))
    at = (places - used["offset"]) / size
    return Term(
        effect=candidate.name,
        argument=argument,
        magnitude=weight == "speed",
        unit=candidate.units[-1],
        at=at,
        values=values,
        std=std,
        period=period,
        closed=min(share_closed(evidence, more, less), 1.0),
        direction=used["direction"],
        reading=read(at, values, covariance[table, table], periodic=periodic),
    )


def leaves_less(evidence: Evidence, term: Described, answer: PartialAnswer) -> bool:
    """Return whether a term leaves so much less of the error than a partial answer's causes that it is offered instead."""
    channel = most_explained(term.without.held_out.residuals, term.best.held_out.residuals)
    noise = power(evidence.noise[channel])
    with_term = power(term.best.held_out.residuals.values[channel])
    e = answer.found.best.held_out.residuals.values[channel] * answer.evidence.floor[channel] / evidence.floor[channel]
    return DEARER * (with_term - noise) <= power(e) - noise
