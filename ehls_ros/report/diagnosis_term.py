"""The term found in the data: its sentence, its table as a figure, and its limits."""

import numpy as np

from ehls_ros.diagnosis.reading import Shape
from ehls_ros.diagnosis.result import Diagnosis, Term, argument_unit
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.report import page
from ehls_ros.report.page import Panel, Row, plane
from ehls_ros.report.plot import BLUE, SKY, Axis, line, region
from ehls_ros.report.quantities import percent, quantity, shown_signal, unit_for, value

NOUNS = {
    "empirical_force": "a force",
    "empirical_friction": "a change of friction",
    "empirical_opening": "a change of the valve's opening",
    "empirical_leakage": "a leakage",
    "empirical_spool": "an offset of the spool's command",
    "empirical_pressure_reading": "an error of the load pressure sensor",
    "empirical_position_reading": "an error of the position sensor",
    "empirical_force_reading": "an error of the load cell",
}
"""Noun of each term."""

DISTANCE = "the spool's distance from its command"
"""Name of the spool's error as an argument or a factor."""

SPREAD = 2.0
"""Standard errors shown around the table."""


def phrase(term: Term) -> str:
    """Describe a term within a sentence: its place, its argument and its shape."""
    noun = f"{NOUNS[term.effect]} that depends on {_argument(term)}"
    factor = [f"in proportion to {DISTANCE if term.factor_error else quantity(term.factor)}"] if term.factor else []
    size, reading = f"up to ±{value(term.reading.amplitude, term.unit, 2)} about its middle", term.reading
    shapes = ["turning round with the direction of motion"] if term.direction > 0.0 else []
    if term.period is not None:
        shapes.append(f"repeating every {_with_error(term.period)}")
        size = f"with an amplitude of {value(reading.amplitude, term.unit, 2)}"
    elif term.formula:
        shapes += [words for shape in term.formula if (words := _shape(shape))]
    elif reading.power is not None:
        symmetry = f"{reading.power.symmetry}, " if reading.power.symmetry else ""
        shapes.append(f"{symmetry}growing with the power {reading.power.exponent:.2f} ± {2.0 * reading.power.std:.1g}")
    elif reading.place is not None:
        shapes.append(f"acting at one place, {value(reading.place, argument_unit(term.argument))}")
    elif reading.rise is not None:
        shapes.append("always rising" if reading.rise > 0.0 else "always falling")
    if term.factor:
        reach = value(term.factor_reach, argument_unit(term.factor), 2)
        size += f" at {reach}"
    return ", ".join([noun, *factor, *shapes, size])


def _argument(term: Term) -> str:
    of = "the time" if term.argument == "time_s" else quantity(term.argument)
    if term.error:
        of = DISTANCE
    elif term.magnitude:
        of = f"the magnitude of {of}"
    if term.lag is not None:
        return f"the changes of {of} faster than {_with_error(term.lag)}"
    return f"{of} by a hysteresis {_with_error(term.play)} wide" if term.play is not None else of


def _with_error(estimate: Estimate) -> str:
    """Write an estimate with two standard errors."""
    return f"{value(estimate.value, estimate.unit, 4)} ± {value(2.0 * estimate.std, estimate.unit, 1)}"


def _shape(shape: Shape) -> str:
    """Describe a shape of a formula; empty for a constant."""
    numbers = shape.numbers
    if shape.name == "power":
        exponent, origin = numbers["exponent"], numbers["from"]
        growth = "linear" if exponent.std == 0.0 and exponent.value == 1.0 else ""
        growth = growth or f"{shape.kind}, growing with the power {exponent.value:.2f} ± {2.0 * exponent.std:.1g}"
        return growth + (f" of the distance from {_with_error(origin)}" if origin.std > 0.0 else "")
    if shape.name == "bump":
        acting = "holding at" if shape.kind == "odd" else "acting at"
        return f"{acting} one place, {_with_error(numbers['place'])}, within {_with_error(numbers['width'])}"
    if shape.name == "step":
        place, width = numbers["place"], _with_error(numbers["width"])
        return f"saturating within {width}" if place.std == 0.0 else f"with a step at {_with_error(place)}, within {width}"
    if shape.name == "beyond":
        side = {"above": "above", "below": "below", "both": "beyond ±"}[shape.kind]
        return f"rising {side} {_with_error(numbers['place'])}".replace("± ", "±", 1)
    return ""


def sentence(term: Term) -> str:
    """Return a sentence on a term and the error that it closes on held-out data."""
    return f"The data show {phrase(term)}; it closes {percent(term.closed)} of that error on held-out data."


def found_term(found: Diagnosis) -> list[str]:
    """Show the term that describes an error of unknown cause: its table, its limits, and where to look."""
    term = found.term
    if term is None:
        return []
    limits = (
        "It repeats beyond the data."
        if term.period is not None
        else "Beyond the data it goes on to twice their range and then keeps its value, which is not known to be right."
        if term.formula
        else "Beyond the data it keeps the values at their ends, which is not known to be right."
    )
    text = (
        f"{sentence(term)} {limits} The extended rig file has it as the effect {term.effect}, so that simulations contain it."
        " It describes the error and does not explain it: keep it until its cause is known."
    )
    words = EFFECTS.load(term.effect).WORDS
    advice: list[Row] = [[words.inspect, words.measure, words.change]]
    return [
        page.figures([_panel(term)]),
        page.paragraph(text),
        page.table(["inspect", "confirm by a measurement", "then change"], advice),
    ]


def _panel(term: Term) -> Panel:
    at, values, std = term.at, term.values, term.std
    if term.period is not None:
        # Close the period.
        at, values, std = (np.append(a, b) for a, b in ((at, at[0] + term.period.value), (values, values[0]), (std, std[0])))
    along = shown_signal(term.argument, np.asarray(at))
    unit = unit_for(term.unit, float(np.max(np.abs(values))))
    axes = Axis(along.quantity, along.unit), Axis(NOUNS[term.effect].split(" ", 1)[1], unit)
    traces = [
        region(along.values, values - SPREAD * std, values + SPREAD * std, f"± {SPREAD:g} standard errors", unit, SKY, 0.3),
        line(along.values, values, "formula" if term.formula else "table", unit, BLUE, width=2.2),
    ]
    return plane("The term found", traces, *axes, height=360)
