"""Memory layout of lanes: parallel trajectories that a compiler can advance by vector instructions.

A *block* holds the numbers of :data:`LANES` lanes in a flat array: row after row, each with one number per lane. LLVM
vectorises a loop over the lanes that loads a lane's numbers, computes, and stores the changed ones, if

* the block is one array and its rows are known when the loop is compiled, so that no two lanes can access the same number;
* small arrays within the loop are on the stack (:func:`stack`), where LLVM turns their elements into registers;
* the computation has neither calls nor loops of unknown length (:mod:`ehls_ros.physics.vector_math`).

Otherwise the loop is executed lane by lane, with the same result.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.np.arrayobj import make_array, populate_array

from ehls_ros.arrays import Array, compiler_function

LANES = 16
"""Lanes of a block: several vectors, so that their latencies overlap, in a block that fits the fastest cache."""

_WORD = 8
"""Size of a number [bytes]."""


def _array(context: Any, builder: Any, kind: Any, data: Any, shape: tuple[int, ...], apart: int) -> Any:
    """Return an array of a shape at ``data``, with a spacing of ``apart`` bytes between elements."""
    made = make_array(kind)(context, builder)
    strides = [apart * math.prod(shape[axis + 1 :]) for axis in range(len(shape))]

    def constants(values: Iterable[int]) -> list[Any]:
        return [context.get_constant(types.intp, value) for value in values]

    (word,) = constants([_WORD])
    populate_array(made, builder.bitcast(data, made.data.type), constants(shape), constants(strides), word, None)
    return made._getvalue()  # noqa: SLF001 - numba's way to build an array


def stack(*shape: int) -> Callable[[], Array]:
    """Return a compiled function that returns an array of a shape on the stack of its caller.

    Its content is undefined, and the same array is reused in every iteration of a loop.
    """
    kind = types.Array(types.float64, len(shape), "C")

    @compiler_function
    def array(typing: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            memory = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), max(math.prod(shape), 1)))
            return _array(context, builder, kind, memory, shape, _WORD)

        return kind(), generate

    return array


def column(*shape: int) -> Callable[[Array, int, int], Array]:
    """Return a compiled ``view(block, row, lane)``: a lane's numbers in the rows from ``row`` on, as an array of a shape."""
    kind = types.Array(types.float64, len(shape), "A")

    @compiler_function
    def view(typing: Any, block: Any, row: Any, lane: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data = _place(context, builder, block, arguments)
            return _array(context, builder, kind, data, shape, _WORD * LANES)

        return kind(block, types.int64, types.int64), generate

    return view


def _place(context: Any, builder: Any, block: Any, arguments: Any) -> Any:
    """Return the address of a lane's number in a row of a block; the last arguments are block, row, and lane."""
    memory, row, lane = arguments[-3:]
    index = builder.add(builder.mul(row, ir.Constant(ir.IntType(64), LANES)), lane)
    return builder.gep(make_array(block)(context, builder, memory).data, [index])


@compiler_function
def wide_vectors(typing: Any) -> Any:
    """Make the calling compiled function use the widest available vectors; it is not inlined.

    By default LLVM uses half the width of AVX-512, since programs with few vector instructions are faster with it.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        # The set's ``add`` method rejects attributes that are no keywords.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')

    return types.none(), generate


def numbers_in(like: Any) -> int:
    """Return the number of scalars in a number or a nested named tuple, equal to the rows that :func:`numbers` reads."""
    return sum(map(numbers_in, like)) if isinstance(like, tuple) else 1


def flat(like: Any) -> list[float]:
    """Return the scalars of a number or a nested named tuple as a list, in their order."""
    return [value for field in like for value in flat(field)] if isinstance(like, tuple) else [float(like)]


@compiler_function
def numbers(typing: Any, like: Any, block: Any, row: Any, lane: Any) -> Any:
    """Return a nested named tuple of numbers from the rows of a block.

    Args:
        typing: numba's typing context.
        like: a value of the same type; only its type is used.
        block: the block.
        row: the first row.
        lane: the lane.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, taken = _place(context, builder, block, arguments), 0

        def load(wanted: Any) -> Any:
            nonlocal taken
            if isinstance(wanted, (types.NamedTuple, types.NamedUniTuple, types.Tuple, types.UniTuple)):
                return context.make_tuple(builder, wanted, [load(field) for field in wanted])
            place = builder.gep(first, [ir.Constant(ir.IntType(64), taken * LANES)])
            taken += 1
            value = builder.load(place)
            return context.cast(builder, value, types.float64, wanted)

        return load(like)

    return like(like, block, types.int64, types.int64), generate


class Rows:
    """Allocates the rows of a block."""

    def __init__(self) -> None:
        """Start without rows."""
        self.count = 0

    def take(self, number: int = 1) -> int:
        """Allocate a number of rows and return the first."""
        first = self.count
        self.count += number
        return first
