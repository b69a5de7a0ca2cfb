"""Functions whose derivative is known better than the chain rule finds it through their arithmetic."""

from typing import Any

from numba import types
from numba.extending import overload

from ehls_ros.duals.code import ONE, CodeDual, chain, intrinsic, read, written
from ehls_ros.duals.kinds import DualType


@intrinsic
def _value(typingctx: Any, dual: Any) -> Any:
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return read(context, builder, dual, args[0]).value

    return types.float64(dual), lower


@intrinsic
def _sloped(typingctx: Any, value: Any, slope: Any, number: Any) -> Any:
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole, factor, varying = (read(context, builder, kind, arg) for kind, arg in zip(sig.args, args, strict=True))
        tangents = chain(builder, (ONE, whole), (factor.value, varying))
        return written(context, builder, sig.return_type, CodeDual(whole.value, tangents))

    return number(value, slope, number), lower


def value_alone(number: Any) -> Any:
    """Return a number without its derivatives."""
    return number


@overload(value_alone, inline="always", strict=False)
def _value_alone(number: Any) -> Any:
    if not isinstance(number, DualType):
        return lambda number: number

    def of_dual(number: Any) -> Any:
        return _value(number)

    return of_dual


def sloped(value: Any, slope: float, number: Any) -> Any:
    """Return a value with the derivatives that a number gives it.

    Args:
        value: what is computed from the number's value alone, or that with the derivatives of other numbers.
        slope: its partial derivative by the number.
        number: the number; of a float, the value itself is returned, at no cost.
    """
    return value


@overload(sloped, inline="always", strict=False)
def _sloped_by(value: Any, slope: Any, number: Any) -> Any:
    if not isinstance(number, DualType):
        return lambda value, slope, number: value

    def of_dual(value: Any, slope: Any, number: Any) -> Any:
        return _sloped(value, slope, number)

    return of_dual
