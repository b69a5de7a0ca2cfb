"""What a file of a programme's block provides.

``Parameters``, a named tuple declaring its parameters; ``course(p, start)``: how it goes from the value where the programme
stands before it; and ``sample(t, p, start)``: value and first and second time derivative at times ``t`` [s] of shape (n,) since
its beginning, as an array of shape (n, 3). A block begins and ends at rest, its rate being 0 there: where it begins at another
value than ``start``, the programme leads there by a ramp.
"""

from typing import Any, NamedTuple, Protocol

from ehls_ros.arrays import Array


class Course(NamedTuple):
    """How a block goes.

    Attributes:
        begin: value at its beginning, in the programme's unit.
        end: value at its end.
        duration: time it takes, above 0 [s].
        cycle: time of a load cycle [s]; 0 where nothing repeats.
        count: number of load cycles.
        step: time between samples that miss no turning point by more than a per cent of its range [s].
    """

    begin: float
    end: float
    duration: float
    cycle: float
    count: int  # type: ignore[assignment]  # a tuple has a method of this name
    step: float


class Block(Protocol):
    """The attributes of one block's file."""

    Parameters: Any

    def course(self, p: Any, start: float) -> Course:
        """Return how the block goes after the programme has been at a value.

        Raises:
            BadInput: the parameters do not fit together.
        """

    def sample(self, t: Array, p: Any, start: float) -> Array:
        """Return value, first and second derivative, shape (n, 3)."""
