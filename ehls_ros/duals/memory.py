"""Arrays and records of duals: rows of floats in memory, the value followed by the tangents."""

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
from numba.extending import lower_builtin, lower_getattr, lower_getattr_generic

from ehls_ros.duals.code import DOUBLE, CodeDual, intrinsic, packed, read, written, zeros
from ehls_ros.duals.kinds import LANES, DualArrayType, DualRecordType, DualType


def _row(context: Any, builder: Any, kind: DualType, data: Any, index: Any) -> Any:
    """Return a pointer to a dual in memory."""
    return builder.gep(data, [builder.mul(index, context.get_constant(types.intp, kind.width))])


def _load(context: Any, builder: Any, kind: DualType, data: Any, index: Any) -> Any:
    place, tangents = _row(context, builder, kind, data, index), []
    for i, lanes in enumerate(kind.lanes):
        part = builder.gep(place, [context.get_constant(types.intp, i * LANES)])
        tangents.append(builder.load(builder.bitcast(part, ir.VectorType(DOUBLE, lanes).as_pointer()), align=8))
    value = builder.extract_element(tangents[0], ir.Constant(ir.IntType(32), 0))
    return written(context, builder, kind, CodeDual(value, tangents))


MIN_TANGENT = 1e-290
"""Smallest stored tangent: influences of initial states decay to subnormal numbers, which are slow to process."""


def _without_subnormal(builder: Any, tangents: Any) -> Any:
    """Return a vector of tangents with negligible ones set to zero."""
    kind = tangents.type
    above, below = (ir.Constant(kind, [sign * MIN_TANGENT] * kind.count) for sign in (1.0, -1.0))
    # Unordered comparison, so that NaN is kept.
    kept = builder.or_(builder.fcmp_unordered(">=", tangents, above), builder.fcmp_unordered("<=", tangents, below))
    return builder.select(kept, tangents, zeros(kind.count))


def _store(context: Any, builder: Any, kind: DualType, data: Any, index: Any, dual: CodeDual) -> None:
    place = _row(context, builder, kind, data, index)
    for i, lanes in enumerate(kind.lanes):
        vector = zeros(lanes) if dual.tangents is None else _without_subnormal(builder, dual.tangents[i])
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
    return packed(row)


@lower_builtin(operator.getitem, DualArrayType, types.BaseTuple)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, array = sig.args[0], _array(context, builder, sig.args[0], args[0])
    return _load(context, builder, kind.dtype, array.data, _flat(builder, array, args[1]))


def _flat(builder: Any, array: Any, index: Any) -> Any:
    row, column = cgutils.unpack_tuple(builder, index, 2)
    return builder.add(builder.mul(row, array.columns), column)


def _part(context: Any, builder: Any, kind: Any, array: Any, slice_type: Any, index: Any) -> Any:
    """Return the part of an array selected by a slice without step and without negative indices."""
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
    return packed(_part(context, builder, sig.args[0], array, sig.args[1], args[1]))


def _set(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, array = sig.args[0], _array(context, builder, sig.args[0], args[0])
    index = args[1] if isinstance(sig.args[1], types.Integer) else _flat(builder, array, args[1])
    _store(context, builder, kind.dtype, array.data, index, read(context, builder, sig.args[2], args[2]))
    return context.get_dummy_value()


def _fill(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, array = sig.args[0], _array(context, builder, sig.args[0], args[0])
    part, dual = _part(context, builder, kind, array, sig.args[1], args[1]), read(context, builder, sig.args[2], args[2])
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

    def generic_resolve(self, record: Any, attr: str) -> Any:  # type: ignore[override]  # numba's base has a placeholder
        if attr in record.lists:
            return DualArrayType(record.dtype.width, 1)
        return record.dtype if attr in record.numbers else None


@lower_getattr_generic(DualRecordType)
def _(context: Any, builder: Any, kind: Any, value: Any, attr: str) -> Any:
    record = _array(context, builder, kind, value)
    if attr in kind.numbers:
        return _load(context, builder, kind.dtype, record.data, context.get_constant(types.intp, kind.numbers.index(attr)))
    entries = context.get_constant(types.intp, kind.entries) if kind.entries else record.entries
    before = builder.mul(entries, context.get_constant(types.intp, kind.lists.index(attr)))
    first = builder.add(before, context.get_constant(types.intp, len(kind.numbers)))
    part = _array(context, builder, DualArrayType(kind.dtype.width, 1), None)
    part.data = _row(context, builder, kind.dtype, record.data, first)
    part.rows = part.columns = entries
    return packed(part)


# --- views of memory ---------------------------------------------------------------------------


@intrinsic(prefer_literal=True)
def dual_array(typingctx: Any, array: Any, width: Any) -> Any:
    """Return an array of floats as an array of duals.

    Shape (n, width) gives n duals, and shape (n, m, width) gives n × m. ``width`` is constant.
    """
    kind = DualArrayType(width.literal_value, array.ndim - 1)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        given = context.make_array(sig.args[0])(context, builder, args[0])
        shape, out = cgutils.unpack_tuple(builder, given.shape), _array(context, builder, kind, None)
        out.data, out.rows, out.columns = given.data, shape[0], shape[kind.ndim - 1]
        return packed(out)

    return kind(array, types.literal(width.literal_value)), lower


@intrinsic(prefer_literal=True)
def dual_record(typingctx: Any, array: Any, width: Any, like: Any) -> Any:
    """Return the duals in an array of floats, shape (n, width), as written by :func:`~ehls_ros.duals.interpreted.record_rows`.

    The names of the fields are those of the named tuple ``like``; its values are ignored. An empty list in it stands for any
    length.
    """
    lists = {name: len(kind) for name, kind in zip(like.fields, like.types, strict=True) if isinstance(kind, types.BaseTuple)}
    numbers = tuple(name for name in like.fields if name not in lists)
    kind = DualRecordType(width.literal_value, numbers, tuple(lists), max(lists.values(), default=0))

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        given = context.make_array(sig.args[0])(context, builder, args[0])
        out, rows = _array(context, builder, kind, None), cgutils.unpack_tuple(builder, given.shape)[0]
        left = builder.sub(rows, context.get_constant(types.intp, len(numbers)))
        out.data, out.entries = given.data, builder.udiv(left, context.get_constant(types.intp, max(len(lists), 1)))
        return packed(out)

    return kind(array, types.literal(width.literal_value), like), lower


@intrinsic(prefer_literal=True)
def constant(typingctx: Any, value: Any, width: Any) -> Any:
    """Return a float as a dual without tangents; ``width`` is constant."""
    kind = DualType(width.literal_value)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return context.cast(builder, args[0], value, kind)

    return kind(value, types.literal(width.literal_value)), lower
