"""Run a controller: its compiled law, its memory, and bumpless changes of tuning, rig or controller."""

import math
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, contiguous, direct
from ehls_ros.control.adaptation.transition import NO_SIZES, WHERE, Transition, with_own_sensors
from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.companions import adaptation
from ehls_ros.control.companions.base import PLACE, Past, Upcoming
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORESEEN, ROW, STATUS_SIZE, Model
from ehls_ros.control.local_plant import law_on, memory_on
from ehls_ros.errors import BadInput
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.valve import VALVES

BUMP_TIME = 0.02
"""Time constant of the transition of the command from the old tuning or controller to the new one [s]."""

ACCEPTED_RATE = 0.2
"""Largest relative change per second on the way to an accepted rig: a fifth of adaptation's, as no force is at risk."""

ADAPTATION_LIMITS = adaptation.adaptation_limits(adaptation.Parameters())._replace(rate=ACCEPTED_RATE)
"""Bounds of the model's transition to an accepted rig, equal to those of adaptation."""


def controller_kernel(name: str, cylinder: str = "double_rod", valve: str = "load_flow") -> ModuleType:
    """Return a module with the compiled law of one controller as ``step``, and its ``follow`` if it has one.

    Args:
        name: file name of the controller.
        cylinder: that of the cylinder that it is to know.
        valve: that of its valve.
    """
    law = CONTROLLERS.load(name)
    entries = {"step": "m, r, f, p, model, memory, status"}
    if hasattr(law, "follow"):
        entries["follow"] = "command, own, memory"
    return compiled(law_on, entries, {"law": law, "cylinder": CYLINDERS.load(cylinder), "valve": VALVES.load(valve)})


class Outlook(NamedTuple):
    """Information on a cycle for companions.

    Attributes:
        cycle: number of the cycle.
        place: place in the programme, shape (PLACE,); None if nothing repeats.
        actuator: command of the actuator under test and its two derivatives, shape (3,); None if unknown.
    """

    cycle: int = 0
    place: Array | None = None
    actuator: Array | None = None


NOTHING_KNOWN = Outlook()
"""Outlook without companions."""


class Controller:
    """Controller of any kind, stepped once per cycle.

    Attributes:
        parameters: the tuning in force.
        model: its present model of the rig.
        companions: its companions.
        status: status of the law after the last step, by the indices of ``controllers.base``.
    """

    def __init__(
        self,
        name: str,
        parameters: Any,
        model: Model,
        companions: CompanionChain | None = None,
        cylinder: str = "double_rod",
        valve: str = "load_flow",
    ) -> None:
        """Prepare the law and its companions, compiling or loading their code.

        Args:
            name: file name of the controller.
            parameters: tuning of the controller.
            model: the controller's model of the rig.
            companions: companions of the controller; None for none.
            cylinder: file name of the model's cylinder.
            valve: that of its valve.
        """
        self._law, self._cylinder = CONTROLLERS.load(name), CYLINDERS.load(cylinder)
        entries = controller_kernel(name, cylinder, valve)
        self._step = entries.step
        self._follow: Callable[[float, float, Array], float] | None = getattr(entries, "follow", None)
        self.parameters = parameters
        self.model = self._original = model
        self._transition: Transition | None = None
        self.companions = CompanionChain({}) if companions is None else companions
        self.uses_friction = self._law.FRICTION
        self.status = np.zeros(STATUS_SIZE)
        self._bump = 0.0
        self._own = math.nan
        self._previous: Any = None
        self._fade = math.exp(-model.period / BUMP_TIME)
        self._row = np.full(ROW, np.nan)
        self._nowhere, self._unknown = np.full(PLACE, np.nan), np.full(FORESEEN, np.nan)
        self.reset()
        self._bind()
        self._direct(np.zeros(7), np.zeros(ROW), np.zeros(2), parameters, model, self._memory, self.status)
        if self._follow is not None:
            self._follow(0.0, 0.0, self._memory)
        self.companions.prepare()
        self.reset()

    def _bind(self) -> None:
        """Bind the law's compiled entry for the present types of tuning and model."""
        seen = np.zeros(7), np.zeros(ROW), np.zeros(2)
        self._direct = direct(self._step, *seen, self.parameters, self.model, self._memory, self.status)

    def reset(self) -> None:
        """Reset the memory and status of the law, and interrupt the companions; tuning and model are kept."""
        self._memory: Array = memory_on(self._law, self._cylinder, self.parameters)
        self._bump = 0.0
        self._own = math.nan
        self._previous = None
        self.status[:] = 0.0
        self.companions.interrupt()

    def retune(self, parameters: Any) -> None:
        """Apply another tuning from the next step on.

        The law uses the new tuning at once; the resulting jump of the command is subtracted and fades with :data:`BUMP_TIME`.
        """
        if self._previous is None:
            self._previous = self.parameters
        self.parameters = parameters
        self._bind()

    def accept(self, model: Model, sizes: Mapping[str, float] = NO_SIZES) -> float:
        """Move the model to that of an accepted rig from the next step on, within the bounds and at the rate of adaptation.

        Args:
            model: model of the accepted rig; companions keep the one that they were made with.
            sizes: references of relative changes, by name, for coefficients that may be near zero, such as a leakage.

        Returns:
            The duration of the change [s].

        Raises:
            BadInput: the rig is of another kind, or differs from the one that the controller was started with by more than
                adaptation may change; or a companion corrects the model already. The model then remains unchanged.
        """
        if self.companions.corrects:
            expected = "a controller without it: both would move the same coefficients"
            raise BadInput("a companion corrects the model", WHERE, expected)
        wanted = with_own_sensors(self._original, model)
        self._transition = Transition(self._original, self.model, wanted, ADAPTATION_LIMITS, sizes)
        return self._transition.duration

    def step(
        self,
        measured: Array,
        reference: Array,
        friction: Array,
        elapsed: int = 1,
        outlook: Outlook = NOTHING_KNOWN,
    ) -> float:
        """Return the spool command [m] for one cycle.

        Args:
            measured: readings in the order of ``SENSED``, shape (7,), or more for a rig that has more.
            reference: value that the law follows, with first and second derivative, shape (3,).
            friction: force of the elements and viscous force, shape (2,) or longer.
            elapsed: cycles since the last step; more than 1 after unanswered cycles.
            outlook: information for companions.
        """
        command = self._answer(measured, reference, friction, elapsed, outlook)
        if self.companions:
            past = Past(
                first=outlook.cycle,
                rows=self._row[np.newaxis],
                wanted=reference[np.newaxis],
                place=self._place(outlook)[np.newaxis],
                measured=measured[np.newaxis],
                command=np.array([command]),
                status=self.status[np.newaxis],
            )
            self.model = self.companions.done(past, self.model)
        return command

    def _place(self, outlook: Outlook) -> Array:
        return self._nowhere if outlook.place is None else outlook.place

    def _answer(self, measured: Array, reference: Array, friction: Array, elapsed: int, outlook: Outlook) -> float:
        """Return the command [m] for the reference as changed by the companions."""
        self._row[:FORESEEN] = reference
        if self.companions:
            self._row[FORESEEN:] = np.nan
            known = self._unknown if outlook.actuator is None else outlook.actuator
            place = self._place(outlook)
            self.companions.ahead(Upcoming(outlook.cycle, self._row[np.newaxis], place[np.newaxis], known[np.newaxis]))
        return self._step_alone(contiguous(measured), contiguous(friction), elapsed)

    def _step_alone(self, measured: Array, friction: Array, elapsed: int) -> float:
        """Return the law's command [m] for the prepared row, without a bump after a change of tuning."""
        if self._transition is not None:
            self.model = self._transition.after(elapsed * self.model.period)
            if self._transition.complete:
                self._transition = None
        model = self.model if elapsed == 1 else self.model._replace(period=elapsed * self.model.period)
        old: float | None = None
        if self._previous is not None:
            trial = self._memory.copy()
            old = self._step(measured, self._row, friction, self._previous, model, trial, self.status)
            self._previous = None
        command: float = self._direct(measured, self._row, friction, self.parameters, model, self._memory, self.status)
        self._bump *= self._fade**elapsed
        if old is not None:
            self._bump += old - command
        self._own = command
        if self._bump != 0.0:
            limit = self.model.spool_limit
            command = min(max(command + self._bump, -limit), limit)
            if abs(self._bump) < 1e-12:
                self._bump = 0.0
        return command

    def follow(
        self,
        measured: Array,
        reference: Array,
        friction: Array,
        commanded: float,
        elapsed: int = 1,
        outlook: Outlook = NOTHING_KNOWN,
    ) -> float:
        """Return the spool command [m] for one cycle, after a cycle that another controller answered.

        The law runs in parallel with the driving one and receives the actual valve commands. It returns the command with which
        it would take over. This command continues the other's; the difference between the two laws in the previous cycle fades
        with :data:`BUMP_TIME`. For a hand-over, send this command, and call :meth:`step` from the next cycle on. Companions
        learn nothing from such a cycle.

        Args:
            measured: as for :meth:`step`.
            reference: as for :meth:`step`.
            friction: as for :meth:`step`.
            commanded: valve command since the last step [m]; ignored before the first step.
            elapsed: as for :meth:`step`.
            outlook: as for :meth:`step`.
        """
        if not math.isnan(self._own):
            own = self._own if self._follow is None else self._follow(commanded, self._own, self._memory)
            self._bump = commanded - own
        return self._answer(measured, reference, friction, elapsed, outlook)
