"""Online tracking of the rig's coefficients, each with its interval or the reason why it is not identifiable.

The coefficients are fitted jointly, linearised around the model, to the sums over the last blocks. Which are identifiable
depends on the programme: the mass is not in slow motion, nor the bulk modulus at constant pressure.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.coefficients import unit_of
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import declarations

NOT_EXCITED = "not excited by the programme"


class Tracked(NamedTuple):
    """A tracked coefficient.

    Attributes:
        effect: effect whose parameter represents its departure.
        parameter: that parameter.
        words: name in reports.
        coefficient: its key in the plant or the friction; empty for an error, whose correct value is 0.
        relative: whether the parameter is a factor on its correct value.
        limit: limit of the rig to which an error is relative; empty: the error is absolute.
    """

    effect: str
    parameter: str
    words: str
    coefficient: str = ""
    relative: bool = False
    limit: str = ""

    def given(self, rig: Rig) -> float:
        """Return its value in the rig's model, effects included."""
        if self.coefficient:
            whole = rig.effective()
            found = {**whole.plant._asdict(), **whole.friction._asdict()}.get(self.coefficient)
            return float(found) if isinstance(found, float) else 0.0
        used = {use.name: use.parameters for use in rig.effects}
        parameters = used.get(self.effect, EFFECTS.load(self.effect).Parameters())
        return float(getattr(parameters, self.parameter))

    def unit(self, rig: Rig) -> str:
        """Return the unit of the coefficient."""
        if self.coefficient:
            return unit_of(rig, self.coefficient)
        declared = declarations(EFFECTS.load(self.effect).Parameters)
        return next(d.unit for d in declared if d.name == self.parameter)

    def needed(self, rig: Rig) -> float:
        """Return the largest standard error with which it counts as identified."""
        if self.coefficient:
            return rules.TOLD_COEFFICIENT * abs(self.given(rig))
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
    "friction_asymmetry": Tracked("coulomb_asymmetry", "offset", "asymmetry of the friction", limit="force"),
    "spring_stiffness": Tracked("spring_rate_shift", "added", "spring rate", "spring_stiffness"),
    "moving_mass": Tracked("mass_shift", "factor", "moving mass", "moving_mass", relative=True),
    "pressure_sensor_bias": Tracked("pressure_sensor_bias", "bias", "offset of the pressure sensor", limit="load_pressure"),
    "pressure_sensor_gain": Tracked("pressure_sensor_gain", "gain", "gain of the pressure sensor", relative=True),
    "position_sensor_gain": Tracked("position_sensor_gain", "gain", "gain of the position sensor", relative=True),
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
    directions: Sequence[Direction], numbers: Mapping[str, int], rig: Rig, score: Array, normal: Array, scatter: Array
) -> tuple[Reading, ...]:
    """Fit all coefficients jointly to the sums of blocks.

    Args:
        directions: of the scores.
        numbers: of the tracked ones, from :func:`tracked`; a coefficient without one is not excited by the programme.
        rig: the model to which the scores refer.
        score: summed scores of the tracked directions, in the order of ``numbers``, shape (n,).
        normal: summed products of their changes, shape (n, n).
        scatter: standard deviation of their scores, by the root of the information, shape (n,).
    """
    moved = np.sqrt(np.maximum(np.diag(normal), 0.0))
    seen = moved > 0.0
    size = np.zeros(len(moved))
    deviation = np.full(len(moved), np.inf)
    partners = [""] * len(moved)
    names = list(numbers)
    if np.any(seen):
        scaled = normal[np.ix_(seen, seen)] / np.outer(moved[seen], moved[seen])
        inverse = np.linalg.inv(scaled + rules.INSEPARABLE * np.eye(len(scaled)))
        size[seen] = inverse @ (score[seen] / moved[seen]) / moved[seen]
        deviation[seen] = scatter[seen] * np.sqrt(np.maximum(np.diag(inverse), 0.0)) / moved[seen]
        correlation = inverse / np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
        np.fill_diagonal(correlation, 0.0)
        index = [place for place in range(len(names)) if seen[place]]
        for row, place in enumerate(index):
            partners[place] = names[index[int(np.argmax(np.abs(correlation[row])))]]
    out = []
    places = {name: place for place, name in enumerate(numbers)}
    for name, coefficient in COEFFICIENTS.items():
        given, unit = coefficient.given(rig), coefficient.unit(rig)
        if name not in places:
            out.append(Reading(name, given, math.inf, unit, NOT_EXCITED))
            continue
        place, direction = places[name], directions[numbers[name]]
        scale = abs(direction.step) * (abs(given) if coefficient.relative else 1.0)
        change, error = float(size[place]) * math.copysign(scale, direction.step), float(deviation[place]) * scale
        why_not = NOT_EXCITED if not seen[place] else ""
        if not why_not and error > coefficient.needed(rig):
            partner = COEFFICIENTS[partners[place]].words if partners[place] else "others"
            why_not = f"not distinguishable from the {partner} in this programme"
        out.append(Reading(name, given if why_not else given + change, math.inf if why_not else error, unit, why_not))
    return tuple(out)
