"""Exponentials and logarithms that compile to plain arithmetic.

A C library call processes one number at a time, so it prevents the vectorisation of a loop. These functions have neither calls
nor branches, so the compiler can vectorise a loop over them. Every operation is rounded separately, inside and outside of
loops, so the results are bitwise equal on every processor.

Each number is split into a power of two, which is read from or written to its bits, and a remainder for a minimax polynomial.
"""

from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from ehls_ros.arrays import compiler_function, kernel
from ehls_ros.duals import sloped, value_alone

ROUNDER = 6755399441055744.0
"""1.5 2^52: its sum with a number below 2^51 has no fraction, and the last bits of the sum are the rounded number."""

SMALLEST_EXPONENT, LARGEST_EXPONENT = -1022.0, 1023.0
"""Exponents of normal numbers."""

MANTISSA_BITS = 52
EXPONENT_BIAS = 1023

HALF_ROOT_BITS = int(np.sqrt(0.5).view(np.int64))
"""Bits of the square root of 1/2, the lower end of the mantissas in :func:`log2`."""

ROUNDER_BITS = int(np.float64(ROUNDER).view(np.int64))

LOG2_E, LOG2_E_REST = 1.4426950408889634, 2.0355273740931033e-17
"""Logarithm of e to base 2, and the remainder of its rounding."""


@partial(compiler_function, python=lambda a, b, c: a * b + c)
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@partial(compiler_function, python=lambda value: np.float64(value).view(np.int64))
def bits_of(typing: Any, value: Any) -> Any:
    """Return the bits of a float as an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@partial(compiler_function, python=lambda bits: np.int64(bits).view(np.float64))
def float_of(typing: Any, bits: Any) -> Any:
    """Return the float that has these bits."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), generate


@kernel
def _power(shifted: float, f: float) -> float:
    """Return 2^(n + f) for |f| <= 1/2, where ``shifted`` is n + ROUNDER."""
    # Minimax polynomial of degree 11 with an error of 3e-18; in Estrin's order, for short dependency chains.
    f2 = f * f
    f4 = f2 * f2
    first = fma(fma(0.05550410866482162, f, 0.24022650695910158), f2, fma(0.6931471805599453, f, 1.0))
    second = fma(fma(1.5252733841556773e-05, f, 0.00015403530463724353), f2, fma(0.001333355814640647, f, 0.009618129107587256))
    third = fma(
        fma(4.4558179083360645e-10, f, 7.074194297288521e-09), f2, fma(1.0178057087733941e-07, f, 1.3215432535912375e-06)
    )
    power = fma(fma(third, f4, second), f4, first)
    return power * float_of((bits_of(shifted) - (ROUNDER_BITS - EXPONENT_BIAS)) << MANTISSA_BITS)


@kernel
def _clipped(x: float, low: float, high: float) -> float:
    """Return x within bounds; NaN stays NaN."""
    # Not min and max, which may turn NaN into a bound.
    x = low if x < low else x  # noqa: FURB136
    return high if x > high else x  # noqa: FURB136


@kernel
def exp2(x: float) -> float:
    """Return 2^x, within 2 units in the last place, for x clipped to the exponents of normal numbers."""
    x = _clipped(x, SMALLEST_EXPONENT, LARGEST_EXPONENT)
    shifted = x + ROUNDER
    return _power(shifted, x - (shifted - ROUNDER))


@kernel
def exp(x: float) -> float:
    """Return e^x, within 2 units in the last place, for x clipped to the range of normal results."""
    clipped = _clipped(value_alone(x), SMALLEST_EXPONENT / LOG2_E, LARGEST_EXPONENT / LOG2_E)
    shifted = fma(clipped, LOG2_E, ROUNDER)
    power = _power(shifted, fma(clipped, LOG2_E_REST, fma(clipped, LOG2_E, ROUNDER - shifted)))
    return sloped(power, power, x)


@kernel
def log2(x: float) -> float:
    """Return the logarithm of a number to base 2, within 3 units in the last place.

    For 0 it is negative infinity; infinity and NaN are returned unchanged. For subnormal numbers it is about -1023; for
    negative numbers it is undefined.
    """
    shifted = bits_of(x) - HALF_ROOT_BITS
    exponent = shifted >> MANTISSA_BITS
    mantissa = float_of(bits_of(x) - (exponent << MANTISSA_BITS))
    s = (mantissa - 1.0) / (mantissa + 1.0)
    # 2 atanh(s)/ln 2 = s (2.885... + z Q(z)) with the minimax polynomial Q of degree 6, error 1.4e-17.
    z = s * s
    z2 = z * z
    high = fma(fma(0.2108903788890639, z, 0.2211884020024386), z2, fma(0.26232368741438405, z, 0.3205987373623553))
    low = fma(fma(high, z, 0.4121985839020938), z2, fma(0.5770780163541267, z, 0.961796693925976))
    whole = float_of(exponent + ROUNDER_BITS) - ROUNDER
    value = fma(s, fma(low, z, 2.8853900817779268), whole)
    value = value if x < np.inf else x
    return value if x != 0.0 else -np.inf


def _stretched_decay_by_numpy(x: float, exponent: float) -> float:
    # Each process that reads a rig needs only a friction level or two, not worth half a second of compilation.
    with np.errstate(over="ignore"):
        return float(np.exp(-np.power(x, exponent)))


@partial(kernel, python=_stretched_decay_by_numpy)
def stretched_decay(x: float, exponent: float) -> float:
    """Return exp(-x^exponent) of a number x >= 0, within 2e-16; an infinite slope at 0 is replaced by zero."""
    base, power = value_alone(x), value_alone(exponent)
    bits = log2(base)
    raised = exp2(power * bits)
    decay = exp2(-LOG2_E * raised)
    by_power = -raised * decay
    positive = base > 0.0
    by_x = sloped(decay, by_power * power / base if positive else 0.0, x)
    return sloped(by_x, by_power * bits / LOG2_E if positive else 0.0, exponent)
