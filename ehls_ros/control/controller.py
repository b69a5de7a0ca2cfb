"""A controller ready to run: its law compiled, its memory, and a change of tuning or of controller without a bump."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.composition import controller_kernel
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import STATUS_SIZE, Model

BUMP_TIME = 0.02
"""Time constant of the change of command from the old tuning, or the old controller, to the new [s]."""


class Controller:
    """One controller of any kind, stepped once a cycle.

    Attributes:
        parameters: the tuning in force.
        status: the law's status after its last step, by the indices of ``controllers.base``.
    """

    def __init__(self, name: str, parameters: Any, model: Model) -> None:
        """Prepare and compile (or load) the law.

        Args:
            name: file name of the controller.
            parameters: its tuning.
            model: the rig as it knows it.
        """
        self._law = CONTROLLERS.load(name)
        compiled = controller_kernel(name)
        self._step = compiled.step
        self._follow: Callable[[float, float, Array], float] | None = getattr(compiled, "follow", None)
        self.parameters = parameters
        self.model = model
        self.uses_friction = self._law.FRICTION
        self.status = np.zeros(STATUS_SIZE)
        self._bump = 0.0
        self._own = math.nan
        self._previous: Any = None
        self._fade = math.exp(-model.period / BUMP_TIME)
        self.reset()
        self._step(np.zeros(7), np.zeros(3), np.zeros(2), parameters, model, self._memory, self.status)
        if self._follow is not None:
            self._follow(0.0, 0.0, self._memory)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the tuning."""
        self._memory: Array = self._law.memory(self.parameters)
        self._bump = 0.0
        self._own = math.nan
        self._previous = None
        self.status[:] = 0.0

    def retune(self, parameters: Any) -> None:
        """Put another tuning in force from the next step on.

        The law uses the new tuning at once; the jump of the command that the change alone would cause is subtracted
        and fades with :data:`BUMP_TIME`.
        """
        if self._previous is None:
            self._previous = self.parameters
        self.parameters = parameters

    def step(self, measured: Array, reference: Array, friction: Array, elapsed: int = 1) -> float:
        """Return the spool command [m] for one cycle.

        Args:
            measured: readings in the order of ``SENSED``, shape (7,).
            reference: what the law follows and its first and second derivative, shape (3,).
            friction: force of the elements and viscous force, shape (2,) or longer.
            elapsed: cycles since the last step; more than 1 after unanswered cycles.
        """
        model = self.model if elapsed == 1 else self.model._replace(period=elapsed * self.model.period)
        old: float | None = None
        if self._previous is not None:
            trial = self._memory.copy()
            old = self._step(measured, reference, friction, self._previous, model, trial, self.status)
            self._previous = None
        command: float = self._step(measured, reference, friction, self.parameters, model, self._memory, self.status)
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

    def follow(self, measured: Array, reference: Array, friction: Array, commanded: float, elapsed: int = 1) -> float:
        """Return the spool command [m] for one cycle, after a cycle that another controller answered.

        In every cycle in which it is called, the law runs beside the one that drives and knows what the valve was told. The
        command returned is the one with which it would take over: it goes on from the other's, and the difference between the
        two laws in the cycle before fades with :data:`BUMP_TIME`. To take over is to send it, and to call :meth:`step` from
        the next cycle on.

        Args:
            measured: as for :meth:`step`.
            reference: as for :meth:`step`.
            friction: as for :meth:`step`.
            commanded: what the valve was told since the last step [m]; before the first step there is nothing to go on from.
            elapsed: as for :meth:`step`.
        """
        if not math.isnan(self._own):
            own = self._own if self._follow is None else self._follow(commanded, self._own, self._memory)
            self._bump = commanded - own
        return self.step(measured, reference, friction, elapsed)
