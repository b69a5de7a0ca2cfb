"""A controller ready to run: its law compiled, its memory, and a change of tuning, rig or controller without a bump."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, direct, plain
from ehls_ros.control.adaptation.acceptance import NO_SIZES, WHERE, Transition, with_own_sensors
from ehls_ros.control.companions import adaptation
from ehls_ros.control.companions.base import PLACE, Past, Upcoming
from ehls_ros.control.company import Company
from ehls_ros.control.composition import controller_kernel
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORESEEN, ROW, STATUS_SIZE, Model
from ehls_ros.errors import BadInput

BUMP_TIME = 0.02
"""Time constant of the change of command from the old tuning, or the old controller, to the new [s]."""

CAUTION = adaptation.caution_of(adaptation.Parameters())
"""How far and how fast the model may change to that of an accepted rig: as adaptation may move it."""


class Outlook(NamedTuple):
    """What companions know of a cycle.

    Attributes:
        cycle: its number.
        place: where the programme is, shape (PLACE,); None: nothing repeats.
        actuator: command of the actuator under test and its two derivatives, shape (3,); None: not known.
    """

    cycle: int = 0
    place: Array | None = None
    actuator: Array | None = None


NOTHING_KNOWN = Outlook()
"""Where there are no companions."""


class Controller:
    """One controller of any kind, stepped once a cycle.

    Attributes:
        parameters: the tuning in force.
        model: the rig as it knows it at present.
        company: its companions.
        status: the law's status after its last step, by the indices of ``controllers.base``.
    """

    def __init__(self, name: str, parameters: Any, model: Model, company: Company | None = None) -> None:
        """Prepare and compile (or load) the law and what its companions need.

        Args:
            name: file name of the controller.
            parameters: its tuning.
            model: the rig as it knows it.
            company: what works beside it.
        """
        self._law = CONTROLLERS.load(name)
        compiled = controller_kernel(name)
        self._step = compiled.step
        self._follow: Callable[[float, float, Array], float] | None = getattr(compiled, "follow", None)
        self.parameters = parameters
        self.model = self._original = model
        self._transition: Transition | None = None
        self.company = Company({}) if company is None else company
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
        self.company.prepare()
        self.reset()

    def _bind(self) -> None:
        """Find the law's entry for the types of tuning and model."""
        seen = np.zeros(7), np.zeros(ROW), np.zeros(2)
        self._direct = direct(self._step, *seen, self.parameters, self.model, self._memory, self.status)

    def reset(self) -> None:
        """Forget everything but the tuning."""
        self._memory: Array = self._law.memory(self.parameters)
        self._bump = 0.0
        self._own = math.nan
        self._previous = None
        self.status[:] = 0.0
        self.company.interrupt()

    def retune(self, parameters: Any) -> None:
        """Put another tuning in force from the next step on.

        The law uses the new tuning at once; the jump of the command that the change alone would cause is subtracted
        and fades with :data:`BUMP_TIME`.
        """
        if self._previous is None:
            self._previous = self.parameters
        self.parameters = parameters
        self._bind()

    def accept(self, model: Model, sizes: Mapping[str, float] = NO_SIZES) -> float:
        """Change the model to that of an accepted rig from the next step on, within the bounds and at the rate of adaptation.

        Args:
            model: of the accepted rig; companions keep the one that they were made with.
            sizes: what changes are relative to, by name, of coefficients that may be about zero, such as a leakage.

        Returns:
            The duration of the change [s].

        Raises:
            BadInput: it is another rig, or differs from the one that the controller was started with by more than adaptation
                may change; or a companion corrects the model already. Nothing changes then.
        """
        if self.company.corrects:
            expected = "a controller without it: both would move the same coefficients"
            raise BadInput("a companion corrects the model", WHERE, expected)
        wanted = with_own_sensors(self._original, model)
        self._transition = Transition(self._original, self.model, wanted, CAUTION, sizes)
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
            measured: readings in the order of ``SENSED``, shape (7,).
            reference: what the law follows and its first and second derivative, shape (3,).
            friction: force of the elements and viscous force, shape (2,) or longer.
            elapsed: cycles since the last step; more than 1 after unanswered cycles.
            outlook: for companions.
        """
        command = self._answer(measured, reference, friction, elapsed, outlook)
        if self.company:
            past = Past(
                first=outlook.cycle,
                rows=self._row[np.newaxis],
                wanted=reference[np.newaxis],
                place=self._place(outlook)[np.newaxis],
                measured=measured[np.newaxis],
                command=np.array([command]),
                status=self.status[np.newaxis],
            )
            self.model = self.company.done(past, self.model)
        return command

    def _place(self, outlook: Outlook) -> Array:
        return self._nowhere if outlook.place is None else outlook.place

    def _answer(self, measured: Array, reference: Array, friction: Array, elapsed: int, outlook: Outlook) -> float:
        """Return the command [m] for what the companions make of the reference."""
        self._row[:FORESEEN] = reference
        if self.company:
            self._row[FORESEEN:] = np.nan
            known = self._unknown if outlook.actuator is None else outlook.actuator
            place = self._place(outlook)
            self.company.ahead(Upcoming(outlook.cycle, self._row[np.newaxis], place[np.newaxis], known[np.newaxis]))
        return self._step_alone(plain(measured), plain(friction), elapsed)

    def _step_alone(self, measured: Array, friction: Array, elapsed: int) -> float:
        """Return the law's command [m] for the row of what it follows, without a bump after a change of tuning."""
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

        In every cycle in which it is called, the law runs beside the one that drives and knows what the valve was told. The
        command returned is the one with which it would take over: it goes on from the other's, and the difference between the
        two laws in the cycle before fades with :data:`BUMP_TIME`. To take over is to send it, and to call :meth:`step` from
        the next cycle on. Companions learn nothing from such a cycle.

        Args:
            measured: as for :meth:`step`.
            reference: as for :meth:`step`.
            friction: as for :meth:`step`.
            commanded: what the valve was told since the last step [m]; before the first step there is nothing to go on from.
            elapsed: as for :meth:`step`.
            outlook: as for :meth:`step`.
        """
        if not math.isnan(self._own):
            own = self._own if self._follow is None else self._follow(commanded, self._own, self._memory)
            self._bump = commanded - own
        return self._answer(measured, reference, friction, elapsed, outlook)
