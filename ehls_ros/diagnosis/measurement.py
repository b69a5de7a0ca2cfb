"""What a recording cannot be blamed for: its channels' skew, the drift of its clocks and the offsets of its converters.

No two channels of a recorder are sampled at one moment. Filters delay one more than another, a multiplexer reads them in turn,
clocks drift apart, and a converter's zero is as good as its data sheet. Half a sample between the recorded disturbance and what
acts leaves a residual far above the noise, and some effect of the right frequency would explain it. So each signal may be late
by up to one of its samples, more so at the end than at the beginning or less, and its zero may be off. One signal's skew in two
channels is two allowances, so that an error in one stage does not spread to others through it.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.allowance import Allowance
from ehls_ros.diagnosis.evidence import Evidence, allowing
from ehls_ros.diagnosis.loss import power
from ehls_ros.diagnosis.record import HELD, Record
from ehls_ros.diagnosis.stages import CHANNELS, Channel, Comparison, Stage, formed_of


def beyond_measurement(evidence: Evidence) -> Evidence:
    """Return evidence that counts only what skews, drifts and offsets within their bounds do not explain."""
    return allowing(evidence, measurement(evidence), beyond_measurement)


def measurement(evidence: Evidence) -> dict[Channel, Allowance]:
    """Return what the measurement may add to each channel's residual.

    Args:
        evidence: the recording compared with the given model, nothing allowed for yet.
    """
    record = evidence.record
    late, off = {c: list[Array]() for c in evidence.channels}, {c: list[Array]() for c in evidence.channels}
    for signal, values in record.signals.items():
        seen = tuple(c for c in evidence.channels if signal in formed_of(record, c))
        # Skews count from the signal whose own noise shows most: a direction that holds a sensor's noise would hold what a
        # delay of that sensor does to it, and any delay would seem to help.
        moving = tuple(c for c in seen if signal != formed_of(record, c)[0])
        if moving:
            sooner, later = (_residuals(evidence, signal, moved, moving) for moved in _moved(evidence.comparison(), signal))
            for c in moving:
                late[c].append(0.5 * (later[c] - sooner[c]))
        if seen and signal not in HELD:
            offset = rules.OFFSET * float(np.quantile(np.abs(values), rules.UNIT_QUANTILE))
            higher = _residuals(evidence, signal, values + offset, seen)
            for c in seen:
                off[c].append(higher[c] - evidence.base.values[c] * evidence.floor[c])
    return {c: _allowance(late[c], off[c], evidence.times[c]) for c in evidence.channels}


def allowed_for(evidence: Evidence, left: Mapping[Channel, Array]) -> str:
    """Say what was allowed for, and where it takes off more than noise.

    Args:
        evidence: the recording compared with the given model.
        left: whitened residuals of the model with the causes.
    """
    record = evidence.record
    samples = [1e3 * pick(record.sampled(signal) for signal in record.signals) for pick in (min, max)]
    sample = " to ".join(f"{value:.3g}" for value in dict.fromkeys(samples))
    said = (
        f"allowed for: signals late or early by up to a sample ({sample} ms) against each other, and drifting;"
        f" zeros off by up to {100.0 * rules.MOST_ALLOWED * rules.OFFSET:.2g} % of their signals"
    )
    explained = dict[Stage, float]()
    for c, e in left.items():
        taken = evidence.whole(c, e) - e
        if power(taken) > max(power(evidence.noise[c]), rules.LEAST_NOISE_POWER):
            explained[CHANNELS[c]] = max(explained.get(CHANNELS[c], 0.0), evidence.nrmse(c, taken))
    parts = [f"{100.0 * part:.2g} % in the {stage.replace('_', ' ')}" for stage, part in explained.items()]
    return f"{said}; that explains {', '.join(parts)}" if parts else said


def _allowance(late: Sequence[Array], off: Sequence[Array], times: Array) -> Allowance:
    """Return the allowance for skews, drifts and offsets of one channel.

    Args:
        late: change of the residual if a signal is one of its samples late, for all signals but the reference.
        off: change of the residual with each signal's offset.
        times: of the windows [s].
    """
    none = np.zeros(len(times))
    # What all signals share is not seen: the reference late is all others early.
    skews = rules.SKEW * np.column_stack([-np.sum([none, *late], axis=0), *late])
    drift = (times - times[0]) / max(float(np.ptp(times)), 1e-300) - 0.5
    directions = np.column_stack([skews, skews * drift[:, None], *off])
    return Allowance(none, directions[:, np.all(np.isfinite(directions), axis=0)], none, most=rules.MOST_ALLOWED)


def _residuals(evidence: Evidence, signal: str, values: Array, channels: tuple[Channel, ...]) -> dict[Channel, Array]:
    """Return the given model's residuals in the usable windows with another signal, in the channels' units."""
    other = evidence.record._replace(signals={**evidence.record.signals, signal: values})
    found = Comparison(other, evidence.setup).residuals(evidence.rig, channels)
    return {c: found[c][evidence.masks[c]] for c in channels}


def _moved(comparison: Comparison, signal: str) -> Iterator[Array]:
    """Yield a signal one of its samples sooner and later.

    One that does not hold its value is moved by a local fit's derivatives: a whole sample's shift would mix the noise of
    neighbouring samples, and averaged noise would look like the right skew.
    """
    record: Record = comparison.record
    values, sample = record.signals[signal], record.sampled(signal)
    if signal in HELD:
        count = max(1, round(sample / record.period))
        ends = np.full(count, values[-1]), np.full(count, values[0])
        yield np.concatenate([values[count:], ends[0]])
        yield np.concatenate([ends[1], values[:-count]])
        return
    rise = sample * comparison.local_fit(values, 1)
    yield values + rise
    yield values - rise
