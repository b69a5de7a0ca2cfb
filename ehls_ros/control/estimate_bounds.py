"""Detect estimates of a law at a bound, where the excess is not compensated and appears as an error."""

from collections.abc import Iterator
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.controllers.base import Bounded, ControllerLaw

NEAR = 1e-9
"""Distance to a bound, relative to its size, that is attributed to rounding."""


class Bound(NamedTuple):
    """Bound of an estimate.

    Attributes:
        estimate: symbol of the estimate.
        place: index of the estimate in the status.
        value: the bound, in the status's unit, which is SI for every bounded estimate.
        side: 1 for an upper bound, -1 for a lower one, 0 for a bound on the absolute value.
        unit: unit of the estimate; ``1`` for a number.
        remedy: advice in case the bound is reached.
    """

    estimate: str
    place: int
    value: float
    side: int
    unit: str
    remedy: str

    @overload
    def reached(self, values: float) -> bool: ...

    @overload
    def reached(self, values: Array) -> NDArray[np.bool_]: ...

    def reached(self, values: Any) -> Any:
        """Return whether values of an estimate are at or beyond this bound; False for NaN."""
        outwards = abs(values) if self.side == 0 else self.side * values
        bound = self.value if self.side == 0 else self.side * self.value
        return outwards - bound >= -NEAR * abs(self.value)

    def __str__(self) -> str:
        """Return the bound with its unit."""
        kilo = self.unit == "N" and abs(self.value) >= 1e3
        number = f"{'±' if self.side == 0 else ''}{(1e-3 if kilo else 1.0) * self.value:.4g}"
        return number if self.unit == "1" else f"{number} {'kN' if kilo else self.unit}"


def bounds_of(law: ControllerLaw, tuning: Any) -> tuple[Bound, ...]:
    """Return the bounds on a law's estimates; none for an estimate that a range of zero width disables.

    Args:
        law: the file of the controller.
        tuning: parameters of the controller.
    """
    bounded: tuple[Bounded, ...] = getattr(law, "BOUNDED", ())
    return tuple(bound for each in bounded for bound in _of(each, tuning))


def _of(bounded: Bounded, tuning: Any) -> Iterator[Bound]:
    def at(name: str, side: int, move: str) -> Bound:
        value, remedy = float(getattr(tuning, name)), f"{move} {name}{bounded.instead}"
        return Bound(bounded.estimate, bounded.place, value, side, bounded.unit, remedy)

    upper = getattr(tuning, bounded.upper)
    if not bounded.lower:
        if upper > 0.0:
            yield at(bounded.upper, 0, "raise")
    elif getattr(tuning, bounded.lower) < upper:
        yield at(bounded.upper, 1, "raise")
        yield at(bounded.lower, -1, "lower")


def sentence(bound: Bound, when: str = "") -> str:
    """Return the report of an estimate at its bound.

    Args:
        bound: the bound.
        when: duration at the bound, such as ``for 37 % of the last half``; empty for the present.
    """
    stands = f"stood at its bound of {bound} {when}" if when else f"stands at its bound of {bound}"
    return f"{bound.estimate} {stands}: {bound.remedy}"
