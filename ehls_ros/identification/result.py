"""Result of the identification of friction, and its content in ``identification.json``."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.estimate import Estimate
from ehls_ros.identification.elements import MODEL
from ehls_ros.identification.joint import JointFit
from ehls_ros.identification.motion import Motion
from ehls_ros.identification.presliding import Branch, Node
from ehls_ros.identification.static import StaticFit
from ehls_ros.identification.strokes import Missing
from ehls_ros.physics.rig import Rig


class Identification(NamedTuple):
    """Result of an identification.

    Attributes:
        rig: the rig with the identified coefficients.
        estimates: the identified coefficients, by their names in the rig file, those of an element with its number.
        correlations: correlations of the estimates, shape (n, n), in their order.
        not_identifiable: names of coefficients that the data do not identify, or not separately.
        remarks: sentences about the limits of the result.
        static: the static fit; None without steady sliding.
        branch: the mean branch of the hysteresis loop; None without reversals in presliding, or friction elements.
        nodes: nodes of the branch.
        criteria: Bayesian information criterion by number of elements.
        fit: the joint fit.
        motions: the recordings in blocks.
        method: the optimiser of the static fit.
        wall_s: wall time [s].
        lacking: strokes missing in the recordings.
        understated: factor by which standard errors are known to be too small, by name of the estimate.
    """

    rig: Rig
    estimates: Mapping[str, Estimate]
    correlations: Array
    not_identifiable: tuple[str, ...]
    remarks: tuple[str, ...]
    static: StaticFit | None
    branch: Branch | None
    nodes: tuple[Node, ...]
    criteria: Mapping[int, float]
    fit: JointFit
    motions: tuple[Motion, ...]
    method: str
    wall_s: float
    lacking: Missing = Missing(())
    understated: Mapping[str, float] = MappingProxyType({})

    @property
    def elements(self) -> int:
        """Number of friction elements; 0 for a friction model without elements."""
        return len(self.rig.friction.element_stiffness) if self.rig.friction_model == MODEL else 0


def to_json(found: Identification) -> dict[str, Any]:
    """Return the content of ``identification.json``."""
    return {
        "parameters": {name: estimate._asdict() for name, estimate in found.estimates.items()},
        "understated": dict(found.understated),
        "correlations": {"names": list(found.estimates), "matrix": found.correlations.tolist()},
        "not_identifiable": list(found.not_identifiable),
        "remarks": list(found.remarks),
        "missing": list(found.lacking.descriptions),
        "elements": found.elements,
        "criteria": {str(number): value for number, value in found.criteria.items()},
        "method": found.method,
        "cost": found.fit.cost,
        "noise_n": {
            motion.name: noise if math.isfinite(noise) else None
            for motion, noise in zip(found.motions, found.fit.noise, strict=True)
        },
        "wall_s": found.wall_s,
    }
