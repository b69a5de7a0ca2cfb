"""Coefficients of a whole rig that recordings can identify, with their paths in a rig file and their search coordinates."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.duals import exp
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.physics.valve.four_edges import EDGES
from ehls_ros.schema import Declaration, declarations

PLANT = (
    "valve_bandwidth", "valve_gain", "supply_pressure", "discharge_coefficient", "leakage_coefficient", "bulk_modulus",
    "moving_mass", "spring_stiffness",
)  # fmt: skip
"""Fitted coefficients of the plant."""

EDGE_GAINS = tuple(f"valve.gain_{edge}" for edge in EDGES)
OVERLAPS = tuple(f"valve.overlap_{edge}" for edge in EDGES)
ROUNDINGS = tuple(f"valve.rounding_{edge}" for edge in EDGES)
HOSES = ("cylinder.hose_compliance_a", "cylinder.hose_compliance_b")
LEAKAGES = ("cylinder.leakage_a", "cylinder.leakage_b")
TANK = "cylinder.tank_pressure"
SUPPLY = ("cylinder.supply_resistance", "cylinder.supply_time_constant")

LOAD = "effects.constant_load.force"
BIASES = ("effects.valve_null_bias.command", "effects.valve_null_bias.opening", LOAD)
"""Effects present in every real rig; they enter linearly."""

DEAD_ZONE = ("effects.valve_dead_zone.positive", "effects.valve_dead_zone.negative")
DELAY = "effects.command_delay.delay"
HYSTERESIS = ("effects.valve_hysteresis.width", "effects.valve_hysteresis.spread")
SECOND_ORDER = ("effects.valve_second_order.natural_frequency", "effects.valve_second_order.damping")
DROOP = ("effects.supply_pressure_droop.resistance", "effects.supply_pressure_droop.time_constant")

SHAPES = (HYSTERESIS[1], *SECOND_ORDER, DROOP[1])
"""Coefficients of an effect's shape, without a neutral value of their own."""

OF_ONE_PRESSURE = ("plant.discharge_coefficient", BIASES[1], *DEAD_ZONE, *DROOP)
"""Coefficients that two chambers do not have: the gains and overlaps of the edges, and the supply, take their place."""

OPTIONAL = (*DEAD_ZONE, DELAY, *HYSTERESIS, *SECOND_ORDER, *DROOP)
"""Effects fitted only if a stage requires them, since the residuals are not smooth at their neutral values."""

SENSORS = ("sensors.force.gain", "sensors.force.bias", "sensors.velocity.gain", "sensors.velocity.bias")
"""Sensor errors, identifiable if a second sensor measures the same: load pressure times piston area, or position."""

STATIC, COULOMB, STIFFNESS = "friction.static_force", "friction.coulomb_force", "friction.element_stiffness"
VISCOUS = "friction.viscous_coefficient"

RANGE = math.log(30.0)
"""Largest factor, as a logarithm, by which a positive coefficient may leave its given value."""

LARGEST_RATIO = math.log(10.0)
"""Largest ratio of static to Coulomb friction, as a logarithm."""

MIN_COULOMB = 1e-4
"""Least Coulomb friction: fraction of the rig's largest force at the start of a search, of the recorded force at its end."""

SMALL_LEAKAGE, SMALL_VISCOUS = 1e-3, 1e-2
"""Negligible leakage and viscous friction, as fractions of flow and force at the rig's limits."""

SMALL_DROOP, TYPICAL_LAG = 0.1, 0.03
"""Loss of supply pressure that counts as large, as a fraction of it at the rig's limit of velocity; and its typical lag [s]."""

LEAST = 1e-3
"""Least coordinate of a positive effect while it is fitted; at zero, the rig would not have it and no residual depend on it."""

SMALL_HOSE = 0.3
"""Compliance of a hose that counts as large, as a fraction of that of the oil in a chamber."""

SMALL_GAIN = 0.1
"""Deviation of a sensor's gain that counts as large."""


class Sizes(NamedTuple):
    """Magnitudes that count as large in the recordings, in SI units.

    Attributes:
        spool: spool displacement [m].
        force: driving force [N].
        velocity: of the piston [m/s].
    """

    spool: float
    force: float
    velocity: float


class Coefficient(NamedTuple):
    """A coefficient and its coordinate, in which a change of 1 is large.

    Attributes:
        path: dotted section and name in the rig file.
        unit: of its value.
        scale: value of a coordinate of 1; 0: the coordinate is the value's logarithm.
        low, high: range of the coordinate.
        given: the coordinate of the first guess.
        neutral: value of an effect or a sensor without this error; None for coefficients of every rig.
    """

    path: str
    unit: str
    scale: float
    low: float
    high: float
    given: float = 0.0
    neutral: float | None = None

    def coordinate(self, rig: Rig) -> float:
        """Return the coordinate in a rig."""
        value = read(rig, self.path)
        if self.path == STATIC:
            value /= read(rig, COULOMB)
        if self.scale:
            return value / self.scale
        return math.log(value) if value > 0.0 else self.low


def read(rig: Rig, path: str) -> float:
    """Return a coefficient's value: the sum for a list of stiffnesses, the neutral value for an absent effect."""
    section, name, *rest = path.split(".")
    if section == "effects":
        used = {use.name: use.parameters for use in rig.effects}
        return float(getattr(used.get(name, EFFECTS.load(name).Parameters()), rest[0]))
    if section == "sensors":
        return float(getattr(rig.sensors.get(name, Sensor()), rest[0]))
    value = getattr(_section(rig, section), name)
    return float(sum(value)) if isinstance(value, tuple) else float(value)


def _section(rig: Rig, section: str) -> Any:
    """Return the parameters of a section of the rig file."""
    found = getattr(rig, section)
    return found.parameters if section in ("cylinder", "valve") else found


def uses(rig: Rig, path: str) -> bool:
    """Return whether a rig has the effect that a coefficient belongs to, or it belongs to none."""
    return not effect_of(path) or effect_of(path) in {use.name for use in rig.effects}


def effect_of(path: str) -> str:
    """Return the name of the effect that a coefficient belongs to, empty if it belongs to none."""
    section, name, *_ = path.split(".")
    return name if section == "effects" else ""


def without(rig: Rig, paths: Iterable[str]) -> Rig:
    """Return a rig whose effects that some coefficients belong to are neutral, still among them."""
    names = {effect_of(path) for path in paths}
    neutral = (EffectUse(u.name, type(u.parameters)()) if u.name in names else u for u in rig.effects)
    return rig._replace(effects=tuple(neutral))


def acting(rig: Rig) -> Rig:
    """Return a rig without its neutral effects."""
    return rig._replace(effects=tuple(u for u in rig.effects if u.parameters != type(u.parameters)()))


def placed(rig: Rig, values: Mapping[str, Any]) -> Rig:
    """Return a rig with some coefficients replaced; effects that become neutral are removed.

    Args:
        rig: the rig.
        values: by path; numbers or duals.
    """
    sections: dict[str, dict[str, Any]] = {"plant": {}, "friction": {}, "cylinder": {}, "valve": {}}
    effects, sensors = dict[str, dict[str, Any]](), dict[str, dict[str, Any]]()
    for path, value in values.items():
        section, name, *rest = path.split(".")
        if rest:
            (effects if section == "effects" else sensors).setdefault(name, {})[rest[0]] = value
        else:
            sections[section][name] = value
    friction: dict[str, Any] = dict(sections["friction"])
    if "element_stiffness" in friction:
        factor = friction["element_stiffness"] / read(rig, STIFFNESS)
        friction["element_stiffness"] = tuple(k * factor for k in rig.friction.element_stiffness)
    if sections["cylinder"]:
        rig = rig.with_cylinder(**sections["cylinder"])
    if sections["valve"]:
        rig = rig.with_valve(**sections["valve"])
    return rig._replace(
        plant=rig.plant._replace(**sections["plant"]),
        friction=rig.friction._replace(**friction),
        effects=_with(rig.effects, effects),
        sensors={**rig.sensors, **{s: rig.sensors.get(s, Sensor())._replace(**new) for s, new in sensors.items()}},
    )


def _with(uses: Sequence[EffectUse], changes: Mapping[str, Mapping[str, Any]]) -> tuple[EffectUse, ...]:
    """Return effects with some parameters replaced; one that becomes neutral is left out."""
    added = [EffectUse(name, EFFECTS.load(name).Parameters()) for name in changes if name not in {use.name for use in uses}]
    out = [u._replace(parameters=u.parameters._replace(**changes.get(u.name, {}))) for u in (*uses, *added)]
    return tuple(u for u in out if u.name not in changes or not _is_neutral(u))


def _is_neutral(use: EffectUse) -> bool:
    """Return whether an effect does nothing: its size is neutral, whatever its shape."""
    neutral = EFFECTS.load(use.name).Parameters()
    of_size = [name for name in neutral._fields if f"effects.{use.name}.{name}" not in SHAPES] or neutral._fields
    return all(getattr(use.parameters, name) == getattr(neutral, name) for name in of_size)


def coefficients(rig: Rig, sizes: Sizes) -> tuple[Coefficient, ...]:
    """Return the coefficients of a rig that can be fitted.

    Args:
        rig: the first guess.
        sizes: large magnitudes in the recordings.
    """
    paths = [f"plant.{name}" for name in PLANT if name != "spring_stiffness" or rig.plant.spring_stiffness > 0.0]
    paths += _friction_paths(rig)
    paths += [*BIASES, *OPTIONAL, *SENSORS]
    if rig.cylinder.law.CHAMBERS:
        # A sharp edge stays one: its rounding has no influence to begin with.
        rounded = [path for path in ROUNDINGS if read(rig, path) > 0.0]
        paths = [path for path in paths if path not in OF_ONE_PRESSURE]
        paths += [*EDGE_GAINS, *OVERLAPS, *rounded, *HOSES, *LEAKAGES, TANK, *SUPPLY]
    found = [_coefficient(path, rig, sizes) for path in paths]
    return tuple(c._replace(given=min(max(c.coordinate(rig), c.low), c.high)) if uses(rig, c.path) else c for c in found)


def _friction_paths(rig: Rig) -> list[str]:
    """Return the paths of the friction model's coefficients, those identifiable from most data first."""
    values = rig.friction._asdict()
    paths = [f"friction.{name}" for name, value in values.items() if isinstance(value, float)]
    if "element_stiffness" in values:
        paths.append(STIFFNESS)
    return sorted(paths, key=lambda path: path not in (COULOMB, VISCOUS, STIFFNESS))


def _declared(path: str, rig: Rig) -> Declaration:
    section, name, *rest = path.split(".")
    if section == "effects":
        kind = EFFECTS.load(name).Parameters
    else:
        kind = Sensor if section == "sensors" else type(_section(rig, section))
    return next(d for d in declarations(kind) if d.name == (rest or [name])[0])


def _coefficient(path: str, rig: Rig, sizes: Sizes) -> Coefficient:
    declared = _declared(path, rig)
    low = -math.inf if declared.minimum is None else declared.minimum
    high = math.inf if declared.maximum is None else declared.maximum
    unit = declared.unit
    limits, plant = rig.limits, rig.plant
    if path == STATIC:
        return Coefficient(path, unit, 0.0, 0.0, LARGEST_RATIO)
    if path == STIFFNESS:
        unit = "N/m"
    scales = {
        "plant.leakage_coefficient": SMALL_LEAKAGE * plant.piston_area * limits.velocity / plant.supply_pressure,
        VISCOUS: SMALL_VISCOUS * limits.force / limits.velocity,
        "effects.valve_null_bias.command": sizes.spool,
        "effects.valve_null_bias.opening": sizes.spool,
        "effects.valve_dead_zone.positive": sizes.spool,
        "effects.valve_dead_zone.negative": sizes.spool,
        LOAD: sizes.force,
        DELAY: 1.0 / plant.valve_bandwidth,
        HYSTERESIS[0]: sizes.spool,
        HYSTERESIS[1]: 1.0,
        DROOP[0]: SMALL_DROOP * plant.supply_pressure / (plant.piston_area * limits.velocity),
        "sensors.force.gain": SMALL_GAIN,
        "sensors.force.bias": sizes.force,
        "sensors.velocity.gain": SMALL_GAIN,
        "sensors.velocity.bias": sizes.velocity,
        **dict.fromkeys(OVERLAPS, sizes.spool),
        **dict.fromkeys(LEAKAGES, SMALL_LEAKAGE * plant.piston_area * limits.velocity / plant.supply_pressure),
        **dict.fromkeys(HOSES, 0.25 * SMALL_HOSE * plant.total_volume / plant.bulk_modulus),
        TANK: SMALL_DROOP * plant.supply_pressure,
        SUPPLY[0]: SMALL_DROOP * plant.supply_pressure / (plant.piston_area * limits.velocity),
    }
    value = read(rig, path) or {SECOND_ORDER[0]: plant.valve_bandwidth, DROOP[1]: TYPICAL_LAG}.get(path, 0.0)
    # Of cylinder and valve, the additional ones are none where the file gives none.
    inherent = path.startswith(("plant.", "friction.")) or path in (*EDGE_GAINS, *ROUNDINGS, SUPPLY[1])
    inherent |= path.startswith(("cylinder.", "valve.")) and value != 0.0
    neutral = None if inherent or path in SHAPES else float(declared.default)
    if path in scales:
        scale = max(scales[path], abs(value) if neutral is None else 0.0)
        unit = {"sensors.force.bias": "N", "sensors.velocity.bias": "m/s"}.get(path, unit)
        lowest = LEAST if path in (DELAY, HYSTERESIS[0], DROOP[0]) else low / scale
        return Coefficient(path, unit, scale, lowest, high / scale, neutral=neutral)
    if path == COULOMB:
        value = max(value, MIN_COULOMB * limits.force)
    middle = math.log(value) if value > 0.0 else 0.0
    bottom = math.log(low) if low > 0.0 else -math.inf
    top = math.log(high) if 0.0 < high < math.inf else math.inf
    lowest = middle - RANGE
    if path == COULOMB:
        # Seals may have next to no friction, however large the rig.
        lowest = min(lowest, math.log(MIN_COULOMB * sizes.force))
    return Coefficient(path, unit, 0.0, max(lowest, bottom), min(middle + RANGE, top), middle, neutral)


def values_at(rig: Rig, chosen: Sequence[Coefficient], z: Iterable[Any]) -> dict[str, Any]:
    """Return the values of coefficients at coordinates ``z``, numbers or duals."""
    out = {c.path: x * c.scale if c.scale else exp(x) for c, x in zip(chosen, z, strict=True)}
    if STATIC in out:
        out[STATIC] *= out.get(COULOMB, read(rig, COULOMB))
    return out


def model_at(rig: Rig, chosen: Sequence[Coefficient], z: Iterable[Any]) -> Rig:
    """Return a rig with coefficients at coordinates ``z``, numbers or duals; static friction keeps its ratio to Coulomb's."""
    return placed(rig, with_ratio(rig, values_at(rig, chosen, z)))


def with_ratio(rig: Rig, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with static friction scaled along if only Coulomb friction changes."""
    out = dict(values)
    if COULOMB in out and STATIC not in out and "static_force" in rig.friction._fields:
        out[STATIC] = out[COULOMB] * read(rig, STATIC) / read(rig, COULOMB)
    return out


def slopes_at(rig: Rig, chosen: Sequence[Coefficient], z: Array) -> Array:
    """Return the derivatives of the values of coefficients by all coordinates, shape (coefficients, coefficients)."""
    values = values_at(rig, chosen, z.tolist())
    out = np.diag([c.scale or values[c.path] for c in chosen])
    paths = [c.path for c in chosen]
    if STATIC in paths and COULOMB in paths:
        out[paths.index(STATIC), paths.index(COULOMB)] = values[STATIC]
    return out
