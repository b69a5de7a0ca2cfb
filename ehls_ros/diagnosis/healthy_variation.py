"""Remainder of a healthy rig and its fault-free variation, learnt from baselines; judgement of evidence against them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.allowance import Allowance, together
from ehls_ros.diagnosis.coefficients import NO_ERRORS, SCALE, RelativeErrors, Term, terms
from ehls_ros.diagnosis.dependence import kept_by_play, signals_along
from ehls_ros.diagnosis.discrepancy import Expected, Learnt, Windows, learn
from ehls_ros.diagnosis.evidence import Evidence, Standard, allowing, part_of
from ehls_ros.diagnosis.fit import Worker
from ehls_ros.diagnosis.hypotheses import Hypothesis, extended
from ehls_ros.diagnosis.loss import loss, power, rms
from ehls_ros.diagnosis.measurement import measurement
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.diagnosis.windows import OVERLAP
from ehls_ros.samples import Mask
from ehls_ros.trajectory import PRESSURE_A, PRESSURE_B

DIRECTION, ACCELERATION, PRESSURE_RATE = "direction", "acceleration_m_s2", "load_pressure_rate_pa_s"
SPOOL_RATE = "spool_rate_m_s"

CELL_PLAYS: Mapping[str, float] = {f"load_pressure_in_play_{i}": width for i, width in enumerate((0.01, 0.03, 0.1))}
"""Widths of plays, as fractions of the supply pressure, by the signal that each keeps of the load pressure: the direction in
which a load cell with hysteresis was last loaded.

Where no force acts but the load's, a hysteresis looks like an error that depends on the velocity; elsewhere it does not. With
these signals, the expected error of three healthy cells with hysteresis is off by 0.07 to 0.19 of that without, rms.
"""

SIGNALS: Mapping[Channel, tuple[str, ...]] = {
    "spool": (COMMAND, SPOOL_RATE, PRESSURE),
    "volume": (SPOOL, PRESSURE, PRESSURE_RATE, POSITION, SUPPLY),
    "volume_a": (SPOOL, PRESSURE_A, PRESSURE_RATE, POSITION, SUPPLY),
    "volume_b": (SPOOL, PRESSURE_B, PRESSURE_RATE, POSITION, SUPPLY),
    "supply": (SPOOL, PRESSURE),
    "force": (VELOCITY, DIRECTION, POSITION, ACCELERATION, LOAD),
    "cell": (PRESSURE, PRESSURE_RATE, VELOCITY, POSITION, *CELL_PLAYS),
    "velocity": (VELOCITY, PRESSURE, POSITION),
}
"""Signals on which the rig's remainder may depend, by channel; unrecorded ones are left out.

One term of each balance is omitted: all terms together would determine the residual, whatever the fault. Two sensors of one
quantity may also respond to different other signals.
"""

FACTORS: Mapping[Channel, str] = {
    "spool": COMMAND, "volume": SPOOL, "volume_a": SPOOL, "volume_b": SPOOL, "supply": SPOOL, "force": DIRECTION,
    "cell": PRESSURE, "velocity": VELOCITY,
}  # fmt: skip
"""Input of each channel's balance. Errors of its gain are proportional to it, as those of friction are to the direction."""

PROGRAMME, SAME_PROGRAMME = (0.05, 0.25, 0.5, 0.75, 0.95), 0.5
"""Quantiles of the signals by which a programme is known; their largest distance from those of all baselines, as a fraction of
the range.

It is up to 0.45 for other seeds of a random programme, 0.8 and more for another one.
"""

SAME_EXCITATION, LITTLE_SHOWN = 2.0, 0.01
"""Factor by which errors of coefficients may show more in a recording of the same programme, and the amount beyond it that says
nothing, as a fraction of the largest term.

The amount is up to 0.5 % for other seeds of a programme, and 19 to 35 % for one that tells the friction at low speed where the
baselines do not.
"""

OFFSET = "offset"
"""Name of a channel's constant error, which is due to a sensor and not to a coefficient."""

OUTSIDE = "nearly all of the recording lies outside the baselines' range: add a healthy recording of its programme"
NOT_LEARNT = "no baseline has its signals: add a healthy recording that has them"
HIDDEN = "the variation that the baselines permit there hides any change: add a healthy recording of its programme"
"""Reasons why a recorded stage cannot be judged against baselines."""

Signals = Mapping[str, Array]
"""Mean of each signal over a channel's usable windows, by name, shape (windows,)."""


class Judgement(NamedTuple):
    """A recording to be judged against the baselines.

    Attributes:
        evidence: the recording compared with the model, without allowances.
        expected: the healthy remainder to be expected in it, by channel.
        new_programme: whether there is no baseline of its programme.
    """

    evidence: Evidence
    expected: Mapping[Channel, Expected]
    new_programme: bool


class DescribedEvidence(NamedTuple):
    """Evidence with the possible components of its remainder.

    Attributes:
        evidence: a recording compared with the model.
        errors: sensitivities to errors of the coefficients, by channel.
        signals: signals on which the remainder may depend, by channel.
    """

    evidence: Evidence
    errors: Mapping[Channel, Sequence[Term]]
    signals: Mapping[Channel, Signals]


def describe(evidence: Evidence) -> DescribedEvidence:
    """Return evidence with the possible components of its remainder."""
    return DescribedEvidence(evidence, terms(evidence), signals_of(evidence))


class RemainderTerms(NamedTuple):
    """Components of one channel's remainder, common to the baselines and a new recording.

    Attributes:
        size: largest term of the channel's balance, used as its unit.
        spreads: relative spread of each coefficient that may be in error, by name; the first is :data:`OFFSET`.
        signals: names of the signals on which the remainder depends.
        factor: name of the channel's input.
        unit: rms of that input, used as its unit.
        temperature: mean oil temperature [K]; None if a baseline lacks it.
        homogeneous: whether all coefficients larger by one factor change the residual by itself. So it is without a measured
            load: then the measured area's term would allow a share of any fault, and that of the modelled balance is taken.
        errors: relative standard deviation of each coefficient's error, by name; :data:`rules.LEFT_ERROR` by default.
        identified: factor of the covariance of the coefficients' relative errors as identified, shape (spreads, n).
    """

    size: float
    spreads: Mapping[str, float]
    signals: tuple[str, ...]
    factor: str
    unit: float
    temperature: float | None
    homogeneous: bool = False
    errors: Mapping[str, float] = {}
    identified: Array = np.empty((0, 0))

    def windows(self, recording: DescribedEvidence, channel: Channel) -> Windows:
        """Return a channel's windows of one recording.

        The coefficients change in proportion to the oil temperature and to their spread.
        """
        evidence, signals = recording.evidence, recording.signals[channel]
        count = len(evidence.floor[channel])
        by_name = {OFFSET: np.ones(count)} | {term.name: term.column / self.size for term in recording.errors[channel]}
        residual = evidence.base.values[channel] * evidence.floor[channel] / self.size
        if self.homogeneous:
            by_name[SCALE] = by_name[SCALE] - residual
        columns = np.column_stack([by_name.get(name, np.zeros(count)) for name in self.spreads])
        if self.temperature is not None:
            warmer = (signals.get(TEMPERATURE, np.full(count, self.temperature)) - self.temperature) / rules.WARMER
            follow = np.array(list(self.spreads.values())) / rules.SPREAD_WITH_OIL
            columns = np.hstack([columns, columns * follow * warmer[:, None]])
        return Windows(
            residual=residual,
            noise=evidence.floor[channel] / self.size,
            terms=columns,
            # A missing signal is taken to be zero.
            signals=np.column_stack([np.empty((count, 0)), *(signals.get(name, np.zeros(count)) for name in self.signals)]),
            factor=signals.get(self.factor, np.zeros(count)) / self.unit,
            block=evidence.block[channel],
        )

    def shown(self, windows: Windows) -> Array:
        """Return the covariance of the amounts by which errors of the identified coefficients show in windows, shape (n, n)."""
        columns = windows.terms[:, : len(self.spreads)] @ self.identified
        found: Array = columns.T @ columns / len(columns)
        return found

    def learn_from(self, recordings: Sequence[Windows]) -> Learnt:
        """Learn the remainder from the windows of several recordings."""
        spread = np.array(list(self.spreads.values()))
        error = np.array([self.errors.get(name, rules.LEFT_ERROR) for name in self.spreads])
        fitted = np.array([name != SCALE for name in self.spreads])
        if self.temperature is not None:
            # The oil temperature varies from recording to recording, its effect does not.
            spread, fitted = np.concatenate([spread, np.zeros_like(spread)]), np.tile(fitted, 2)
            error = np.concatenate([error, np.full(len(error), rules.LEFT_ERROR)])
        return learn(recordings, spread, error, fitted)


class ChannelRemainder(NamedTuple):
    """Remainder of a healthy rig in one channel.

    Attributes:
        terms: its components.
        learnt: the learnt discrepancy.
        misjudged: error beyond noise of its expectation in a recording that it was not learnt from, in standard deviations of
            that expectation, at least 1.
        ranges: quantiles of the signals in each baseline, by its name, shape (quantiles, signals).
    """

    terms: RemainderTerms
    learnt: Learnt
    misjudged: float = 1.0
    ranges: Mapping[str, Array] = {}

    def compared(self, baselines: Mapping[str, Windows]) -> "ChannelRemainder":
        """Return the remainder with the baselines, or sections of one, compared with their expectation from the others."""
        recording = self.learnt.recording
        parts = np.unique(recording)
        # All windows of a baseline may lie in one section, which leaves nothing to expect it from.
        misjudged = max(self._misjudged(recording == k) for k in parts) if len(parts) > 1 else math.inf
        ranges = {name: np.quantile(own.signals, PROGRAMME, axis=0) for name, own in baselines.items()}
        return self._replace(misjudged=max(misjudged, 1.0), ranges=ranges)

    def _misjudged(self, own: Mask) -> float:
        """Return how far some of the windows are from their expectation from the others, in standard deviations of it."""
        windows = self.learnt.windows.where(own)
        others = self._replace(learnt=self.learnt.where(~own))
        away = others.distance(windows)
        inside = away <= 1.0
        # Beyond their range, the expectation itself is uncertain.
        few = np.mean(inside) < rules.MIN_KEPT_WINDOWS
        windows = windows.where(away <= rules.MAX_EXTRAPOLATION if few else inside)
        expected = others.expected(windows)
        off = _beyond_noise(windows.residual - expected.mean, windows.noise)
        return off / expected.deviation if off > 0.0 else 0.0

    def form(self, expected: Expected, *, new: bool) -> float:
        """Return the rms error of a recording's expectation beyond its allowed variation, as a fraction of the largest term.

        Args:
            expected: the expectation.
            new: whether there is no baseline of its programme.
        """
        return (rules.OTHER_PROGRAMME if new else 1.0) * expected.rest

    def most(self, *, new: bool) -> float:
        """Return the standard deviations of its expectation by which a healthy recording may differ from it, at most.

        Args:
            new: whether there is no baseline of its programme; the sections of a single one say little of another.
        """
        single = new and len(self.ranges) == 1
        return rules.MAX_ALLOWED * self.misjudged * (rules.OTHER_PROGRAMME if single else 1.0)

    def is_known(self, new: Windows) -> bool:
        """Return whether a recording is of a baseline's programme.

        The signals that follow the programme range as in the baselines, or between them, and errors of the identified
        coefficients show hardly more than in the baseline that is most alike, or than what is left unexplained.
        """
        there, known = np.quantile(new.signals, PROGRAMME, axis=0), np.array(list(self.ranges.values()))
        allowed = SAME_PROGRAMME * np.min(np.ptp(known, axis=1), axis=0)
        within = (there >= np.min(known, axis=0) - allowed) & (there <= np.max(known, axis=0) + allowed)
        follows = np.array([name not in (SUPPLY, *CELL_PLAYS) for name in self.terms.signals])
        return bool(np.all(within[:, follows])) and self._excites_as_known(new)

    def _excites_as_known(self, new: Windows) -> bool:
        if self.terms.identified.size == 0:
            return True
        windows, recording = self.learnt.windows, self.learnt.recording
        baselines = [windows.where(recording == k) for k in np.unique(recording)] if len(self.ranges) > 1 else [windows]
        here = self.terms.shown(new)
        more = (np.linalg.eigvalsh(here - SAME_EXCITATION**2 * self.terms.shown(own))[-1] for own in baselines)
        return bool(min(more) <= max(LITTLE_SHOWN, self.learnt.left) ** 2)

    def distance(self, new: Windows) -> Array:
        """Return how far windows are from the middle of the baselines' range, in half ranges, shape (n,)."""
        low, high = np.quantile(self.learnt.windows.signals, (rules.SEEN, 1.0 - rules.SEEN), axis=0)
        middle, half = 0.5 * (low + high), 0.5 * (1.0 + rules.MARGIN) * (high - low)
        # A direction is no operating point.
        points = np.array([name not in CELL_PLAYS for name in self.terms.signals], dtype=np.bool_)
        away: Array = np.max((np.abs(new.signals - middle) / np.maximum(half, 1e-300))[:, points], axis=1, initial=0.0)
        return away

    def expected(self, new: Windows) -> Expected:
        """Return the expected remainder of a healthy rig in windows of another recording.

        Errors of form cannot be extrapolated. Outside the baselines their uncertainty grows with the distance, by as much as is
        relevant over half the range even if no error shows inside, and becomes infinite far away.
        """
        away = self.distance(new)
        growth = np.clip(away, 1.0, rules.MAX_EXTRAPOLATION)
        found = self.learnt.expected(new.terms, new.signals, new.factor, growth)
        variance = found.variance + (rules.RELEVANT * (growth - 1.0)) ** 2
        return found._replace(variance=np.where(away > rules.MAX_EXTRAPOLATION, np.inf, variance))


@dataclass(frozen=True)
class HealthyVariation(Standard):
    """Remainder of a healthy rig in all channels, the standard by which a change of it is judged.

    A change detected against it needs no other evidence of excitation, and one hidden in the healthy spread is no deficiency of
    the data.

    Attributes:
        channels: the remainder by channel.
        healthy: the baselines, judged by it.
        judgements: receives each recording judged by it.
        form: rms error of the expectation in the judged recording beyond its allowed variation, as a fraction of the channel's
            largest term.
    """

    channels: Mapping[Channel, ChannelRemainder]
    healthy: tuple[Evidence, ...] = ()
    judgements: list[Judgement] = field(default_factory=list)
    form: Mapping[Channel, float] = field(default_factory=dict)
    excitation_needed = False
    largest_undetected = rules.MAX_UNDETECTED_BESIDE_SPREAD
    form_is_noise = True
    needed_gain = rules.NEEDED_GAIN_BESIDE_FORM
    min_gain_ratio = rules.MIN_GAIN_RATIO_BESIDE_FORM
    bounds_are_of_chance = True

    def expected(self, recording: DescribedEvidence) -> dict[Channel, Expected]:
        """Return the expected remainder of a healthy rig in each channel of the baselines, in units of its size."""
        return {c: self.channels[c].expected(windows) for c, windows in self._windows(recording).items()}

    def _windows(self, recording: DescribedEvidence) -> dict[Channel, Windows]:
        """Return the windows of a recording in each channel of the baselines."""
        known = self.channels
        return {c: known[c].terms.windows(recording, c) for c in recording.evidence.channels if c in known}

    def judged(self, evidence: Evidence) -> Evidence:
        """Return the evidence with the rig's expected remainder subtracted and its healthy spread allowed for.

        Channels missing in all baselines are left out.
        """
        windows = self._windows(describe(evidence))
        own = {c: self.channels[c] for c in windows}
        expected = {c: known.expected(windows[c]) for c, known in own.items()}
        new = not all(known.is_known(windows[c]) for c, known in own.items())
        self.judgements.append(Judgement(evidence, expected, new))
        # In a recording of smaller motion, the error is as large as in the baselines.
        smaller = {c: max(1.0, known.terms.size / max(evidence.sizes[c], 1e-300)) for c, known in own.items()}
        form = {c: smaller[c] * known.form(expected[c], new=new) for c, known in own.items()}
        return replace(self, form=form).judged_by(evidence, expected, new=new)

    def judged_by(self, evidence: Evidence, expected: Mapping[Channel, Expected], *, new: bool = False) -> Evidence:
        """Return the evidence judged by a given expectation; ``new`` is whether there is no baseline of its programme."""
        near = {c: np.isfinite(healthy.variance) for c, healthy in expected.items()}
        reasons = {CHANNELS[c]: OUTSIDE if c in expected else NOT_LEARNT for c in evidence.channels}
        allowances, evidence = {}, part_of(evidence, near)
        reasons |= {CHANNELS[c]: HIDDEN for c in evidence.channels}
        evidence = replace(evidence, setup=evidence.setup._replace(why_not={**reasons, **evidence.setup.why_not}))
        measured = measurement(evidence)
        for c in evidence.channels:
            size, healthy = self.channels[c].terms.size, expected[c]
            variation = Allowance(
                mean=healthy.mean[near[c]] * size,
                directions=healthy.directions[near[c]] * size,
                variance=healthy.variance[near[c]] * size**2,
                correlated=self.channels[c].learnt.together,
                most=self.channels[c].most(new=new),
            )
            allowances[c] = together([variation, measured[c]])
        return allowing(evidence, allowances, self)

    def noise_power(self, channel: Channel, e: Array) -> float:
        """Return the fault-free mean square of a channel's whitened residuals: that of all allowances, or of a baseline.

        The scatter is estimated without the largest residuals, which a baseline has too, such as those at reversals.
        """
        return max([1.0, *(power(own) for own in self._healthy_residuals(channel))])

    def rare_square(self, channel: Channel, noise: float) -> float:
        """Return the fault-free square of a channel's rare whitened residuals, that of normal ones or of a baseline."""
        rare = (float(np.quantile(own * own, rules.RARE_QUANTILE)) for own in self._healthy_residuals(channel))
        return max([rules.RARE_SCATTER * noise, *rare])

    def form_error(self, channel: Channel) -> float:
        """Return the rms error of the healthy remainder's expectation in the judged recording, beyond its allowed variation."""
        return self.form.get(channel, 0.0)

    def beyond(self, evidence: Evidence, channel: Channel, change: Array) -> Array:
        """Return the part of a change that the healthy spread does not allow; that spread makes no change smaller."""
        return evidence.beyond(channel, change)

    def _healthy_residuals(self, channel: Channel) -> list[Array]:
        """Return the whitened residuals of each baseline that has the channel."""
        return [baseline.base.values[channel] for baseline in self.healthy if channel in baseline.base.values]

    def scatter(self, windows: float) -> float:
        """Return the multiple of its mean that the mean square of so many independent windows may reach by chance."""
        return rules.SCATTER * (1.0 + rules.MAX_ALLOWED * math.sqrt(2.0 / windows))

    def before(self, evidence: Evidence, channel: Channel, before: Array, after: Array) -> Array:
        """Return the residuals of the given model in which a first cause's share is closed, whitened like ``after``.

        A first cause counts in full: its excess over the healthy spread would be small beside the scatter of a long recording,
        however large the change. The remainder of another cause is mostly spread; there only the excess counts.
        """
        return evidence.whole(channel, before) - (evidence.whole(channel, after) - after)

    def sizes_by_chance(self, hypothesis: Hypothesis, values: Array, steps: Array) -> Array:
        """Return the mean square of the parameters by which each baseline's remainder would be explained, shape (p, p).

        Errors of the rig's form last, and pass for a size as well as the cause they resemble; no scatter in the new recording
        shows them.
        """
        sizes = []
        for healthy in self.healthy:
            evidence = healthy.unbounded()
            there = Worker(evidence).linearise(hypothesis, values, steps)
            if there.channels:
                sizes.append(np.linalg.lstsq(there.jacobian, evidence.base.joined(there.channels), rcond=None)[0])
        return (
            np.mean([np.outer(size, size) for size in sizes], axis=0)
            if sizes
            else super().sizes_by_chance(hypothesis, values, steps)
        )

    def allows(self, hypothesis: Hypothesis, values: Array, inflation: Mapping[Channel, float]) -> bool:
        """Return whether a cause fits the baselines as well."""
        against = 0.0
        for healthy in self.healthy:
            always = extended(healthy.rig, hypothesis, values)
            before, after = healthy.base.values, healthy.residuals(healthy.comparison(), always).values
            against += sum(float(np.sum(loss(after[c]) - loss(before[c]))) / inflation[c] for c in before if c in inflation)
        return against < rules.NEEDED_GAIN


def _beyond_noise(residual: Array, noise: Array) -> float:
    """Return the rms of a residual beyond noise; 0 without windows.

    An error that lasts for several windows shows below the noise too, which is independent in windows without common samples.
    """
    if len(residual) <= OVERLAP:
        return 0.0
    lasting = float(np.mean(residual[OVERLAP:] * residual[:-OVERLAP]))
    return math.sqrt(max(float(np.mean(residual**2 - noise**2)), lasting, 0.0))


def is_homogeneous(recording: DescribedEvidence, channel: Channel) -> bool:
    """Return whether a channel's residual, noise included, is a sum of its derivatives by the coefficients."""
    terms, noise = recording.errors[channel], recording.evidence.floor[channel]
    if SCALE not in {term.name for term in terms}:
        return False
    columns = np.column_stack([term.column / noise for term in terms])
    columns /= np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    residual = recording.evidence.base.values[channel]
    fitted = columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    return rms(residual - fitted) < rules.HOMOGENEOUS * rms(recording.evidence.noise[channel])


def learn_healthy_variation(baselines: Sequence[DescribedEvidence], errors: RelativeErrors = NO_ERRORS) -> HealthyVariation:
    """Learn the remainder of a healthy rig from recordings compared with the same model.

    Args:
        baselines: the recordings.
        errors: of all coefficients fitted to them, also of those that they do not identify.
    """
    # The piston's area is known from its drawing. An error as small as a healthy variation does not matter.
    known = {name: max(error, rules.SPREAD) for name, error in errors.of_identified().items()} | {SCALE: rules.AREA_ERROR}
    out = dict[Channel, ChannelRemainder]()
    for c in dict.fromkeys(c for b in baselines for c in b.evidence.channels):
        recordings = [b for b in baselines if c in b.evidence.channels]
        common = set.intersection(*(set(b.signals[c]) for b in recordings))
        values = {name: np.concatenate([b.signals[c][name] for b in recordings]) for name in common}
        spreads = {OFFSET: rules.SPREAD_OF_OFFSET} | {term.name: term.spread for b in recordings for term in b.errors[c]}
        components = RemainderTerms(
            size=max(1e-300, *(b.evidence.sizes[c] for b in recordings)),
            spreads=spreads | dict.fromkeys({SCALE} & set(spreads), 0.0),
            # A signal missing in a baseline cannot be used.
            signals=tuple(name for name in SIGNALS[c] if name in common),
            factor=FACTORS[c],
            unit=rms(values.get(FACTORS[c], np.zeros(1))) or 1.0,
            temperature=float(np.mean(values[TEMPERATURE])) if TEMPERATURE in common else None,
            homogeneous=all(is_homogeneous(b, c) for b in recordings),
            errors=known,
            identified=errors.in_terms(tuple(spreads)),
        )
        windows = {b.evidence.record.name: components.windows(b, c) for b in recordings}
        out[c] = ChannelRemainder(components, components.learn_from(list(windows.values()))).compared(windows)
    learnt = HealthyVariation(out)
    return replace(learnt, healthy=tuple(learnt.judged_by(b.evidence, learnt.expected(b)) for b in baselines))


def signals_of(evidence: Evidence) -> dict[Channel, dict[str, Array]]:
    """Return the signals on which each channel's remainder may depend, and the oil's temperature, over its usable windows."""
    comparison = evidence.comparison()
    along = signals_along(comparison, evidence.rig)
    if VELOCITY in along:
        slow = max(float(getattr(evidence.rig.friction, "stribeck_velocity", 0.0)), 1e-6)
        along[DIRECTION] = np.tanh(along[VELOCITY] / slow)
    if "spool" in evidence.channels:
        along[SPOOL_RATE] = np.gradient(comparison.simulated_spool(evidence.rig.effective()), evidence.record.period)
    if "cell" in evidence.channels:
        pressure, supply = along[PRESSURE], evidence.rig.plant.supply_pressure
        along |= {name: kept_by_play(evidence.record, pressure, part * supply) for name, part in CELL_PLAYS.items()}
    # A measured load responds to the friction: at controlled pressure it would determine the residual.
    usable = [name for name in along if name not in evidence.record.measured]
    return {
        c: {name: evidence.means(c, along[name]) for name in (*SIGNALS[c], TEMPERATURE) if name in usable}
        for c in evidence.channels
    }
