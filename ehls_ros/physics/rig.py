"""The rig description shared by simulator, controller, identification and diagnosis."""

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple, get_type_hints

from ehls_ros.arrays import in_python
from ehls_ros.duals.interpreted import value_of
from ehls_ros.errors import BadInput, one_of
from ehls_ros.families import Family
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import acts_on_chambers, acts_on_one_pressure
from ehls_ros.physics.equations import piston_mass
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.friction.base import FrictionModel
from ehls_ros.physics.parameters import Limits, Plant, Sensor
from ehls_ros.physics.valve import VALVES
from ehls_ros.schema import missing_key, notes, parse


class EffectUse(NamedTuple):
    """An active effect with its parameters."""

    name: str
    parameters: Any

    @property
    def piston_share(self) -> float:
        """Fraction of the moving mass that stays with the piston; 0 unless this effect separates piston and load."""
        share = getattr(EFFECTS.load(self.name), "piston_share", None)
        return 0.0 if share is None else float(share(self.parameters))


class CylinderUse(NamedTuple):
    """The cylinder of a rig with its parameters; () if it has none beyond those of ``plant``."""

    model: str = "double_rod"
    parameters: Any = ()

    @property
    def law(self) -> Any:
        """The cylinder's module."""
        return CYLINDERS.load(self.model)


class ValveUse(NamedTuple):
    """The valve of a rig with its parameters; () if it has none beyond those of ``plant``."""

    model: str = "load_flow"
    parameters: Any = ()

    @property
    def law(self) -> Any:
        """The valve's module."""
        return VALVES.load(self.model)


SENSED = ("position", "velocity", "load_pressure", "spool_position", "force", "supply_pressure", "oil_temperature")
"""The signals that every rig has, in the order of a loader_state."""

CHAMBER_SENSED = ("pressure_a", "pressure_b")
"""The signals after :data:`SENSED` of a rig whose cylinder has two chambers."""

EVERY_SENSED = SENSED + CHAMBER_SENSED
"""The signals of such a rig, in order."""


class Rig(NamedTuple):
    """A complete rig.

    Attributes:
        plant: coefficients of hydraulics, valve and beam load.
        friction_model: name of the friction model.
        friction: ``Parameters`` of the friction model.
        effects: effects beyond the paper's model; empty for the paper's rig.
        sensors: sensors by signal; a missing one is perfect.
        limits: limits of the rig.
        cylinder, valve: cylinder and valve.
        other_friction: keys of the rig file that belong to other friction models, kept for a change of model.
        standard_errors: standard errors of coefficients by dotted path, such as ``plant.bulk_modulus``, in their units.
    """

    plant: Plant
    friction_model: str
    friction: Any
    effects: tuple[EffectUse, ...]
    sensors: Mapping[str, Sensor]
    limits: Limits
    cylinder: CylinderUse = CylinderUse()
    valve: ValveUse = ValveUse()
    other_friction: Mapping[str, Any] = {}
    standard_errors: Mapping[str, float] = {}

    @property
    def friction_law(self) -> FrictionModel:
        """The module of the friction model."""
        return FRICTION_MODELS.load(self.friction_model)

    def forces(self) -> tuple[float, float]:
        """Return the lowest and the highest driving force that the supply can hold [N]."""
        low, high = self.cylinder.law.forces(self.cylinder.parameters, self.plant)
        return float(low), float(high)

    def friction_level(self, velocity: float) -> float:
        """Return the friction of steady sliding without its viscous part and without effects [N].

        Args:
            velocity: velocity [m/s]; 0 gives the break-away force, infinity the Coulomb friction.
        """
        return float(in_python(self.friction_law.level)(velocity, self.friction))

    def effective(self) -> "EffectiveRig":
        """Return the rig with the shifts of its effects applied to its parameters."""
        rig = self
        for use in self.effects:
            for name in ("shift", "shift_chambers") if self.cylinder.law.CHAMBERS else ("shift",):
                shift = getattr(EFFECTS.load(use.name), name, None)
                if shift is not None:
                    rig = shift(rig, use.parameters)
        if derived := self.cylinder.law.derived(rig.cylinder.parameters):
            rig = rig.with_plant(**derived)
        sensors = {**_derived_sensors(rig), **rig.sensors}
        return EffectiveRig(
            rig.plant, rig.friction_model, rig.friction, rig.effects, sensors, rig.limits, rig.cylinder, rig.valve
        )

    @property
    def sensed(self) -> tuple[str, ...]:
        """The signals of its loader_state, in order."""
        return SENSED + tuple(self.cylinder.law.SENSED)

    def with_cylinder(self, **values: Any) -> "Rig":
        """Return the rig with other parameters of its cylinder."""
        return self._replace(cylinder=self.cylinder._replace(parameters=self.cylinder.parameters._replace(**values)))

    def with_valve(self, **values: Any) -> "Rig":
        """Return the rig with other parameters of its valve."""
        return self._replace(valve=self.valve._replace(parameters=self.valve.parameters._replace(**values)))

    def quiet(self) -> "Rig":
        """Return the rig with sensors free of noise and quantisation."""
        quiet = {signal: sensor._replace(noise_std=0.0, resolution=0.0) for signal, sensor in self.sensors.items()}
        return self._replace(sensors=quiet)

    def with_plant(self, **values: Any) -> "Rig":
        """Return the rig with other coefficients of its plant."""
        return self._replace(plant=self.plant._replace(**values))

    def with_friction(self, **values: Any) -> "Rig":
        """Return the rig with other coefficients of its friction model; those that the model lacks are ignored."""
        present = {key: value for key, value in values.items() if key in self.friction._fields}
        return self._replace(friction=self.friction._replace(**present))

    def with_sensors(self, signals: Iterable[str], change: Callable[[Sensor], Sensor]) -> "Rig":
        """Return the rig with the sensors of some signals changed; a missing sensor starts as a perfect one."""
        return self._replace(sensors={**self.sensors, **{name: change(self.sensors.get(name, Sensor())) for name in signals}})

    def with_effects(self, more: tuple[EffectUse, ...]) -> "Rig":
        """Return the rig with further effects appended."""
        return self._replace(effects=self.effects + more)


class EffectiveRig(NamedTuple):
    """A rig with the shifts of its effects applied to its parameters, as the equations require it.

    It is returned by :meth:`Rig.effective`. Its type differs from :class:`Rig` so that no shift is applied twice. The hooks of
    ``effects`` still act.
    """

    plant: Plant
    friction_model: str
    friction: Any
    effects: tuple[EffectUse, ...]
    sensors: Mapping[str, Sensor]
    limits: Limits
    cylinder: CylinderUse
    valve: ValveUse

    @property
    def friction_law(self) -> FrictionModel:
        """The module of the friction model."""
        return FRICTION_MODELS.load(self.friction_model)

    @property
    def sensed(self) -> tuple[str, ...]:
        """The signals of its loader_state, in order."""
        return SENSED + tuple(self.cylinder.law.SENSED)

    def forces(self) -> tuple[float, float]:
        """Return the lowest and the highest driving force, see :meth:`Rig.forces` [N]."""
        low, high = self.cylinder.law.forces(self.cylinder.parameters, self.plant)
        return float(low), float(high)

    def friction_level(self, velocity: float) -> float:
        """Return the friction of steady sliding [N], see :meth:`Rig.friction_level`."""
        return float(in_python(self.friction_law.level)(velocity, self.friction))

    def piston_mass(self) -> float:
        """Return the mass of a piston separate from the load; 0 if they are one body [kg]."""
        share = max((use.piston_share for use in self.effects), default=0.0)
        return in_python(piston_mass)(share, self.plant)

    def without_effects(self) -> Rig:
        """Return the rig with these parameters and no effects, as modelled by a controller."""
        return Rig(*self)._replace(effects=())


UNKNOWN = math.nan
"""Value of a coefficient that the rig file lacks."""

ABSENT: Mapping[type, Mapping[str, Any]] = {
    Plant: dict.fromkeys(Plant._fields, UNKNOWN),
    Limits: {**dict.fromkeys(Limits._fields, UNKNOWN), "position": (UNKNOWN, UNKNOWN)},
}
"""Placeholders of keys missing in a rig file."""

SECTIONS = ("plant", "friction", "cylinder", "valve", "effects", "sensors", "limits", "standard_errors")

MAX_EFFECTS = 64
"""Most effects of a rig, including those of an experiment; the compile time of its equations grows more than linearly."""

DEFAULT_FRICTION = "gms"
"""The default friction model of a rig file."""


def rig_from_mapping(data: Any, where: str) -> Rig:
    """Build a rig from the content of a rig file.

    Args:
        data: the parsed file, with sections of :data:`SECTIONS`.
        where: the file, for error messages.

    Returns:
        The rig; missing keys of plant or limits are :data:`UNKNOWN` in it, see :func:`check_known`.

    Raises:
        BadInput: a key is unknown or out of range, or a friction key is missing; the first one is reported.
    """
    if not isinstance(data, Mapping):
        raise BadInput(f"a rig is {type(data).__name__}", where, f"a mapping with the sections {', '.join(SECTIONS)}")
    for section in data:
        if section not in SECTIONS:
            raise BadInput(f"section {section!r} is unknown", where, one_of(section, SECTIONS))
    if "friction" not in data:
        raise BadInput("section 'friction' is missing", where, "a mapping of its keys")
    for section in ("plant", "friction", "cylinder", "valve", "limits"):
        if not isinstance(data.get(section, {}), Mapping):
            raise BadInput(f"section '{section}' is {data[section]!r}", where, "a mapping of its keys")
    model, friction, others = _friction_from_mapping(data["friction"], f"{where}: friction")
    limits = parse(Limits, data.get("limits", {}), f"{where}: limits", ABSENT[Limits])
    if "position" in data.get("limits", {}) and not limits.position[0] < limits.position[1]:
        expected = "two finite numbers [min, max] with min < max [m]"
        raise BadInput(f"position is {list(limits.position)}", f"{where}: limits", expected)
    cylinder = CylinderUse(*_member(CYLINDERS, CylinderUse().model, data.get("cylinder", {}), f"{where}: cylinder"))
    valve = ValveUse(*_member(VALVES, cylinder.law.DEFAULT_VALVE, data.get("valve", {}), f"{where}: valve"))
    if not hasattr(valve.law, cylinder.law.FLOW):
        usable = ", ".join(name for name in VALVES.names() if hasattr(VALVES.load(name), cylinder.law.FLOW))
        raise BadInput(
            f"the valve {valve.model} has no flow for cylinder {cylinder.model}", f"{where}: valve", f"model: {usable}"
        )
    rig = Rig(
        plant=_plant_from_mapping(data.get("plant", {}), cylinder, f"{where}: plant"),
        friction_model=model,
        friction=friction,
        effects=effects_from_list([] if data.get("effects") is None else data["effects"], f"{where}: effects"),
        sensors=_sensors_from_mapping(
            {} if data.get("sensors") is None else data["sensors"], SENSED + tuple(cylinder.law.SENSED), f"{where}: sensors"
        ),
        limits=limits,
        cylinder=cylinder,
        valve=valve,
        other_friction=others,
    )
    check_effects(rig, f"{where}: effects")
    return rig._replace(standard_errors=_errors_from_mapping(data.get("standard_errors"), rig, f"{where}: standard_errors"))


def _member(family: Family[Any], default: str, data: Mapping[str, Any], where: str) -> tuple[str, Any]:
    """Return the name and the parameters of a cylinder or a valve; () if it has no keys."""
    name = data.get("model", default)
    law = family.load(name, f"{where}: model")
    parameters = parse(law.Parameters, {key: value for key, value in data.items() if key != "model"}, where)
    law.check(parameters, where)
    return name, parameters or ()


def _plant_from_mapping(data: Mapping[str, Any], cylinder: CylinderUse, where: str) -> Plant:
    """Check the plant section; keys that follow from those of the cylinder are refused."""
    derived = cylinder.law.derived(cylinder.parameters)
    for key in derived:
        if key in data:
            raise BadInput(
                f"key '{key}' is given", where, f"no such key, as it follows from those of cylinder {cylinder.model}"
            )
    return parse(Plant, {**data, **derived}, where, ABSENT[Plant])


def unknown_keys(rig: Rig) -> tuple[str, ...]:
    """Return the keys of plant and limits that the rig file lacks, such as ``plant.bulk_modulus``."""
    values: dict[str, Any] = {
        f"{section}.{key}": v for section in ("plant", "limits") for key, v in getattr(rig, section)._asdict().items()
    }
    return tuple(path for path, value in values.items() if math.isnan(value[0] if isinstance(value, tuple) else value))


def check_known(rig: Rig, where: str, needed: Collection[str] = ()) -> None:
    """Check that a rig has the needed keys.

    Args:
        rig: the rig.
        where: the file, for error messages.
        needed: keys such as ``plant.bulk_modulus``; if empty, all keys, as for a simulation.

    Raises:
        BadInput: the first missing key, with its unit and a typical value.
    """
    for path in unknown_keys(rig):
        if not needed or path in needed:
            section, _, key = path.partition(".")
            raise missing_key(key, notes(type(getattr(rig, section)))[key], f"{where}: {section}")


def _friction_from_mapping(data: Mapping[str, Any], where: str) -> tuple[str, Any, dict[str, Any]]:
    """Check the friction section.

    Every key must belong to some friction model, with a value in its range. Missing keys of the rig's model are derived from
    those of other models if possible. The keys of other models are kept.

    Returns:
        Name of the model, its parameters, and the other models' keys.
    """
    model = data.get("model", DEFAULT_FRICTION)
    law = FRICTION_MODELS.load(model, f"{where}: model")
    own = law.Parameters._fields
    foreign = {key: value for key, value in data.items() if key not in own and key != "model"}
    known = _keys_of(tuple(FRICTION_MODELS.usable())) if foreign else {}
    for key in foreign:
        if key not in known:
            possible = ("model", *own, *(k for k in known if k not in own))
            raise BadInput(f"key '{key}' is unknown", where, one_of(key, possible))
    others = {key: parse(known[key], {key: value}, where)[0] for key, value in foreign.items()}
    friction = parse(law.Parameters, _derived(law, others) | {key: data[key] for key in own if key in data}, where)
    law.check(friction, where)
    return model, friction, others


def _derived(law: FrictionModel, others: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a model that follow from other models' keys."""
    derived: Callable[[Mapping[str, Any]], dict[str, Any]] | None = getattr(law, "derived", None)
    return {} if derived is None else derived(others)


@cache
def _keys_of(models: tuple[str, ...]) -> dict[str, Any]:
    """Return the keys of friction models, each as a separate parameter set."""
    hints: dict[str, Any] = {}
    for name in models:
        hints |= get_type_hints(FRICTION_MODELS.load(name).Parameters, include_extras=True)
    return {key: NamedTuple("Key", [(key, hint)]) for key, hint in hints.items()}


def _derived_sensors(rig: Rig) -> dict[str, Sensor]:
    """Return the load pressure's sensor if that pressure is read from the sensors of both chambers, with their noise."""
    described = [rig.sensors.get(signal) for signal in CHAMBER_SENSED]
    if not rig.cylinder.law.CHAMBERS or None in described:
        return {}
    # Areas may be duals where derivatives by them are wanted; noise has none.
    p, area = rig.cylinder.parameters, value_of(rig.plant.piston_area)
    shares = value_of(p.area_a) / area, value_of(p.area_b) / area
    noise = (share * sensor.reading_std for share, sensor in zip(shares, described, strict=True) if sensor is not None)
    return {"load_pressure": Sensor(noise_std=math.hypot(*noise))}


def check_effects(rig: Rig, where: str) -> None:
    """Check that a rig's effects are compatible with its cylinder and its friction model.

    Args:
        rig: the rig.
        where: file and section of the effects, for error messages.

    Raises:
        BadInput: the model has none of the coefficients that an effect shifts, the shifted values contradict each other, or
            an effect acts on a pressure that the cylinder does not have.
    """
    chambers = rig.cylinder.law.CHAMBERS
    other = f"cylinder: {{model: {'double_rod' if chambers else 'two_chamber'}}}"
    for use in rig.effects:
        effect = EFFECTS.load(use.name)
        if chambers and not acts_on_chambers(effect):
            what = f"effect {use.name!r} acts on a load pressure, which cylinder {rig.cylinder.model} does not have"
            raise BadInput(what, where, f"effects on the oil that act on a chamber, or {other}")
        if not chambers and not acts_on_one_pressure(effect):
            what = f"effect {use.name!r} acts on a chamber, and cylinder {rig.cylinder.model} has one pressure for both"
            raise BadInput(what, where, f"effects on the load pressure, or {other}")
        neutral = effect.Parameters()
        for key in getattr(effect, "NOT_IN_CHAMBERS" if chambers else "ONLY_IN_CHAMBERS", ()):
            if (value := getattr(use.parameters, key)) != getattr(neutral, key):
                what = f"{key} of effect {use.name!r} is {value:g}, which has no meaning in cylinder {rig.cylinder.model}"
                raise BadInput(what, where, f"{key}: {getattr(neutral, key):g}, or {other}")
    for use in rig.effects:
        shifted = getattr(EFFECTS.load(use.name), "SHIFTS", ())
        if shifted and not set(shifted) & set(rig.friction._fields):
            what = f"effect {use.name!r} has nothing to act on in friction model {rig.friction_model!r}"
            raise BadInput(what, where, f"a friction model with {' or '.join(shifted)}: {', '.join(_models_with(shifted))}")
    rig.friction_law.check(rig.effective().friction, where)


def _models_with(keys: tuple[str, ...]) -> list[str]:
    """Return the friction models that have at least one of the keys."""
    names = FRICTION_MODELS.names()
    return [name for name in names if set(keys) & set(FRICTION_MODELS.load(name).Parameters._fields)]


def effects_from_list(data: Any, where: str) -> tuple[EffectUse, ...]:
    """Build effects from a list of mappings, each with a ``name`` and parameters.

    Raises:
        BadInput: an effect is unknown or one of its parameters is wrong.
    """
    if not isinstance(data, list):
        raise BadInput(f"effects is {data!r}", where, "a list of {name: <effect>, <parameter>: value}")
    check_effect_count(len(data), where)
    uses = []
    for index, entry in enumerate(data):
        place = f"{where}[{index}]"
        if not isinstance(entry, Mapping) or "name" not in entry:
            raise BadInput(f"entry is {entry!r}", place, f"a mapping with a name, one of {', '.join(EFFECTS.names())}")
        effect = EFFECTS.load(entry["name"], place)
        values = {key: value for key, value in entry.items() if key != "name"}
        uses.append(EffectUse(entry["name"], parse(effect.Parameters, values, f"{place}: {entry['name']}")))
    if len(joints := [use.name for use in uses if use.piston_share > 0.0]) > 1:
        raise BadInput(f"{' and '.join(joints)} both separate the load from the piston", where, "at most one that does")
    return tuple(uses)


def check_effect_count(count: int, where: str) -> None:
    """Check that a rig does not have more effects than :data:`MAX_EFFECTS`.

    Args:
        count: number of effects.
        where: file and section of the effects, for error messages.

    Raises:
        BadInput: there are more.
    """
    if count > MAX_EFFECTS:
        raise BadInput(f"{count} effects", where, f"at most {MAX_EFFECTS}, those of rig and experiment together")


def _sensors_from_mapping(data: Any, signals: tuple[str, ...], where: str) -> dict[str, Sensor]:
    if not isinstance(data, Mapping):
        raise BadInput(f"sensors is {data!r}", where, "a mapping signal: {noise_std, resolution, ...}")
    for signal in data:
        if signal not in signals:
            raise BadInput(f"signal {signal!r} is unknown", where, one_of(signal, signals))
        if not isinstance(data[signal], Mapping | None):
            raise BadInput(f"{signal} is {data[signal]!r}", where, f"a mapping of {', '.join(Sensor._fields)}")
    return {signal: parse(Sensor, values or {}, f"{where}: {signal}") for signal, values in data.items()}


def _errors_from_mapping(data: Any, rig: Rig, where: str) -> dict[str, float]:
    if not isinstance(data, Mapping | None):
        raise BadInput(f"standard_errors is {data!r}", where, "a mapping of paths such as plant.bulk_modulus")
    for path, std in (data or {}).items():
        if not has_number(rig, str(path)):
            raise BadInput(f"the rig has no {path}", where, "the path of one of its coefficients, such as plant.bulk_modulus")
        if isinstance(std, bool) or not isinstance(std, int | float) or not 0.0 <= std < math.inf:
            raise BadInput(f"{path} is {std!r}", where, "a standard error of 0 or more, in the coefficient's unit")
    return {str(path): float(std) for path, std in (data or {}).items()}


def has_number(rig: Rig, path: str) -> bool:
    """Return whether a dotted path, such as ``plant.bulk_modulus`` or ``effects.command_delay.delay``, is one of a rig."""
    section, _, name = path.partition(".")
    owner, _, key = name.partition(".")
    names: dict[str, Collection[str]] = {
        "plant": Plant._fields,
        "friction": (*rig.friction._fields, *rig.other_friction),
        "cylinder": rig.cylinder.law.Parameters._fields,
        "valve": rig.valve.law.Parameters._fields,
        "effects": next((use.parameters._fields for use in rig.effects if use.name == owner), ()),
        "sensors": Sensor._fields if owner in rig.sensed else (),
    }
    return (key if section in ("effects", "sensors") else name) in names.get(section, ())


def rig_to_mapping(rig: Rig) -> dict[str, Any]:
    """Return the content of a rig file, the inverse of :func:`rig_from_mapping`.

    Friction coefficients derived from others are omitted, and so are those that are :data:`UNKNOWN`, and the many neutral
    parameters of a term found in data.
    """

    def plain(parameters: Any) -> dict[str, Any]:
        return listed(parameters._asdict())

    def listed(values: Mapping[str, Any]) -> dict[str, Any]:
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}

    def used(use: EffectUse) -> dict[str, Any]:
        neutral = type(use.parameters)()._asdict() if getattr(EFFECTS.load(use.name), "LEARNT", False) else {}
        return {key: value for key, value in plain(use.parameters).items() if neutral.get(key) != value}

    def known(section: str) -> dict[str, Any]:
        values = plain(getattr(rig, section))
        return {key: value for key, value in values.items() if f"{section}.{key}" not in unknown}

    def member(use: CylinderUse | ValveUse, default: str) -> dict[str, Any] | None:
        return {"model": use.model, **plain(use.parameters)} if use.parameters or use.model != default else None

    unknown = {*unknown_keys(rig), *(f"plant.{key}" for key in rig.cylinder.law.derived(rig.cylinder.parameters))}
    oil = {"cylinder": member(rig.cylinder, CylinderUse().model), "valve": member(rig.valve, rig.cylinder.law.DEFAULT_VALVE)}
    derived = _derived(rig.friction_law, rig.other_friction)
    friction = {key: value for key, value in rig.friction._asdict().items() if derived.get(key) != value}
    return {
        "plant": known("plant"),
        "friction": {"model": rig.friction_model, **listed(friction), **listed(rig.other_friction)},
        **{section: values for section, values in oil.items() if values is not None},
        "effects": [{"name": use.name, **used(use)} for use in rig.effects],
        "sensors": {signal: plain(sensor) for signal, sensor in rig.sensors.items()},
        "limits": known("limits"),
        **({"standard_errors": dict(rig.standard_errors)} if rig.standard_errors else {}),
    }
