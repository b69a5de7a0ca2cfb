"""Acceptance rules for incoming commands, by sender, answered cycle and value."""

import math

from ehls_ros.hardware.detectors import Detector
from ehls_ros.hardware.gate_parameters import HOLD, REACTIONS, Parameters

HOLD_REACTION = REACTIONS.index(HOLD)

ROUNDING = 1e-9
"""Rounding error of an age, which is a sum of periods [s]."""


class CommandIntake:
    """The last accepted command and its sender.

    Attributes:
        owner: sender whose commands are accepted; None: the first to send.
        departed_owner: owner before a hand-over, and last cycle for which its commands may still arrive.
        value: the last accepted command [m].
        answered: the cycle it answers; -1 before the first.
        fresh: whether it arrived since the last :meth:`advance_age`.
        detectors: of faults in commands.
    """

    def __init__(self, limit: float, period: float) -> None:
        """Start without a command.

        Args:
            limit: largest spool command [m].
            period: control period [s].
        """
        self._limit = limit
        self._period = period
        self._not_finite = Detector("command_not_finite", "m")
        self._range = Detector("command_range", "m")
        self._rate = Detector("command_rate", "m/s")
        self._order = Detector("command_order", "cycles")
        self._second_sender = Detector("second_sender", "")
        self.detectors = (self._not_finite, self._range, self._rate, self._order, self._second_sender)
        self.begin()

    def begin(self) -> None:
        """Forget all commands: the cycle count restarts."""
        self.owner: str | None = None
        self.departed_owner: tuple[str | None, int] = None, -1
        self.value = 0.0
        self.answered = -1
        self.fresh = False
        self._age = math.inf

    def retune(self, parameters: Parameters) -> None:
        """Apply other limits."""
        self._p = parameters
        self._range.limit, self._rate.limit = self._limit, parameters.command_rate

    def take(self, cycle: int | None, spool: float, sender: str, newest: int, *, followed: bool, driving: bool) -> bool:
        """Accept or refuse a command.

        Args:
            cycle: the cycle it answers; None if it names none.
            spool: spool command [m].
            sender: name of the sender.
            newest: the newest cycle.
            followed: whether the output follows commands at once; only then is their rate checked.
            driving: whether commands reach the actuator; a silent owner then remains the owner.

        Returns:
            Whether it is accepted; if not, a detector gives the reason.
        """
        if cycle is None:
            self._order.flag(math.nan, float(newest), "no cycle")
            return False
        return self._is_owner(sender, cycle, driving) and self._is_due(cycle, newest) and self._is_sound(cycle, spool, followed)

    def advance_age(self, elapsed: float) -> None:
        """Age the command by a time [s], unless it has just arrived."""
        self._age = 0.0 if self.fresh else self._age + elapsed
        self.fresh = False

    def age(self, newest: int, snapshot_age: float) -> float:
        """Return the age of the command in use, from its arrival or from its snapshot, whichever is larger [s].

        Args:
            newest: the newest cycle.
            snapshot_age: age of that cycle's snapshot [s].
        """
        came = 0.0 if self.fresh else self._age
        return max(came, (newest - self.answered) * self._period + snapshot_age)

    def clear_message_faults(self) -> None:
        """Clear the faults that last for one message."""
        self._order.raised = self._second_sender.raised = False

    @property
    def silent(self) -> bool:
        """Whether the owner has been silent long enough to be replaced."""
        return not self.fresh and self._age >= self._p.command_timeout - ROUNDING

    def hand_over(self, sender: str, newest: int) -> None:
        """Accept another sender's commands from now on; the age of the last command keeps counting.

        Args:
            sender: the new owner.
            newest: the newest cycle.
        """
        if sender != self.owner:
            self.departed_owner = self.owner, newest + math.ceil(self._p.command_timeout / self._period)
            self.owner = sender

    def _is_owner(self, sender: str, cycle: int, driving: bool) -> bool:
        if self.owner is None or (self.silent and not driving):
            self.owner = sender
        elif sender != self.owner:
            departed, until = self.departed_owner
            if sender != departed or cycle > until:
                self._second_sender.flag(math.nan, math.nan, sender)
            return False
        return True

    def _is_due(self, cycle: int, newest: int) -> bool:
        """Return whether the cycle of a command is neither in the future, nor answered already, nor too old."""
        if cycle > newest:
            self._order.flag(float(cycle - newest), 0.0, "in the future")
        elif cycle == self.answered:
            self._order.flag(0.0, 1.0, "duplicate")
        elif cycle < self.answered:
            self._order.flag(float(cycle - self.answered), 1.0, "out of order")
        elif (newest - cycle) * self._period >= self._p.command_timeout - ROUNDING:
            self._order.flag(float(newest - cycle), self._p.command_timeout / self._period, "too old")
        else:
            return True
        return False

    def _is_sound(self, cycle: int, value: float, followed: bool) -> bool:
        """Return whether a command's value is acceptable, and store it if so."""
        finite = math.isfinite(value)
        self._not_finite.look(not finite, value, math.inf)
        if not finite:
            return False
        beyond = abs(value) > self._limit
        self._range.look(beyond, value, self._limit)
        if beyond and self._range.reaction >= HOLD_REACTION:
            return False
        value = min(max(value, -self._limit), self._limit)
        rate = abs(value - self.value) / ((cycle - self.answered) * self._period)
        # While the gate is closed or blends in, a command may jump; the output does not.
        fast = rate > self._p.command_rate and self.answered >= 0 and followed
        self._rate.look(fast, rate, self._p.command_rate)
        if fast and self._rate.reaction >= HOLD_REACTION:
            return False
        self.value, self.answered, self.fresh = value, cycle, True
        return True
