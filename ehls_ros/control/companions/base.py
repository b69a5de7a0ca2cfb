"""What a companion's file provides: something that works beside any controller, on what is known ahead and on what happened.

``Parameters``; ``ACTUATOR``, whether it uses the command of the actuator under test; ``check(p, setting)``, which refuses what
it cannot work with; and ``build(p, setting)``, a :class:`Companion`. It serves laws that follow a force. Before some cycles
run, it may change the rows that the law will follow; after them, it sees what happened and may hand the law another
:class:`~ehls_ros.control.controllers.base.Model`. A node calls it for every cycle, the loop in one process for many cycles at
once. What it does depends on the numbers of the cycles alone, so both come to the same.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from ehls_ros.arrays import Array
from ehls_ros.control.controllers.base import ControllerLaw, Model
from ehls_ros.declared_arrays import Arrays
from ehls_ros.physics.parameters import Limits

BLOCK, REPETITIONS, PLACE = range(3)
"""Where a place in a programme holds the number of the block, and the load cycles completed in it with the fraction of the
present one, NaN where nothing repeats; and its length."""


class Setting(NamedTuple):
    """What a companion knows before the first cycle.

    Attributes:
        law: the file of the controller.
        tuning: the controller's parameters.
        model: what the controller knows of the rig.
        actuator: what the actuator's command is, ``"force"`` [N] or ``"position"`` [m].
        limits: of the rig; None: they are not known.
    """

    law: ControllerLaw
    tuning: Any
    model: Model
    actuator: str
    limits: Limits | None = None


class Kept(NamedTuple):
    """Learnt arrays of a companion, to be kept for the next run.

    Attributes:
        about: conditions of the learning, by name, in words; another run must have the same.
        parts: arrays of each part, such as a block of a programme; empty: nothing is learnt.
    """

    about: Mapping[str, str] = {}
    parts: Mapping[int, Arrays] = {}


class Upcoming(NamedTuple):
    """Cycles that will run, a row each.

    Attributes:
        first: number of the first.
        rows: what the law follows, shape (n, :data:`ehls_ros.control.controllers.base.ROW`); to be changed in place.
        place: place in the programme, shape (n, :data:`PLACE`).
        actuator: command of the actuator under test and its two derivatives, shape (n, 3); NaN where it is not known.
    """

    first: int
    rows: Array
    place: Array
    actuator: Array


class Past(NamedTuple):
    """Cycles that have run, a row each.

    Attributes:
        first: number of the first.
        rows: what the law followed, shape (n, ROW).
        wanted: the reference before any companion changed it, shape (n, 3).
        place: place in the programme, shape (n, :data:`PLACE`).
        measured: readings in the order of ``SENSED``, shape (n, 7).
        command: spool commands [m], shape (n,).
        status: the law's, by the indices of :mod:`ehls_ros.control.controllers.base`, shape (n, STATUS_SIZE).
    """

    first: int
    rows: Array
    wanted: Array
    place: Array
    measured: Array
    command: Array
    status: Array


class Companion(Protocol):
    """A companion at work; one that hands the law another model of the rig says so with ``corrects = True``."""

    def prepare(self) -> None:
        """Compile, or load, what :meth:`ahead` and :meth:`done` call, so that no cycle waits for it; change nothing."""

    def room(self, first: int, place: Array) -> int:
        """Return how many of some cycles to come, one at least, may run before :meth:`done` is called.

        Args:
            first: number of the first.
            place: place in the programme, shape (n, :data:`PLACE`).
        """

    def ahead(self, upcoming: Upcoming) -> None:
        """Change the rows of the cycles that will run next; called once for each cycle, in order."""

    def done(self, past: Past, model: Model) -> Model:
        """Take in what happened in these cycles; return the model that the law uses from now on."""

    def interrupt(self) -> None:
        """The valve does not follow the controller, or the plant has started anew: what is half learnt does not count."""

    def report(self) -> Mapping[str, float | str]:
        """Return figures and sentences for diagnostics and run folders."""

    def at_bounds(self) -> Sequence[str]:
        """Return a sentence for each estimate that stands at its bound, with the remedy."""

    def kept(self) -> Kept:
        """Return the learnt arrays. They are written to the file that the parameter ``file`` names, if there is one."""

    def recall(self, kept: Kept) -> None:
        """Take up the learnt arrays of an earlier run; called before the first cycle.

        Args:
            kept: with the same ``about``; the arrays may be anything.

        Raises:
            ValueError: an array is missing, of another type or shape, not finite, or beyond the bounds of the rig.
        """


class CompanionKind(Protocol):
    """The attributes of one companion's file."""

    Parameters: Any
    ACTUATOR: bool

    def check(self, p: Any, setting: Setting) -> None:
        """Refuse what it cannot work with. Whoever reads an experiment checks it: it opens no file.

        Raises:
            BadInput: it cannot work with this controller or rig.
        """

    def build(self, p: Any, setting: Setting) -> Companion:
        """Return the companion ready to work, once its parameters were checked; only where the controller runs."""
