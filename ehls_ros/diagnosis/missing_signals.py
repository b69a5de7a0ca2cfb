"""What a missing signal would tell apart: each of two hypotheses says what that signal would have shown."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.hypotheses import extended
from ehls_ros.diagnosis.noise import largest_terms
from ehls_ros.diagnosis.record import FORCE, PRESSURE, SPOOL, SUPPLY, VELOCITY
from ehls_ros.diagnosis.stages import Comparison, setup
from ehls_ros.physics.rig import EffectiveRig, Rig

EXPECTED: Mapping[str, Callable[[Comparison, EffectiveRig], Array]] = {
    SPOOL: lambda along, rig: along.simulated_spool(rig),
    PRESSURE: lambda along, rig: along.pressure(rig),
    SUPPLY: lambda along, rig: along.flow_terms(rig)[:, 3],
    FORCE: lambda along, rig: rig.plant.piston_area * along.pressure(rig),
    VELOCITY: lambda along, rig: along.motion(rig).velocity,
}
"""What a model says of a signal that was not recorded, along those that were, shape (n,)."""


def deciding(evidence: Evidence, one: Fit, other: Fit) -> tuple[str, ...]:
    """Return the missing signals with which a balance could be formed that differs between two hypotheses.

    Args:
        evidence: the recording compared with the given model.
        one: the first hypothesis, fitted.
        other: the second.
    """
    missing = [signal for signal in EXPECTED if signal not in evidence.record]
    if not missing:
        return ()
    along, rigs = evidence.comparison(), [extended(evidence.rig, fit.hypothesis, fit.values) for fit in (one, other)]
    return tuple(signal for signal in missing if _tells(along, signal, *rigs))


def _tells(along: Comparison, signal: str, one: Rig, other: Rig) -> bool:
    record = along.record
    completed = record._replace(
        signals={**record.signals, signal: EXPECTED[signal](along, one.effective())},
        good={**record.good, signal: np.ones(len(record.time), dtype=np.bool_)},
        # Nothing is to be read from it but what the new balances compare.
        noise={**record.noise, signal: math.inf},
    )
    whole = Comparison(completed, setup(completed, one))
    added = tuple(c for c in whole.setup.channels if c not in along.setup.channels)
    first, second, sizes = whole.residuals(one, added), whole.residuals(other, added), largest_terms(whole, one)
    return any(float(np.sqrt(np.mean((first[c] - second[c]) ** 2))) > rules.RELEVANT * sizes[c] for c in added)
