"""Reading of a table found in the data: amplitude, symmetry, growth, power and place, as numbers."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.estimate import Estimate

FITS = 0.05
"""Fraction of a table's power that a shape may leave, beyond its errors, to describe it."""

EXPONENTS = np.arange(0.3, 4.01, 0.02)
"""Exponents of a power that are tried."""

LIKELY = 0.95
"""Probability of an interval."""

PLACE = 0.3
"""Largest fraction of the knots over which a bump at one place extends."""


ShapeName = Literal["level", "power", "bump", "step", "beyond", "wave"]


class Shape(NamedTuple):
    """A shape in a formula.

    Attributes:
        name: a constant, a power, a Gaussian bump, a hyperbolic tangent, a line beyond a place, or a sine with its harmonic.
        numbers: its numbers with standard errors by name, in SI units: ``size`` in the unit of the term, for a power and a line
            at a distance ``at_distance`` from where they are zero; ``exponent``, ``from``, ``place``, ``width``, ``period``,
            ``phase``, and ``second``, the amplitude of the harmonic.
        kind: of a power and a bump, odd or even; of a line, above, below or both.
    """

    name: ShapeName
    numbers: Mapping[str, Estimate]
    kind: str = ""


class Power(NamedTuple):
    """A power of the argument that describes a table.

    Attributes:
        exponent: the exponent.
        std: its standard error.
        symmetry: of the table about zero; empty if its argument does not change sign.
    """

    exponent: float
    std: float
    symmetry: Literal["odd", "even", ""]


class Reading(NamedTuple):
    """The shape of a table.

    Attributes:
        amplitude: half the range of its values.
        std: standard error of a value.
        rise: change from the first to the last knot, if the table only rises or only falls.
        power: the power that describes it.
        place: place in the argument of a bump, if that is all it has.
    """

    amplitude: float
    std: float
    rise: float | None = None
    power: Power | None = None
    place: float | None = None


def read(at: Array, values: Array, covariance: Array, *, periodic: bool) -> Reading:
    """Return the shape of a table.

    Args:
        at: places of the knots, in SI units, shape (k,).
        values: of the table, shape (k,).
        covariance: of the values, shape (k, k).
        periodic: whether the table repeats.
    """
    amplitude = 0.5 * float(np.ptp(values))
    std = math.sqrt(max(float(np.mean(np.diag(covariance))), 0.0))
    if periodic or amplitude == 0.0:
        return Reading(amplitude, std)
    return Reading(amplitude, std, _rise(values), _power(at, values, covariance), _place(at, values))


def read_formula(shapes: Sequence[Shape], values: Array, std: Array) -> Reading:
    """Return the shape of a formula.

    Args:
        shapes: of the formula.
        values: over the range of the data, shape (n,).
        std: their standard errors, shape (n,).
    """
    amplitude, spread = 0.5 * float(np.ptp(values)), float(np.sqrt(np.mean(std * std)))
    by_name = {shape.name: shape for shape in shapes if shape.name != "level"}
    if "wave" in by_name:
        return Reading(amplitude, spread)
    alone = next(iter(by_name.values())) if len(by_name) == 1 else None
    power = place = None
    if alone is not None and alone.name == "power":
        exponent = alone.numbers["exponent"]
        power = Power(exponent.value, exponent.std, "even" if alone.kind == "even" else "odd")
    elif alone is not None and alone.name == "bump":
        place = alone.numbers["place"].value
    return Reading(amplitude, spread, _rise(values), power, place)


def _rise(values: Array) -> float | None:
    steps = np.diff(values)
    up, down = float(np.sum(np.maximum(steps, 0.0))), float(np.sum(np.maximum(-steps, 0.0)))
    return float(values[-1] - values[0]) if min(up, down) <= FITS * max(up, down) else None


def _power(at: Array, values: Array, covariance: Array) -> Power | None:
    """Return the odd or even power that describes the values; None if none does."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    # Between two knots the table is linear and a power is not.
    spread = np.hypot(spread, 0.01 * float(np.ptp(values)))
    turns = bool(at[0] < 0.0 < at[-1])
    squares = np.full((2 if turns else 1, len(EXPONENTS)), np.inf)
    for symmetry in range(len(squares)):
        for i, exponent in enumerate(EXPONENTS):
            shape = np.abs(at) ** exponent * (np.sign(at) if symmetry == 0 and turns else 1.0)
            columns = np.stack((shape, np.ones(len(at))), axis=1) / spread[:, np.newaxis]
            solution, *_ = np.linalg.lstsq(columns, values / spread, rcond=None)
            squares[symmetry, i] = float(np.sum((values / spread - columns @ solution) ** 2))
    symmetry, best = divmod(int(np.argmin(squares)), len(EXPONENTS))
    least, freedoms = float(squares[symmetry, best]), max(len(at) - 3, 1)
    total = float(np.sum(((values - np.mean(values)) / spread) ** 2))
    if (least > float(scipy.stats.chi2.ppf(LIKELY, freedoms)) and least > FITS * total) or best in (0, len(EXPONENTS) - 1):
        return None
    near = EXPONENTS[squares[symmetry] <= least + max(1.0, least / freedoms)]
    words: tuple[Literal["odd", "even", ""], ...] = ("odd", "even") if turns else ("",)
    return Power(float(EXPONENTS[best]), max(0.5 * float(np.ptp(near)), 0.01), words[symmetry])


def _place(at: Array, values: Array) -> float | None:
    """Return the place of a bump; None if the values have more than one."""
    raised = values - np.median(values)
    peak = int(np.argmax(np.abs(raised)))
    wide = np.abs(raised) > 0.3 * abs(float(raised[peak]))
    share = float(np.sum(raised[wide] ** 2)) / max(float(np.sum(raised**2)), 1e-300)
    return float(at[peak]) if share >= 1.0 - 3.0 * FITS and np.mean(wide) <= PLACE else None
