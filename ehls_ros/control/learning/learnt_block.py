"""Learn from the load cycle of one block of a programme.

Two signals repeat. The measured force error is cancelled by a correction of the reference. For a law with preview, the external
force is handed to the law in advance. The force is learnt first, since it changes the error: the reference is corrected from
the first cycle with the foreseen force on.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.controllers.base import FORESEEN, ROW
from ehls_ros.control.learning.corrector import Corrector
from ehls_ros.control.learning.force_prediction import ForcePrediction
from ehls_ros.control.learning.repetition import ERROR, EXTERNAL, PREVIEWED, SMOOTHED, WANTED, LoadCycle
from ehls_ros.control.learning.repetition import FORESEEN as FORESEEN_FORCE
from ehls_ros.control.references._signals import quintic, weighted

SAME_REFERENCE = 0.02
"""Largest difference between two references that count as equal, relative to their size."""

CHECK_INTERVAL = 10
"""Samples between successive checks of the error within a load cycle."""

MIN_ERROR = 1e-3
"""Error that is never too large, relative to the size of the reference."""

FADE = 0.1
"""Fraction of a load cycle over which the foreseen force changes from the previously learnt one to the present one."""

MIN_FORCE_ERROR = 0.05
"""Error of the foreseen force that is never too large, relative to the range of the force on the piston."""

MAX_DEVIATION = 0.3
"""Rms difference between the error without correction and the expected one, over its rms, below which learning is valid."""

WITHDRAWAL_MARGIN = 0.5
"""Margin of a load cycle's squared error over that without correction, as a fraction of the latter's sum."""

MAX_ERROR_RATIO = 1.05
"""Ratio of a load cycle's rms error to that without correction above which the correction is withdrawn."""

TRANSIENT = 0.5
"""Ratio of a load cycle's squared error to that of the previous one below which the previous one contained a transient."""

WAIT, MAX_WAIT = 4, 64
"""Load cycles for which a harmful correction is withdrawn, the first time and at most."""


class Withdrawal:
    """Withdrawal of a correction with a larger force error than without it.

    The error of load cycles without correction is the reference. If the cumulative squared error of a load cycle with
    correction exceeds it by a margin, the correction is withdrawn at once. If the load cycle ends with a larger error, the
    correction is withdrawn for the next one. The waiting time, in load cycles, doubles with each withdrawal and halves with
    good corrections.

    Attributes:
        bare: cumulative squared error without correction up to each sample of the load cycle, shape (size,) [N^2]; infinite
            while unknown.
        repeats: whether two successive load cycles have shown an error of that size.
        waiting: load cycles for which the correction remains withdrawn.
    """

    def __init__(self, size: int) -> None:
        """Start without observations, for a load cycle of ``size`` samples."""
        self.bare = np.full(size, np.inf)
        self.repeats = False
        self.waiting = 0
        self._count = self._good = 0

    def observe(self, error: Array) -> None:
        """Process the error [N] of a load cycle without any correction, shape (size,)."""
        squares, before = np.cumsum(error**2), float(self.bare[-1])
        lasts = bool(squares[-1] >= TRANSIENT * before)
        self.repeats = self.repeats or lasts
        self.bare = 0.5 * (self.bare + squares) if lasts else squares
        self.waiting = max(self.waiting - 1, 0)

    def exceeds(self, squares: float, samples: int) -> bool:
        """Return whether the cumulative squared error of a load cycle with correction exceeds the margin.

        Args:
            squares: cumulative squared error so far [N^2].
            samples: samples so far.
        """
        return squares > float(self.bare[min(samples, len(self.bare)) - 1] + WITHDRAWAL_MARGIN * self.bare[-1])

    def is_worse(self, error: Array) -> bool:
        """Return whether a load cycle with correction has a larger error than those without; count a smaller one as good.

        Args:
            error: error [N], shape (size,).
        """
        if float(error @ error) > MAX_ERROR_RATIO**2 * float(self.bare[-1]):
            return True
        self._good += 1
        if self._good >= 2**self._count:
            self._count, self._good = max(self._count - 1, 0), 0
        return False

    def withdraw(self) -> None:
        """Withdraw the correction for a number of load cycles."""
        self._count, self._good = self._count + 1, 0
        self.waiting = min(WAIT * 2 ** (self._count - 1), MAX_WAIT)


class Learners(NamedTuple):
    """Learners of one load cycle.

    Attributes:
        reference: corrects the reference.
        force: foresees the external force; None if the law uses no preview.
    """

    reference: Corrector
    force: ForcePrediction | None


class Errors(NamedTuple):
    """Errors of one load cycle, shape (size,) each [N].

    Attributes:
        force: measured force minus the wanted reference.
        prediction: foreseen external force minus its immediate estimate.
        external: external force minus that foreseen by others, NaN where not yet known.
        previewed: whether others foresaw a force throughout.
    """

    force: Array
    prediction: Array
    external: Array
    previewed: bool


class LearntBlock:
    """One load cycle, with its learnt corrections.

    Attributes:
        period: length of the load cycle in control cycles.
        size: samples.
        wanted: reference at the samples, the first again at the end, shape (size + 1,) [N].
        tolerance: largest difference between references that count as equal [N].
        learners: learners of reference and force.
        table: corrections to the law's rows at the samples, the first again at the end, shape (size + 1, ROW).
        active: whether there is any correction.
        paused: whether the correction is suspended, as the error has grown.
        stale: whether the reference is not corrected, as it has changed.
        limits: rms over :data:`CHECK_INTERVAL` samples of the two errors above which they have grown.
        withdrawal: whether the correction increases the error.
        first_error, last_error: largest repeatable error in the first and in the last load cycle used [N].
    """

    def __init__(self, cycle: LoadCycle, learners: Learners, control_period: float) -> None:
        """Start from the reference of a load cycle; ``control_period`` in s."""
        self.control_period = control_period
        self.period, wanted = cycle.period, cycle.columns[:, WANTED]
        self.size = len(wanted)
        self.wanted = np.append(wanted, wanted[0])
        size = float(np.max(np.abs(wanted)))
        self.tolerance = SAME_REFERENCE * max(size, 1.0)
        self._min_error = MIN_ERROR * max(size, 1.0)
        self.learners = learners
        self.table = np.zeros((self.size + 1, ROW))
        self.active = self.paused = self.stale = False
        self.withdrawal = Withdrawal(self.size)
        self._begun = False
        self.limits = np.full(2, np.inf)
        self._largest = np.zeros(2)
        self.first_error = self.last_error = 0.0
        self._fade = round(FADE * self.size)
        self._pending: tuple[Array, Array] | None = None
        self._combine()

    @property
    def applied(self) -> bool:
        """Whether the reference correction is added."""
        return self.active and not self.paused and not self.stale

    @property
    def foresees(self) -> bool:
        """Whether the foreseen external force is added; another reference does not change it."""
        return self.active and not self.paused and self._predicts

    @property
    def cycles(self) -> int:
        """Number of load cycles used."""
        return self.learners.reference.cycles

    def matches(self, cycle: LoadCycle) -> bool:
        """Return whether a load cycle has the same length and reference."""
        same_length = len(cycle.columns) == self.size and abs(cycle.period - self.period) < SAME_REFERENCE
        return same_length and bool(np.max(np.abs(cycle.columns[:, WANTED] - self.wanted[:-1])) <= self.tolerance)

    def learn(self, errors: Errors, freeze: float) -> None:
        """Learn from a load cycle in which the table, if any, was added throughout.

        Args:
            errors: errors of that cycle.
            freeze: ratio of the error to the usual one above which it has grown.
        """
        reference, force = self.learners
        reference.observe(errors.force, settled=not self._begun)
        self._begun = False
        if force is not None:
            foreseen = bool(np.any(force.spectrum))
            force.observe(_external(errors, force))
            if force.correct() and not foreseen:
                reference.start_over()
                self._begun = True
        reference.correct()
        before = self.table.copy()
        if self._pending is not None:
            before[: self._fade] = self._pending[1]
        self._combine()
        self._blend(before, previewed=errors.previewed)
        largest = np.array([_largest_rms(errors.force), _largest_rms(errors.prediction)])
        if self.active:
            pull = 0.0 if force is None else float(np.ptp(force.expected()))
            lower = np.array([self._min_error, MIN_FORCE_ERROR * pull])
            self.limits = np.maximum(freeze * np.maximum(largest, self._largest), lower)
        self._largest = largest
        self.last_error = float(np.max(np.abs(reference.kept(errors.force))))
        if self.cycles == 1:
            self.first_error = self.last_error

    def observe_transition(self, errors: Errors) -> None:
        """Process the errors of a load cycle that contains a transition."""
        reference, force = self.learners
        reference.observe(errors.force, settled=False)
        if force is not None:
            force.observe(_external(errors, force), settled=False)

    def is_valid(self, errors: Errors) -> bool:
        """Return whether a load cycle without correction has the expected errors.

        If a force is foreseen, only that force is compared: without it the force error differs from the learnt one.
        """
        reference, force = self.learners
        if force is not None and self._predicts:
            return _agree(_external(errors, force), force.expected())
        return _agree(reference.kept(errors.force), reference.without())

    @property
    def _predicts(self) -> bool:
        return bool(np.isfinite(self.table[0, FORESEEN]))

    def begin_cycle(self) -> None:
        """Start a changed table from the previous foreseen force, for this load cycle."""
        if self._pending is None:
            return
        first, later = self._pending
        end = len(first)
        if np.array_equal(self.table[:end], later, equal_nan=True):
            self.table[:end] = first
        else:
            self.table[:end], self._pending = later, None

    def _blend(self, before: Array, *, previewed: bool) -> None:
        """Prepare a smooth transition to the new foreseen force over the first samples of the next load cycle."""
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
        first[:, FORESEEN:] = old + weighted((fade, rate, curvature), later[:, FORESEEN:] - old)
        self._pending = first, later

    def _combine(self) -> None:
        reference, force = self.learners
        self.table[:, :FORESEEN] = reference.table
        self.table[:, FORESEEN:] = np.nan if force is None or not np.any(force.spectrum) else force.table
        self.active = bool(np.any(reference.table)) or self._predicts

    def stored(self) -> dict[str, NDArray[Any]]:
        """Return the arrays to keep, by name."""
        reference, force = self.learners
        kept = {"period": np.array(self.period), "wanted": self.wanted[:-1], "limits": self.limits, "largest": self._largest}
        kept["errors"] = np.array([self.first_error, self.last_error])
        kept["bare"] = self.withdrawal.bare
        kept |= {f"reference.{name}": value for name, value in reference.stored().items()}
        return kept if force is None else kept | {f"force.{name}": value for name, value in force.stored().items()}

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> bool:
        """Restore arrays returned by :meth:`stored`; return whether they fit."""
        named = zip(("reference.", "force."), self.learners, strict=True)
        for prefix, learner in named:
            part = {name.removeprefix(prefix): value for name, value in stored.items() if name.startswith(prefix)}
            if learner is not None and not learner.restore(part):
                return False
        self.limits, self._largest = stored["limits"], stored["largest"]
        self.first_error, self.last_error = map(float, stored["errors"])
        self.withdrawal.bare = stored["bare"]
        self._combine()
        return True


def errors_of(cycle: LoadCycle) -> Errors:
    """Return the errors of a load cycle."""
    columns = cycle.columns
    foreseen, previewed = columns[:, FORESEEN_FORCE], columns[:, PREVIEWED]
    external = columns[:, SMOOTHED] - np.nan_to_num(previewed)
    return Errors(
        columns[:, ERROR], np.nan_to_num(foreseen) - columns[:, EXTERNAL], external, not bool(np.isnan(previewed).any())
    )


def recent_errors(rows: Array) -> tuple[float, float]:
    """Return the rms of both errors over contiguous control cycles [N].

    Args:
        rows: rows of a recorder, shape (n, COLUMNS).
    """
    force, prediction = rows[:, ERROR], rows[:, FORESEEN_FORCE] - rows[:, EXTERNAL]
    missed = 0.0 if math.isnan(prediction[0]) else math.sqrt(prediction @ prediction / len(rows))
    return math.sqrt(force @ force / len(rows)), missed


def _external(errors: Errors, force: ForcePrediction) -> Array:
    """Return the external force of a load cycle; where not yet known, the learnt force or the immediate estimate."""
    external = errors.external
    guess = force.expected() if force.cycles > 0 else -errors.prediction
    force_known: Array = np.where(np.isnan(external), guess, external)
    return force_known


def _agree(error: Array, expected: Array) -> bool:
    return bool(np.sum((error - expected) ** 2) < MAX_DEVIATION**2 * np.sum(error**2))


def _largest_rms(error: Array) -> float:
    whole = len(error) // CHECK_INTERVAL * CHECK_INTERVAL
    return float(np.sqrt(np.max(np.mean(error[:whole].reshape(-1, CHECK_INTERVAL) ** 2, axis=1), initial=0.0)))


NewLearners = Callable[[int, float], Learners]
"""Creates the learners of a load cycle, from its samples and its length [s]."""
