"""Numbers that know their derivatives, for compiled functions: forward automatic differentiation of the same source.

A dual is a value and its derivatives by some parameters, the *tangents*. A function compiled for duals instead of floats
computes what it did before, to the bit, and the derivatives beside it by the chain rule (Griewank, Walther, Evaluating
Derivatives, 2008, chapter 3). Comparisons go by value; but what varies equals no number, so that short cuts for special values
are not taken. Whole numbers that :func:`math.ceil` and its like make have no derivative. Where a function has a corner, the
derivative is that of one side; where it is infinite, it counts as zero.

``DualArray`` and ``DualRecord`` stand for an array of floats and for a named tuple of parameters. In memory, a dual is
a row of an array of floats, shape (n, width): the value, then the tangents. All tangents of a dual are added and multiplied
at once, as vectors of the processor. The last tangent is that by the length of the present step; it is zero but while
:func:`length_to_event` needs it.
"""

from ehls_ros.duals import rules as _rules  # noqa: F401 - registers the rules
from ehls_ros.duals.events import alike, length_to_event, varies
from ehls_ros.duals.in_python import (
    Dual,
    exp,
    joined,
    linear,
    numbers_of,
    parameters_of,
    record_rows,
    rows_of,
    tangents_of,
    value_of,
    values_of,
)
from ehls_ros.duals.kinds import DualArrayType, DualRecordType, DualType, width_of
from ehls_ros.duals.known import sloped, value_alone
from ehls_ros.duals.memory import constant, dual_array, dual_record

__all__ = [
    "Dual",
    "DualArrayType",
    "DualRecordType",
    "DualType",
    "alike",
    "constant",
    "dual_array",
    "dual_record",
    "exp",
    "joined",
    "length_to_event",
    "linear",
    "numbers_of",
    "parameters_of",
    "record_rows",
    "rows_of",
    "sloped",
    "tangents_of",
    "value_alone",
    "value_of",
    "values_of",
    "varies",
    "width_of",
]
