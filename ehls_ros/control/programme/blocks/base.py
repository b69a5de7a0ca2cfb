"""Interface of the file of a programme block.

A file has ``Parameters``, a named tuple declaring its parameters; ``course(p, start)``, its course from the value of the
programme before it; and ``sample(t, p, start)``: value and first and second time derivative at times ``t`` [s] of shape (n,)
since its beginning, as an array of shape (n, 3). A block begins and ends at rest, with zero rate. If it begins at another value
than ``start``, the programme inserts a ramp.
"""

from typing import Any, NamedTuple, Protocol

from ehls_ros.arrays import Array


class Course(NamedTuple):
    """Course of a block.

    Attributes:
        begin: value at its beginning, in the programme's unit.
        end: value at its end.
        duration: duration, above 0 [s].
        cycle: period of a load cycle [s]; 0 if nothing repeats.
        count: number of load cycles.
        step: sampling interval that resolves every turning point to a per cent of its range [s].
    """

    begin: float
    end: float
    duration: float
    cycle: float
    count: int  # type: ignore[assignment]  # a tuple has a method of this name
    step: float


class Block(Protocol):
    """The attributes of a block's file."""

    Parameters: Any

    def course(self, p: Any, start: float) -> Course:
        """Return the course of the block after the programme has been at a value.

        Raises:
            BadInput: the parameters are inconsistent.
        """

    def sample(self, t: Array, p: Any, start: float) -> Array:
        """Return value, first and second derivative, shape (n, 3)."""
