"""Duals for what is computed once and in Python, such as the parameters of a rig from those of its effects."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ehls_ros.arrays import Array


class Dual:
    """A number and its derivatives by some parameters; comparisons go by value.

    Attributes:
        value: its value.
        tangents: derivatives by the parameters, shape (parameters,).
    """

    __hash__ = None  # type: ignore[assignment]  # as for all that can change its value

    def __init__(self, value: float, tangents: Array) -> None:
        """Take value and tangents."""
        self.value = value
        self.tangents = tangents

    def __add__(self, other: "float | Dual") -> "Dual":
        """Return the sum."""
        return Dual(self.value + value_of(other), self.tangents + tangents_of(other))

    def __sub__(self, other: "float | Dual") -> "Dual":
        """Return the difference."""
        return Dual(self.value - value_of(other), self.tangents - tangents_of(other))

    def __rsub__(self, other: float) -> "Dual":
        """Return the difference."""
        return Dual(other - self.value, -self.tangents)

    def __mul__(self, other: "float | Dual") -> "Dual":
        """Return the product."""
        factor = value_of(other)
        return Dual(self.value * factor, factor * self.tangents + self.value * tangents_of(other))

    def __truediv__(self, other: "float | Dual") -> "Dual":
        """Return the quotient."""
        quotient = self.value / value_of(other)
        return Dual(quotient, (self.tangents - quotient * tangents_of(other)) / value_of(other))

    def __rtruediv__(self, other: float) -> "Dual":
        """Return the quotient."""
        return Dual(other / self.value, -other / self.value**2 * self.tangents)

    def __neg__(self) -> "Dual":
        """Return the negative."""
        return Dual(-self.value, -self.tangents)

    def exp(self) -> "Dual":
        """Return the exponential; numpy calls it so."""
        value = math.exp(self.value)
        return Dual(value, value * self.tangents)

    def __lt__(self, other: "float | Dual") -> bool:
        """Compare by value."""
        return self.value < value_of(other)

    def __le__(self, other: "float | Dual") -> bool:
        """Compare by value."""
        return self.value <= value_of(other)

    def __gt__(self, other: "float | Dual") -> bool:
        """Compare by value."""
        return self.value > value_of(other)

    def __ge__(self, other: "float | Dual") -> bool:
        """Compare by value."""
        return self.value >= value_of(other)

    def __eq__(self, other: object) -> bool:
        """Tell whether both are the same and neither varies."""
        same = self.value == (other.value if isinstance(other, Dual) else other)
        return same and not any(np.any(tangents_of(number)) for number in (self, other) if isinstance(number, Dual))

    __radd__, __rmul__ = __add__, __mul__


def value_of(number: float | Dual) -> float:
    """Return the value of a number."""
    return number.value if isinstance(number, Dual) else number


def tangents_of(number: float | Dual) -> Array | float:
    """Return the tangents of a number; 0 for a float."""
    return number.tangents if isinstance(number, Dual) else 0.0


def exp(number: Any) -> Any:
    """Return the exponential of a number."""
    return number.exp() if isinstance(number, Dual) else math.exp(number)


def rows_of(numbers: Iterable[Any], width: int) -> Array:
    """Return numbers as duals in memory, shape (n, width).

    Args:
        numbers: floats and duals of Python.
        width: of a dual.
    """
    all_of_them = list(numbers)
    out = np.zeros((len(all_of_them), width))
    for row, number in zip(out, all_of_them, strict=True):
        row[0] = value_of(number)
        if isinstance(number, Dual):
            row[1 : 1 + len(number.tangents)] = number.tangents
    return out


def record_rows(parameters: Any, width: int) -> Array:
    """Return a named tuple as duals in memory, its numbers first and then its lists, shape (n, width)."""
    lists = [entry for value in parameters if isinstance(value, tuple) for entry in value]
    return rows_of([*(value for value in parameters if not isinstance(value, tuple)), *lists], width)
