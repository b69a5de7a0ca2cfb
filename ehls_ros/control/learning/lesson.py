"""What is learnt of the load cycle of one block of a programme.

Two things repeat. The force error, as measured, is cancelled by a correction of the reference; and for a law that takes a
foreseen force, the external force that it estimates is handed to it before it comes. The force is learnt first, since it
changes the error: the reference is corrected from the cycle on that had it.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.controllers.base import FORESEEN, ROW
from ehls_ros.control.learning.base import Corrector, Learner
from ehls_ros.control.learning.repetition import ERROR, EXTERNAL, POSITION, WANTED, LoadCycle
from ehls_ros.control.learning.repetition import FORESEEN as FORESEEN_FORCE
from ehls_ros.control.learning.robustness import Design
from ehls_ros.control.references._blend import quintic

SAME = 0.02
"""Largest difference between two references that count as the same, over their size."""

LOOK = 10
"""Samples between two looks at the error within a load cycle."""

QUIET = 1e-3
"""Error that is never too large, over the size of the reference."""

FADE = 0.1
"""Part of a load cycle in which the foreseen force changes from what was learnt before to what is learnt now."""

FORCE_SHARE = 0.05
"""Error of the foreseen force that is never too large, over the range of the force on the piston."""

ALIKE = 0.3
"""Rms difference, over the rms, between the error without correction and the one expected, at which what was learnt holds."""


class Coupling(NamedTuple):
    """What holds the piston to the actuator under test.

    Attributes:
        stiffness: [N/m].
        damping: [N s/m].
    """

    stiffness: float
    damping: float


class Learners(NamedTuple):
    """The learners of one load cycle.

    Attributes:
        reference: corrects the reference.
        force: foresees the external force; None where the law takes none.
        later: filters of that learner once a force is foreseen.
    """

    reference: Corrector
    force: Learner | None
    later: Design | None


class Errors(NamedTuple):
    """Errors of one load cycle, shape (size,) each [N].

    Attributes:
        force: measured force less the reference wanted.
        foresight: foreseen external force less the one estimated.
        pull: force between the piston and the actuator under test, as the law estimates it.
        previewed: whether a force was foreseen throughout.
    """

    force: Array
    foresight: Array
    pull: Array
    previewed: bool


class Lesson:
    """One load cycle, and what is known of it.

    Attributes:
        period: its length in control cycles.
        size: samples.
        wanted: reference at the samples, the first again at the end, shape (size + 1,) [N].
        tolerance: largest difference of a reference that is the same [N].
        learners: what learns.
        table: what is added to the law's rows at the samples, the first again at the end, shape (size + 1, ROW).
        active: whether there is anything to add.
        paused: whether it is not added, as the error has grown.
        stale: whether the reference is not corrected, as it is another one at present.
        limits: rms over :data:`LOOK` samples of the two errors above which they have grown.
        first_error, last_error: largest repeatable error in the first load cycle that counted, and in the last [N].
    """

    def __init__(self, cycle: LoadCycle, learners: Learners, control_period: float) -> None:
        """Begin with the reference of a load cycle; ``control_period`` in s."""
        self.control_period = control_period
        self.period, wanted = cycle.period, cycle.columns[:, WANTED]
        self.size = len(wanted)
        self.wanted = np.append(wanted, wanted[0])
        size = float(np.max(np.abs(wanted)))
        self.tolerance = SAME * max(size, 1.0)
        self._quiet = QUIET * max(size, 1.0)
        self.learners = learners
        self.table = np.zeros((self.size + 1, ROW))
        self.active = self.paused = self.stale = False
        self.limits = np.full(2, np.inf)
        self._largest = np.zeros(2)
        self.first_error = self.last_error = 0.0
        self._fade = round(FADE * self.size)
        self._pending: tuple[Array, Array] | None = None
        self._combine()

    @property
    def applied(self) -> bool:
        """Whether the table is added."""
        return self.active and not self.paused and not self.stale

    @property
    def foresees(self) -> bool:
        """Whether that part of the table is added that foresees the external force: another reference does not change it."""
        return self.active and not self.paused and self._was_foreseen

    @property
    def cycles(self) -> int:
        """Load cycles that count."""
        return self.learners.reference.cycles

    def is_of(self, cycle: LoadCycle) -> bool:
        """Tell whether a load cycle has the same length and reference."""
        same_length = len(cycle.columns) == self.size and abs(cycle.period - self.period) < SAME
        return same_length and bool(np.max(np.abs(cycle.columns[:, WANTED] - self.wanted[:-1])) <= self.tolerance)

    def take(self, errors: Errors, freeze: float) -> None:
        """Learn from a load cycle in which the table was added throughout, if there is anything in it.

        Args:
            errors: of that cycle.
            freeze: error, over the usual one, above which it has grown.
        """
        reference, force, _ = self.learners
        reference.observe(errors.force)
        if force is not None:
            foreseen = bool(np.any(force.spectrum))
            self._believe(errors)
            force.observe(errors.foresight)
            if force.correct() and not foreseen:
                self._narrow()
                reference.begin_again()
        reference.correct()
        before = self.table.copy()
        if self._pending is not None:
            before[: self._fade] = self._pending[1]
        self._combine()
        self._blend(before, previewed=errors.previewed)
        largest = np.array([_largest_rms(errors.force), _largest_rms(errors.foresight)])
        if self.active:
            quiet = np.array([self._quiet, FORCE_SHARE * float(np.ptp(errors.pull))])
            self.limits = np.maximum(freeze * np.maximum(largest, self._largest), quiet)
        self._largest = largest
        self.last_error = float(np.max(np.abs(reference.kept(errors.force))))
        if self.cycles == 1:
            self.first_error = self.last_error

    def begin(self, errors: Errors) -> None:
        """See the errors of a load cycle that holds a transition."""
        self._believe(errors)
        for learner, error in self._pairs(errors):
            learner.observe(error, settled=False)

    def _believe(self, errors: Errors) -> None:
        """Believe less of the law's estimate where another companion foresees the force, so that the law's filter is slower."""
        if errors.previewed:
            self._narrow()

    def _narrow(self) -> None:
        _, force, later = self.learners
        if force is not None and later is not None and force.design is not later:
            force.narrow(later)

    def still_holds(self, errors: Errors) -> bool:
        """Tell whether a load cycle without correction has the errors that are expected.

        Where a force is foreseen, that force tells: without it the force error is another one than was learnt.
        """
        learner, error = list(self._pairs(errors))[-1] if self._was_foreseen else (self.learners.reference, errors.force)
        return _alike(learner.kept(error), learner.without())

    @property
    def _was_foreseen(self) -> bool:
        return bool(np.isfinite(self.table[0, FORESEEN]))

    def _pairs(self, errors: Errors) -> Iterator[tuple[Corrector, Array]]:
        yield self.learners.reference, errors.force
        if self.learners.force is not None:
            yield self.learners.force, errors.foresight

    def turn_begins(self) -> None:
        """Let a table that has changed begin with the one before, for this load cycle."""
        if self._pending is None:
            return
        first, later = self._pending
        end = len(first)
        if np.array_equal(self.table[:end], later, equal_nan=True):
            self.table[:end] = first
        else:
            self.table[:end], self._pending = later, None

    def _blend(self, before: Array, *, previewed: bool) -> None:
        """Prepare the first samples of the next load cycle: from the force foreseen before to the new one, without a jump."""
        end = self._fade
        first, later = self.table[:end].copy(), self.table[:end].copy()
        share = np.arange(end) / end
        fade, rate, curvature = quintic(share, 1.0)
        length = end * self.control_period
        rate, curvature = rate / length, curvature / length**2
        old = before[:end, FORESEEN:]
        if np.isnan(later[:, FORESEEN:]).any() or (np.isnan(old).any() and not previewed):
            self._pending = None
            return
        old = np.nan_to_num(old)
        value, slope, bend = (later[:, FORESEEN:] - old).T
        mixed = (fade * value, rate * value + fade * slope, curvature * value + 2.0 * rate * slope + fade * bend)
        first[:, FORESEEN:] = old + np.column_stack(mixed)
        self._pending = first, later

    def _combine(self) -> None:
        reference, force, _ = self.learners
        self.table[:, :FORESEEN] = reference.table
        self.table[:, FORESEEN:] = np.nan if force is None or not np.any(force.spectrum) else force.table
        self.active = bool(np.any(reference.table)) or self._was_foreseen

    def stored(self) -> dict[str, NDArray[Any]]:
        """Return what is to be kept, by name."""
        reference, force, _ = self.learners
        kept = {"period": np.array(self.period), "wanted": self.wanted[:-1], "limits": self.limits, "largest": self._largest}
        kept["errors"] = np.array([self.first_error, self.last_error])
        kept |= {f"reference.{name}": value for name, value in reference.stored().items()}
        return kept if force is None else kept | {f"force.{name}": value for name, value in force.stored().items()}

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> bool:
        """Take up what :meth:`stored` gave; return whether it fits."""
        named = zip(("reference.", "force."), self.learners[:2], strict=True)
        for prefix, learner in named:
            part = {name.removeprefix(prefix): value for name, value in stored.items() if name.startswith(prefix)}
            if learner is not None and not learner.restore(part):
                return False
        self.limits, self._largest = stored["limits"], stored["largest"]
        self.first_error, self.last_error = map(float, stored["errors"])
        self._combine()
        return True


def errors_of(cycle: LoadCycle, coupling: Coupling, period: float) -> Errors:
    """Return the errors of a load cycle.

    The law's external force holds the force in the coupling at the piston's side; that is taken out, by position and velocity.

    Args:
        cycle: the load cycle.
        coupling: what is known of it.
        period: of the control cycles [s].
    """
    columns = cycle.columns
    position = columns[:, POSITION]
    velocity = np.gradient(position, period * cycle.period / len(position))
    external = columns[:, EXTERNAL] - coupling.stiffness * position - coupling.damping * velocity
    foreseen = columns[:, FORESEEN_FORCE]
    absent = np.isnan(foreseen)
    foresight = np.where(absent, 0.0, foreseen) - external
    return Errors(columns[:, ERROR], foresight, columns[:, EXTERNAL], not absent.any())


def recent_errors(rows: Array, coupling: Coupling, period: float) -> tuple[float, float]:
    """Return the rms of both errors in some control cycles on end [N].

    Args:
        rows: as a recorder has them, shape (n, COLUMNS), n at least 2.
        coupling: what is known of it.
        period: of the control cycles [s].
    """
    position, force = rows[:, POSITION], rows[:, ERROR]
    velocity = (position[-1] - position[0]) / (period * (len(rows) - 1))
    foresight = rows[:, FORESEEN_FORCE] - rows[:, EXTERNAL] + coupling.stiffness * position
    foresight += coupling.damping * velocity
    missed = 0.0 if math.isnan(foresight[0]) else math.sqrt(foresight @ foresight / len(rows))
    return math.sqrt(force @ force / len(rows)), missed


def _alike(error: Array, expected: Array) -> bool:
    return bool(np.sum((error - expected) ** 2) < ALIKE**2 * np.sum(error**2))


def _largest_rms(error: Array) -> float:
    whole = len(error) // LOOK * LOOK
    return float(np.sqrt(np.max(np.mean(error[:whole].reshape(-1, LOOK) ** 2, axis=1), initial=0.0)))


NewLearners = Callable[[int, float], Learners]
"""Makes the learners of a load cycle, from its samples and its length [s]."""
