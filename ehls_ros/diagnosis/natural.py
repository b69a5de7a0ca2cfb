"""What a healthy rig leaves and how far it varies without fault, learnt on baselines; evidence judged against that."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.allowance import Allowance, together
from ehls_ros.diagnosis.coefficients import Term, terms
from ehls_ros.diagnosis.dependence import signals_along
from ehls_ros.diagnosis.discrepancy import Expected, Learnt, Windows, learn
from ehls_ros.diagnosis.evidence import Evidence, allowing, part_of
from ehls_ros.diagnosis.measurement import measurement
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.stages import Channel

DIRECTION, ACCELERATION, PRESSURE_RATE = "direction", "acceleration_m_s2", "load_pressure_rate_pa_s"
SPOOL_RATE = "spool_rate_m_s"

SIGNALS: Mapping[Channel, tuple[str, ...]] = {
    "spool": (COMMAND, SPOOL_RATE, PRESSURE),
    "volume": (SPOOL, PRESSURE, PRESSURE_RATE, POSITION, SUPPLY),
    "supply": (SPOOL, PRESSURE),
    "force": (VELOCITY, DIRECTION, POSITION, ACCELERATION, LOAD),
    "cell": (PRESSURE, PRESSURE_RATE, VELOCITY, POSITION),
    "velocity": (VELOCITY, PRESSURE, POSITION),
}
"""Signals the rig's own remainder may depend on, by channel; those that were not recorded are left out.

One term of each balance is missing. All of them together would tell the residual itself, whatever is wrong. Of two sensors of
one quantity, each may also see another signal.
"""

FACTORS: Mapping[Channel, str] = {
    "spool": COMMAND, "volume": SPOOL, "supply": SPOOL, "force": DIRECTION, "cell": PRESSURE, "velocity": VELOCITY,
}  # fmt: skip
"""The input of each channel's balance, which errors of its gain are proportional to, as of friction to the direction."""

OFFSET = "offset"
"""Name of a channel's constant error, which is a sensor's and no coefficient's."""

SCALE = "piston_area"
"""The coefficient in whose units the balances are weighed; it is not fitted, as all of them at zero close the balances, too.

No fault changes it. But at a pressure where no baseline has been, its error shows.
"""

Signals = Mapping[str, Array]
"""Mean of each signal over a channel's usable windows, by name, shape (windows,)."""


class Described(NamedTuple):
    """Evidence with what its remainder may be made of.

    Attributes:
        evidence: a recording compared with the model.
        errors: what errors of the coefficients add, by channel.
        signals: signals the remainder may depend on, by channel.
    """

    evidence: Evidence
    errors: Mapping[Channel, Sequence[Term]]
    signals: Mapping[Channel, Signals]


def describe(evidence: Evidence) -> Described:
    """Return evidence with what its remainder may be made of."""
    return Described(evidence, terms(evidence), signals_of(evidence))


class Terms(NamedTuple):
    """What the remainder of one channel is described by, on baselines and on a new recording alike.

    Attributes:
        size: largest term of the channel's balance, in whose units all of it is.
        spreads: spread of each coefficient whose error counts, relative, by name; the first is :data:`OFFSET`.
        signals: names of the signals the remainder depends on.
        factor: name of the channel's input.
        unit: size of that, in whose units it is taken.
        temperature: mean of the oil's [K]; None if a baseline does not tell it.
    """

    size: float
    spreads: Mapping[str, float]
    signals: tuple[str, ...]
    factor: str
    unit: float
    temperature: float | None

    def windows(self, recording: Described, channel: Channel) -> Windows:
        """Return a channel's windows of one recording.

        A change of the oil's temperature changes the coefficients in proportion to it, the more the more they spread anyway.
        """
        evidence, signals = recording.evidence, recording.signals[channel]
        count = len(evidence.floor[channel])
        by_name = {OFFSET: np.ones(count)} | {term.name: term.column / self.size for term in recording.errors[channel]}
        # The piston's area is in its drawing.
        by_name[SCALE] = by_name.get(SCALE, np.zeros(count)) * rules.AREA_ERROR / rules.LEFT_ERROR
        columns = np.column_stack([by_name.get(name, np.zeros(count)) for name in self.spreads])
        if self.temperature is not None:
            warmer = (signals.get(TEMPERATURE, np.full(count, self.temperature)) - self.temperature) / rules.WARMER
            follow = np.array(list(self.spreads.values())) / rules.SPREAD_WITH_OIL
            columns = np.hstack([columns, columns * follow * warmer[:, None]])
        return Windows(
            residual=evidence.base.values[channel] * evidence.floor[channel] / self.size,
            noise=evidence.floor[channel] / self.size,
            terms=columns,
            # A signal that is missing is taken to be zero.
            signals=np.column_stack([np.empty((count, 0)), *(signals.get(name, np.zeros(count)) for name in self.signals)]),
            factor=signals.get(self.factor, np.zeros(count)) / self.unit,
            block=evidence.block[channel],
        )

    def learnt_on(self, recordings: Sequence[Windows]) -> Learnt:
        """Learn the remainder."""
        spread = np.array(list(self.spreads.values()))
        fitted = np.array([name != SCALE for name in self.spreads])
        if self.temperature is not None:
            # From recording to recording the oil's temperature varies, not what follows from it.
            spread, fitted = np.concatenate([spread, np.zeros_like(spread)]), np.tile(fitted, 2)
        return learn(recordings, spread, fitted)


class OfChannel(NamedTuple):
    """What a healthy rig leaves in one channel.

    Attributes:
        terms: what it is described by.
        learnt: what was learnt.
    """

    terms: Terms
    learnt: Learnt

    def expected(self, new: Windows) -> Expected:
        """Return what a healthy rig would leave in windows of another recording.

        Nothing tells how errors of form go on where no baseline has been: they are taken to grow with the distance, and far
        away nothing is expected.
        """
        low, high = np.quantile(self.learnt.windows.signals, (rules.SEEN, 1.0 - rules.SEEN), axis=0)
        middle, half = 0.5 * (low + high), 0.5 * (1.0 + rules.MARGIN) * (high - low)
        away = np.max(np.abs(new.signals - middle) / np.maximum(half, 1e-300), axis=1, initial=1.0)
        growth = np.minimum(away, rules.FARTHEST_UNSEEN)
        found = self.learnt.expected(new.terms, new.signals, new.factor, growth)
        return found._replace(variance=np.where(away > rules.FARTHEST_UNSEEN, np.inf, found.variance))


class Natural(NamedTuple):
    """What a healthy rig leaves.

    Attributes:
        channels: what it leaves in each channel.
        healthy: the baselines, judged by it.
    """

    channels: Mapping[Channel, OfChannel]
    healthy: tuple[Evidence, ...] = ()

    def expected(self, recording: Described) -> dict[Channel, Expected]:
        """Return what a healthy rig would leave in each channel that a baseline has too, in units of its size."""
        channels = [c for c in recording.evidence.channels if c in self.channels]
        return {c: self.channels[c].expected(self.channels[c].terms.windows(recording, c)) for c in channels}

    def judged(self, evidence: Evidence) -> Evidence:
        """Return the evidence with the rig's own remainder expected and its natural spread allowed for.

        Channels that no baseline has are left out.
        """
        return self.judged_by(evidence, self.expected(describe(evidence)))

    def judged_by(self, evidence: Evidence, expected: Mapping[Channel, Expected]) -> Evidence:
        """Return the same with the expectation given."""
        near = {c: np.isfinite(healthy.variance) for c, healthy in expected.items()}
        allowances, evidence = {}, part_of(evidence, near)
        measured = measurement(evidence)
        for c in evidence.channels:
            size, healthy = self.channels[c].terms.size, expected[c]
            natural = Allowance(
                mean=healthy.mean[near[c]] * size,
                directions=healthy.directions[near[c]] * size,
                variance=healthy.variance[near[c]] * size**2,
                alike=self.channels[c].learnt.together,
            )
            allowances[c] = together([natural, measured[c]])
        return replace(allowing(evidence, allowances, self.judged), baselines=self.healthy)


def learn_natural(baselines: Sequence[Described]) -> Natural:
    """Learn what a healthy rig leaves, from its recordings compared with one and the same model."""
    out = dict[Channel, OfChannel]()
    for c in dict.fromkeys(c for b in baselines for c in b.evidence.channels):
        having = [b for b in baselines if c in b.evidence.channels]
        told = set.intersection(*(set(b.signals[c]) for b in having))
        values = {name: np.concatenate([b.signals[c][name] for b in having]) for name in told}
        spreads = {OFFSET: rules.SPREAD_OF_OFFSET} | {term.name: term.spread for b in having for term in b.errors[c]}
        made_of = Terms(
            size=max(1e-300, *(b.evidence.sizes[c] for b in having)),
            spreads=spreads | dict.fromkeys({SCALE} & set(spreads), 0.0),
            # A signal that one of them lacks cannot be learnt from.
            signals=tuple(name for name in SIGNALS[c] if name in told),
            factor=FACTORS[c],
            unit=float(np.sqrt(np.mean(values.get(FACTORS[c], np.zeros(1)) ** 2))) or 1.0,
            temperature=float(np.mean(values[TEMPERATURE])) if TEMPERATURE in told else None,
        )
        out[c] = OfChannel(made_of, made_of.learnt_on([made_of.windows(b, c) for b in having]))
    natural = Natural(out)
    return natural._replace(healthy=tuple(natural.judged_by(b.evidence, natural.expected(b)) for b in baselines))


def signals_of(evidence: Evidence) -> dict[Channel, dict[str, Array]]:
    """Return the signals each channel's remainder may depend on, and the oil's temperature, over its usable windows."""
    comparison = evidence.comparison()
    along = signals_along(comparison, evidence.rig)
    if VELOCITY in along:
        slow = max(float(getattr(evidence.rig.friction, "stribeck_velocity", 0.0)), 1e-6)
        along[DIRECTION] = np.tanh(along[VELOCITY] / slow)
    if "spool" in evidence.channels:
        along[SPOOL_RATE] = np.gradient(comparison.simulated_spool(evidence.rig.effective()), evidence.record.period)
    # A load that a sensor gives answers to the friction: where the pressure is held it would tell the residual.
    told = [name for name in along if name not in evidence.record.measured]
    return {
        c: {name: evidence.means(c, along[name]) for name in (*SIGNALS[c], TEMPERATURE) if name in told}
        for c in evidence.channels
    }
