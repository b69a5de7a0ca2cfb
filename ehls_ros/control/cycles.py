"""Match the snapshot, reference and friction estimate of each cycle, and select the next cycle to answer.

They come from three senders. A snapshot opens its cycle. The reference arrives long before it. The friction estimate answers
the same snapshot, and may even arrive before it.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

KEPT = 4000
"""Number of stored references above which those of answered cycles are dropped."""


class Ready(NamedTuple):
    """A cycle that can be answered.

    Attributes:
        cycle: number of the cycle.
        stamp_ns: time stamp of the snapshot [ns].
        measured: readings in the order of :data:`ehls_ros.physics.rig.SENSED`.
        reference: value that the controller follows, with first and second derivative.
        friction: force of the elements and viscous force [N]; None if no estimate has arrived.
        elapsed: cycles since the one answered before; 1 for the first.
        anew: whether the plant has restarted, so that learnt state from earlier cycles is invalid.
    """

    cycle: int
    stamp_ns: int
    measured: Sequence[float]
    reference: Sequence[float]
    friction: Sequence[float] | None
    elapsed: int
    anew: bool


class Cycles:
    """Messages that have arrived for cycles not yet answered.

    Attributes:
        answered: the cycle answered last; -1 before the first.
        friction_comes: whether a cycle waits for its friction estimate. Once an estimate is later than the patience, cycles
            do not wait until another estimate arrives.
    """

    def __init__(self, *, friction: bool, patience: float) -> None:
        """Start empty.

        Args:
            friction: whether the controller uses the friction estimate.
            patience: longest time a cycle waits for its friction estimate [s].
        """
        self.answered = -1
        self.friction_comes = friction
        self._uses_friction = friction
        self._patience = patience
        self._pending: dict[int, tuple[int, Sequence[float]]] = {}
        self._since = 0.0
        self._newest = -1
        self._references: dict[int, Sequence[float]] = {}
        self._frictions: dict[int, Sequence[float]] = {}
        self._newest_friction = -1

    def add_snapshot(self, cycle: int, stamp_ns: int, measured: Sequence[float], now: float) -> None:
        """Add a snapshot received at a time [s] of a monotonic clock; a repetition does not restart the wait."""
        if self._pending.get(cycle) == (stamp_ns, measured):
            return
        if cycle <= self._newest:
            # The plant has restarted: its earlier snapshots are never answered.
            self._pending.clear()
        if not self._pending:
            self._since = now
        self._pending[cycle] = stamp_ns, measured
        self._newest = cycle

    def add_reference(self, cycle: int, row: Sequence[float]) -> None:
        """Add the reference of a cycle: its value and first and second derivative."""
        self._references[cycle] = row

    def add_friction(self, cycle: int, forces: Sequence[float]) -> None:
        """Add the friction estimate of a cycle: force of the elements and viscous force [N]."""
        if not self._uses_friction:
            return
        if cycle < self._newest_friction:
            # The estimator has restarted: its earlier estimates belong to other cycles with the same numbers.
            self._frictions.clear()
        self._frictions[cycle] = forces
        self._newest_friction = cycle
        self.friction_comes = True

    @property
    def lacks_reference(self) -> bool:
        """Whether the newest snapshot has no reference yet."""
        return bool(self._pending) and self._newest not in self._references

    @property
    def lacks(self) -> Literal["snapshot", "friction", "reference", "estimate"]:
        """The message awaited by the next cycle: the usual last one, or, once its snapshot is there, the missing one.

        The friction estimate usually arrives after the snapshot, so a loop that waits for it wakes up once per cycle.
        """
        if self._pending:
            return "reference" if self.lacks_reference else "estimate"
        return "friction" if self.friction_comes and self._newest_friction <= self.answered else "snapshot"

    def waited(self, now: float) -> float:
        """Return the time since the last answer for which snapshots have waited [s]; 0 if none waits."""
        return now - self._since if self._pending else 0.0

    def take(self, now: float) -> Ready | None:
        """Return the newest cycle that can be answered at a time [s], and mark it answered; None if there is none.

        Older cycles are never answered, as the answer would be too late.
        """
        for cycle in sorted(self._pending, reverse=True):
            if cycle in self._references and (cycle in self._frictions or not self._awaits_friction(now)):
                return self._answer(cycle, now)
        return None

    def _awaits_friction(self, now: float) -> bool:
        if now - self._since > self._patience:
            self.friction_comes = False
        return self.friction_comes

    def _answer(self, cycle: int, now: float) -> Ready:
        stamp_ns, measured = self._pending[cycle]
        anew = cycle <= self.answered
        elapsed = cycle - self.answered if self.answered >= 0 and not anew else 1
        ready = Ready(cycle, stamp_ns, measured, self._references.pop(cycle), self._frictions.get(cycle), elapsed, anew)
        self._pending = {k: snapshot for k, snapshot in self._pending.items() if k > cycle}
        self._since = now
        self._frictions = {k: forces for k, forces in self._frictions.items() if k > cycle}
        if cycle != self.answered + 1 or len(self._references) > KEPT:
            self._references = {k: row for k, row in self._references.items() if k > cycle}
        self.answered = cycle
        return ready
