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
from ehls_ros.diagnosis.evidence import Evidence, allowing
from ehls_ros.diagnosis.measurement import measurement
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.stages import Channel

DIRECTION, ACCELERATION, PRESSURE_RATE = "direction", "acceleration_m_s2", "load_pressure_rate_pa_s"

SIGNALS: Mapping[Channel, tuple[str, ...]] = {
    "spool": (COMMAND, PRESSURE, TEMPERATURE),
    "volume": (SPOOL, PRESSURE, POSITION, SUPPLY, TEMPERATURE),
    "supply": (SPOOL, PRESSURE, TEMPERATURE),
    "force": (VELOCITY, DIRECTION, POSITION, ACCELERATION, LOAD, TEMPERATURE),
    "cell": (PRESSURE, PRESSURE_RATE, VELOCITY, POSITION, TEMPERATURE),
    "velocity": (VELOCITY, PRESSURE, POSITION, TEMPERATURE),
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


class OfChannel(NamedTuple):
    """What a healthy rig leaves in one channel.

    Attributes:
        learnt: what was learnt.
        size: largest term of the channel's balance, in whose units it was learnt.
        terms: names of the coefficients whose errors count; the first is :data:`OFFSET`, and :data:`SCALE` is not fitted.
        signals: names of the signals it depends on.
        unit: size of the channel's input, in whose units it was learnt.
    """

    learnt: Learnt
    size: float
    terms: tuple[str, ...]
    signals: tuple[str, ...]
    unit: float

    def columns(self, found: Sequence[Term], windows: int) -> Array:
        """Return what errors of the coefficients add, a column each, zero where one changes nothing, shape (windows, terms)."""
        return _columns(found, self.terms, self.size, windows)

    def unseen(self, signals: Array) -> Array:
        """Return how far the remainder may have grown where no baseline has been, standard deviation, shape (windows,).

        Nothing tells how it goes on there: it is taken to grow as the cube of the distance. The oil's temperature does not
        count, as it moves from day to day.
        """
        known = [i for i, name in enumerate(self.signals) if name != TEMPERATURE]
        low, high = np.quantile(self.learnt.windows.signals[:, known], (rules.SEEN, 1.0 - rules.SEEN), axis=0)
        middle, half = 0.5 * (low + high), 0.5 * (1.0 + rules.MARGIN) * (high - low)
        away = np.abs(signals[:, known] - middle) / np.maximum(half, 1e-300)
        beyond = np.max(np.clip(away, 1.0, rules.FARTHEST_UNSEEN), axis=1, initial=1.0)
        grown: Array = np.sqrt(self.learnt.power[0]) * (beyond**3 - 1.0)
        return grown


class Natural(NamedTuple):
    """What a healthy rig leaves in each channel."""

    channels: Mapping[Channel, OfChannel]

    def expected(self, evidence: Evidence) -> dict[Channel, Expected]:
        """Return what a healthy rig would leave in each channel that a baseline has too, in units of its size."""
        found, signals, out = terms(evidence), signals_of(evidence), dict[Channel, Expected]()
        for c in evidence.channels:
            if c in self.channels:
                own, count = self.channels[c], len(evidence.floor[c])
                table = _table(signals[c], own.signals, count)
                factor = _table(signals[c], (FACTORS[c],), count)[:, 0] / own.unit
                healthy = own.learnt.expected(own.columns(found[c], count), table, factor)
                out[c] = healthy._replace(variance=healthy.variance + own.unseen(table) ** 2)
        return out

    def judged(self, evidence: Evidence) -> Evidence:
        """Return the evidence with the rig's own remainder expected and its natural spread allowed for.

        Channels that no baseline has are left out.
        """
        return self.judged_by(evidence, self.expected(evidence))

    def judged_by(self, evidence: Evidence, expected: Mapping[Channel, Expected]) -> Evidence:
        """Return the same with the expectation given."""
        allowances, measured = {}, measurement(evidence)
        for c, healthy in expected.items():
            size = self.channels[c].size
            natural = Allowance(
                mean=healthy.mean * size,
                directions=healthy.directions * size,
                variance=healthy.variance * size**2,
                alike=self.channels[c].learnt.together,
            )
            allowances[c] = together([natural, measured[c]])
        return replace(allowing(evidence, allowances, self.judged), against_baselines=True)


def learn_natural(baselines: Sequence[Evidence]) -> Natural:
    """Learn what a healthy rig leaves, from its recordings compared with one and the same model."""
    columns, signals = [terms(e) for e in baselines], [signals_of(e) for e in baselines]
    out = dict[Channel, OfChannel]()
    for c in dict.fromkeys(c for e in baselines for c in e.channels):
        have = [i for i, e in enumerate(baselines) if c in e.channels]
        size = max(1e-300, *(baselines[i].sizes[c] for i in have))
        spreads = {OFFSET: rules.SPREAD_OF_OFFSET} | {term.name: term.spread for i in have for term in columns[i][c]}
        spreads |= dict.fromkeys({SCALE} & set(spreads), 0.0)
        # A signal that one of them lacks cannot be learnt from.
        told = tuple(name for name in SIGNALS[c] if all(name in signals[i][c] for i in have))
        factors = {i: _table(signals[i][c], (FACTORS[c],), len(baselines[i].floor[c]))[:, 0] for i in have}
        unit = float(np.sqrt(np.mean(np.concatenate(list(factors.values())) ** 2))) or 1.0
        windows = [
            Windows(
                residual=e.base.values[c] * e.floor[c] / size,
                noise=e.floor[c] / size,
                terms=_columns(columns[i][c], tuple(spreads), size, len(e.floor[c])),
                signals=_table(signals[i][c], told, len(e.floor[c])),
                factor=factors[i] / unit,
                block=e.block[c],
            )
            for i, e in enumerate(baselines)
            if i in have
        ]
        learnt = learn(windows, np.array(list(spreads.values())), np.array([name != SCALE for name in spreads]))
        out[c] = OfChannel(learnt, size, tuple(spreads), told, unit)
    return Natural(out)


def signals_of(evidence: Evidence) -> dict[Channel, dict[str, Array]]:
    """Return the signals each channel's remainder may depend on, their means over its usable windows."""
    along = signals_along(evidence.comparison(), evidence.rig)
    if VELOCITY in along:
        slow = max(float(getattr(evidence.rig.friction, "stribeck_velocity", 0.0)), 1e-6)
        along[DIRECTION] = np.tanh(along[VELOCITY] / slow)
    # A load that a sensor gives answers to the friction: where the pressure is held it would tell the residual.
    told = [name for name in along if name not in evidence.record.measured]
    return {c: {name: evidence.means(c, along[name]) for name in SIGNALS[c] if name in told} for c in evidence.channels}


def _table(signals: Mapping[str, Array], names: Sequence[str], windows: int) -> Array:
    """Return the signals of some names side by side; one that is missing is taken to be zero."""
    return np.column_stack([np.empty((windows, 0)), *(signals.get(name, np.zeros(windows)) for name in names)])


def _columns(found: Sequence[Term], names: Sequence[str], size: float, windows: int) -> Array:
    by_name = {OFFSET: np.ones(windows)} | {term.name: term.column / size for term in found}
    return np.column_stack([by_name.get(name, np.zeros(windows)) for name in names])
