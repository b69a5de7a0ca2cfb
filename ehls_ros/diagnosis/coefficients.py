"""Coefficients of a rig's model, and the sensitivity of the residuals to a small error of each."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import FIRST_STEP
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.errors import BadInput
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import declarations

WITH_OIL = ("leakage_coefficient",)
"""Coefficients of the plant that depend on the oil and its temperature, as do all of the friction."""

WITH_OTHERS = "it turns pressure into force and motion into flow; everything else is relative to it; kept as given"

KEPT: Mapping[str, str] = {
    "plant.oil_density": "only plant.discharge_coefficient × plant.valve_area_gradient / √density is known; kept as given",
    "plant.valve_area_gradient": "only its product with plant.discharge_coefficient is known; kept as given",
    "plant.total_volume": "only its ratio to plant.bulk_modulus is known; kept as given",
    "plant.piston_area": WITH_OTHERS,
    "plant.viscous_damping": "only its sum with friction.viscous_coefficient is known; kept as given",
    "plant.gravity": "only plant.moving_mass × gravity less effects.constant_load.force is known; kept as given",
    "plant.arm_length": "no equation of the stages depends on it; kept as given",
}
"""Coefficients known only in combination with others, or without effect on any residual, with the reason."""

KEPT_IN_CHAMBERS: Mapping[str, str] = {
    "plant.discharge_coefficient": "only its product with the gains of the valve's edges is known; kept as given",
    "cylinder.area_a": WITH_OTHERS,
    "cylinder.area_b": WITH_OTHERS,
    "cylinder.volume_a": "only its ratio to plant.bulk_modulus is known; kept as given",
    "cylinder.volume_b": "only its ratio to plant.bulk_modulus is known; kept as given",
    "cylinder.vapour_pressure": "no equation of the stages depends on it; kept as given",
    "valve.transition_pressure": "it matters only where there is hardly a pressure drop; kept as given",
}
"""The same of a cylinder with two chambers and its valve, in place of those that follow from them."""


def kept(rig: Rig) -> dict[str, str]:
    """Return the coefficients of a rig that are kept as given, with the reason."""
    if not rig.cylinder.law.CHAMBERS:
        return dict(KEPT)
    derived = {f"plant.{name}" for name in rig.cylinder.law.derived(rig.cylinder.parameters)}
    return {path: why for path, why in KEPT.items() if path not in derived} | dict(KEPT_IN_CHAMBERS)


SCALE = "piston_area"
"""Coefficient that sets the scale of the balances.

It is not fitted, since with all coefficients at zero the balances would close too. No fault changes it, but its error shows at
a pressure outside the baselines.
"""


COULOMB, STATIC = "coulomb_force", "static_force"
"""Names of both friction forces, of which the second keeps its ratio to the first where that varies."""


class RelativeErrors(NamedTuple):
    """Errors of coefficients of a rig's model, as fractions of their values.

    Attributes:
        names: of the coefficients.
        covariance: of their errors, shape (n, n).
        identified: names of those that recordings determine.
    """

    names: tuple[str, ...] = ()
    covariance: Array = np.empty((0, 0))
    identified: frozenset[str] = frozenset()

    def of_identified(self) -> dict[str, float]:
        """Return the standard deviation of the error of each identified coefficient, by name."""
        std = np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).tolist()
        return {name: own for name, own in zip(self.names, std, strict=True) if name in self.identified}

    def in_terms(self, names: Sequence[str]) -> Array:
        """Return a factor of the covariance of the coefficients' terms, shape (len(names), n).

        Args:
            names: of the terms; those without a coefficient of that name have no error.
        """
        squares, along = np.linalg.eigh(self.covariance)
        factor = along * np.sqrt(np.maximum(squares, 0.0))
        own = dict(zip(self.names, factor, strict=True))
        if COULOMB in own and STATIC in own:
            # The term of the Coulomb friction moves both.
            own[STATIC] = own[STATIC] - own[COULOMB]
        nothing = np.zeros(len(self.names))
        return np.array([own.get(name, nothing) for name in names])


NO_ERRORS = RelativeErrors()


class Term(NamedTuple):
    """Sensitivity of a channel's residual to a relative error of one coefficient.

    Attributes:
        name: name of the coefficient.
        column: change of the residual per relative change, in the channel's unit, shape (n,).
        spread: standard deviation of the relative change from recording to recording that is always allowed for.
    """

    name: str
    column: Array
    spread: float


def varied(rig: Rig, part: float) -> Iterator[tuple[str, Rig]]:
    """Yield the name of each coefficient with an effect of its own, and the rig with it enlarged by a fraction of itself."""
    constant = kept(rig)
    for name, value in rig.plant._asdict().items():
        if value != 0.0 and (name == SCALE or f"plant.{name}" not in constant):
            yield name, rig._replace(plant=rig.plant._replace(**{name: value * (1.0 + part)}))
    for section in ("cylinder", "valve"):
        use = getattr(rig, section)
        for name, value in use.parameters._asdict().items() if use.parameters else ():
            if value != 0.0 and f"{section}.{name}" not in constant:
                parameters = use.parameters._replace(**{name: value * (1.0 + part)})
                yield name, rig._replace(**{section: use._replace(parameters=parameters)})
    for name, value in rig.friction._asdict().items():
        larger = tuple(v * (1.0 + part) for v in value) if isinstance(value, tuple) else value * (1.0 + part)
        if larger == value:
            continue
        friction = rig.friction._replace(**{name: larger})
        if name == COULOMB and STATIC in rig.friction._fields:
            # Static friction keeps its ratio, so that it is never the smaller one.
            friction = friction._replace(static_force=rig.friction.static_force * (1.0 + part))
        try:
            rig.friction_law.check(friction, name)
        except BadInput:
            # A coefficient that cannot vary alone, such as one of the weights that sum to 1.
            continue
        yield name, rig._replace(friction=friction)


def unit_of(rig: Rig, name: str) -> str:
    """Return the unit of a coefficient."""
    uses = [use.parameters for use in (rig.cylinder, rig.valve) if use.parameters]
    declared = [d for section in (rig.plant, rig.friction, *uses) for d in declarations(type(section))]
    return next((d.unit for d in declared if d.name == name), "1")


def terms(evidence: Evidence) -> dict[Channel, tuple[Term, ...]]:
    """Return the sensitivities of each channel's residual to errors of the coefficients."""
    comparison = evidence.comparison()
    found: dict[Channel, list[Term]] = {c: [] for c in evidence.channels}
    for name, rig in varied(evidence.rig, FIRST_STEP):
        residuals = evidence.residuals(comparison, rig)
        for c in evidence.channels:
            moved = (residuals.values[c] - evidence.base.values[c]) * evidence.floor[c]
            if np.any(moved) and np.all(np.isfinite(moved)):
                oily = name in WITH_OIL or name in rig.friction._fields
                spread = rules.SPREAD_WITH_OIL if oily else rules.SPREAD
                found[c].append(Term(name, moved / FIRST_STEP, spread))
    return {c: tuple(items) for c, items in found.items()}
