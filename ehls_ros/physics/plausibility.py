"""Plausibility of a rig's parameters and of a run's results.

Parameters that are each in range may still describe no real rig: a pressure in bar instead of pascals, an area in mm².
:data:`RANGES` and :data:`RELATIONS` check a rig before a run, :mod:`ehls_ros.physics.integration_step` checks that a step
resolves it. :data:`WARNING_FACTOR` and :data:`ABORT_FACTOR` define how far a run may exceed the rig's limits.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.physics.parameters import Limits
from ehls_ros.physics.rig import CHAMBER_SENSED, SENSED, Rig, check_effects
from ehls_ros.schema import declarations
from ehls_ros.units import QUANTITIES, UNITS, size

WARNING_FACTOR = 1.05
"""Multiple of a rig's limit above which a run is reported to exceed it. The paper's piston exceeds its stroke by 1.4 %."""

ABORT_FACTOR = 10.0
"""Multiple of a rig's limit above which a reading is impossible and the run ends; impacts of the servo's beam reach 2.4."""

RANGES: dict[tuple[str, str], tuple[float, float]] = {
    ("plant", "supply_pressure"): (1e5, 2e8),
    ("plant", "oil_density"): (300.0, 3e3),
    ("plant", "bulk_modulus"): (1e6, 1e11),
    ("plant", "discharge_coefficient"): (0.01, 10.0),
    ("plant", "valve_area_gradient"): (1e-6, 1.0),
    ("plant", "leakage_coefficient"): (0.0, 1e-8),
    ("plant", "total_volume"): (1e-8, 1.0),
    ("plant", "moving_mass"): (0.1, 1e6),
    ("plant", "piston_area"): (1e-6, 1.0),
    ("plant", "arm_length"): (1e-3, 100.0),
    ("plant", "spring_stiffness"): (0.0, 1e10),
    ("plant", "viscous_damping"): (0.0, 1e7),
    ("plant", "valve_bandwidth"): (0.1, 1e5),
    ("cylinder", "area_a"): (1e-6, 1.0),
    ("cylinder", "area_b"): (1e-6, 1.0),
    ("cylinder", "volume_a"): (1e-8, 1.0),
    ("cylinder", "volume_b"): (1e-8, 1.0),
    ("friction", "stribeck_velocity"): (1e-6, 1.0),
    ("friction", "stribeck_exponent"): (0.01, 4.0),
    ("friction", "viscous_coefficient"): (0.0, 1e7),
    ("friction", "attraction_rate"): (1e-3, 1e9),
    ("limits", "spool"): (1e-7, 1.0),
    ("limits", "velocity"): (1e-4, 100.0),
}
"""Ranges that include all hydraulic rigs with a margin; zero is included if the equations allow it."""

MISTAKEN = (
    "bar", "MPa", "kPa", "psi", "mm", "cm", "in", "cm^2", "mm^2", "l", "cm^3", "l/min", "mm/s",
    "t", "g", "g/cm^3", "kN", "N/mm", "kN/m", "N s/mm", "Hz", "kHz",
)  # fmt: skip
"""Units in which values are often given although the SI unit is required; of equally likely ones the first is reported."""


def mistaken_for(unit: str) -> Mapping[str, float]:
    """Return the units commonly confused with an SI unit, and their sizes in it."""
    quantity = QUANTITIES.get(unit)
    return {other: size(other) for other in MISTAKEN if UNITS[other].quantity == quantity}


class Relation(NamedTuple):
    """A quantity derived from several parameters of a rig.

    Attributes:
        value: function that computes it.
        low: smallest plausible value.
        high: largest plausible value.
        what: name of the quantity, with the keys it depends on.
        advice: advice on the values to check.
    """

    value: Callable[[Rig], float]
    low: float
    high: float
    what: str
    advice: str


def largest_force(rig: Rig) -> float:
    """Return the larger one of the forces in both directions that the supply can hold [N]."""
    return max(map(abs, rig.forces()))


def _stroke(rig: Rig) -> float:
    return rig.limits.position[1] - rig.limits.position[0]


RELATIONS = (
    Relation(
        lambda rig: rig.limits.load_pressure / rig.plant.supply_pressure,
        0.01,
        100.0,
        "limits.load_pressure over plant.supply_pressure",
        "both in Pa; 1 bar is 1e5 Pa, 1 MPa is 1e6 Pa",
    ),
    Relation(
        lambda rig: rig.limits.force / largest_force(rig),
        0.01,
        100.0,
        "limits.force relative to plant.supply_pressure times plant.piston_area",
        "N, Pa and m^2; 1 mm^2 is 1e-6 m^2, 1 kN is 1e3 N, 1 bar is 1e5 Pa",
    ),
    Relation(
        lambda rig: rig.friction_level(0.0) / largest_force(rig),
        0.0,
        1.0,
        "break-away force, friction.static_force or coulomb_force, relative to plant.supply_pressure times plant.piston_area",
        "a friction in N that the cylinder can overcome",
    ),
    Relation(
        lambda rig: rig.plant.moving_mass * abs(rig.plant.gravity) / largest_force(rig),
        0.0,
        1.0,
        "weight of plant.moving_mass relative to plant.supply_pressure times plant.piston_area",
        "a mass in kg that the cylinder can hold",
    ),
    Relation(
        _stroke,
        1e-4,
        100.0,
        "stroke in m between the bounds of limits.position",
        "m; 1 mm is 1e-3 m",
    ),
    Relation(
        lambda rig: rig.friction_law.break_away(rig.friction) / _stroke(rig),
        0.0,
        0.1,
        "travel to break-away, friction force over presliding stiffness, as a fraction of the stroke",
        "a stiffness in N/m; 1 N/mm is 1e3 N/m",
    ),
    Relation(
        lambda rig: rig.plant.total_volume / (rig.plant.piston_area * _stroke(rig)),
        0.01,
        1e3,
        "plant.total_volume over plant.piston_area times the stroke",
        "m^3, m^2 and m; 1 l is 1e-3 m^3, 1 mm^2 is 1e-6 m^2, 1 mm is 1e-3 m",
    ),
    Relation(
        lambda rig: rig.plant.valve_gain * rig.limits.spool,
        1e-7,
        1.0,
        "largest spool displacement in m, plant.valve_gain times limits.spool",
        "m; 1 mm is 1e-3 m",
    ),
)
"""Relations between a rig's parameters."""

SCALES: dict[str, Callable[[Rig], float]] = {
    "position": _stroke,
    "velocity": lambda rig: rig.limits.velocity,
    "load_pressure": lambda rig: max(rig.limits.load_pressure, rig.plant.supply_pressure),
    "spool_position": lambda rig: rig.limits.spool * max(1.0, rig.plant.valve_gain),
    "force": lambda rig: max(rig.limits.force, largest_force(rig)),
    "supply_pressure": lambda rig: rig.plant.supply_pressure,
    "oil_temperature": lambda rig: 450.0,
    **dict.fromkeys(CHAMBER_SENSED, lambda rig: max(rig.limits.load_pressure, rig.plant.supply_pressure)),
}
"""Largest value of each signal, the bound on noise, resolution and bias of its sensor."""

GAINS = (0.01, 100.0)
"""Smallest and largest plausible gain of a sensor."""


def check_rig(rig: Rig, where: str) -> None:
    """Check that a rig's parameters are plausible.

    Args:
        rig: a rig whose parameters are each in range.
        where: the file, for error messages.

    Raises:
        BadInput: the first implausible parameter or relation, or an effect without a coefficient to act on.
    """
    # Those of the plant may follow from the cylinder's.
    for section, use in (("cylinder", rig.cylinder), ("valve", rig.valve)):
        if use.parameters:
            check_ranges(use.parameters, section, f"{where}: {section}")
    for section in ("plant", "friction", "limits"):
        check_ranges(getattr(rig, section), section, f"{where}: {section}")
    rig.cylinder.law.check_stroke(rig.cylinder.parameters, rig.limits.position, f"{where}: cylinder")
    check_effects(rig, f"{where}: effects")
    for relation in RELATIONS:
        value = relation.value(rig)
        if not relation.low <= value <= relation.high:
            expected = f"{relation.low:g} to {relation.high:g} ({relation.advice})"
            raise BadInput(f"{relation.what} is {value:.3g}", where, expected)
    for signal, sensor in rig.sensors.items():
        largest = SCALES[signal](rig)
        for key in ("noise_std", "resolution", "bias"):
            value = getattr(sensor, key)
            if abs(value) > largest:
                expected = f"at most {largest:g}, the largest value of the signal, in SI units"
                raise BadInput(f"{key} is {value:g}", f"{where}: sensors: {signal}", expected)
        if not GAINS[0] <= sensor.gain <= GAINS[1]:
            expected = f"{GAINS[0]:g} to {GAINS[1]:g}, with readings in SI units"
            raise BadInput(f"gain is {sensor.gain:g}", f"{where}: sensors: {signal}", expected)


def check_ranges(parameters: Any, section: str, where: str) -> None:
    """Check parameters against :data:`RANGES`.

    Args:
        parameters: a section of a rig, or other parameters whose fields have the same names and meaning.
        section: name of the section.
        where: file and section, for error messages.

    Raises:
        BadInput: the first parameter out of range.
    """
    for key, value in parameters._asdict().items():
        if (section, key) not in RANGES:
            continue
        low, high = RANGES[section, key]
        if not low <= value <= high:
            unit = units_of(type(parameters))[key]
            shown = "" if unit == "1" else f" {unit}"
            expected = f"{low:g} to {high:g}{shown}{_likely(value, unit, low, high)}"
            raise BadInput(f"{key} is {value:g}{shown}", where, expected)


def _likely(value: float, unit: str, low: float, high: float) -> str:
    """Return the other units that may have been meant, as text; empty if none fits."""
    meant = [
        f"{value:g} {name} is {value * factor:g} {unit}"
        for name, factor in mistaken_for(unit).items()
        if low <= value * factor <= high
    ]
    return f"; {', '.join(meant)}" if meant else ""


def units_of(parameters: Any) -> Mapping[str, str]:
    """Return the unit of each field of a parameter set."""
    return _units_of(parameters)


@cache
def _units_of(parameters: Any) -> Mapping[str, str]:
    return MappingProxyType({declared.name: declared.unit for declared in declarations(parameters)})


SIGNAL_RANGES: dict[str, tuple[Callable[[Rig], tuple[float, float]], str]] = {
    "force": (
        Rig.forces,
        "the force of plant.supply_pressure on the piston; is it in N?",
    ),
    "position": (lambda rig: rig.limits.position, "limits.position; is it in m?"),
}
"""By kind of a reference or disturbance: function for the rig's range, and the range as text."""

RANGE_FACTOR, DISTURBANCE_FORCE_FACTOR = 2.0, 10.0
"""Largest plausible multiple of that range about its middle, and of the range of a disturbance force. A signal beyond the range
but within the multiple only causes a warning."""


def check_signal(rows: Array, part: str, kind: str, rig: Rig, period: float, where: str) -> None:
    """Check that a reference or disturbance suits the rig and is resolved by the control period.

    Args:
        rows: value, first derivative and possibly more of the signal during the experiment, shape (n, 2 or more).
        part: ``reference`` or ``disturbance``.
        kind: ``force`` or ``position``.
        rig: the rig.
        period: control period [s].
        where: the file and section, for error messages.

    Raises:
        BadInput: the signal is not finite, too large or too fast.
    """
    unit = LIMIT_UNITS[kind]
    value, rate = rows[:, 0], rows[:, 1]
    if not np.all(np.isfinite(rows)):
        raise BadInput(f"the {part} is not always finite", where, "parameters that give finite numbers")
    bounds, of = SIGNAL_RANGES[kind]
    factor = DISTURBANCE_FORCE_FACTOR if (part, kind) == ("disturbance", "force") else RANGE_FACTOR
    low, high = bounds(rig)
    away = np.abs(value - 0.5 * (low + high))
    farthest = float(value[np.argmax(away)])
    if away.max() > factor * 0.5 * (high - low):
        expected = f"at most {factor:g} times {low:g} to {high:g} {unit}, {of}"
        raise BadInput(f"the {part} reaches {farthest:g} {unit}", where, expected)
    change, span = float(np.abs(rate).max()) * period, 0.5 * float(np.ptp(value))
    if change > math.pi * span and change > 0.0 and span > 0.0:
        expected = "a lower frequency or a shorter control_period, for at least two cycles per period of the signal"
        raise BadInput(
            f"the {part} changes at {change / period:g} {unit}/s, too fast for cycles of {period:g} s", where, expected
        )


class Exceedance(NamedTuple):
    """A reading beyond its limit.

    Attributes:
        row: index of the reading.
        what: signal, value and limit as text.
    """

    row: int
    what: str


LIMIT_UNITS = {"position": "m", "velocity": "m/s", "load_pressure": "Pa", "force": "N"}
"""Units of the signals that have limits."""


def within(limits: Limits, signal: str) -> tuple[float, float]:
    """Return the smallest and largest permitted value of a signal of :data:`LIMIT_UNITS`."""
    limit = getattr(limits, signal)
    return (limit[0], limit[1]) if signal == "position" else (-limit, limit)


def excess(values: Array, limits: Limits, signal: str) -> Array:
    """Return the distance of readings from the middle of the permitted range, relative to half the range.

    Args:
        values: readings, any shape.
        limits: the rig's limits.
        signal: one of :data:`LIMIT_UNITS`.
    """
    middle, half = _range(limits, signal)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.abs(values - middle) / half


def _range(limits: Limits, signal: str) -> tuple[float, float]:
    """Return the middle of a signal's permitted range, and half of the range."""
    low, high = within(limits, signal)
    return 0.5 * (low + high), 0.5 * (high - low)


def beyond(values: Array, limits: Limits, signal: str, factor: float) -> Exceedance | None:
    """Return the reading farthest beyond a rig's limits, or None if all are within a multiple of them; NaN is skipped.

    Args:
        values: readings, shape (n,).
        limits: the rig's limits.
        signal: one of :data:`LIMIT_UNITS`.
        factor: multiple of half the permitted range.
    """
    away = excess(values, limits, signal)
    if not np.any(away > factor):
        return None
    row = int(np.nanargmax(away))
    return Exceedance(row, _compared_to_limit(float(values[row]), limits, signal))


def _compared_to_limit(value: float, limits: Limits, signal: str) -> str:
    low, high = within(limits, signal)
    limit = low if value < 0.5 * (low + high) else high
    unit = LIMIT_UNITS[signal]
    return f"{signal.replace('_', ' ')} {value:.4g} {unit}, where the rig's limit is {limit:g} {unit}"


ADVICE = (
    "try a smaller integration_step; otherwise check the units of rig, reference and disturbance, and the controller's "
    "parameters"
)
"""Advice for a state that has diverged."""


def possible_range(limits: Limits, columns: int) -> tuple[Array, Array]:
    """Return the middle and half the width of the range in which each reading is possible.

    Args:
        limits: the rig's limits.
        columns: number of readings; those after ``SENSED`` must only be finite.
    """
    middle, farthest = np.zeros(columns), np.full(columns, np.finfo(np.float64).max)
    for signal in LIMIT_UNITS:
        column = SENSED.index(signal)
        middle[column], half = _range(limits, signal)
        farthest[column] = ABORT_FACTOR * half
    return middle, farthest


def implausible(readings: Array, limits: Limits) -> Exceedance | None:
    """Return the first impossible reading of a run: not finite, or :data:`ABORT_FACTOR` times beyond its limits.

    Args:
        readings: in the order of ``SENSED``, shape (n, signals); further columns are only checked for finite numbers.
        limits: the rig's limits.

    Returns:
        Its row and the fault as text, with advice; of several signals the farthest out. None if all are possible.
    """
    middle, farthest = possible_range(limits, readings.shape[1])
    possible = np.abs(readings - middle) <= farthest
    if possible.all():
        return None
    row = int(np.argmin(possible.all(axis=1)))
    if not np.isfinite(readings[row]).all():
        return Exceedance(row, f"the rig's state is no longer finite; {ADVICE}")
    values = {signal: readings[row, SENSED.index(signal)] for signal in LIMIT_UNITS}
    worst = max(values, key=lambda signal: float(excess(values[signal], limits, signal)))
    compared = _compared_to_limit(float(values[worst]), limits, worst)
    return Exceedance(row, f"the rig's state is impossible: {compared}; {ADVICE}")
