"""The smallest formula that describes a table found in data: one or two shapes with few, physically bounded parameters.

Each shape is fitted to the table, with its covariance, in place of the recording; those that describe it with the fewest
parameters are then fitted to the recording, where held-out blocks judge between them and the table.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array, in_python
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.reading import Shape
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects._table import formula_value

Numbers = Mapping[str, float]

Parameters: Any = EFFECTS.load("empirical_force").Parameters

FORMULA = in_python(formula_value)


class Table(NamedTuple):
    """A table over an argument whose zero is that of its signal, in units in which the signal reaches 1.

    Attributes:
        at: arguments of the knots, shape (k,).
        values: at the knots, shape (k,).
        covariance: of the values, shape (k, k).
        periodic: whether it repeats with the span from the first knot to the last one and a step.
        signed: whether the argument has a natural zero.
    """

    at: Array
    values: Array
    covariance: Array
    periodic: bool
    signed: bool


class Formula(NamedTuple):
    """A sum of shapes as parameters of a term.

    Attributes:
        free: the fitted parameters by name.
        fixed: the other parameters that are not neutral.
        cost: half the squares that it leaves of the table, in units of the table's errors, and the penalty [nat].
        bounds: ranges of the fitted parameters that are no values of the term.
    """

    free: Numbers
    fixed: Numbers = MappingProxyType({})
    cost: float = math.inf
    bounds: Mapping[str, tuple[float, float]] = MappingProxyType({})


REFINED, ROUNDS, TRIED = 14, 30, 3
"""Formulas that are fitted to the table, evaluations of each, and formulas that are fitted to the recording."""

KNOWN_PERIOD = 1e-6
"""Relative change of a table's period up to which it stays in step with the recording, over a thousand periods and more."""

UNLIKE = 0.07
"""Fraction of a table's range by which the lines between its knots may differ from a formula, times the number of lines."""

EXPONENTS, WIDTHS = (0.5, 1.0, 2.0, 3.0), (0.05, 0.2, 0.6)
"""Exponents, and widths as fractions of the table's span, from which shapes are fitted."""

SIZES = ("level", "power", "bump", "step", "beyond", "wave", "wave_2")
"""Parameters of a formula that are values of the term; it is linear in them."""

PLACES = ("power_at", "bump_at", "step_at", "beyond_at")
"""Parameters of a formula that are places in the argument."""

BOUNDS: Mapping[str, tuple[float, float]] = {
    "exponent": (0.2, 6.0), "bump_width": (0.005, 1.0), "step_width": (1e-3, 3.0), "wave_number": (1e-3, 1e3),
}  # fmt: skip
"""Ranges of the parameters that are neither values of the term nor places, which lie within the table."""


def value_of(parameters: Any, u: Array) -> Array:
    """Return the value of a formula, without factor and table, shape (n,).

    Args:
        parameters: of the term.
        u: arguments, shape (n,).
    """
    return np.array([FORMULA(at, parameters) for at in u.tolist()])


def formulas(table: Table) -> list[Formula]:
    """Return the formulas that describe a table with the fewest parameters, best first."""
    size = max(float(np.ptp(table.values)), 1e-300)
    # Where the data hardly determine some values, rounding leaves their covariance without a Cholesky root.
    variances, directions = np.linalg.eigh(0.5 * (table.covariance + table.covariance.T))
    whitening = directions.T / np.sqrt(np.maximum(variances, 0.0) + (UNLIKE * size / (len(table.at) - 1)) ** 2)[:, np.newaxis]
    shapes = _waves(table) if table.periodic else chain(*_shapes(table))
    starts = sorted((_sized(table, whitening, start) for start in shapes), key=lambda formula: formula.cost)
    best = dict[tuple[str, ...], Formula]()
    for found in (_fitted(table, whitening, start) for start in starts[:REFINED]):
        key = (*found.free, *(f"{name}={value}" for name, value in found.fixed.items()))
        if key not in best or found.cost < best[key].cost:
            best[key] = found
    return sorted(best.values(), key=lambda formula: formula.cost)[:TRIED]


def _shapes(table: Table) -> Iterator[Iterator[Formula]]:
    """Yield the starts of every shape, alone and beside a line, with and without a constant."""
    level = {"level": float(np.median(table.values))}
    for constant in ({}, level):
        yield (formula._replace(free={**constant, **formula.free}) for formula in _alone(table))
    yield (
        formula._replace(free={**level, "power": float(np.ptp(table.values)), **formula.free})
        for formula in _alone(table)
        if "power" not in formula.free
    )


def _alone(table: Table) -> Iterator[Formula]:
    low, high = float(table.at[0]), float(table.at[-1])
    size, span = float(np.ptp(table.values)), high - low
    turns = low < 0.0 < high
    yield Formula({"power": size})
    for exponent in EXPONENTS if table.signed else ():
        yield Formula({"power": size, "exponent": exponent})
        if turns:
            yield Formula({"power": size, "exponent": exponent}, {"even": 1.0})
    yield Formula({"power": size, "power_at": 0.5 * (low + high), "exponent": 2.0}, {"even": 1.0})
    raised = table.values - float(np.median(table.values))
    peak = float(table.at[int(np.argmax(np.abs(raised)))])
    for width in WIDTHS:
        yield Formula({"bump": size, "bump_at": peak, "bump_width": width * span})
        if table.signed:
            yield Formula({"step": size, "step_width": width * span})
        steepest = float(table.at[int(np.argmax(np.abs(np.diff(table.values))))])
        yield Formula({"step": size, "step_at": steepest, "step_width": width * span})
        yield Formula({"bump": size, "bump_at": steepest, "bump_width": width * span}, {"bump_odd": 1.0})
    for part in (0.2, 0.5, 0.8):
        at = low + part * span
        for side in (1.0, -1.0):
            yield Formula({"beyond": size / span, "beyond_at": at}, {"beyond_side": side})
            yield Formula(
                {"beyond": size / span, "beyond_at": at, "step": size, "step_at": at, "step_width": 0.05 * span},
                {"beyond_side": side},
            )
        if turns and table.signed:
            yield Formula({"beyond": size / span, "beyond_at": part * min(-low, high)})


def _waves(table: Table) -> Iterator[Formula]:
    """Yield a sine that repeats with the table or twice in it, alone and with its second harmonic; a constant beside each."""
    period = (table.at[-1] - table.at[0]) * len(table.at) / (len(table.at) - 1)
    spectrum = np.fft.rfft(table.values) / len(table.values)
    shift = 2.0 * math.pi * table.at[0] / period

    def sine(harmonic: int) -> tuple[float, float]:
        # A cosine of phase φ is a sine of phase φ + π/2.
        phase = np.angle(spectrum[harmonic]) + 0.5 * math.pi - harmonic * shift
        return 2.0 * abs(spectrum[harmonic]), float((phase + math.pi) % (2.0 * math.pi) - math.pi)

    # A wave also repeats after two of its periods.
    for periods in (1, 2):
        (size, phase), (size_2, phase_2) = sine(periods), sine(2 * periods)
        one = {"wave": size, "wave_number": float(periods / period), "wave_phase": phase}
        for level in ({}, {"level": float(np.real(spectrum[0]))}):
            yield Formula({**level, **one})
            yield Formula({**level, **one, "wave_2": size_2, "wave_2_phase": phase_2})


def _sized(table: Table, whitening: Array, start: Formula) -> Formula:
    """Return a start with the sizes of its shapes that fit the table best, and their cost."""
    sizes = [name for name in start.free if name in SIZES]
    others = {name: value for name, value in {**start.fixed, **start.free}.items() if name not in sizes}
    columns = whitening @ np.stack([value_of(Parameters(**others, **{name: 1.0}), table.at) for name in sizes], axis=1)
    target = whitening @ table.values
    found = np.linalg.lstsq(columns, target, rcond=1e-9)[0]
    cost = 0.5 * float(np.sum((target - columns @ found) ** 2)) + rules.PENALTY * len(start.free)
    return start._replace(free={**start.free, **dict(zip(sizes, found.tolist(), strict=True))}, cost=cost)


def _fitted(table: Table, whitening: Array, start: Formula) -> Formula:
    """Fit a formula to a table; its cost is half the squares in units of the table's errors, and the penalty."""
    names = tuple(start.free)
    scale = np.array([max(float(np.ptp(table.values)), 1e-300) if name in SIZES else 1.0 for name in names])
    places = dict.fromkeys(PLACES, (float(table.at[0]), float(table.at[-1])))
    bounds = {name: range_ for name, range_ in {**BOUNDS, **places}.items() if name in names}
    low, high = np.array([bounds.get(name, (-np.inf, np.inf)) for name in names]).T
    if table.periodic:
        # The period is known from the recording much better than from the table.
        number, is_number = start.free["wave_number"], np.array([name == "wave_number" for name in names])
        low, high = (np.where(is_number, (1.0 + sign * KNOWN_PERIOD) * number, end) for sign, end in ((-1.0, low), (1.0, high)))

    def left(x: Array) -> Array:
        numbers = {**start.fixed, **dict(zip(names, (x * scale).tolist(), strict=True))}
        return np.nan_to_num(whitening @ (table.values - value_of(Parameters(**numbers), table.at)), nan=1e6)

    inside = 1e-9 * np.where(np.isfinite(high - low), high - low, 1.0)
    x0 = np.clip(np.array([start.free[name] for name in names]), low + inside, high - inside) / scale
    found = scipy.optimize.least_squares(left, x0, bounds=(low / scale, high / scale), max_nfev=ROUNDS)
    cost = float(found.cost) + rules.PENALTY * len(names)
    return start._replace(free=dict(zip(names, (found.x * scale).tolist(), strict=True)), cost=cost, bounds=bounds)


def shapes_of(used: Numbers, std: Numbers, zero_and_size: tuple[float, float], units: tuple[str, str]) -> tuple[Shape, ...]:
    """Return the shapes of a fitted formula with their numbers in SI units.

    Args:
        used: parameters of the term.
        std: standard errors of the fitted ones.
        zero_and_size: zero of the formula's argument, and its unit, in the SI unit of the signal.
        units: of the signal and of the term.
    """
    zero, size = zero_and_size
    length, unit = units

    def value(name: str) -> Estimate:
        return Estimate(used[name], std.get(name, 0.0), unit)

    def number(name: str) -> Estimate:
        return Estimate(used[name], std.get(name, 0.0), "1")

    def at(name: str) -> Estimate:
        return Estimate(zero + size * used[name], size * std.get(name, 0.0), length)

    def width(name: str) -> Estimate:
        return Estimate(size * used[name], size * std.get(name, 0.0), length)

    out = list[Shape]()
    if used["level"] != 0.0:
        out.append(Shape("level", {"size": value("level")}))
    if used["power"] != 0.0:
        kind = "even" if used["even"] > 0.0 else "odd"
        numbers = {"size": value("power"), "at_distance": Estimate(size, 0.0, length), "exponent": number("exponent")}
        out.append(Shape("power", {**numbers, "from": at("power_at")}, kind))
    if used["bump"] != 0.0:
        kind = "odd" if used["bump_odd"] > 0.0 else "even"
        out.append(Shape("bump", {"size": value("bump"), "place": at("bump_at"), "width": width("bump_width")}, kind))
    if used["step"] != 0.0:
        out.append(Shape("step", {"size": value("step"), "place": at("step_at"), "width": width("step_width")}))
    if used["beyond"] != 0.0:
        kind = {1.0: "above", -1.0: "below"}.get(used["beyond_side"], "both")
        slope = {"size": value("beyond"), "at_distance": Estimate(size, 0.0, length)}
        out.append(Shape("beyond", {**slope, "place": at("beyond_at")}, kind))
    if used["wave"] != 0.0:
        n, error = used["wave_number"], std.get("wave_number", 0.0)
        numbers = {"size": value("wave"), "period": Estimate(size / n, size * error / n**2, length)}
        phase = Estimate(used["wave_phase"], std.get("wave_phase", 0.0), "rad")
        second = {"second": value("wave_2")} if used["wave_2"] != 0.0 else {}
        out.append(Shape("wave", {**numbers, "phase": phase, **second}))
    return tuple(out)
