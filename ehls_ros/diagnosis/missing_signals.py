"""Missing signals that would distinguish two hypotheses, from each hypothesis' prediction of the signal."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.hypotheses import candidates, extended
from ehls_ros.diagnosis.loss import rms
from ehls_ros.diagnosis.noise import largest_terms
from ehls_ros.diagnosis.record import FORCE, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.stages import Comparison, setup
from ehls_ros.physics.rig import EffectiveRig, Rig
from ehls_ros.physics.simulator import OIL_TEMPERATURE

EXPECTED: Mapping[str, Callable[[Comparison, EffectiveRig], Array]] = {
    SPOOL: lambda along, rig: along.simulated_spool(rig),
    PRESSURE: lambda along, rig: along.pressure(rig),
    SUPPLY: lambda along, rig: along.supply_pressure(rig),
    FORCE: lambda along, rig: rig.plant.piston_area * along.pressure(rig),
    VELOCITY: lambda along, rig: along.motion(rig).velocity,
}
"""Model prediction of an unrecorded signal from the recorded ones, shape (n,)."""


STILL: Mapping[str, float] = {TEMPERATURE: OIL_TEMPERATURE + 1.0}
"""Signals without which an effect is not tried, and a value at which the effect acts."""


def deciding(evidence: Evidence, one: Fit, other: Fit) -> tuple[str, ...]:
    """Return the missing signals that would allow a balance to be formed that differs between two hypotheses.

    Args:
        evidence: the recording compared with the given model.
        one: the first hypothesis, fitted.
        other: the second.
    """
    missing = [signal for signal in EXPECTED if signal not in evidence.record]
    if not missing:
        return ()
    along, rigs = evidence.comparison(), [extended(evidence.rig, fit.hypothesis, fit.values) for fit in (one, other)]
    return tuple(signal for signal in missing if _separates(along, signal, *rigs))


def untried(evidence: Evidence, best: Fit, without: Fit) -> dict[str, tuple[str, ...]]:
    """Return the effects untried for lack of a sensor that reproduce a cause at a constant value of that sensor's signal.

    Args:
        evidence: the recording compared with the given model.
        best: the hypothesis with the cause, fitted.
        without: the same without it.

    Returns:
        The missing signals by effect.
    """
    record = evidence.record
    still = {signal: value for signal, value in STILL.items() if signal not in record}
    if not still:
        return {}
    signals = {signal: np.full(len(record.time), value) for signal, value in still.items()}
    completed = record._replace(signals={**record.signals, **signals}, noise={**record.noise, **dict.fromkeys(still, 0.0)})
    worker = Worker(replace(evidence, record=completed))
    (_, left_out), (tried, _) = (candidates(r, evidence.rig, ()) for r in (record, completed))
    out = dict[str, tuple[str, ...]]()
    change = best.residuals.joined(evidence.channels) - without.residuals.joined(evidence.channels)
    for candidate in tried:
        if candidate.name in left_out:
            fit = worker.linearise((candidate,), candidate.neutral)
            within_reach = best.residuals.joined(fit.channels) - without.residuals.joined(fit.channels)
            reached = fit.jacobian @ np.linalg.lstsq(fit.jacobian, within_reach, rcond=None)[0]
            if float(reached @ reached) >= rules.CLOSED * float(change @ change):
                out[candidate.name] = tuple(still)
    return out


def _separates(along: Comparison, signal: str, one: Rig, other: Rig) -> bool:
    record = along.record
    completed = record._replace(
        signals={**record.signals, signal: EXPECTED[signal](along, one.effective())},
        good={**record.good, signal: np.ones(len(record.time), dtype=np.bool_)},
        # It must not be used for anything but the new balances.
        noise={**record.noise, signal: math.inf},
    )
    whole = Comparison(completed, setup(completed, one))
    added = tuple(c for c in whole.setup.channels if c not in along.setup.channels)
    first, second, sizes = whole.residuals(one, added), whole.residuals(other, added), largest_terms(whole, one)
    return any(rms(first[c] - second[c]) > rules.RELEVANT * sizes[c] for c in added)
