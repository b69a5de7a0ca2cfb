"""Allowances for measurement errors: skew between channels, clock drift, converter offsets, and noise that lasts.

No two channels of a recorder are sampled at the same instant. Filters delay one more than another, a multiplexer reads them in
turn, clocks drift apart, and a converter's zero is only as good as its data sheet. A skew of half a sample between the recorded
and the acting disturbance leaves a residual far above the noise, which some effect of that frequency would explain.

Each signal may therefore be late by up to one of its samples, with a drift over the recording, and its zero may be off. The
skew of one signal in two channels is two separate allowances, so that an error in one stage does not spread to others. Noise
that a model remembers is allowed for as an offset of its windows.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.allowance import Allowance
from ehls_ros.diagnosis.evidence import Evidence, Standard, allowing
from ehls_ros.diagnosis.loss import power
from ehls_ros.diagnosis.memory import remembered
from ehls_ros.diagnosis.noise import without_noise
from ehls_ros.diagnosis.record import HELD, Record
from ehls_ros.diagnosis.stages import CHANNELS, Channel, Comparison, Stage, formed_of, moved_by


class BeyondMeasurement(Standard):
    """The sensors' noise, with allowances for skews, drifts and offsets within their bounds."""

    def judged(self, evidence: Evidence) -> Evidence:
        """Return evidence, so far without allowances, judged by this standard."""
        return allowing(evidence, measurement(evidence), self)

    def counted(self, evidence: Evidence, channel: Channel, change: Array) -> Array:
        """Return the change beyond the bounds of the allowances in full: the weights there only soften their edge."""
        return evidence.beyond(channel, change)


BEYOND_MEASUREMENT = BeyondMeasurement()
"""The standard of a diagnosis without baselines."""


@dataclass(frozen=True)
class BesideForm(BeyondMeasurement):
    """The same beside errors of the model's form.

    Attributes:
        form: change of a balance, as a fraction of its largest term, up to which a cause may be such an error.
    """

    form: float = rules.FORM_ERROR
    relevant_beside = rules.FORM_ERROR
    accepted_rivals_only = True

    def lenient(self) -> "BesideForm":
        """Return the standard by which a single small cause is accepted where nothing else is."""
        return BesideForm(rules.RELEVANT)


def measurement(evidence: Evidence) -> dict[Channel, Allowance]:
    """Return the allowance for measurement errors in each channel's residual.

    Args:
        evidence: the recording compared with the given model, without allowances.
    """
    record = evidence.record
    late, bent, off = ({c: list[Array]() for c in evidence.channels} for _ in range(3))
    given = {c: evidence.base.values[c] * evidence.floor[c] for c in evidence.channels}
    for signal, values in record.signals.items():
        seen = tuple(c for c in evidence.channels if signal in formed_of(record, c))
        # Skews are relative to the signal whose noise shows most: a direction containing a sensor's noise would also contain
        # the effect of a delay on that noise, and any delay would seem to help.
        moving = tuple(c for c in seen if signal != formed_of(record, c)[0])
        if moving:
            sooner, later = (_residuals(evidence, signal, moved, moving) for moved in _moved(record, signal))
            for c in moving:
                late[c].append(0.5 * (later[c] - sooner[c]))
                bent[c].append(0.5 * (later[c] + sooner[c]) - given[c])
        if seen and signal not in HELD:
            offset = rules.OFFSET * float(np.quantile(np.abs(values), rules.RARE_QUANTILE))
            higher = _residuals(evidence, signal, values + offset, seen)
            for c in seen:
                off[c].append(higher[c] - given[c])
    for c in evidence.channels:
        lasting = remembered([more[c] for more in evidence.added], evidence.times[c])
        off[c] += [deviation * evidence.floor[c] for deviation in lasting]
    return {c: _allowance(late[c], bent[c], off[c], evidence.times[c]) for c in evidence.channels}


def allowed_for(evidence: Evidence, left: Mapping[Channel, Array]) -> str:
    """Return a remark on the allowances, and the stages in which they explain more than noise.

    Args:
        evidence: the recording compared with the given model.
        left: whitened residuals of the model with the causes.
    """
    record = evidence.record
    samples = [1e3 * pick(record.sampled(signal) for signal in record.signals) for pick in (min, max)]
    sample = " to ".join(f"{value:.3g}" for value in dict.fromkeys(samples))
    allowances = (
        f"allowed for: signals late or early by up to a sample ({sample} ms) against each other, and drifting;"
        f" zeros off by up to {100.0 * rules.MAX_ALLOWED * rules.OFFSET:.2g} % of their signals; noise that lasts until"
        " friction slides again"
    )
    explained = dict[Stage, float]()
    for c, e in left.items():
        taken = evidence.whole(c, e) - e
        if power(taken) > max(power(evidence.noise[c]), rules.MIN_NOISE_POWER):
            explained[CHANNELS[c]] = max(explained.get(CHANNELS[c], 0.0), evidence.nrmse(c, taken))
    parts = [f"{100.0 * part:.2g} % in the {stage.replace('_', ' ')}" for stage, part in explained.items()]
    return f"{allowances}; that explains {', '.join(parts)}" if parts else allowances


def _allowance(late: Sequence[Array], bent: Sequence[Array], off: Sequence[Array], times: Array) -> Allowance:
    """Return the allowance for skews, drifts and offsets of one channel.

    Args:
        late: change of the residual by a delay of one original sample, for all signals but the reference.
        bent: part of that change that is even in the delay, which shows in fast turns.
        off: change of the residual by each signal's offset, and by each error that the model remembers.
        times: of the windows [s].
    """
    none = np.zeros(len(times))
    # A skew common to all signals is unobservable: a late reference is equivalent to all others early.
    skews = rules.SKEW * np.column_stack([-np.sum([none, *late], axis=0), *late])
    drift = (times - times[0]) / max(float(np.ptp(times)), 1e-300) - 0.5
    bends = [rules.SKEW * even for even in bent]
    directions = np.column_stack([skews, skews * drift[:, None], *bends, *off])
    return Allowance(none, directions[:, np.all(np.isfinite(directions), axis=0)], none, most=rules.MAX_ALLOWED)


def _residuals(evidence: Evidence, signal: str, values: Array, channels: tuple[Channel, ...]) -> dict[Channel, Array]:
    """Return the given model's residuals in the usable windows with a signal replaced, in the channels' units."""
    other = evidence.record._replace(signals={**evidence.record.signals, signal: values})
    found = Comparison(other, evidence.setup).residuals(evidence.rig, channels)
    return {c: found[c][evidence.masks[c]] for c in channels}


def _moved(record: Record, signal: str) -> Iterator[Array]:
    """Yield a signal advanced and delayed by one of its samples.

    A measured signal is shifted by the derivative of a local fit: a whole sample's shift would mix the noise of neighbouring
    samples, and averaged noise would look like the right skew. A commanded one has no noise, but steps that a fit would round.
    """
    values, sample = record.signals[signal], record.sampled(signal)
    if signal in HELD or signal in without_noise(record):
        count = max(1, round(sample / record.period))
        ends = np.full(count, values[-1]), np.full(count, values[0])
        yield np.concatenate([values[count:], ends[0]])
        yield np.concatenate([ends[1], values[:-count]])
        return
    yield from moved_by(record, signal, sample)
