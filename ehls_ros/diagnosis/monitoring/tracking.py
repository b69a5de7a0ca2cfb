"""Online tracking of the rig's coefficients, each with its interval or the reason why it is not identifiable.

The coefficients are fitted jointly, linearised around the identified rig, to the sums over the last blocks. Which are
identifiable depends on the programme: the mass is not in slow motion, nor the bulk modulus at constant pressure. A value far
from the rig is not valid: the rig has to be identified again.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import Declaration, declarations

NOT_EXCITED = "not excited by the programme"
NOT_SEPARATE = "not separable from the others by an identification"
MOVED = "too far from the identified rig for its linearisation"
NOT_PHYSICAL = "its estimate is outside the physical range"

VALIDITY = 0.1
"""Change of a coefficient beyond which the linearisation is not valid, as a fraction of its value.

The error of a linearised factor is the square of its change: 1 % of the value here, as the bulk modulus is in the denominator.
"""

INSIDE = 2.0
"""Standard errors by which an estimate may be outside the physical range; it is told as the end of the range."""


class Tracked(NamedTuple):
    """A tracked coefficient.

    Attributes:
        effect: effect whose parameter represents its departure.
        parameter: that parameter.
        words: name in reports.
        coefficient: its key in the plant or the friction; empty for an error, whose correct value is 0.
        relative: whether the parameter is a factor on its correct value.
        limit: limit of the rig to which an error is relative; empty: the error is absolute.
        only_named: whether an identification does not fit it, since it would take up errors of the model's form. It is fitted
            once a diagnosis has named its effect, which the model then has.
    """

    effect: str
    parameter: str
    words: str
    coefficient: str = ""
    relative: bool = False
    limit: str = ""
    only_named: bool = False

    def is_fitted(self, rig: Rig) -> bool:
        """Return whether it is fitted around a model."""
        return not self.only_named or any(use.name == self.effect for use in rig.effects)

    @property
    def path(self) -> str:
        """Dotted section and name in a rig file, as of :mod:`ehls_ros.identification.rig_coefficients`."""
        if not self.coefficient:
            return f"effects.{self.effect}.{self.parameter}"
        return f"{'plant' if self.coefficient in Plant._fields else 'friction'}.{self.coefficient}"

    def given(self, rig: Rig) -> float:
        """Return its value in the rig's model, effects included."""
        if self.coefficient:
            whole = rig.effective()
            found = {**whole.plant._asdict(), **whole.friction._asdict()}.get(self.coefficient)
            return float(found) if isinstance(found, float) else 0.0
        used = {use.name: use.parameters for use in rig.effects}
        parameters = used.get(self.effect, EFFECTS.load(self.effect).Parameters())
        return float(getattr(parameters, self.parameter))

    def changed(self, value: float, change: Estimate) -> Estimate:
        """Return its value after a change of the parameter, from its value before."""
        scale = value if self.relative else 1.0
        moved = value * change.value if self.relative else value + change.value
        return Estimate(moved, abs(scale) * change.std, change.unit)

    def change(self, value: float, now: Estimate, error: float = 0.0) -> Estimate:
        """Return the change of the parameter, from its value before, with the standard error of that, and its value now."""
        if self.relative:
            ratio = now.value / value
            return Estimate(ratio, math.hypot(now.std, ratio * error) / abs(value), "1")
        return Estimate(now.value - value, math.hypot(now.std, error), now.unit)

    def unit(self, rig: Rig) -> str:
        """Return the unit of the coefficient."""
        found = self._declared(rig)
        return "1" if found is None else found.unit

    def bounds(self, rig: Rig) -> tuple[float, float]:
        """Return the physical range of the coefficient; that of an error is unlimited."""
        found = self._declared(rig) if self.coefficient else None
        low, high = (None, None) if found is None else (found.minimum, found.maximum)
        return -math.inf if low is None else low, math.inf if high is None else high

    def _declared(self, rig: Rig) -> Declaration | None:
        kinds = (type(rig.plant), type(rig.friction)) if self.coefficient else (EFFECTS.load(self.effect).Parameters,)
        name = self.coefficient or self.parameter
        return next((d for kind in kinds for d in declarations(kind) if d.name == name), None)

    def needed(self, rig: Rig, scale: float = 0.0) -> float:
        """Return the largest standard error with which it counts as identified, at least for a value of ``scale``."""
        if self.coefficient:
            return rules.TOLD_COEFFICIENT * max(abs(self.given(rig)), scale)
        return rules.TOLD_ERROR * (float(getattr(rig.limits, self.limit)) if self.limit else 1.0)


COEFFICIENTS: Mapping[str, Tracked] = {
    "leakage_coefficient": Tracked("internal_leakage_shift", "added", "internal leakage", "leakage_coefficient"),
    "bulk_modulus": Tracked("bulk_modulus_shift", "factor", "bulk modulus", "bulk_modulus", relative=True),
    "discharge_coefficient": Tracked("valve_gain_shift", "flow_gain", "flow gain", "discharge_coefficient", relative=True),
    "valve_gain": Tracked("valve_gain_shift", "gain", "valve gain", "valve_gain", relative=True),
    "valve_null": Tracked("valve_null_bias", "command", "null of the spool", limit="spool"),
    "orifice_null": Tracked("valve_null_bias", "opening", "null of the orifice", limit="spool"),
    "coulomb_force": Tracked("coulomb_shift", "offset", "friction level", "coulomb_force"),
    "viscous_coefficient": Tracked("viscous_shift", "added", "viscous friction", "viscous_coefficient"),
    "friction_asymmetry": Tracked("coulomb_asymmetry", "offset", "asymmetry of the friction", limit="force", only_named=True),
    "spring_stiffness": Tracked("spring_rate_shift", "added", "spring rate", "spring_stiffness"),
    "moving_mass": Tracked("mass_shift", "factor", "moving mass", "moving_mass", relative=True),
    "pressure_sensor_bias": Tracked(
        "pressure_sensor_bias", "bias", "offset of the pressure sensor", limit="load_pressure", only_named=True
    ),
    "pressure_sensor_gain": Tracked(
        "pressure_sensor_gain", "gain", "gain of the pressure sensor", relative=True, only_named=True
    ),
    "position_sensor_gain": Tracked(
        "position_sensor_gain", "gain", "gain of the position sensor", relative=True, only_named=True
    ),
    "constant_load": Tracked("constant_load", "force", "constant load", limit="force"),
}
"""Tracked coefficients, by their names in topic, file and page."""


WANTED = frozenset((coefficient.effect, coefficient.parameter) for coefficient in COEFFICIENTS.values())
"""Effects and parameters that represent a coefficient's departure; these are always monitored."""


class Reading(NamedTuple):
    """Estimate of a coefficient from the last blocks.

    Attributes:
        name: its name in :data:`COEFFICIENTS`.
        value: its value; that of the model if it is not identifiable.
        deviation: standard error; infinite if it is not identifiable.
        unit: of both.
        why_not: why it is not identifiable; empty if it is.
    """

    name: str
    value: float
    deviation: float
    unit: str
    why_not: str = ""

    @property
    def identified(self) -> bool:
        """Whether the data identify the coefficient."""
        return not self.why_not


class IdentifiedRig(NamedTuple):
    """The identification around which the coefficients are linearised, by the coefficients' names.

    Attributes:
        rig: the identified rig, or the rig file's if it does not differ.
        deviation: standard errors of its values: of those identified, otherwise of the model's approximation.
        scale: small values that count as large enough to be identified.
        why_not: reasons for the coefficients that are not identifiable.
    """

    rig: Rig
    deviation: Mapping[str, float] = {}
    scale: Mapping[str, float] = {}
    why_not: Mapping[str, str] = {}


class PastReadings(NamedTuple):
    """Past readings of the coefficients.

    Attributes:
        time: end of the averaged blocks [s].
        readings: readings of all coefficients.
    """

    time: float
    readings: tuple[Reading, ...]


def tracked(directions: Sequence[Direction]) -> dict[str, int]:
    """Return the number of the direction that represents each coefficient, if it has one."""
    out = {}
    for name, coefficient in COEFFICIENTS.items():
        for number, direction in enumerate(directions):
            if direction.name == coefficient.effect and direction.parameter == coefficient.parameter and name not in out:
                out[name] = number
    return out


def readings(
    directions: Sequence[Direction],
    numbers: Mapping[str, int],
    identified: IdentifiedRig,
    blocks: Sequence[Scores],
    scatter: Array,
) -> tuple[Reading, ...]:
    """Fit all coefficients jointly to blocks.

    Args:
        directions: of the blocks.
        numbers: of the tracked ones, from :func:`tracked`; a coefficient without one is not excited by the programme.
        identified: the model to which the blocks refer, and its identification.
        blocks: the blocks, with the tracked directions in the order of ``numbers``.
        scatter: standard deviation of their scores on the healthy rig, by the root of the information, shape (n,).
    """
    pulls, normals = np.array([b.pull for b in blocks]), np.array([b.normal for b in blocks])
    moved = np.sqrt(np.maximum(np.einsum("bii->i", normals), 0.0))
    seen = moved > 0.0
    size, deviation, partners = np.zeros(len(moved)), np.full(len(moved), np.inf), [""] * len(moved)
    names = list(numbers)
    index = [place for place, name in enumerate(names) if seen[place] and COEFFICIENTS[name].is_fitted(identified.rig)]
    if index:
        unit = moved[index]
        fit = _joint_fit(pulls[:, index] / unit, normals[:, index][:, :, index] / np.outer(unit, unit), scatter[index])
        size[index], deviation[index] = fit.sizes / unit, fit.deviations / unit
        for row, place in enumerate(index):
            partners[place] = names[index[int(fit.partners[row])]]
    out = []
    places = {name: place for place, name in enumerate(numbers)}
    for name, coefficient in COEFFICIENTS.items():
        given = coefficient.given(identified.rig)
        reading = Reading(name, given, math.inf, coefficient.unit(identified.rig), NOT_EXCITED)
        if not coefficient.is_fitted(identified.rig):
            reading = reading._replace(why_not=NOT_SEPARATE)
        elif name in places and seen[places[name]]:
            place, direction = places[name], directions[numbers[name]]
            scale = abs(direction.step) * (abs(given) if coefficient.relative else 1.0)
            change = float(size[place]) * math.copysign(scale, direction.step)
            error = math.hypot(float(deviation[place]) * scale, identified.deviation.get(name, 0.0))
            partner = COEFFICIENTS[partners[place]].words if partners[place] else "others"
            indistinct = f"not distinguishable from the {partner} in this programme"
            reading = _judged(identified, name, given + change, error, indistinct)
        out.append(reading)
    return tuple(out)


def _judged(identified: IdentifiedRig, name: str, value: float, error: float, indistinct: str) -> Reading:
    """Return the reading of a coefficient; one that the identification would not give has its reason."""
    coefficient, scale = COEFFICIENTS[name], identified.scale.get(name, 0.0)
    given, unit = coefficient.given(identified.rig), coefficient.unit(identified.rig)
    low, high = coefficient.bounds(identified.rig)
    beyond = max(low - value, value - high, 0.0)
    is_factor = bool(coefficient.coefficient) or coefficient.relative
    why_not = ""
    if error > coefficient.needed(identified.rig, scale):
        why_not = indistinct
    elif is_factor and abs(value - given) > VALIDITY * max(abs(given), scale) + error:
        why_not = MOVED
    elif beyond > INSIDE * error:
        why_not = NOT_PHYSICAL
    elif name in identified.why_not:
        why_not = identified.why_not[name]
    if why_not:
        return Reading(name, given, math.inf, unit, why_not)
    return Reading(name, min(max(value, low), high), error, unit)


class _JointFit(NamedTuple):
    """Joint fit of scaled directions; each attribute has the shape (n,).

    Attributes:
        sizes: fitted sizes.
        deviations: their standard errors.
        partners: number of the direction with the largest correlation.
    """

    sizes: Array
    deviations: Array
    partners: NDArray[np.intp]


def _joint_fit(pulls: Array, normals: Array, scatter: Array) -> _JointFit:
    """Fit directions, in units of their information, to blocks.

    The variance is the larger one of that known from the healthy rig's blocks and the jackknife's over these blocks (CR3 of
    Cameron and Miller, Journal of Human Resources 50, 2015), which includes correlated windows and errors of the model's form.

    Args:
        pulls: shape (blocks, n).
        normals: shape (blocks, n, n).
        scatter: shape (n,).
    """
    count, size = pulls.shape
    total = np.sum(normals, axis=0) + rules.INSEPARABLE * np.eye(size)
    inverse = np.linalg.inv(total)
    sizes = inverse @ np.sum(pulls, axis=0)
    variance = scatter**2 * np.maximum(np.diag(inverse), 0.0)
    if count > size:
        rest = pulls - normals @ sizes
        shifts = np.linalg.solve(total - normals, rest[:, :, np.newaxis])[:, :, 0]
        variance = np.maximum(variance, np.sum(shifts**2, axis=0) * count / (count - size))
    deviation = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    correlation = inverse / np.outer(deviation, deviation)
    np.fill_diagonal(correlation, 0.0)
    return _JointFit(sizes, np.sqrt(variance), np.argmax(np.abs(correlation), axis=1))


def identified_readings(identified: IdentifiedRig, values: Mapping[str, Estimate]) -> tuple[Reading, ...]:
    """Return the readings of an identification.

    Args:
        identified: the identified rig.
        values: the identified coefficients, by their names.
    """
    out = []
    for name, coefficient in COEFFICIENTS.items():
        found, unit = values.get(name), coefficient.unit(identified.rig)
        if found is not None:
            out.append(Reading(name, found.value, found.std, unit))
        else:
            reason = identified.why_not.get(name, NOT_SEPARATE)
            out.append(Reading(name, coefficient.given(identified.rig), math.inf, unit, reason))
    return tuple(out)
