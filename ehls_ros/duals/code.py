"""Duals in intermediate code: separate value and tangents, and the chain rule."""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic as _intrinsic

from ehls_ros.duals.kinds import DualType

DOUBLE = ir.DoubleType()
FUSED = ("contract",)


intrinsic: Any = _intrinsic
"""Numba's decorator, untyped because decorated functions are called with other arguments than they are defined with."""


class CodeDual:
    """A dual in intermediate code.

    Attributes:
        value: the value.
        tangents: vectors of tangents; None if all are zero.
    """

    def __init__(self, value: ir.Value, tangents: Sequence[ir.Value] | None) -> None:
        """Store value and tangents."""
        self.value = value
        self.tangents = tangents


def read(context: Any, builder: Any, kind: Any, value: Any) -> CodeDual:
    """Return a dual, or a number without tangents, of a numba type."""
    if not isinstance(kind, DualType):
        return CodeDual(context.cast(builder, value, kind, types.float64), None)
    parts = cgutils.create_struct_proxy(kind)(context, builder, value=value)
    return CodeDual(parts.value, [getattr(parts, f"tangents{i}") for i in range(len(kind.lanes))])


def written(context: Any, builder: Any, kind: DualType, dual: CodeDual) -> Any:
    """Return a dual as a value of its numba type."""
    parts = cgutils.create_struct_proxy(kind)(context, builder)
    parts.value = dual.value
    for i, lanes in enumerate(kind.lanes):
        setattr(parts, f"tangents{i}", zeros(lanes) if dual.tangents is None else dual.tangents[i])
    return packed(parts)


def packed(parts: Any) -> ir.Value:
    """Return the value of a structure from its parts."""
    return parts._getvalue()  # noqa: SLF001 - numba's own name


def zeros(lanes: int) -> ir.Constant:
    """Return a vector of zeros."""
    return ir.Constant(ir.VectorType(DOUBLE, lanes), [0.0] * lanes)


def spread(builder: Any, scalar: ir.Value, lanes: int) -> ir.Value:
    """Return a vector of equal numbers."""
    vector = ir.VectorType(DOUBLE, lanes)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), places)


ONE, MINUS = 1, -1


def chain(builder: Any, *terms: tuple[Any, CodeDual]) -> list[Any] | None:
    """Return the sum of tangents times partial derivatives, which are numbers in intermediate code, 1 or -1."""
    total: list[Any] | None = None
    for partial, dual in terms:
        if dual.tangents is None:
            continue
        if total is None and partial is MINUS:
            total = [builder.fneg(v) for v in dual.tangents]
            continue
        if partial is MINUS:
            total = [builder.fsub(s, v, flags=FUSED) for s, v in zip(total or [], dual.tangents, strict=True)]
            continue
        scaled = list(dual.tangents)
        if partial is not ONE:
            scaled = [builder.fmul(spread(builder, partial, v.type.count), v, flags=FUSED) for v in scaled]
        total = scaled if total is None else [builder.fadd(s, v, flags=FUSED) for s, v in zip(total, scaled, strict=True)]
    return total


def number(value: float) -> ir.Constant:
    """Return a constant."""
    return ir.Constant(DOUBLE, value)


def or_zero(builder: Any, allowed: ir.Value, value: ir.Value) -> ir.Value:
    """Return a value if the condition holds, otherwise 0."""
    return builder.select(allowed, value, number(0.0))


class Plain:
    """Calls functions of plain floats, so that values are bitwise the same."""

    def __init__(self, context: Any, builder: Any) -> None:
        """Store the builder, at whose position the calls are inserted."""
        self._context, self._builder = context, builder

    def __call__(self, function: Any, *values: ir.Value) -> ir.Value:
        """Insert a call of a function of floats and return its result."""
        typing = self._context.typing_context
        kind = typing.resolve_value_type(function)
        sig = typing.resolve_function_type(kind, (types.float64,) * len(values), {})
        return self._context.get_function(kind, sig)(self._builder, values)


def any_tangent(builder: Any, tangents: Sequence[ir.Value]) -> ir.Value:
    """Return whether any tangent is nonzero; the first lane is not a tangent."""
    found = ir.Constant(ir.IntType(1), 0)
    for index, vector in enumerate(tangents):
        lanes, own = vector.type.count, vector
        if index == 0:
            own = builder.insert_element(vector, number(0.0), ir.Constant(ir.IntType(32), 0))
        differs = builder.fcmp_ordered("!=", own, zeros(lanes))
        bits = builder.bitcast(differs, ir.IntType(lanes))
        found = builder.or_(found, builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(lanes), 0)))
    return found
