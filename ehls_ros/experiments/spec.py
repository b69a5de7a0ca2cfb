"""Specification of an experiment: rig, reference, disturbance, controller, duration, seed."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.companions.base import Setting
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import Model, model_of
from ehls_ros.control.disturbances import DISTURBANCES, position_servo
from ehls_ros.control.local_plant import double_rod_of
from ehls_ros.control.observers import OBSERVERS, default_observer
from ehls_ros.control.observers.base import check_friction_support
from ehls_ros.control.programme.expansion import programme_of
from ehls_ros.control.references import REFERENCES
from ehls_ros.control.rig_scale import defaults_for
from ehls_ros.errors import BadInput, one_of
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.reference_files import programme_values, read_points
from ehls_ros.physics.integration_step import LONGEST_STEP, check_step, steps_per_period
from ehls_ros.physics.plausibility import WARNING_FACTOR, check_ranges, check_rig, check_signal
from ehls_ros.physics.rig import (
    EffectUse,
    Rig,
    check_effect_count,
    check_known,
    effects_from_list,
    rig_from_mapping,
    rig_to_mapping,
)
from ehls_ros.physics.servo import Servo
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import parse, quantity, text


class Use(NamedTuple):
    """A member of a family, by name, with its parameters."""

    name: str
    parameters: Any


class DisturbanceUse(NamedTuple):
    """A disturbance with its signal."""

    name: str
    parameters: Any
    signal: Use


class Settings(NamedTuple):
    """Scalar settings of a spec."""

    title: Annotated[str, text("title of the experiment in reports")] = "experiment"
    duration: Annotated[float, quantity("s", "plant time to run", above=0.0, maximum=1e6)] = 10.0
    control_period: Annotated[float, quantity("s", "time between two control cycles", minimum=1e-6, maximum=0.1)] = 1e-3
    integration_step: Annotated[
        float | None,
        quantity(
            "s",
            f"largest integration step of the plant; by default {LONGEST_STEP:g} s, or less if the rig needs it",
            minimum=1e-7,
            maximum=1e-2,
        ),
    ] = None
    initial_position: Annotated[float, quantity("m", "piston position at the start; it rests without pressure")] = 0.0
    oil_temperature: Annotated[float, quantity("K", "oil temperature at the start", minimum=200.0, maximum=450.0)] = 313.15
    oil_warming: Annotated[float, quantity("K/s", "rate at which the oil warms", minimum=-10.0, maximum=10.0)] = 0.0
    seed: Annotated[int, quantity("1", "seed of the sensors' noise", minimum=0)] = 0


class Spec(NamedTuple):
    """A complete experiment.

    Attributes:
        rig: the true rig.
        controller_rig: the rig as modelled in controller and friction observer.
        companions: companions of the controller, in order.
    """

    settings: Settings
    rig: Rig
    controller_rig: Rig
    reference: Use
    disturbance: DisturbanceUse
    controller: Use
    compensation: Use
    companions: tuple[Use, ...] = ()

    @property
    def cycles(self) -> int:
        """Number of control cycles, the last one included."""
        return round(self.settings.duration / self.settings.control_period) + 1

    def loader_rig(self) -> Rig:
        """Return the rig with the effects of the disturbance on the loader's plant, in place of the rig's own of that name."""
        acting = DISTURBANCES.load(self.disturbance.name).loader_effects(self.disturbance.parameters)
        named = {use.name for use in acting}
        own = tuple(use for use in self.rig.effects if use.name not in named)
        return self.rig._replace(effects=own + acting)

    def servo(self) -> Servo | None:
        """Return the actuator under test that is simulated with the loader; None if it does not react to the loader."""
        kind: Any = DISTURBANCES.load(self.disturbance.name)
        if not kind.REACTS:
            return None
        signal = self.disturbance.signal
        start = float(REFERENCES.load(signal.name).sample(np.zeros(1), signal.parameters)[0, 0])
        servo: Servo = kind.servo(self.disturbance.parameters, self.rig, start)
        return servo


SECTIONS = (
    *Settings._fields,
    "rig",
    "controller_rig",
    "effects",
    "known_effects",
    "reference",
    "disturbance",
    "controller",
    "compensation",
    "companions",
)


def load_rig(path: Path) -> Rig:
    """Read a rig file.

    Raises:
        BadInput: the file or one of its keys is wrong.
    """
    return rig_from_mapping(read_yaml(path, "rig file"), str(path))


def load_spec(path: Path, rig: Path | None = None) -> Spec:
    """Read an experiment's YAML file; files named in it are relative to its folder.

    Args:
        path: the file.
        rig: rig file that replaces the experiment's rig, its effects and its controller's rig.

    Raises:
        BadInput: a file or one of its keys is wrong, or its values are inconsistent.
    """
    data = read_yaml(path, "spec")
    if rig is not None and isinstance(data, Mapping):
        data = {**data, "rig": str(rig.resolve()), "controller_rig": None, "effects": None, "known_effects": None}
    spec = spec_from_mapping(data, str(path), path.parent)
    check_spec(spec, str(rig or path))
    return spec


def chosen_spec(spec: str, rig: str) -> Spec:
    """Read the experiment given to a node or a launch file.

    Args:
        spec: experiment file; empty: the 10 kN sine of the package.
        rig: rig file that replaces the experiment's; empty: none.

    Raises:
        BadInput: a file or one of its keys is wrong.
    """
    return load_spec(configured(spec or "sine_fd2", "experiments"), configured(rig) if rig else None)


def with_programme(spec: Spec, file: str) -> Spec:
    """Return an experiment with a test programme as its reference.

    Args:
        spec: the experiment.
        file: the programme's file, or the name of one of the package; empty: the reference of the experiment.

    Raises:
        BadInput: a file cannot be read, or a key is missing, unknown or out of range. Values that are valid individually but
            inconsistent together, such as both time and rate of a ramp, are reported when the programme is expanded.
    """
    if not file:
        return spec
    return spec._replace(reference=_use(REFERENCES, {"name": "programme", "file": file}, "programme", Path()))


def check_law(spec: Spec, law: str, where: str) -> None:
    """Check that a controller can replace that of an experiment.

    Args:
        spec: the experiment.
        law: name of the controller.
        where: origin of the choice, for errors.

    Raises:
        BadInput: it does not support the rig's friction model, or follows another quantity than the reference.
    """
    check_friction_support(CONTROLLERS, law, spec.controller_rig, where)
    follows, meant_for = (CONTROLLERS.load(name).FOLLOWS for name in (law, spec.controller.name))
    if meant_for != follows:
        raise BadInput(
            f"the spec's reference is a {meant_for} for {spec.controller.name}",
            where,
            f"a spec whose controller follows a {follows}, as {law} does",
        )


def spec_from_mapping(data: Any, where: str, folder: Path) -> Spec:
    """Check a spec's content and build the spec.

    Args:
        data: the parsed file.
        where: the file, for errors.
        folder: base folder of relative file names.

    Returns:
        The spec.

    Raises:
        BadInput: names the first key that is missing, unknown or out of range.
    """
    if not isinstance(data, Mapping):
        raise BadInput(f"a spec is {type(data).__name__}", where, f"a mapping with keys of {', '.join(SECTIONS)}")
    for key in data:
        if key not in SECTIONS:
            raise BadInput(f"key {key!r} is unknown", where, one_of(key, SECTIONS))
    settings = parse(Settings, {key: data[key] for key in Settings._fields if key in data}, where)
    if data.get("rig") is None:
        raise BadInput("key 'rig' is missing", where, "a rig file's name or its content")
    rig = _rig(data["rig"], f"{where}: rig", folder)
    believed = data.get("controller_rig")
    controller_rig = rig if believed is None else _rig(believed, f"{where}: controller_rig", folder)
    rig = rig.with_effects(effects_from_list(data.get("effects") or [], f"{where}: effects"))
    check_effect_count(len(rig.effects), f"{where}: effects")
    disturbance = _disturbance(data.get("disturbance"), f"{where}: disturbance", folder, rig)
    acting = DISTURBANCES.load(disturbance.name).loader_effects(disturbance.parameters)
    known = _known_effects(data.get("known_effects") or [], (*rig.effects, *acting), f"{where}: known_effects")
    controller_rig = controller_rig.with_effects(known)
    compensation = data["compensation"] if "compensation" in data else default_observer(controller_rig)
    spec = Spec(
        settings=settings,
        rig=rig,
        controller_rig=controller_rig,
        reference=_use(REFERENCES, data.get("reference"), f"{where}: reference", folder),
        disturbance=disturbance,
        controller=_use(CONTROLLERS, data.get("controller"), f"{where}: controller", folder, controller_rig),
        compensation=_use(OBSERVERS, compensation, f"{where}: compensation", folder, controller_rig),
        companions=_companions(data.get("companions") or [], f"{where}: companions", folder, controller_rig),
    )
    _sampled_once(spec.reference, f"{where}: reference")
    _sampled_once(spec.disturbance.signal, f"{where}: disturbance: signal")
    return spec


COMMAND_DELAY = "command_delay"
"""Name of the effect that delays the command, and of the parameter with which a law assumes that."""

COUPLING = "coupling_stiffness"
"""Name of the effect by which a rig file tells the coupling to the actuator under test."""

SAMPLES = 4096
"""Number of times at which a signal is checked before an experiment."""


def check_spec(spec: Spec, where: str) -> None:
    """Reject values that are valid individually but inconsistent together.

    Args:
        spec: the experiment.
        where: the file, for errors.

    Raises:
        BadInput: names the first inconsistent value.
    """
    settings, rig = spec.settings, spec.rig
    period = settings.control_period
    if settings.duration < period:
        expected = f"at least one control_period, {period:g} s"
        raise BadInput(f"duration is {settings.duration:g}", where, expected)
    for section in ("rig", "controller_rig"):
        check_rig(getattr(spec, section), f"{where}: {section}")
    check_friction_support(OBSERVERS, spec.compensation.name, spec.controller_rig, f"{where}: compensation")
    check_friction_support(CONTROLLERS, spec.controller.name, spec.controller_rig, f"{where}: controller")
    _check_companions(spec, where, _setting(spec, model_of(spec.controller_rig, period), where))
    # The disturbance may have a separate cylinder.
    check_ranges(spec.disturbance.parameters, "plant", f"{where}: disturbance")
    loader, servo = spec.loader_rig(), spec.servo()
    steps = steps_per_period(loader, period, settings.integration_step, servo)
    check_step(loader, period / steps, f"{where}: rig", servo)
    low, high = rig.limits.position
    if abs(settings.initial_position - 0.5 * (low + high)) > WARNING_FACTOR * 0.5 * (high - low):
        expected = f"{low:g} to {high:g} m, limits.position of the rig"
        raise BadInput(f"initial_position is {settings.initial_position:g} m", where, expected)
    follows = CONTROLLERS.load(spec.controller.name).FOLLOWS
    disturbed = signal_kind(spec.disturbance.name)
    for part, use, kind in (("reference", spec.reference, follows), ("disturbance", spec.disturbance.signal, disturbed)):
        check_signal(_throughout(_Signal(repr(use), use), settings.duration), part, kind, rig, period, f"{where}: {part}")


@dataclass(frozen=True)
class _Signal:
    """Hashable signal, identified by its text, as its parameters may not be hashable."""

    text: str
    use: Use = field(compare=False)


@lru_cache(maxsize=16)
def _throughout(signal: _Signal, duration: float) -> Array:
    """Sample a signal over an experiment; cached, as the runs of a campaign have few different signals."""
    # Evenly spread, and not synchronous with any frequency.
    times = duration * (0.5 * (math.sqrt(5.0) - 1.0) * np.arange(SAMPLES, dtype=np.float64) % 1.0)
    rows: Array = REFERENCES.load(signal.use.name).sample(times, signal.use.parameters)
    return rows


def for_simulated_rig(spec: Spec) -> Spec:
    """Return an experiment whose law assumes no command delay by default if the simulated rig has none.

    The default of such a law is the cycle by which a command acts late on a real rig. On a simulated rig without that delay, a
    filter that assumes it loses the force as soon as the piston rests.

    Args:
        spec: the experiment; a value that differs from the default is kept.
    """
    given = spec.controller.parameters
    default = getattr(given, "_field_defaults", {}).get(COMMAND_DELAY)
    acting = {use.name for use in spec.loader_rig().effects}
    if default is None or getattr(given, COMMAND_DELAY) != default or COMMAND_DELAY in acting:
        return spec
    return spec._replace(controller=spec.controller._replace(parameters=given._replace(**{COMMAND_DELAY: 0.0})))


def reference_extremes(spec: Spec) -> tuple[float, float]:
    """Return the smallest and largest value of an experiment's reference [N] or [m], as sampled for :func:`check_spec`."""
    rows = _throughout(_Signal(repr(spec.reference), spec.reference), spec.settings.duration)
    return float(rows[:, 0].min()), float(rows[:, 0].max())


def _rig(data: Any, where: str, folder: Path) -> Rig:
    """Read a rig for simulation, which requires all its values."""
    file = configured(data, beside=folder) if isinstance(data, str) else None
    rig = rig_from_mapping(data, where) if file is None else load_rig(file)
    check_known(rig, where if file is None else str(file))
    return rig


def _use(family: Any, data: Any, where: str, folder: Path, rig: Rig | None = None) -> Use:
    """Read a member of a family; ``rig``: rig to which defaults are scaled."""
    if isinstance(data, str):
        data = {"name": data}
    if not isinstance(data, Mapping) or "name" not in data:
        raise BadInput(f"section is {data!r}", where, f"a name, or a mapping with a name, of {', '.join(family.names())}")
    member = family.load(data["name"], where)
    values = {key: value for key, value in data.items() if key != "name"}
    if "file" in values and "points" in member.Parameters._fields:
        values["points"] = read_points(folder / str(values.pop("file")))
    if "file" in values and "blocks" in member.Parameters._fields:
        values = {**programme_values(configured(str(values.pop("file")), "programmes", folder)), **values}
    defaults = None if rig is None else defaults_for(member.Parameters, rig)
    return Use(data["name"], parse(member.Parameters, values, f"{where}: {data['name']}", defaults))


def _disturbance(data: Any, where: str, folder: Path, rig: Rig) -> DisturbanceUse:
    if data is None:
        data = {"name": "force", "signal": {"name": "constant", "value": 0.0}}
    if not isinstance(data, Mapping):
        raise BadInput(f"section is {data!r}", where, f"a mapping with a name, one of {', '.join(DISTURBANCES.names())}")
    rest = {key: value for key, value in data.items() if key != "signal"}
    use = _use(DISTURBANCES, rest, where, folder, rig)
    return DisturbanceUse(use.name, use.parameters, _use(REFERENCES, data.get("signal"), f"{where}: signal", folder))


def _known_effects(data: Any, acting: Sequence[EffectUse], where: str) -> tuple[EffectUse, ...]:
    """Return the effects known to the controller: by name with the acting parameters, or with other parameters."""
    if not isinstance(data, list):
        raise BadInput(
            f"known_effects is {data!r}", where, "a list of effects, each a name or {name: <effect>, <parameter>: value}"
        )
    by_name = {use.name: use for use in acting}
    for name in data:
        if isinstance(name, str) and name not in by_name:
            raise BadInput(f"{name!r} does not act on this rig", where, f"one of {', '.join(by_name) or 'none'}, or a mapping")
    acting_as = {name: {"name": name, **use.parameters._asdict()} for name, use in by_name.items()}
    return effects_from_list([acting_as[entry] if isinstance(entry, str) else entry for entry in data], where)


def _companions(data: Any, where: str, folder: Path, rig: Rig) -> tuple[Use, ...]:
    if not isinstance(data, list):
        raise BadInput(f"companions is {data!r}", where, f"a list of names or mappings, of {', '.join(COMPANIONS.names())}")
    uses = tuple(_use(COMPANIONS, entry, f"{where}[{index}]", folder, rig) for index, entry in enumerate(data))
    if len({use.name for use in uses}) < len(uses):
        raise BadInput(f"companions are {', '.join(use.name for use in uses)}", where, "each name once")
    return uses


def company_of(spec: Spec, model: Model, where: str, law: str | None = None, tuning: Any = None) -> CompanionChain:
    """Return an experiment's companions, without the content of their files (:mod:`ehls_ros.experiments.learnt_files`).

    Args:
        spec: the experiment.
        model: the controller's model of the rig.
        where: the file, for errors.
        law: name of a controller that replaces the experiment's.
        tuning: its parameters.

    Raises:
        BadInput: a companion cannot work with this controller or rig.
    """
    setting = _setting(spec, model, where, law, tuning)
    _check_companions(spec, where, setting)
    with _placed(where):
        return CompanionChain({use.name: COMPANIONS.load(use.name).build(use.parameters, setting) for use in spec.companions})


def _setting(spec: Spec, model: Model, where: str, law: str | None = None, tuning: Any = None) -> Setting:
    """Return the initial information of companions; arguments as of :func:`company_of`."""
    name = spec.controller.name if law is None else law
    kind = CONTROLLERS.load(name)
    if spec.companions and kind.FOLLOWS != "force":
        beside = ", ".join(use.name for use in spec.companions)
        expected = "no companion, or a controller that follows a force"
        raise BadInput(f"{beside} beside {name}, which follows a {kind.FOLLOWS}", f"{where}: companions", expected)
    actuator = signal_kind(spec.disturbance.name)
    tuning = spec.controller.parameters if tuning is None else tuning
    rig = spec.controller_rig
    under_test = double_rod_of(rig).rig.plant
    return Setting(kind, tuning, model, actuator, rig.limits, under_test, rig.cylinder.model, rig.valve.model)


def _check_companions(spec: Spec, where: str, setting: Setting) -> None:
    """Reject companions that are incompatible with the controller or the rig."""
    law = str(getattr(setting.law, "__name__", "")).rpartition(".")[2]
    for use in spec.companions:
        with _placed(f"{where}: {use.name} beside {law}"):
            COMPANIONS.load(use.name).check(use.parameters, setting)


@contextmanager
def _placed(where: str) -> Iterator[None]:
    """Prefix the file to the place of errors."""
    try:
        yield
    except BadInput as error:
        raise BadInput(error.what, f"{where}: {error.where}", error.expected) from None


def undeclared_effects(spec: Spec, law: str | None = None) -> tuple[str, ...]:
    """Return a warning for each effect of the rig that the controller supports but that is not declared as known.

    Args:
        spec: the experiment.
        law: name of a controller that replaces the experiment's.
    """
    name = spec.controller.name if law is None else law
    acting = {use.name for use in spec.loader_rig().effects}
    undeclared = acting - {use.name for use in spec.controller_rig.effects}
    return tuple(
        f"{name} does not know the rig's {effect} and may lose the force: name it under known_effects"
        for effect in getattr(CONTROLLERS.load(name), "KNOWS", ())
        if effect in undeclared
    )


def swinging_actuator(spec: Spec) -> tuple[str, ...]:
    """Return a warning if the simulated actuator under test swings by itself, whatever the controller does."""
    p = spec.disturbance.parameters
    if not isinstance(p, position_servo.Parameters):
        return ()
    most = position_servo.swinging_gain(spec.rig, p.moving_mass)
    if p.position_gain <= most:
        return ()
    gain = f"its position_gain is {p.position_gain:g} 1/s, and leakage and friction damp up to {most:.3g} 1/s"
    return (f"the simulated actuator under test swings on its oil by itself: {gain}; set disturbance.position_gain below that",)


def ignored_pacing(spec: Spec) -> tuple[str, ...]:
    """Return a warning for a programme with pacing in a run without :mod:`~ehls_ros.nodes.programme_node`, which paces it."""
    if spec.reference.name != "programme" or not programme_of(spec.reference.parameters).is_paced:
        return ()
    return ("the programme ran without its pacing, which needs the programme node: leave out --in-process",)


def uses_actuator(spec: Spec) -> bool:
    """Return whether a companion of the controller uses the setpoint of the actuator under test."""
    return any(COMPANIONS.load(use.name).ACTUATOR for use in spec.companions)


def signal_kind(disturbance: str) -> str:
    """Return the quantity of a disturbance's signal: ``"force"``, or ``"position"`` for a servo."""
    return "position" if DISTURBANCES.load(disturbance).REACTS else "force"


def _sampled_once(use: Use, where: str) -> None:
    """Check the consistency of a signal's parameters by sampling it once."""
    with _placed(where):
        rows = REFERENCES.load(use.name).sample(np.zeros(1), use.parameters)
    if not np.all(np.isfinite(rows)):
        raise BadInput(f"{use.name} is not finite at its start", where, "parameters that give finite numbers")


def spec_to_mapping(spec: Spec) -> dict[str, Any]:
    """Return a spec as a self-contained mapping, the inverse of :func:`spec_from_mapping`."""

    def plain(use: Use) -> dict[str, Any]:
        return {"name": use.name, **use.parameters._asdict()}

    disturbance = plain(Use(spec.disturbance.name, spec.disturbance.parameters))
    return {
        **spec.settings._asdict(),
        "rig": rig_to_mapping(spec.rig),
        "controller_rig": rig_to_mapping(spec.controller_rig),
        "reference": plain(spec.reference),
        "disturbance": {**disturbance, "signal": plain(spec.disturbance.signal)},
        "controller": plain(spec.controller),
        "compensation": plain(spec.compensation),
        "companions": [plain(use) for use in spec.companions],
    }
