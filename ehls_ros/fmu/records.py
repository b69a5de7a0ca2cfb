"""Named tuples and arrays of numbers within one flat array, for compiled functions."""

import math
from collections.abc import Callable, Iterable
from typing import Any, get_args, get_origin

from llvmlite import ir
from numba import typeof, types
from numba.np.arrayobj import make_array, populate_array

from ehls_ros.arrays import Array, compiler_function
from ehls_ros.schema import fields_of

_WORD = 8
"""Size of a number [bytes]."""


def example(parameters: Any, entries: int = 0) -> Any:
    """Return a parameter set in which every number is zero.

    Args:
        parameters: a ``NamedTuple`` class of numbers, lists of numbers and further such classes.
        entries: length of each list.
    """
    return parameters(**{name: _zero(field.kind, entries) for name, field in fields_of(parameters).items()})


def _zero(kind: Any, entries: int) -> Any:
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        return (_zero(inner[0], entries),) * (entries if inner[1:] == (...,) else len(inner))
    return example(kind, entries) if hasattr(kind, "_fields") else kind()


def _place(context: Any, builder: Any, block: Any, arguments: Any) -> Any:
    """Return the address of a number; the arguments are the block and the index."""
    return builder.gep(make_array(block)(context, builder, arguments[0]).data, [arguments[1]])


def reader(like: Any) -> Callable[[Array, int], Any]:
    """Return a compiled ``read(block, first)``: the numbers of a block from an index on, as a named tuple.

    Args:
        like: a named tuple of the same type; an empty one is read as ().
    """
    kind = typeof(like or ())

    @compiler_function
    def read(typing: Any, block: Any, first: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data, taken = _place(context, builder, block, arguments), 0

            def load(wanted: Any) -> Any:
                nonlocal taken
                if isinstance(wanted, (types.NamedTuple, types.NamedUniTuple, types.Tuple, types.UniTuple)):
                    return context.make_tuple(builder, wanted, [load(field) for field in wanted])
                place = builder.gep(data, [ir.Constant(ir.IntType(64), taken)])
                taken += 1
                return context.cast(builder, builder.load(place), types.float64, wanted)

            return load(kind)

        return kind(block, types.int64), generate

    return read


def view(*shape: int) -> Callable[[Array, int], Array]:
    """Return a compiled ``view(block, first)``: the numbers of a block from an index on, as an array of a shape.

    A slice or a reshaped array would bring code that raises errors and counts references, which needs Python.
    """
    kind = types.Array(types.float64, len(shape), "C")

    @compiler_function
    def of(typing: Any, block: Any, first: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            def constants(values: Iterable[int]) -> list[Any]:
                return [context.get_constant(types.intp, value) for value in values]

            made = make_array(kind)(context, builder)
            strides = [_WORD * math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
            (word,) = constants([_WORD])
            data = _place(context, builder, block, arguments)
            populate_array(made, data, constants(shape), constants(strides), word, None)
            return made._getvalue()  # noqa: SLF001 - numba's way to build an array

        return kind(block, types.int64), generate

    return of
