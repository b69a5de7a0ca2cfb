"""The term found in the data: its sentence, its table as a figure, and its limits."""

import numpy as np

from ehls_ros.diagnosis.result import Diagnosis, Term, argument_unit
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
}
"""Noun of each term."""

SPREAD = 2.0
"""Standard errors shown around the table."""


def phrase(term: Term) -> str:
    """Describe a term within a sentence: its place, its argument and its shape."""
    of = "the time" if term.argument == "time_s" else quantity(term.argument)
    noun = f"{NOUNS[term.effect]} that depends on {'the magnitude of ' if term.magnitude else ''}{of}"
    size, reading = f"up to ±{value(term.reading.amplitude, term.unit, 2)} about its middle", term.reading
    shapes = ["turning round with the direction of motion"] if term.direction > 0.0 else []
    if term.period is not None:
        period = f"{value(term.period.value, term.period.unit, 4)} ± {value(2.0 * term.period.std, term.period.unit, 1)}"
        shapes.append(f"repeating every {period}")
        size = f"with an amplitude of {value(reading.amplitude, term.unit, 2)}"
    elif reading.power is not None:
        symmetry = f"{reading.power.symmetry}, " if reading.power.symmetry else ""
        shapes.append(f"{symmetry}growing with the power {reading.power.exponent:.2f} ± {2.0 * reading.power.std:.1g}")
    elif reading.place is not None:
        shapes.append(f"acting at one place, {value(reading.place, argument_unit(term.argument))}")
    elif reading.rise is not None:
        shapes.append("always rising" if reading.rise > 0.0 else "always falling")
    return ", ".join([noun, *shapes, size])


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
        line(along.values, values, "table", unit, BLUE, width=2.2),
    ]
    return plane("The term found", traces, *axes, height=360)
