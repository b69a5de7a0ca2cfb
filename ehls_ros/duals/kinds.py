"""Numba types of duals, of their arrays and of their records."""

import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.datamodel import models
from numba.core.typeconv.castgraph import Conversion
from numba.extending import register_model

LANES = 8
"""Most floats in one vector; a processor with shorter vectors uses two."""

UNIT = 4
"""Divisor of every width."""


def width_of(parameters: int, *, events: bool = True) -> int:
    """Return the floats in a dual, rounded up: the value, a tangent per parameter, and one for the time of an event.

    Args:
        parameters: number of parameters to differentiate by.
        events: whether the system has events.
    """
    return UNIT * math.ceil((1 + parameters + events) / UNIT)


class VectorType(types.Type):
    """Part of the tangents, as one vector."""

    def __init__(self, lanes: int) -> None:
        """Name the type by its length."""
        super().__init__(f"Vector({lanes})")
        self.lanes = lanes


class DualType(types.Type):
    """Type of a dual of a given width."""

    def __init__(self, width: int) -> None:
        """Name the type by the width."""
        super().__init__(f"Dual({width})")
        self.width = width

    @property
    def lanes(self) -> list[int]:
        """Lengths of the vectors of tangents; the first lane is the value's place in memory."""
        return [min(LANES, self.width - first) for first in range(0, self.width, LANES)]

    def unify(self, typingctx: Any, other: types.Type) -> "DualType | None":
        """Return the common type of a dual in one branch and a plain number in another."""
        return self if isinstance(other, types.Number) else None

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """Allow the conversion of a plain number to a dual without tangents."""
        return Conversion.safe if isinstance(other, types.Number) else None


class DualArrayType(types.Type):
    """Type of an array of duals of one or two dimensions, or a part of it."""

    def __init__(self, width: int, ndim: int) -> None:
        """Name the type by width and dimensions."""
        super().__init__(f"DualArray({width}, {ndim})")
        self.dtype = DualType(width)
        self.ndim = ndim


class DualRecordType(types.Type):
    """Type of named parameters: numbers, and lists of equal length, which are arrays of duals.

    In memory the numbers come first, then the lists.
    """

    def __init__(self, width: int, numbers: tuple[str, ...], lists: tuple[str, ...] = (), entries: int = 0) -> None:
        """Name the type by all its arguments.

        Args:
            width: width of a dual.
            numbers: names of the numbers.
            lists: names of the lists.
            entries: length of each list; 0 if known only at run time.
        """
        super().__init__(f"DualRecord({width}, {numbers}, {lists}, {entries})")
        self.dtype = DualType(width)
        self.numbers = numbers
        self.lists = lists
        self.entries = entries


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(ir.DoubleType(), fe_type.lanes))


@register_model(DualType)
class _DualModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        members = [(f"tangents{i}", VectorType(lanes)) for i, lanes in enumerate(fe_type.lanes)]
        super().__init__(dmm, fe_type, [("value", types.float64), *members])


@register_model(DualArrayType)
class _ArrayModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        members = [("data", types.CPointer(types.float64)), ("rows", types.intp), ("columns", types.intp)]
        super().__init__(dmm, fe_type, members)


@register_model(DualRecordType)
class _RecordModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, [("data", types.CPointer(types.float64)), ("entries", types.intp)])
