"""Rules of differentiation: functions that accept duals, and explicit derivatives in place of the chain rule."""

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast, overload, type_callable

from ehls_ros.duals.code import (
    MINUS,
    ONE,
    CodeDual,
    Plain,
    any_tangent,
    chain,
    number,
    or_zero,
    read,
    written,
    zeros,
)
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


_Rule = Callable[..., CodeDual | tuple[ir.Value, list[tuple[Any, CodeDual]]]]
"""``rule(builder, plain, *duals)`` returns the dual, or its value and the partial derivatives, each with its argument."""


def _are_numbers_with_a_dual(args: Any, count: int) -> bool:
    """Return whether these are the types of ``count`` numbers, at least one of them a dual."""
    numbers = all(isinstance(a, DualType | types.Integer | types.Float) for a in args)
    return len(args) == count and numbers and any(isinstance(a, DualType) for a in args)


def _differentiable(*functions: Any, value_of: Any = None) -> Callable[[_Rule], _Rule]:
    """Register the derivative of functions of one or two numbers, at least one of them a dual."""

    def register(rule: _Rule) -> _Rule:
        count = rule.__code__.co_argcount - 2
        for function in functions:
            plain_function = value_of or function

            @infer_global(function)
            class _Typing(AbstractTemplate):
                key = function

                def generic(self, args: Any, kws: Any) -> Any:
                    if not _are_numbers_with_a_dual(args, count):
                        return None
                    kinds = [a if isinstance(a, DualType) else types.float64 for a in args]
                    return signature(next(a for a in args if isinstance(a, DualType)), *kinds)

            def lower(
                context: Any, builder: Any, sig: Any, args: Any, plain_function: Any = plain_function, rule: Any = rule
            ) -> Any:
                duals = [read(context, builder, kind, value) for kind, value in zip(sig.args, args, strict=True)]
                found = rule(builder, Plain(context, builder), *duals)
                if not isinstance(found, CodeDual):
                    found = CodeDual(found[0], chain(builder, *found[1]))
                return written(context, builder, sig.return_type, found)

            kinds = (DualType, types.Float)
            for one in kinds:
                for other in kinds if count == 2 else (None,):
                    if DualType in (one, other):
                        lower_builtin(function, *(kind for kind in (one, other) if kind is not None))(lower)
        return rule

    return register


@_differentiable(operator.add, operator.iadd)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    return plain(operator.add, a.value, b.value), [(ONE, a), (ONE, b)]


@_differentiable(operator.sub, operator.isub)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    return plain(operator.sub, a.value, b.value), [(ONE, a), (MINUS, b)]


@_differentiable(operator.mul, operator.imul)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    return plain(operator.mul, a.value, b.value), [(b.value, a), (a.value, b)]


@_differentiable(operator.truediv, operator.itruediv)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    quotient = plain(operator.truediv, a.value, b.value)
    inverse = builder.fdiv(number(1.0), b.value)
    return quotient, [(inverse, a), (builder.fneg(builder.fmul(quotient, inverse)), b)]


@_differentiable(operator.pow, operator.ipow)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    power = plain(operator.pow, a.value, b.value)
    by_base = builder.fdiv(builder.fmul(b.value, power), a.value)
    at_zero = builder.select(builder.fcmp_ordered("==", b.value, number(1.0)), number(1.0), number(0.0))
    by_base = builder.select(builder.fcmp_ordered("==", a.value, number(0.0)), at_zero, by_base)
    terms = [(by_base, a)]
    if b.tangents is not None:
        # A logarithm is expensive, and the exponent seldom varies.
        slot = cgutils.alloca_once_value(builder, number(0.0))
        with builder.if_then(builder.and_(any_tangent(builder, b.tangents), builder.fcmp_ordered(">", a.value, number(0.0)))):
            builder.store(builder.fmul(power, plain(math.log, a.value)), slot)
        terms.append((builder.load(slot), b))
    return power, terms


@_differentiable(operator.neg)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    return plain(operator.neg, a.value), [(MINUS, a)]


@_differentiable(operator.pos)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    return a.value, [(ONE, a)]


def _sign(builder: Any, value: ir.Value) -> ir.Value:
    return builder.select(builder.fcmp_ordered("<", value, number(0.0)), number(-1.0), number(1.0))


@_differentiable(abs, math.fabs)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    return plain(abs, a.value), [(_sign(builder, a.value), a)]


@_differentiable(math.copysign)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    value = plain(math.copysign, a.value, b.value)
    same = builder.fcmp_ordered("==", value, a.value)
    return value, [(builder.select(same, number(1.0), number(-1.0)), a)]


@_differentiable(math.exp)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    value = plain(math.exp, a.value)
    return value, [(value, a)]


@_differentiable(math.expm1)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    value = plain(math.expm1, a.value)
    return value, [(builder.fadd(value, number(1.0)), a)]


@_differentiable(math.log)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    return plain(math.log, a.value), [(builder.fdiv(number(1.0), a.value), a)]


@_differentiable(math.log1p)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    return plain(math.log1p, a.value), [(builder.fdiv(number(1.0), builder.fadd(number(1.0), a.value)), a)]


@_differentiable(math.sqrt)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    root = plain(math.sqrt, a.value)
    slope = builder.fdiv(number(0.5), root)
    return root, [(or_zero(builder, builder.fcmp_ordered(">", root, number(0.0)), slope), a)]


@_differentiable(math.sin)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    return plain(math.sin, a.value), [(plain(math.cos, a.value), a)]


@_differentiable(math.cos)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    return plain(math.cos, a.value), [(builder.fneg(plain(math.sin, a.value)), a)]


@_differentiable(math.tanh)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    value = plain(math.tanh, a.value)
    return value, [(builder.fsub(number(1.0), builder.fmul(value, value)), a)]


@_differentiable(math.atan)
def _(builder: Any, plain: Plain, a: CodeDual) -> Any:
    square = builder.fmul(a.value, a.value)
    return plain(math.atan, a.value), [(builder.fdiv(number(1.0), builder.fadd(number(1.0), square)), a)]


@_differentiable(math.hypot)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    value = plain(math.hypot, a.value, b.value)
    positive = builder.fcmp_ordered(">", value, number(0.0))
    return value, [(or_zero(builder, positive, builder.fdiv(v.value, value)), v) for v in (a, b)]


def _chosen(builder: Any, second: ir.Value, a: CodeDual, b: CodeDual) -> CodeDual:
    """Return the second of two duals if a condition holds, otherwise the first."""
    kinds = [v.type.count for v in a.tangents or b.tangents or ()]
    first, other = (dual.tangents or [zeros(lanes) for lanes in kinds] for dual in (a, b))
    tangents = [builder.select(second, y, x) for x, y in zip(first, other, strict=True)]
    return CodeDual(builder.select(second, b.value, a.value), tangents)


# The comparisons match those of numba's min and max.


@_differentiable(min)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    return _chosen(builder, builder.fcmp_ordered("<", b.value, a.value), a, b)


@_differentiable(max)
def _(builder: Any, plain: Plain, a: CodeDual, b: CodeDual) -> Any:
    return _chosen(builder, builder.fcmp_ordered(">", b.value, a.value), a, b)


def _typed_by_value(function: Any, count: int) -> None:
    """Register the type of a function that uses only the values."""

    @infer_global(function)
    class _Typing(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:
            if not _are_numbers_with_a_dual(args, count):
                return None
            plain = self.context.resolve_value_type(function)
            result = self.context.resolve_function_type(plain, (types.float64,) * count, {})
            return signature(result.return_type, *(a if isinstance(a, DualType) else types.float64 for a in args))


_PAIRS = ((DualType, DualType), (DualType, types.Float), (types.Float, DualType))


def _by_value(function: Any, count: int) -> None:
    """Register a function that uses only the values, such as a comparison."""
    _typed_by_value(function, count)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        duals = [read(context, builder, kind, value) for kind, value in zip(sig.args, args, strict=True)]
        return Plain(context, builder)(function, *(dual.value for dual in duals))

    for kinds in ((DualType,),) if count == 1 else _PAIRS:
        lower_builtin(function, *kinds)(lower)


def _equality(function: Any, *, equal: bool) -> None:
    """Register a test of equality: a varying number equals no number, so shortcuts for special values are not taken."""
    _typed_by_value(function, count=2)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        duals = [read(context, builder, kind, value) for kind, value in zip(sig.args, args, strict=True)]
        same = builder.fcmp_ordered("==", *(dual.value for dual in duals))
        for dual in duals:
            same = builder.and_(same, builder.not_(any_tangent(builder, dual.tangents or [])))
        return same if equal else builder.not_(same)

    for kinds in _PAIRS:
        lower_builtin(function, *kinds)(lower)


for _comparison in (operator.lt, operator.le, operator.gt, operator.ge):
    _by_value(_comparison, count=2)
_equality(operator.eq, equal=True)
_equality(operator.ne, equal=False)
for _function in (math.ceil, math.floor, math.isfinite, math.isnan):
    _by_value(_function, count=1)


@overload(np.round, inline="always", strict=False)
def _rounded(a: Any, decimals: int = 0, out: Any = None) -> Any:
    return (lambda a, decimals=0, out=None: np.round(value_alone(a))) if isinstance(a, DualType) else None


@lower_cast(types.Number, DualType)
def _(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    return written(context, builder, toty, read(context, builder, fromty, value))
