"""Temporal formulas over sampled signals, and their robustness: the signed distance to violation.

A formula is ``always(condition -> quantity <= bound)``. Its conditions refer to the past: an event, such as a stop, begins a
span that another event ends, and within it the time since the beginning is a quantity like any other. With conditions that are
true or false, robustness is ``bound - quantity``, in that quantity's unit; at the border it is 0, and the formula holds.

The evaluation needs only a few numpy operations. Of the libraries for signal temporal logic, rtamt pins antlr 4.7 and Python
below 3.13, and evaluates sample by sample in Python. None supports bounds that depend on other signals, such as messages
still in flight.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from policies.trace import IN_FLIGHT, ROUNDING, Spans, Trace

Flags = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

ROWS = "rows of the rig's log"
"""The axis of most formulas; others are lists of requests or messages."""


class Margins(NamedTuple):
    """Robustness at each instant at which a formula applies.

    Attributes:
        time: the instants, by this computer's clock [s], shape (n,).
        margin: bound less quantity, shape (n,).
    """

    time: Array
    margin: Array


NOTHING = Margins(np.empty(0), np.empty(0))


@dataclass(frozen=True)
class Condition:
    """A truth value per row.

    Attributes:
        text: as displayed in formulas.
        of: computes the values from a trace.
    """

    text: str
    of: Callable[[Trace], Flags]

    def __and__(self, other: "Condition") -> "Condition":
        """Return the conjunction."""
        return Condition(f"{self.text} and {other.text}", lambda trace: self.of(trace) & other.of(trace))

    def __invert__(self) -> "Condition":
        """Return the negation."""
        return Condition(f"not {self.text}", lambda trace: ~self.of(trace))


@dataclass(frozen=True)
class Quantity:
    """A number per row, with its unit."""

    text: str
    unit: str
    of: Callable[[Trace], Array]

    def __add__(self, other: "Quantity") -> "Quantity":
        """Return the sum."""
        return Quantity(f"{self.text} + {other.text}", self.unit, lambda trace: self.of(trace) + other.of(trace))

    def __le__(self, bound: "Quantity") -> "Inequality":
        """Bound the quantity."""
        return Inequality(self, bound)


class Inequality(NamedTuple):
    """A quantity with its upper bound."""

    quantity: Quantity
    bound: Quantity


class Formula(NamedTuple):
    """A formula that must always hold.

    Attributes:
        text: in plain temporal form.
        unit: of the robustness.
        margins: evaluates it.
    """

    text: str
    unit: str
    margins: Callable[[Trace], Margins]


def always(condition: Condition, claim: Inequality) -> Formula:
    """Return the formula that a bound holds in every row in which a condition does."""

    def margins(trace: Trace) -> Margins:
        if not trace.command.size:
            return NOTHING
        rows = condition.of(trace)
        found = claim.bound.of(trace)[rows] - claim.quantity.of(trace)[rows]
        return Margins(trace.moments[rows], np.where(np.isnan(found), -np.inf, found))

    text = f"always({condition.text} -> {claim.quantity.text} <= {claim.bound.text})"
    return Formula(text, claim.quantity.unit, margins)


def each(text: str, unit: str, margins: Callable[[Trace], Margins]) -> Formula:
    """Return a formula over requests or messages, which have no common time axis: a function computes its margins."""
    return Formula(text, unit, margins)


def constant(text: str, unit: str, value: Callable[[Trace], float]) -> Quantity:
    """Return a quantity that is the same in all rows of a trace."""
    return Quantity(text, unit, lambda trace: np.full(trace.command.size, value(trace)))


@dataclass(frozen=True)
class During:
    """Spans of time that events begin and end.

    Attributes:
        text: as displayed in formulas.
        spans: finds them in a trace, by this computer's clock.
    """

    text: str
    spans: Callable[[Trace], Spans]

    @property
    def holds(self) -> Condition:
        """Whether a row is within such a span."""
        return Condition(self.text, lambda trace: self._number(trace) >= 0)

    def null_within(self, takes: Quantity | None = None) -> Inequality:
        """Claim that the valve comes to null within a time of the beginning.

        Earlier commands may arrive later, and the rig holds them for its watchdog time. Neither counts.

        Args:
            takes: the time [s]; None: none.
        """
        text = "what was in flight" if takes is None else f"{takes.text} + what was in flight"
        elapsed = Quantity("time open since", "s", self._open_since)
        return Inequality(elapsed, Quantity(text, "s", lambda trace: self._deadlines(trace, takes)))

    def _open_since(self, trace: Trace) -> Array:
        """Return the time since the start of a row's span if the valve is open, else 0 [s]."""
        number, begins = self._number(trace), trace.at(self.spans(trace).begins)
        return np.where(trace.open, trace.time - np.append(begins, np.inf)[number], 0.0)

    def _number(self, trace: Trace) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        spans = self.spans(trace)
        return Spans(trace.at(spans.begins), trace.at(spans.ends)).index(trace.time)

    def _deadlines(self, trace: Trace, takes: Quantity | None) -> Array:
        """Return for each row the time from its span's beginning within which the valve must be at null [s]."""
        allowed = np.zeros(trace.command.size) if takes is None else takes.of(trace)
        number, begins = self._number(trace), trace.at(self.spans(trace).begins)
        found = np.full(trace.command.size, np.inf)
        for span in np.unique(number[number >= 0]):
            rows = np.flatnonzero(number == span)
            begin = begins[span]
            late = rows[trace.time[rows] - trace.transport_delay[rows] >= begin + allowed[rows[0]]]
            found[rows] = in_flight_until(trace, late) - begin
        return found


def in_flight_until(trace: Trace, rows: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> float:
    """Return until when commands from before the first of some rows may act on the valve [s]; infinite if through the last."""
    if not rows.size:
        return np.inf
    times, arrived = trace.time[rows], trace.arrived[rows]
    newest = np.maximum.accumulate(np.where(arrived, times, times[0]))
    held = trace.setup.watchdog + trace.setup.period
    before = (np.cumsum(arrived) <= IN_FLIGHT) & (times - newest <= held + ROUNDING)
    if np.all(before):
        return np.inf
    return float(times[np.argmin(before)]) - 0.5 * trace.setup.period
