"""The one description of a rig that simulator, controller, identification and diagnosis share."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.parameters import Friction, Limits, Plant, Sensor
from ehls_ros.schema import parse


class EffectUse(NamedTuple):
    """An effect switched on, with its parameters."""

    name: str
    parameters: Any

    @property
    def piston_share(self) -> float:
        """Fraction of the moving mass that this effect leaves with the piston, parted from the load; 0 where it parts none."""
        share = getattr(EFFECTS.load(self.name), "piston_share", None)
        return 0.0 if share is None else float(share(self.parameters))


SENSED = ("position", "velocity", "load_pressure", "spool_position", "force", "supply_pressure", "oil_temperature")
"""What a loader_state holds, in its order."""


class Rig(NamedTuple):
    """A rig as its file describes it; ``effects`` is empty for the paper's model."""

    plant: Plant
    friction_model: str
    friction: Friction
    effects: tuple[EffectUse, ...]
    sensors: Mapping[str, Sensor]
    limits: Limits

    def effective(self) -> "EffectiveRig":
        """Return the rig with the shifts of its effects applied to its parameters."""
        rig = self
        for use in self.effects:
            shift = getattr(EFFECTS.load(use.name), "shift", None)
            if shift is not None:
                rig = shift(rig, use.parameters)
        return EffectiveRig(*rig)

    def quiet(self) -> "Rig":
        """Return the rig with sensors that neither scatter nor round, for what is expected of it."""
        quiet = {signal: sensor._replace(noise_std=0.0, resolution=0.0) for signal, sensor in self.sensors.items()}
        return self._replace(sensors=quiet)

    def with_effects(self, more: tuple[EffectUse, ...]) -> "Rig":
        """Return the rig with further effects switched on after its own."""
        return self._replace(effects=self.effects + more)


class EffectiveRig(NamedTuple):
    """A rig whose parameters have the shifts of its effects applied: what the equations take.

    Made by :meth:`Rig.effective`, and of another type than a :class:`Rig`, so that no shift is applied twice. ``effects``
    are the rig's, whose hooks still act.
    """

    plant: Plant
    friction_model: str
    friction: Friction
    effects: tuple[EffectUse, ...]
    sensors: Mapping[str, Sensor]
    limits: Limits

    def piston_mass(self) -> float:
        """Return the mass that moves with the piston and not with the load; 0 where they are one [kg]."""
        share = max((use.piston_share for use in self.effects), default=0.0)
        return self.plant.moving_mass * share / (1.0 - share)

    def without_effects(self) -> Rig:
        """Return a rig of these parameters and no effects: what somebody knows of it who knows its parameters only."""
        return Rig(*self)._replace(effects=())


SECTIONS = ("plant", "friction", "effects", "sensors", "limits")


def rig_from_mapping(data: Any, where: str) -> Rig:
    """Check a rig file's content and build the rig.

    Args:
        data: the parsed file, with the sections of :data:`SECTIONS`.
        where: the file, for errors.

    Returns:
        The rig.

    Raises:
        BadInput: the first key that is missing, unknown or out of range.
    """
    if not isinstance(data, Mapping):
        raise BadInput(f"a rig is {type(data).__name__}", where, f"a mapping with the sections {', '.join(SECTIONS)}")
    for section in ("plant", "friction", "limits"):
        if section not in data:
            raise BadInput(f"section '{section}' is missing", where, "a mapping of its keys")
        if not isinstance(data[section], Mapping):
            raise BadInput(f"section '{section}' is {data[section]!r}", where, "a mapping of its keys")
    for section in data:
        if section not in SECTIONS:
            raise BadInput(f"section {section!r} is unknown", where, f"one of {', '.join(SECTIONS)}")
    friction_data = dict(data["friction"])
    model = friction_data.pop("model", "gms")
    FRICTION_MODELS.load(model, f"{where}: friction: model")
    friction = parse(Friction, friction_data, f"{where}: friction")
    _check_elements(friction, f"{where}: friction")
    limits = parse(Limits, data["limits"], f"{where}: limits")
    if not -math.inf < limits.position[0] < limits.position[1] < math.inf:
        expected = "two finite numbers [min, max] with min < max [m]"
        raise BadInput(f"position is {list(limits.position)}", f"{where}: limits", expected)
    rig = Rig(
        plant=parse(Plant, data["plant"], f"{where}: plant"),
        friction_model=model,
        friction=friction,
        effects=effects_from_list([] if data.get("effects") is None else data["effects"], f"{where}: effects"),
        sensors=_sensors_from_mapping({} if data.get("sensors") is None else data["sensors"], f"{where}: sensors"),
        limits=limits,
    )
    _check_elements(rig.effective().friction, f"{where}: effects")
    return rig


def effects_from_list(data: Any, where: str) -> tuple[EffectUse, ...]:
    """Check a list of effects, each a mapping with its ``name`` and its parameters.

    Raises:
        BadInput: an effect is unknown or one of its parameters is wrong.
    """
    if not isinstance(data, list):
        raise BadInput(f"effects is {data!r}", where, "a list of {name: <effect>, <parameter>: value}")
    uses = []
    for index, entry in enumerate(data):
        place = f"{where}[{index}]"
        if not isinstance(entry, Mapping) or "name" not in entry:
            raise BadInput(f"entry is {entry!r}", place, f"a mapping with a name, one of {', '.join(EFFECTS.names())}")
        effect = EFFECTS.load(entry["name"], place)
        values = {key: value for key, value in entry.items() if key != "name"}
        uses.append(EffectUse(entry["name"], parse(effect.Parameters, values, f"{place}: {entry['name']}")))
    if len(parting := [use.name for use in uses if use.piston_share > 0.0]) > 1:
        raise BadInput(f"{' and '.join(parting)} both part the load from the piston", where, "at most one that does")
    return tuple(uses)


def _sensors_from_mapping(data: Any, where: str) -> dict[str, Sensor]:
    if not isinstance(data, Mapping):
        raise BadInput(f"sensors is {data!r}", where, "a mapping signal: {noise_std, resolution, ...}")
    for signal in data:
        if signal not in SENSED:
            raise BadInput(f"signal {signal!r} is unknown", where, f"one of {', '.join(SENSED)}")
        if not isinstance(data[signal], Mapping | None):
            raise BadInput(f"{signal} is {data[signal]!r}", where, f"a mapping of {', '.join(Sensor._fields)}")
    return {signal: parse(Sensor, values or {}, f"{where}: {signal}") for signal, values in data.items()}


def _check_elements(friction: Friction, where: str) -> None:
    stiffness, weight = friction.element_stiffness, friction.element_weight
    if not stiffness or len(stiffness) != len(weight):
        raise BadInput(
            f"{len(stiffness)} element_stiffness and {len(weight)} element_weight", where, "equally many, at least one"
        )
    for key, values in (("element_stiffness", stiffness), ("element_weight", weight)):
        if not all(0.0 < value < math.inf for value in values):
            raise BadInput(f"{key} is {list(values)}", where, "finite numbers above 0")
    if abs(sum(weight) - 1.0) > 1e-6:
        raise BadInput(f"element_weight sums to {sum(weight):g}", where, "a sum of 1")
    if friction.coulomb_force > friction.static_force:
        raise BadInput(
            f"coulomb_force is {friction.coulomb_force:g}", where, f"at most static_force = {friction.static_force:g} N"
        )


def rig_to_mapping(rig: Rig) -> dict[str, Any]:
    """Return the mapping that a rig file holds; :func:`rig_from_mapping` turns it back."""

    def plain(parameters: Any) -> dict[str, Any]:
        return {k: list(v) if isinstance(v, tuple) else v for k, v in parameters._asdict().items()}

    return {
        "plant": plain(rig.plant),
        "friction": {"model": rig.friction_model, **plain(rig.friction)},
        "effects": [{"name": use.name, **plain(use.parameters)} for use in rig.effects],
        "sensors": {signal: plain(sensor) for signal, sensor in rig.sensors.items()},
        "limits": plain(rig.limits),
    }
