"""A controller and a simulated plant, stepped cycle by cycle in a loop of one's own."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ehls_ros.api.arguments import check_kind
from ehls_ros.api.simulation import Part, RigSource, SpecSource, spec_content
from ehls_ros.api.simulation import rig as read_rig
from ehls_ros.arrays import Array
from ehls_ros.control.controller import Outlook
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import STATUS_TO_SI
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.errors import BadInput, one_of
from ehls_ros.experiments.files import configured_names
from ehls_ros.experiments.loop import controller_of
from ehls_ros.experiments.spec import Spec, check_spec, spec_from_mapping
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.physics.sensors import VELOCITY
from ehls_ros.physics.simulator import Simulator
from ehls_ros.recording.topics import CONTROLLER_STATUS, READINGS
from ehls_ros.trajectory import READABLE

EXPECTED = "a rig or an experiment: an object, a mapping, a file's path, or the name of one that comes with the package"

DEFAULT_LAW = "fasmc_predictive"
"""Law of a controller that is made from a rig alone: it takes delay, coupling and noise from the rig file."""

UNITS: Mapping[str, str] = MappingProxyType({name: READABLE[signal].unit for name, signal in READINGS.items()})
"""Units of the readings, by name."""


class SteppedController:
    """A control law with its friction observer and companions, called once per control period.

    Attributes:
        spec: the experiment that describes it.
        period: control period [s].
        needs: names of the readings that the law needs.
        cycle: number of steps since the last reset.
    """

    def __init__(self, spec: Spec) -> None:
        """Prepare the law, its friction observer and its companions, compiling or loading their code.

        Args:
            spec: an experiment; its rig, effects, reference and disturbance are not simulated.
        """
        self.spec = spec
        self.period = spec.settings.control_period
        self.needs = CONTROLLERS.load(spec.controller.name).NEEDS
        self._law = controller_of(spec)
        uses = spec.compensation
        self._friction = (
            FrictionEstimator(uses.name, spec.controller_rig, self.period, uses.parameters) if self._law.uses_friction else None
        )
        self._places = {name: place for place, name in enumerate(spec.controller_rig.sensed)}
        self._measured, self._wanted, self._no_friction = np.full(len(self._places), np.nan), np.zeros(3), np.zeros(2)
        self.cycle = 0

    def step(self, measured: Mapping[str, float], reference: float | Sequence[float], *, elapsed: int = 1) -> float:
        """Return the spool command for one cycle [m].

        Args:
            measured: readings by name, those of :data:`UNITS` in its units. A reading that is not finite is bridged by the law.
            reference: wanted force [N], or position [m] for a law that follows one, optionally with its first and second
                derivative. Without them, the reference counts as constant.
            elapsed: cycles since the last call; more than 1 after missed ones.

        Raises:
            BadInput: a reading is unknown, one that the law needs is missing, or the reference has too many values.
        """
        readings = self._measured
        readings[:] = math.nan
        for name, value in measured.items():
            if name not in self._places:
                raise BadInput(f"the reading {name!r} is unknown", "measured", one_of(name, list(self._places)))
            readings[self._places[name]] = value
        if missing := [f"{name} [{UNITS[name]}]" for name in self.needs if name not in measured]:
            expected = f"the readings that {self.spec.controller.name} needs"
            raise BadInput(f"{', '.join(missing)} missing", "measured", expected)
        _fill(self._wanted, reference, "reference")
        self.cycle += elapsed if self.cycle else 1
        friction = self._no_friction
        if self._friction is not None:
            friction = self._friction.update(float(readings[VELOCITY]), elapsed)
        return self._law.step(readings, self._wanted, friction, elapsed, Outlook(self.cycle - 1))

    @property
    def status(self) -> dict[str, float]:
        """Quantities of the law after the last step, by the names they have in recordings, in SI units."""
        values = self._law.status * STATUS_TO_SI
        return {name: float(value) for name, value in zip(CONTROLLER_STATUS.signals.values(), values, strict=False)}

    def reset(self) -> None:
        """Reset law, observer and companions to their state before the first cycle."""
        self._law.reset()
        if self._friction is not None:
            self._friction.reset()
        self.cycle = 0


class SteppedPlant:
    """A simulated rig with its sensors, advanced by one control period at a time.

    Attributes:
        rig: the rig.
        period: control period [s].
        measured: readings at the present time, by name, in the units of :data:`UNITS`.
    """

    def __init__(self, rig: Rig, period: float, seed: int) -> None:
        """Prepare the plant at rest, compiling or loading its code.

        Args:
            rig: the rig, with its effects.
            period: control period [s].
            seed: seed of the sensors' noise.
        """
        self.rig, self.period = rig, period
        self._simulator = Simulator(rig, period)
        self._random, self._disturbance = np.random.default_rng(seed), np.zeros(4)
        self.measured = self._read()

    def step(self, command: float, disturbance: float | Sequence[float] = 0.0) -> dict[str, float]:
        """Hold a command for one control period and return the readings at its end.

        Args:
            command: spool command [m].
            disturbance: force of the actuator under test at the start of the period [N], optionally followed by its rate
                [N/s], and the displacement [m] and velocity [m/s] of that actuator, for a rig with a coupling to it.

        Raises:
            BadInput: the command is not finite, or the disturbance has too many values.
        """
        if not math.isfinite(command):
            raise BadInput(f"the command is {command}", "command", "a finite spool displacement [m]")
        _fill(self._disturbance, disturbance, "disturbance")
        self._simulator.advance(command, *self._disturbance.tolist())
        self.measured = self._read()
        return self.measured

    def _read(self) -> dict[str, float]:
        readings = self._simulator.measure(self._random.standard_normal(len(self.rig.sensed)))
        return dict(zip(self.rig.sensed, readings.tolist(), strict=True))

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self._simulator.cycle * self.period

    @property
    def truth(self) -> dict[str, float]:
        """True values of the readings at the present time."""
        return dict(zip(self.rig.sensed, self._simulator.truth.tolist(), strict=True))

    @property
    def trouble(self) -> str:
        """An impossible state of the rig with advice; empty if there is none."""
        return self._simulator.trouble()


def _fill(row: Array, given: float | Sequence[float], where: str) -> None:
    """Write a value, or several, to the beginning of a row, and zeros after it."""
    values = (given,) if isinstance(given, float | int) else given
    if len(values) > row.size:
        raise BadInput(f"it has {len(values)} values", where, f"1 to {row.size}")
    row[: len(values)], row[len(values) :] = values, 0.0


def controller(
    source: SpecSource | RigSource,
    law: str | None = None,
    *,
    period: float = 1e-3,
    companions: Sequence[Part] | None = None,
    **numbers: float,
) -> SteppedController:
    """Return a controller for a loop of one's own.

    Args:
        source: the rig as the controller shall know it, with delay, coupling and sensors' noise from its file; or an
            experiment, whose controller, friction observer, companions and control period are taken.
        law: name of the control law, such as ``"fasmc"``; by default the experiment's, or :data:`DEFAULT_LAW`.
        period: control period for a rig [s]; an experiment has its own.
        companions: companions in place of the experiment's, such as ``["adaptation"]``.
        **numbers: the law's parameters in place of its defaults for this rig.

    Raises:
        BadInput: a value is wrong, or the law cannot work with this rig.
    """
    content, where, folder = _experiment(source, period)
    tuned: dict[str, Any] = {} if law else dict(_mapping(content.get("controller")))
    content["controller"] = {**tuned, "name": law or tuned.get("name", DEFAULT_LAW), **numbers}
    if companions is not None:
        content["companions"] = list(companions)
    spec = spec_from_mapping(content, where, folder)
    check_spec(spec, where)
    return SteppedController(spec)


def plant(rig: RigSource, *, period: float = 1e-3, seed: int = 0) -> SteppedPlant:
    """Return a simulated rig for a loop of one's own.

    Args:
        rig: the rig, in any form that :func:`ehls_ros.rig` takes.
        period: control period [s].
        seed: seed of the sensors' noise.

    Raises:
        BadInput: the rig's file or one of its values is wrong.
    """
    return SteppedPlant(read_rig(rig), period, seed)


def _experiment(source: SpecSource | RigSource, period: float) -> tuple[dict[str, Any], str, Path]:
    """Return an experiment's keys, its name in errors and the folder of its files; for a rig, one that controls it."""
    check_kind(source, (Rig, Spec, Mapping, str, Path), "source", EXPECTED)
    if isinstance(source, str | Path) and str(source) in configured_names():
        source = read_rig(source)
    if isinstance(source, Rig):
        return _controlled(source, period), "controller", Path()
    content, where, folder = spec_content(source)
    if "plant" in content:
        content = _controlled(rig_from_mapping(content, where), period)
    return content, where, folder


def _controlled(rig: Rig, period: float) -> dict[str, Any]:
    return {"rig": rig_to_mapping(rig), "control_period": period, "reference": {"name": "constant", "value": 0.0}}


def _mapping(part: Any) -> Mapping[str, Any]:
    return part if isinstance(part, Mapping) else {"name": part} if part else {}
