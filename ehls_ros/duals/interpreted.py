"""Duals for one-time computations in Python: the parameters of a rig from those of its effects, and signals from these."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ehls_ros.arrays import Array

Tangents = Mapping[int, Any]
"""Derivatives by the index of the parameter."""


class Dual:
    """A number or an array with its derivatives by some parameters; comparisons use the value.

    Attributes:
        value: the value.
        tangents: derivatives by the parameters that it depends on, each a number or an array that broadcasts to the value.
    """

    __array_ufunc__ = None
    """Disables numpy's operators, so that arithmetic with arrays uses those of duals."""

    def __init__(self, value: Any, tangents: Tangents) -> None:
        """Store value and tangents."""
        self.value = value
        self.tangents = tangents

    def __add__(self, other: Any) -> "Dual":
        """Return the sum."""
        return _chain(self.value + value_of(other), (1.0, self), (1.0, other))

    def __sub__(self, other: Any) -> "Dual":
        """Return the difference."""
        return _chain(self.value - value_of(other), (1.0, self), (-1.0, other))

    def __rsub__(self, other: Any) -> "Dual":
        """Return the difference."""
        return _chain(other - self.value, (-1.0, self))

    def __mul__(self, other: Any) -> "Dual":
        """Return the product."""
        factor = value_of(other)
        return _chain(self.value * factor, (factor, self), (self.value, other))

    def __truediv__(self, other: Any) -> "Dual":
        """Return the quotient."""
        divisor = value_of(other)
        quotient = self.value / divisor
        return _chain(quotient, (1.0 / divisor, self), (-quotient / divisor, other))

    def __rtruediv__(self, other: Any) -> "Dual":
        """Return the quotient."""
        quotient = other / self.value
        return _chain(quotient, (-quotient / self.value, self))

    def __neg__(self) -> "Dual":
        """Return the negative."""
        return _chain(-self.value, (-1.0, self))

    def __getitem__(self, index: Any) -> "Dual":
        """Return a part of an array, without the tangents that are zero in it."""
        part = _each(lambda array: array[index], self)
        return Dual(part.value, {i: tangent for i, tangent in part.tangents.items() if np.any(tangent)})

    @property
    def T(self) -> "Dual":  # noqa: N802 - numpy's name
        """The transpose of an array."""
        return _each(np.transpose, self)

    def exp(self) -> "Dual":
        """Return the exponential; called by ``numpy.exp``."""
        value = math.exp(self.value)
        return _chain(value, (value, self))

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
        """Return whether the values are equal and neither varies."""
        same = self.value == (other.value if isinstance(other, Dual) else other)
        return same and not any(tangents_of(number) for number in (self, other))

    def __hash__(self) -> int:
        """Return the hash of the value."""
        return hash(self.value)

    __radd__, __rmul__ = __add__, __mul__


def _chain(value: Any, *parts: tuple[Any, Any]) -> Dual:
    """Return a value whose derivatives are the sum of those of some numbers, each times a factor."""
    tangents = dict[int, Any]()
    for factor, number in parts:
        for parameter, tangent in tangents_of(number).items():
            term = factor * tangent
            tangents[parameter] = tangents[parameter] + term if parameter in tangents else term
    return Dual(value, tangents)


def _each(function: Callable[[Any], Any], dual: Dual) -> Dual:
    shape = np.shape(dual.value)
    return Dual(function(dual.value), {i: function(np.broadcast_to(t, shape)) for i, t in dual.tangents.items()})


def linear(function: Callable[[Any], Any], signal: Any) -> Any:
    """Return a linear function of a signal; for a signal of duals, with its derivatives.

    Args:
        function: the function of an array.
        signal: the array, or a dual of it.
    """
    return _each(function, signal) if isinstance(signal, Dual) else function(signal)


def value_of(number: Any) -> Any:
    """Return the value of a number or an array."""
    return number.value if isinstance(number, Dual) else number


def tangents_of(number: Any) -> Tangents:
    """Return the tangents of a number or an array; empty for a float."""
    return number.tangents if isinstance(number, Dual) else {}


def exp(number: Any) -> Any:
    """Return the exponential of a number."""
    return number.exp() if isinstance(number, Dual) else math.exp(number)


def values_of(parameters: Any) -> Any:
    """Return a named tuple of numbers and tuples of numbers without derivatives."""
    return type(parameters)(*(tuple(map(value_of, p)) if isinstance(p, tuple) else value_of(p) for p in parameters))


def joined(numbers: Iterable[Any]) -> Any:
    """Return numbers as an array, shape (n,); as a dual if any of them is."""
    all_of_them = list(numbers)
    values = np.array([value_of(number) for number in all_of_them], dtype=np.float64)
    varied = parameters_of(all_of_them)
    if not varied:
        return values
    return Dual(values, {i: np.array([tangents_of(number).get(i, 0.0) for number in all_of_them]) for i in varied})


def numbers_of(parameters: Any) -> list[Any]:
    """Return the contents of a named tuple: its numbers first, then the entries of its lists."""
    lists = [entry for value in parameters if isinstance(value, tuple) for entry in value]
    return [*(value for value in parameters if not isinstance(value, tuple)), *lists]


def parameters_of(numbers: Iterable[Any]) -> list[int]:
    """Return the indices of the parameters on which some numbers or arrays depend, in ascending order."""
    return sorted({parameter for number in numbers if isinstance(number, Dual) for parameter in number.tangents})


def rows_of(numbers: Any, width: int, parameters: Sequence[int] | None = None) -> Array:
    """Return numbers as duals in memory layout, shape (n, width).

    Args:
        numbers: floats and duals of Python, or an array or a dual of it, shape (n,).
        width: width of a dual.
        parameters: indices of the parameters whose tangents follow the value; by default all, each at its index.
    """
    signal = numbers if isinstance(numbers, Dual | np.ndarray) else joined(numbers)
    values, tangents = value_of(signal), tangents_of(signal)
    out = np.zeros((len(values), width))
    out[:, 0] = values
    for place, parameter in enumerate(range(width - 1) if parameters is None else parameters):
        if parameter in tangents:
            out[:, 1 + place] = tangents[parameter]
    return out


def record_rows(parameters: Any, width: int, varied: Sequence[int] | None = None) -> Array:
    """Return a named tuple as duals in memory layout, its numbers first and then its lists, shape (n, width).

    Args:
        parameters: the named tuple.
        width: width of a dual.
        varied: indices of the parameters, as in :func:`rows_of`.
    """
    return rows_of(numbers_of(parameters), width, varied)
