"""Which of the commands that come in count: whose they are, what they answer, and whether the valve may follow them."""

import math

from ehls_ros.hardware.detectors import Detector
from ehls_ros.hardware.gate_parameters import HOLD, REACTIONS, Parameters

HOLD_REACTION = REACTIONS.index(HOLD)

ROUNDING = 1e-9
"""Ages are sums of periods [s]."""


class CommandIntake:
    """The last command that counts, and its sender.

    Attributes:
        owner: whose commands are taken; None: whoever comes first.
        value: the last one that counts [m].
        answered: the cycle it answers; -1 before the first.
        fresh: whether it came since the last :meth:`grow_old`.
        detectors: of what is wrong with commands.
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
        self._stranger = Detector("second_sender", "")
        self.detectors = (self._not_finite, self._range, self._rate, self._order, self._stranger)
        self.begin()

    def begin(self) -> None:
        """Forget what came: cycles are counted anew."""
        self.owner: str | None = None
        self.value = 0.0
        self.answered = -1
        self.fresh = False
        self._age = math.inf

    def retune(self, parameters: Parameters) -> None:
        """Put other limits in force."""
        self._p = parameters
        self._range.limit, self._rate.limit = self._limit, parameters.command_rate

    def take(self, cycle: int | None, spool: float, sender: str, newest: int, *, followed: bool) -> bool:
        """Take a command that came in.

        Args:
            cycle: the cycle it answers; None where it names none.
            spool: spool command [m].
            sender: who sent it.
            newest: the newest cycle there is.
            followed: whether the output follows commands at once, so that their rate counts.

        Returns:
            Whether it counts; if not, a detector says why.
        """
        if cycle is None:
            self._order.again(math.nan, float(newest), "no cycle")
            return False
        return self._is_owner(sender) and self._is_due(cycle, newest) and self._is_sound(cycle, spool, followed)

    def grow_old(self, elapsed: float) -> None:
        """Let the command age [s], unless it is new."""
        self._age = 0.0 if self.fresh else self._age + elapsed
        self.fresh = False

    def age(self, newest: int, snapshot_age: float) -> float:
        """Return the age of what is followed [s]: since it came, or since the snapshot it answers if that is more.

        Args:
            newest: the newest cycle there is.
            snapshot_age: age of its snapshot [s].
        """
        came = 0.0 if self.fresh else self._age
        return max(came, (newest - self.answered) * self._period + snapshot_age)

    def messages_seen(self) -> None:
        """End the faults that last for one message."""
        self._order.raised = self._stranger.raised = False

    def _is_owner(self, sender: str) -> bool:
        silent = not self.fresh and self._age >= self._p.command_timeout - ROUNDING
        if self.owner is None or silent:
            self.owner = sender
        elif sender != self.owner:
            self._stranger.again(math.nan, math.nan, sender)
            return False
        return True

    def _is_due(self, cycle: int, newest: int) -> bool:
        """Tell whether a command answers a cycle that is neither to come, nor answered, nor long past."""
        if cycle > newest:
            self._order.again(float(cycle - newest), 0.0, "to come")
        elif cycle == self.answered:
            self._order.again(0.0, 1.0, "duplicate")
        elif cycle < self.answered:
            self._order.again(float(cycle - self.answered), 1.0, "out of order")
        elif (newest - cycle) * self._period >= self._p.command_timeout - ROUNDING:
            self._order.again(float(newest - cycle), self._p.command_timeout / self._period, "too old")
        else:
            return True
        return False

    def _is_sound(self, cycle: int, value: float, followed: bool) -> bool:
        """Tell whether a command's value may be followed, and keep it if so."""
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
        # Where it does not act, and while it is blended in, a command may jump: the output does not.
        fast = rate > self._p.command_rate and self.answered >= 0 and followed
        self._rate.look(fast, rate, self._p.command_rate)
        if fast and self._rate.reaction >= HOLD_REACTION:
            return False
        self.value, self.answered, self.fresh = value, cycle, True
        return True
