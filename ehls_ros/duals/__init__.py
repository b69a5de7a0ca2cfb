"""Dual numbers for compiled functions: forward automatic differentiation of the same source.

A dual is a value and its derivatives by some parameters, the *tangents*. A function compiled for duals instead of floats
computes bitwise the same value, and its derivatives by the chain rule (Griewank, Walther, Evaluating Derivatives, 2008,
chapter 3). Comparisons use the value, but a varying number equals no number, so that shortcuts for special values are not
taken. Whole numbers returned by :func:`math.ceil` and similar functions have no derivative. At a corner of a function the
derivative is one-sided; an infinite derivative is replaced by zero.

``DualArray`` and ``DualRecord`` represent an array of floats and a named tuple of parameters. In memory, a dual is a row of an
array of floats, shape (n, width): the value, then the tangents. All tangents of a dual are added and multiplied at once, as
vectors of the processor. The last tangent is that by the length of the present step; it is zero except within
:func:`length_to_event`.
"""

from ehls_ros.duals.events import as_element, length_to_event, varies
from ehls_ros.duals.interpreted import (
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
from ehls_ros.duals.memory import constant, dual_array, dual_record
from ehls_ros.duals.rules import sloped, value_alone

__all__ = [
    "Dual",
    "DualArrayType",
    "DualRecordType",
    "DualType",
    "as_element",
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
