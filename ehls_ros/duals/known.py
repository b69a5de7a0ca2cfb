"""Functions with a given derivative, in place of the chain rule through their arithmetic."""

from typing import Any

from numba import types
from numba.extending import lower_builtin, type_callable

from ehls_ros.duals.code import ONE, CodeDual, chain, read, written
from ehls_ros.duals.kinds import DualType


def value_alone(number: Any) -> Any:
    """Return a number without its derivatives."""
    return number


@type_callable(value_alone)
def _value_alone_of(context: Any) -> Any:
    return lambda number: types.float64 if isinstance(number, DualType) else number


@lower_builtin(value_alone, types.Any)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    [kind], [number] = sig.args, args
    return read(context, builder, kind, number).value if isinstance(kind, DualType) else number


def sloped(value: Any, slope: float, number: Any) -> Any:
    """Return a value with the derivatives due to a number.

    Args:
        value: result computed from the number's value alone; it may have the derivatives by other numbers.
        slope: its partial derivative by the number.
        number: the number; for a float, the value is returned unchanged, at no cost.
    """
    return value


@type_callable(sloped)
def _sloped_by(context: Any) -> Any:
    return lambda value, slope, number: number if isinstance(number, DualType) else value


@lower_builtin(sloped, types.Any, types.Any, types.Any)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    if not isinstance(sig.args[2], DualType):
        return args[0]
    whole, factor, varying = (read(context, builder, kind, arg) for kind, arg in zip(sig.args, args, strict=True))
    tangents = chain(builder, (ONE, whole), (factor.value, varying))
    return written(context, builder, sig.return_type, CodeDual(whole.value, tangents))
