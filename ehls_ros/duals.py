"""Numbers that know their derivatives, for compiled functions: forward automatic differentiation of the same source.

A dual is a value and its derivatives by some parameters, the *tangents*. A function compiled for duals instead of floats
computes what it did before, to the bit, and the derivatives beside it by the chain rule (Griewank, Walther, Evaluating
Derivatives, 2008, chapter 3). Comparisons go by value. Whole numbers that :func:`math.ceil` and its like make have no
derivative. Where a function has a corner, the derivative is that of one side; where it is infinite, it counts as zero.

:data:`DualArray` and :data:`DualRecord` stand for an array of floats and for a named tuple of parameters. In memory, a dual is
a row of an array of floats, shape (n, width): the value, then the tangents. All tangents of a dual are added and multiplied
at once, as vectors of the processor. The last tangent is that by the length of the present step; it is zero but while
:func:`length_to_event` needs it.
"""

import math
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_cast,
    lower_getattr,
    lower_getattr_generic,
    overload,
    register_model,
)

from ehls_ros.arrays import Array

LANES = 8
"""Most floats in one vector; a processor with shorter vectors takes two."""

UNIT = 4
"""A width is a multiple of this."""


def width_of(parameters: int) -> int:
    """Return the floats in a dual: the value, a tangent for each parameter and one for the length of a step, rounded up."""
    return UNIT * math.ceil((parameters + 2) / UNIT)


# --- duals in Python ---------------------------------------------------------------------------


class Dual:
    """A dual for what is computed once and in Python, such as the parameters of a rig from those of its effects.

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
        return Dual(self.value + value_of(other), self.tangents + tangents_of(other))

    def __sub__(self, other: "float | Dual") -> "Dual":
        return Dual(self.value - value_of(other), self.tangents - tangents_of(other))

    def __rsub__(self, other: float) -> "Dual":
        return Dual(other - self.value, -self.tangents)

    def __mul__(self, other: "float | Dual") -> "Dual":
        factor = value_of(other)
        return Dual(self.value * factor, factor * self.tangents + self.value * tangents_of(other))

    def __truediv__(self, other: "float | Dual") -> "Dual":
        quotient = self.value / value_of(other)
        return Dual(quotient, (self.tangents - quotient * tangents_of(other)) / value_of(other))

    def __rtruediv__(self, other: float) -> "Dual":
        return Dual(other / self.value, -other / self.value**2 * self.tangents)

    def __neg__(self) -> "Dual":
        return Dual(-self.value, -self.tangents)

    def exp(self) -> "Dual":
        """Return the exponential; numpy calls it so."""
        value = math.exp(self.value)
        return Dual(value, value * self.tangents)

    def __lt__(self, other: "float | Dual") -> bool:
        return self.value < value_of(other)

    def __le__(self, other: "float | Dual") -> bool:
        return self.value <= value_of(other)

    def __gt__(self, other: "float | Dual") -> bool:
        return self.value > value_of(other)

    def __ge__(self, other: "float | Dual") -> bool:
        return self.value >= value_of(other)

    def __eq__(self, other: object) -> bool:
        return self.value == (other.value if isinstance(other, Dual) else other)

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
    """Return numbers as duals in memory, shape (n, width); of a tuple, its numbers.

    Args:
        numbers: floats, duals of Python and tuples of them.
        width: of a dual.
    """
    flat = [n for number in numbers for n in (number if isinstance(number, tuple) else (number,))]
    out = np.zeros((len(flat), width))
    for row, number in zip(out, flat, strict=True):
        row[0] = value_of(number)
        if isinstance(number, Dual):
            row[1 : 1 + len(number.tangents)] = number.tangents
    return out


# --- types -------------------------------------------------------------------------------------


class _Vector(types.Type):
    """Part of the tangents, as one vector."""

    def __init__(self, lanes: int) -> None:
        super().__init__(f"Vector({lanes})")
        self.lanes = lanes


class DualType(types.Type):
    """A dual of a width."""

    def __init__(self, width: int) -> None:
        """Name the type by the width."""
        super().__init__(f"Dual({width})")
        self.width = width

    @property
    def lanes(self) -> list[int]:
        """Lengths of the vectors that hold it; the first lane is the value's place in memory."""
        return [min(LANES, self.width - first) for first in range(0, self.width, LANES)]

    def unify(self, typingctx: Any, other: types.Type) -> "DualType | None":
        """Return the type of what is a dual in one branch and a plain number in another."""
        return self if isinstance(other, types.Number) else None

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """Tell that a plain number is a dual without tangents."""
        return Conversion.safe if isinstance(other, types.Number) else None


class DualArrayType(types.Type):
    """An array of duals of one or two dimensions, or a part of it."""

    def __init__(self, width: int, ndim: int) -> None:
        """Name the type by width and dimensions."""
        super().__init__(f"DualArray({width}, {ndim})")
        self.dtype = DualType(width)
        self.ndim = ndim


class DualRecordType(types.Type):
    """Parameters by name; one that is a tuple is an array of duals."""

    def __init__(self, width: int, layout: tuple[tuple[str, int, int], ...]) -> None:
        """Name the type by width and layout.

        Args:
            width: of a dual.
            layout: name, first row and number of rows of each parameter; 0: it is no tuple.
        """
        super().__init__(f"DualRecord({width}, {layout})")
        self.dtype = DualType(width)
        self.layout = layout


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(ir.DoubleType(), fe_type.lanes))


@register_model(DualType)
class _DualModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        members = [(f"tangents{i}", _Vector(lanes)) for i, lanes in enumerate(fe_type.lanes)]
        super().__init__(dmm, fe_type, [("value", types.float64), *members])


@register_model(DualArrayType)
class _ArrayModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        members = [("data", types.CPointer(types.float64)), ("rows", types.intp), ("columns", types.intp)]
        super().__init__(dmm, fe_type, members)


@register_model(DualRecordType)
class _RecordModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, [("data", types.CPointer(types.float64))])


# --- duals in intermediate code ----------------------------------------------------------------

_DOUBLE = ir.DoubleType()
_FUSED = ("contract",)


class _Dual:
    """A dual in intermediate code.

    Attributes:
        value: its value.
        tangents: vectors; None if all are zero.
    """

    def __init__(self, value: ir.Value, tangents: Sequence[ir.Value] | None) -> None:
        self.value = value
        self.tangents = tangents


def _read(context: Any, builder: Any, kind: Any, value: Any) -> _Dual:
    if not isinstance(kind, DualType):
        return _Dual(context.cast(builder, value, kind, types.float64), None)
    parts = cgutils.create_struct_proxy(kind)(context, builder, value=value)
    return _Dual(parts.value, [getattr(parts, f"tangents{i}") for i in range(len(kind.lanes))])


def _written(context: Any, builder: Any, kind: DualType, dual: _Dual) -> Any:
    parts = cgutils.create_struct_proxy(kind)(context, builder)
    parts.value = dual.value
    for i, lanes in enumerate(kind.lanes):
        setattr(parts, f"tangents{i}", _zeros(lanes) if dual.tangents is None else dual.tangents[i])
    return parts._getvalue()


def _zeros(lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(_DOUBLE, lanes), [0.0] * lanes)


def _spread(builder: Any, scalar: ir.Value, lanes: int) -> ir.Value:
    """Return a vector of equal numbers."""
    vector = ir.VectorType(_DOUBLE, lanes)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), places)


_ONE, _MINUS = 1, -1


def _chain(builder: Any, *terms: tuple[Any, _Dual]) -> list[Any] | None:
    """Return the sum of tangents times partial derivatives, which are numbers in intermediate code, 1 or -1."""
    total: list[Any] | None = None
    for partial, dual in terms:
        if dual.tangents is None:
            continue
        if total is None and partial is _MINUS:
            total = [builder.fneg(v) for v in dual.tangents]
            continue
        if partial is _MINUS:
            total = [builder.fsub(s, v, flags=_FUSED) for s, v in zip(total or [], dual.tangents, strict=True)]
            continue
        scaled = list(dual.tangents)
        if partial is not _ONE:
            scaled = [builder.fmul(_spread(builder, partial, v.type.count), v, flags=_FUSED) for v in scaled]
        total = scaled if total is None else [builder.fadd(s, v, flags=_FUSED) for s, v in zip(total, scaled, strict=True)]
    return total


def _number(value: float) -> ir.Constant:
    return ir.Constant(_DOUBLE, value)


def _or_zero(builder: Any, allowed: ir.Value, value: ir.Value) -> ir.Value:
    return builder.select(allowed, value, _number(0.0))


class _Plain:
    """Calls of the functions of plain floats, so that values are the same to the bit."""

    def __init__(self, context: Any, builder: Any) -> None:
        self._context, self._builder = context, builder

    def __call__(self, function: Any, *values: ir.Value) -> ir.Value:
        typing = self._context.typing_context
        kind = typing.resolve_value_type(function)
        sig = typing.resolve_function_type(kind, (types.float64,) * len(values), {})
        return self._context.get_function(kind, sig)(self._builder, values)


# --- rules -------------------------------------------------------------------------------------

_Rule = Callable[..., _Dual | tuple[ir.Value, list[tuple[Any, _Dual]]]]
"""``rule(builder, plain, *duals)`` returns the dual, or its value and the partial derivatives, each with its argument."""


def _differentiable(*functions: Any, value_of: Any = None) -> Callable[[_Rule], _Rule]:
    """Register the derivative of functions of one or two numbers, of which at least one is a dual."""

    def register(rule: _Rule) -> _Rule:
        count = rule.__code__.co_argcount - 2
        for function in functions:
            plain_function = value_of or function

            @infer_global(function)
            class _Typing(AbstractTemplate):
                key = function

                def generic(self, args: Any, kws: Any) -> Any:
                    if len(args) != count or not any(isinstance(a, DualType) for a in args):
                        return None
                    if not all(isinstance(a, DualType | types.Integer | types.Float) for a in args):
                        return None
                    kinds = [a if isinstance(a, DualType) else types.float64 for a in args]
                    return signature(next(a for a in args if isinstance(a, DualType)), *kinds)

            def lower(
                context: Any, builder: Any, sig: Any, args: Any, plain_function: Any = plain_function, rule: Any = rule
            ) -> Any:
                duals = [_read(context, builder, kind, value) for kind, value in zip(sig.args, args, strict=True)]
                found = rule(builder, _Plain(context, builder), *duals)
                if not isinstance(found, _Dual):
                    found = _Dual(found[0], _chain(builder, *found[1]))
                return _written(context, builder, sig.return_type, found)

            kinds = (DualType, types.Float)
            for one in kinds:
                for other in kinds if count == 2 else (None,):
                    if DualType in (one, other):
                        lower_builtin(function, *(kind for kind in (one, other) if kind is not None))(lower)
        return rule

    return register


@_differentiable(operator.add, operator.iadd)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    return plain(operator.add, a.value, b.value), [(_ONE, a), (_ONE, b)]


@_differentiable(operator.sub, operator.isub)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    return plain(operator.sub, a.value, b.value), [(_ONE, a), (_MINUS, b)]


@_differentiable(operator.mul, operator.imul)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    return plain(operator.mul, a.value, b.value), [(b.value, a), (a.value, b)]


@_differentiable(operator.truediv, operator.itruediv)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    quotient = plain(operator.truediv, a.value, b.value)
    inverse = builder.fdiv(_number(1.0), b.value)
    return quotient, [(inverse, a), (builder.fneg(builder.fmul(quotient, inverse)), b)]


@_differentiable(operator.pow, operator.ipow)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    power = plain(operator.pow, a.value, b.value)
    by_base = builder.fdiv(builder.fmul(b.value, power), a.value)
    at_zero = builder.select(builder.fcmp_ordered("==", b.value, _number(1.0)), _number(1.0), _number(0.0))
    by_base = builder.select(builder.fcmp_ordered("==", a.value, _number(0.0)), at_zero, by_base)
    terms = [(by_base, a)]
    if b.tangents is not None:
        # A logarithm is dear, and the exponent seldom varies.
        slot = cgutils.alloca_once_value(builder, _number(0.0))
        with builder.if_then(builder.and_(_any(builder, b.tangents), builder.fcmp_ordered(">", a.value, _number(0.0)))):
            builder.store(builder.fmul(power, plain(math.log, a.value)), slot)
        terms.append((builder.load(slot), b))
    return power, terms


def _any(builder: Any, tangents: Sequence[ir.Value]) -> ir.Value:
    """Return whether a tangent is not zero; the first lane is none."""
    found = ir.Constant(ir.IntType(1), 0)
    for index, vector in enumerate(tangents):
        lanes = vector.type.count
        if index == 0:
            vector = builder.insert_element(vector, _number(0.0), ir.Constant(ir.IntType(32), 0))
        differs = builder.fcmp_ordered("!=", vector, _zeros(lanes))
        bits = builder.bitcast(differs, ir.IntType(lanes))
        found = builder.or_(found, builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(lanes), 0)))
    return found


@_differentiable(operator.neg)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    return plain(operator.neg, a.value), [(_MINUS, a)]


@_differentiable(operator.pos)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    return a.value, [(_ONE, a)]


def _sign(builder: Any, value: ir.Value) -> ir.Value:
    return builder.select(builder.fcmp_ordered("<", value, _number(0.0)), _number(-1.0), _number(1.0))


@_differentiable(abs, math.fabs)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    return plain(abs, a.value), [(_sign(builder, a.value), a)]


@_differentiable(math.copysign)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    value = plain(math.copysign, a.value, b.value)
    same = builder.fcmp_ordered("==", value, a.value)
    return value, [(builder.select(same, _number(1.0), _number(-1.0)), a)]


@_differentiable(math.exp)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    value = plain(math.exp, a.value)
    return value, [(value, a)]


@_differentiable(math.expm1)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    value = plain(math.expm1, a.value)
    return value, [(builder.fadd(value, _number(1.0)), a)]


@_differentiable(math.log)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    return plain(math.log, a.value), [(builder.fdiv(_number(1.0), a.value), a)]


@_differentiable(math.log1p)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    return plain(math.log1p, a.value), [(builder.fdiv(_number(1.0), builder.fadd(_number(1.0), a.value)), a)]


@_differentiable(math.sqrt)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    root = plain(math.sqrt, a.value)
    slope = builder.fdiv(_number(0.5), root)
    return root, [(_or_zero(builder, builder.fcmp_ordered(">", root, _number(0.0)), slope), a)]


@_differentiable(math.sin)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    return plain(math.sin, a.value), [(plain(math.cos, a.value), a)]


@_differentiable(math.cos)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    return plain(math.cos, a.value), [(builder.fneg(plain(math.sin, a.value)), a)]


@_differentiable(math.tanh)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    value = plain(math.tanh, a.value)
    return value, [(builder.fsub(_number(1.0), builder.fmul(value, value)), a)]


@_differentiable(math.atan)
def _(builder: Any, plain: _Plain, a: _Dual) -> Any:
    square = builder.fmul(a.value, a.value)
    return plain(math.atan, a.value), [(builder.fdiv(_number(1.0), builder.fadd(_number(1.0), square)), a)]


@_differentiable(math.hypot)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    value = plain(math.hypot, a.value, b.value)
    positive = builder.fcmp_ordered(">", value, _number(0.0))
    return value, [(_or_zero(builder, positive, builder.fdiv(v.value, value)), v) for v in (a, b)]


def _chosen(builder: Any, second: ir.Value, a: _Dual, b: _Dual) -> _Dual:
    """Return the second of two duals if a condition holds, else the first."""
    kinds = [v.type.count for v in a.tangents or b.tangents or ()]
    first, other = (dual.tangents or [_zeros(lanes) for lanes in kinds] for dual in (a, b))
    tangents = [builder.select(second, y, x) for x, y in zip(first, other, strict=True)]
    return _Dual(builder.select(second, b.value, a.value), tangents)


# The comparisons are those of numba's min and max.


@_differentiable(min)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    return _chosen(builder, builder.fcmp_ordered("<", b.value, a.value), a, b)


@_differentiable(max)
def _(builder: Any, plain: _Plain, a: _Dual, b: _Dual) -> Any:
    return _chosen(builder, builder.fcmp_ordered(">", b.value, a.value), a, b)


def _by_value(function: Any, count: int) -> None:
    """Register a function of the values alone, such as a comparison."""

    @infer_global(function)
    class _Typing(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) != count or not any(isinstance(a, DualType) for a in args):
                return None
            if not all(isinstance(a, DualType | types.Integer | types.Float) for a in args):
                return None
            plain = self.context.resolve_value_type(function)
            result = self.context.resolve_function_type(plain, (types.float64,) * count, {})
            return signature(result.return_type, *(a if isinstance(a, DualType) else types.float64 for a in args))

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        duals = [_read(context, builder, kind, value) for kind, value in zip(sig.args, args, strict=True)]
        return _Plain(context, builder)(function, *(dual.value for dual in duals))

    if count == 1:
        lower_builtin(function, DualType)(lower)
    else:
        for kinds in ((DualType, DualType), (DualType, types.Float), (types.Float, DualType)):
            lower_builtin(function, *kinds)(lower)


for _function in (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne):
    _by_value(_function, count=2)
for _function in (math.ceil, math.floor, math.isfinite, math.isnan):
    _by_value(_function, count=1)


@intrinsic
def _value_of(typingctx: Any, dual: Any) -> Any:
    """Return the value of a dual."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _read(context, builder, dual, args[0]).value

    return types.float64(dual), lower


@overload(np.round, inline="always", strict=False)
def _rounded(a: Any, decimals: int = 0, out: Any = None) -> Any:
    return (lambda a, decimals=0, out=None: np.round(_value_of(a))) if isinstance(a, DualType) else None


@lower_cast(types.Number, DualType)
def _(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    return _written(context, builder, toty, _read(context, builder, fromty, value))


# --- arrays and records ------------------------------------------------------------------------


def _row(context: Any, builder: Any, kind: DualType, data: Any, index: Any) -> Any:
    """Return a pointer to a dual in memory."""
    return builder.gep(data, [builder.mul(index, context.get_constant(types.intp, kind.width))])


def _load(context: Any, builder: Any, kind: DualType, data: Any, index: Any) -> Any:
    place, tangents = _row(context, builder, kind, data, index), []
    for i, lanes in enumerate(kind.lanes):
        part = builder.gep(place, [context.get_constant(types.intp, i * LANES)])
        tangents.append(builder.load(builder.bitcast(part, ir.VectorType(_DOUBLE, lanes).as_pointer()), align=8))
    value = builder.extract_element(tangents[0], ir.Constant(ir.IntType(32), 0))
    return _written(context, builder, kind, _Dual(value, tangents))


def _store(context: Any, builder: Any, kind: DualType, data: Any, index: Any, dual: _Dual) -> None:
    place = _row(context, builder, kind, data, index)
    for i, lanes in enumerate(kind.lanes):
        vector = _zeros(lanes) if dual.tangents is None else dual.tangents[i]
        if i == 0:
            vector = builder.insert_element(vector, dual.value, ir.Constant(ir.IntType(32), 0))
        part = builder.gep(place, [context.get_constant(types.intp, i * LANES)])
        builder.store(vector, builder.bitcast(part, vector.type.as_pointer()), align=8)


@infer_global(operator.getitem)
class _Item(AbstractTemplate):
    key = operator.getitem

    def generic(self, args: Any, kws: Any) -> Any:
        array, index = args
        if not isinstance(array, DualArrayType):
            return None
        if isinstance(index, types.Integer):
            row = array.dtype if array.ndim == 1 else DualArrayType(array.dtype.width, 1)
            return signature(row, array, types.intp)
        if isinstance(index, types.SliceType) and array.ndim == 1 and not index.has_step:
            return signature(array, array, index)
        if isinstance(index, types.BaseTuple) and array.ndim == 2 and len(index) == 2:
            return signature(array.dtype, array, types.UniTuple(types.intp, 2))
        return None


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    key = operator.setitem

    def generic(self, args: Any, kws: Any) -> Any:
        array, index, value = args
        if not isinstance(array, DualArrayType) or not isinstance(value, DualType | types.Integer | types.Float):
            return None
        kind = value if isinstance(value, DualType) else types.float64
        if isinstance(index, types.Integer) and array.ndim == 1:
            return signature(types.none, array, types.intp, kind)
        if isinstance(index, types.SliceType) and array.ndim == 1 and not index.has_step:
            return signature(types.none, array, index, kind)
        if isinstance(index, types.BaseTuple) and array.ndim == 2 and len(index) == 2:
            return signature(types.none, array, types.UniTuple(types.intp, 2), kind)
        return None


def _array(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return cgutils.create_struct_proxy(kind)(context, builder, value=value)


@lower_builtin(operator.getitem, DualArrayType, types.Integer)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, array = sig.args[0], _array(context, builder, sig.args[0], args[0])
    if kind.ndim == 1:
        return _load(context, builder, kind.dtype, array.data, args[1])
    row = _array(context, builder, sig.return_type, None)
    row.data = _row(context, builder, kind.dtype, array.data, builder.mul(args[1], array.columns))
    row.rows, row.columns = array.columns, array.columns
    return row._getvalue()


@lower_builtin(operator.getitem, DualArrayType, types.BaseTuple)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, array = sig.args[0], _array(context, builder, sig.args[0], args[0])
    return _load(context, builder, kind.dtype, array.data, _flat(builder, array, args[1]))


def _flat(builder: Any, array: Any, index: Any) -> Any:
    row, column = cgutils.unpack_tuple(builder, index, 2)
    return builder.add(builder.mul(row, array.columns), column)


def _part(context: Any, builder: Any, kind: Any, array: Any, slice_type: Any, index: Any) -> Any:
    """Return the part of an array that a slice without step and without negative numbers tells."""
    bounds = context.make_helper(builder, slice_type, index)
    low, high = (
        builder.select(builder.icmp_signed("<", bound, array.rows), bound, array.rows) for bound in (bounds.start, bounds.stop)
    )
    part = _array(context, builder, kind, None)
    part.data = _row(context, builder, kind.dtype, array.data, low)
    part.rows, part.columns = builder.sub(high, low), array.columns
    return part


@lower_builtin(operator.getitem, DualArrayType, types.SliceType)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    array = _array(context, builder, sig.args[0], args[0])
    return _part(context, builder, sig.args[0], array, sig.args[1], args[1])._getvalue()


def _set(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, array = sig.args[0], _array(context, builder, sig.args[0], args[0])
    index = args[1] if isinstance(sig.args[1], types.Integer) else _flat(builder, array, args[1])
    _store(context, builder, kind.dtype, array.data, index, _read(context, builder, sig.args[2], args[2]))
    return context.get_dummy_value()


def _fill(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, array = sig.args[0], _array(context, builder, sig.args[0], args[0])
    part, dual = _part(context, builder, kind, array, sig.args[1], args[1]), _read(context, builder, sig.args[2], args[2])
    with cgutils.for_range(builder, part.rows) as loop:
        _store(context, builder, kind.dtype, part.data, loop.index, dual)
    return context.get_dummy_value()


for _kind in (DualType, types.Float):
    lower_builtin(operator.setitem, DualArrayType, types.Integer, _kind)(_set)
    lower_builtin(operator.setitem, DualArrayType, types.BaseTuple, _kind)(_set)
    lower_builtin(operator.setitem, DualArrayType, types.SliceType, _kind)(_fill)


@infer_getattr
class _ArrayAttributes(AttributeTemplate):
    key = DualArrayType

    def resolve_size(self, array: Any) -> Any:
        return types.intp if array.ndim == 1 else None

    def resolve_shape(self, array: Any) -> Any:
        return types.UniTuple(types.intp, array.ndim)


@lower_getattr(DualArrayType, "shape")
def _(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    array = _array(context, builder, kind, value)
    return context.make_tuple(builder, types.UniTuple(types.intp, kind.ndim), (array.rows, array.columns)[: kind.ndim])


@lower_getattr(DualArrayType, "size")
def _(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return _array(context, builder, kind, value).rows


@infer_global(len)
class _Length(AbstractTemplate):
    key = len

    def generic(self, args: Any, kws: Any) -> Any:
        return signature(types.intp, *args) if isinstance(args[0], DualArrayType) else None


@lower_builtin(len, DualArrayType)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return _array(context, builder, sig.args[0], args[0]).rows


@infer_getattr
class _RecordAttributes(AttributeTemplate):
    key = DualRecordType

    def generic_resolve(self, record: Any, attr: str) -> Any:
        for name, _, rows in record.layout:
            if name == attr:
                return DualArrayType(record.dtype.width, 1) if rows else record.dtype
        return None


@lower_getattr_generic(DualRecordType)
def _(context: Any, builder: Any, kind: Any, value: Any, attr: str) -> Any:
    data = _array(context, builder, kind, value).data
    first, rows = next((first, rows) for name, first, rows in kind.layout if name == attr)
    if not rows:
        return _load(context, builder, kind.dtype, data, context.get_constant(types.intp, first))
    part = _array(context, builder, DualArrayType(kind.dtype.width, 1), None)
    part.data = _row(context, builder, kind.dtype, data, context.get_constant(types.intp, first))
    part.rows = part.columns = context.get_constant(types.intp, rows)
    return part._getvalue()


# --- views of memory ---------------------------------------------------------------------------


def layout_of(fields: Sequence[tuple[str, Any]]) -> tuple[tuple[str, int, int], ...]:
    """Return name, first row and number of rows of parameters; ``fields`` has the lengths of those that are tuples, else 0."""
    out, first = [], 0
    for name, rows in fields:
        out.append((name, first, rows))
        first += max(rows, 1)
    return tuple(out)


@intrinsic(prefer_literal=True)
def dual_array(typingctx: Any, array: Any, width: Any) -> Any:
    """Return the duals in an array of floats: of shape (n, width) n, of shape (n, m, width) n × m; ``width`` is constant."""
    kind = DualArrayType(width.literal_value, array.ndim - 1)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        given = context.make_array(sig.args[0])(context, builder, args[0])
        shape, out = cgutils.unpack_tuple(builder, given.shape), _array(context, builder, kind, None)
        out.data, out.rows, out.columns = given.data, shape[0], shape[kind.ndim - 1]
        return out._getvalue()

    return kind(array, types.literal(width.literal_value)), lower


@intrinsic(prefer_literal=True)
def dual_record(typingctx: Any, array: Any, width: Any, like: Any) -> Any:
    """Return the duals in an array of floats, shape (n, width), named as the fields of the named tuple ``like``."""
    rows = [len(kind) if isinstance(kind, types.BaseTuple) else 0 for kind in like.types]
    kind = DualRecordType(width.literal_value, layout_of(list(zip(like.fields, rows, strict=True))))

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        out = _array(context, builder, kind, None)
        out.data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return out._getvalue()

    return kind(array, types.literal(width.literal_value), like), lower


@intrinsic(prefer_literal=True)
def constant(typingctx: Any, value: Any, width: Any) -> Any:
    """Return a float as a dual without tangents; ``width`` is constant."""
    kind = DualType(width.literal_value)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return context.cast(builder, args[0], value, kind)

    return kind(value, types.literal(width.literal_value)), lower


# --- events ------------------------------------------------------------------------------------


@intrinsic
def _ticking(typingctx: Any, length: Any) -> Any:
    """Return a length as the variable that the last tangent belongs to."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = sig.return_type
        tangents: list[Any] = [_zeros(lanes) for lanes in kind.lanes]
        tangents[-1] = ir.Constant(tangents[-1].type, [0.0] * (kind.lanes[-1] - 1) + [1.0])
        return _written(context, builder, kind, _Dual(_read(context, builder, length, args[0]).value, tangents))

    return length(length), lower


def _by_length(builder: Any, dual: _Dual) -> Any:
    """Return the last tangent."""
    last = (dual.tangents or [])[-1]
    return builder.extract_element(last, ir.Constant(ir.IntType(32), last.type.count - 1))


def _without_length(builder: Any, tangents: list[Any]) -> list[Any]:
    """Return tangents with the last one zero."""
    last = tangents[-1]
    return [*tangents[:-1], builder.insert_element(last, _number(0.0), ir.Constant(ir.IntType(32), last.type.count - 1))]


@intrinsic
def _implied(typingctx: Any, length: Any, event: Any) -> Any:
    """Return a length at which an event function is zero, with the tangents that follow; zero where it only touches zero."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = _read(context, builder, length, args[0]).value
        function = _read(context, builder, event, args[1])
        rate = _by_length(builder, function)
        factor = _or_zero(builder, builder.fcmp_ordered(">", rate, _number(0.0)), builder.fdiv(_number(-1.0), rate))
        tangents = _chain(builder, (factor, function)) or []
        return _written(context, builder, sig.return_type, _Dual(value, _without_length(builder, tangents)))

    return length(length, event), lower


@intrinsic
def _after(typingctx: Any, value: Any, length: Any) -> Any:
    """Return a value that depends on the step's length, with the length's own tangents counted."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        dual, step = (_read(context, builder, kind, arg) for kind, arg in zip(sig.args, args, strict=True))
        tangents = _chain(builder, (_ONE, dual), (_by_length(builder, dual), step)) or []
        return _written(context, builder, value, _Dual(dual.value, _without_length(builder, tangents)))

    return value(value, length), lower


@intrinsic
def _varies(typingctx: Any, value: Any) -> Any:
    """Return whether a tangent is not zero."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _any(builder, _read(context, builder, value, args[0]).tangents or [])

    return types.boolean(value), lower


def length_to_event(take_step: Any, evaluate: Any, t: Any, y: Any, mode: Any, c: Any, length: Any, work: Any) -> Any:
    """Return the length of a step that ends on an event; of duals, with the derivatives of the event's time.

    These follow from the event function g, which is zero at the event whatever the parameters: dh/dp = -(dg/dp) / (dg/dh).
    The state at the event, ``work[0]``, gets what it changes by the time of the event. What is left of the whole step
    is shorter by as much, so that both parts together have the derivatives at a fixed time, with the jump that is known as
    the saltation matrix (Leine, Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004, chapter 7).

    Args:
        take_step: takes a step of the integrator, which ends in ``work[0]``.
        evaluate: rates and event function of the system.
        t: time at the start of the step [s].
        y: state at the start of the step.
        mode: modes during the step.
        c: coefficients of the system.
        length: length of the step [s].
        work: workspace of the integrator.
    """
    return length


@overload(length_to_event, strict=False, jit_options={"_nrt": False, "error_model": "numpy"})
def _length_to_event(take_step: Any, evaluate: Any, t: Any, y: Any, mode: Any, c: Any, length: Any, work: Any) -> Any:
    if not isinstance(y, DualArrayType):
        return lambda take_step, evaluate, t, y, mode, c, length, work: length

    def differentiated(take_step, evaluate, t, y, mode, c, length, work):  # type: ignore[no-untyped-def]
        ticking = _ticking(length)
        take_step(t, y, mode, c, ticking, work)
        end = work[0]
        length = _implied(length, evaluate(t + ticking, end, mode, c, work[1]))
        for i in range(y.size):
            end[i] = _after(end[i], length)
        return length

    return differentiated


def alike(array: Any, number: Any) -> Any:
    """Return a number as the elements of an array are: a dual for duals, else itself."""
    return number


@overload(alike, inline="always", strict=False)
def _alike(array: Any, number: Any) -> Any:
    if not isinstance(array, DualArrayType) or isinstance(number, DualType):
        return lambda array, number: number
    width = array.dtype.width
    return lambda array, number: constant(number, width)


def varies(value: Any) -> bool:
    """Return whether a number has a derivative that is not zero; of a float always False."""
    return False


@overload(varies, inline="always", strict=False)
def _varies_of(value: Any) -> Any:
    return (lambda value: _varies(value)) if isinstance(value, DualType) else (lambda value: False)
