"""Interface of the file of a companion, which works beside any controller on known future and past cycles.

A file has ``Parameters``; ``ACTUATOR``, whether it uses the command of the actuator under test; ``check(p, setting)``, which
rejects settings that it does not support; and ``build(p, setting)``, which returns a :class:`Companion`. It serves laws that
follow a force. Before some cycles run, it may change the rows that the law will follow. After them, it receives their record
and may hand the law another :class:`~ehls_ros.control.controllers.base.Model`. A node calls it for every cycle, the loop in one
process for many cycles at once. Its action depends only on the numbers of the cycles, so the results are equal.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from ehls_ros.arrays import Array
from ehls_ros.control.controllers.base import ControllerLaw, Model
from ehls_ros.declared_arrays import Arrays
from ehls_ros.physics.parameters import Limits, Plant

BLOCK, REPETITIONS, PLACE = range(3)
"""Indices of a place in a programme: number of the block, and load cycles completed in it, including the fraction of the
present one (NaN without repetition); and the length of a place."""


class Setting(NamedTuple):
    """Information for a companion before the first cycle.

    Attributes:
        law: the file of the controller.
        tuning: the controller's parameters.
        model: the controller's model of the rig.
        actuator: kind of the actuator's command, ``"force"`` [N] or ``"position"`` [m].
        limits: limits of the rig; None if unknown.
        under_test: valve and cylinder of an actuator under test that is a double rod like the loader; None if that is the
            model's own.
        cylinder, valve: file names of the model's cylinder and valve.
    """

    law: ControllerLaw
    tuning: Any
    model: Model
    actuator: str
    limits: Limits | None = None
    under_test: Plant | None = None
    cylinder: str = "double_rod"
    valve: str = "load_flow"


class Kept(NamedTuple):
    """Learnt arrays of a companion, kept for the next run.

    Attributes:
        about: conditions of the learning as text, by name; they must be equal in the next run.
        parts: arrays of each part, such as a block of a programme; empty if nothing is learnt.
    """

    about: Mapping[str, str] = {}
    parts: Mapping[int, Arrays] = {}


class Upcoming(NamedTuple):
    """Upcoming cycles, one per row.

    Attributes:
        first: number of the first cycle.
        rows: inputs that the law follows, shape (n, :data:`ehls_ros.control.controllers.base.ROW`); to be changed in place.
        place: place in the programme, shape (n, :data:`PLACE`).
        actuator: command of the actuator under test and its two derivatives, shape (n, 3); NaN if unknown.
    """

    first: int
    rows: Array
    place: Array
    actuator: Array


class Past(NamedTuple):
    """Past cycles, one per row.

    Attributes:
        first: number of the first cycle.
        rows: inputs that the law followed, shape (n, ROW).
        wanted: the reference before changes by companions, shape (n, 3).
        place: place in the programme, shape (n, :data:`PLACE`).
        measured: readings in the order of ``SENSED``, shape (n, 7).
        command: spool commands [m], shape (n,).
        status: status of the law, by the indices of :mod:`ehls_ros.control.controllers.base`, shape (n, STATUS_SIZE).
    """

    first: int
    rows: Array
    wanted: Array
    place: Array
    measured: Array
    command: Array
    status: Array


class Companion(Protocol):
    """Companion at work; one that hands the law another model of the rig has ``corrects = True``.

    A subclass inherits a neutral version of each method, which changes, learns and reports nothing.
    """

    def prepare(self) -> None:
        """Compile or load the code of :meth:`ahead` and :meth:`done`, so that no cycle waits for it; change no state."""
        return

    def room(self, first: int, place: Array) -> int:
        """Return the number of upcoming cycles, at least one, that may run before :meth:`done` is called; by default all.

        Args:
            first: number of the first cycle.
            place: place in the programme, shape (n, :data:`PLACE`).
        """
        return len(place)

    def ahead(self, upcoming: Upcoming) -> None:
        """Change the rows of the cycles that will run next; called once for each cycle, in order."""
        return

    def done(self, past: Past, model: Model) -> Model:
        """Process the record of past cycles; return the model for the law from now on, by default unchanged."""
        return model

    def interrupt(self) -> None:
        """Discard incomplete learning: the valve does not follow the controller, or the plant has restarted."""
        return

    def report(self) -> Mapping[str, float | str]:
        """Return figures and sentences for diagnostics and run folders."""
        return {}

    def at_bounds(self) -> Sequence[str]:
        """Return a sentence for each estimate at its bound, with the remedy."""
        return ()

    def kept(self) -> Kept:
        """Return the learnt arrays, to be written to the file named by the parameter ``file``, if any."""
        return Kept()

    def recall(self, kept: Kept) -> None:
        """Restore the learnt arrays of an earlier run; called before the first cycle.

        Args:
            kept: arrays with the same ``about``, otherwise unchecked.

        Raises:
            ValueError: an array is missing, of another type or shape, not finite, or beyond the bounds of the rig.
        """
        return


class CompanionKind(Protocol):
    """The attributes of a companion's file."""

    Parameters: Any
    ACTUATOR: bool

    def check(self, p: Any, setting: Setting) -> None:
        """Reject unsupported settings. Called by every reader of an experiment, so it opens no file.

        Raises:
            BadInput: the companion does not support this controller or rig.
        """

    def build(self, p: Any, setting: Setting) -> Companion:
        """Return a new companion for checked parameters; called only where the controller runs."""
