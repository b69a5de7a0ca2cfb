"""The Tune tab: the parameters of a running node, built from the node's own descriptions."""

import asyncio
import math
import re
from html import escape
from typing import Any

from nicegui import ui

from ehls_ros.dashboard.controls import show
from ehls_ros.dashboard.graph import Graph, Tunable

REACH = 10.0
"""A slider spans a tenth to ten times its initial value, within the node's limits."""

STEPS = 200
"""Positions of a slider."""

_UNIT = re.compile(r"(?P<help>.*) \[(?P<unit>[^][]*)\](?P<rest>;[^][]*)?")
"""Description, unit and origin of the default, as :mod:`ehls_ros.schema` joins them."""


class TuningTab:
    """Parameters of one node at a time."""

    def __init__(self, graph: Graph) -> None:
        """Build the tab in the current slot."""
        self._graph = graph
        self._asking = self._answered = self._by_hand = False
        self._version = (-1, 0)
        with ui.element("div").classes("row-of"):
            self._node = ui.select([], label="node", on_change=self.show).props("dense").style("flex: 1; min-width: 0")
            self._node.on("update:model-value", self._chosen_by_hand)
            ui.button("Reload", on_click=self.show).props("flat dense")
        self._list = ui.column().classes("tunables")

    async def show(self) -> None:
        """Show a node's parameters: the node the user selected, otherwise the first one."""
        nodes = list(self._graph.tunable_nodes())
        chosen = self._node_to_show(nodes)
        if chosen != self._node.value:
            # Selecting calls show again.
            self._node.set_options(nodes, value=chosen)
            return
        self._node.set_options(nodes)
        self._asking = True
        found = await asyncio.to_thread(self._graph.parameters, chosen) if chosen else ()
        self._asking, self._answered = False, bool(found)
        self._list.clear()
        with self._list:
            for tunable in found:
                _Tuner(self._graph, str(chosen), tunable)
            if not found:
                ui.label(f"{chosen} does not answer." if chosen else "There is no node to tune.").classes("note")

    async def follow(self, era: int, applications: int) -> None:
        """Update the list of nodes; keep the input for a node that is still present.

        Args:
            era: changes when the graph restarts, whose nodes may have other values.
            applications: number of applications of a tuning's numbers, which change values too.
        """
        nodes = list(self._graph.tunable_nodes())
        unknown = self._node.value != self._node_to_show(nodes) or not self._answered or self._version != (era, applications)
        self._version = era, applications
        if unknown and not self._asking:
            await self.show()
        elif nodes != self._node.options:
            self._node.set_options(nodes)

    def _node_to_show(self, nodes: list[str]) -> str | None:
        return self._node.value if self._by_hand and self._node.value in nodes else next(iter(nodes), None)

    def _chosen_by_hand(self) -> None:
        self._by_hand = True


class _Tuner:
    """One parameter: an input field, a slider if it is a float, and the node's reason if it refuses a value."""

    def __init__(self, graph: Graph, node: str, tunable: Tunable) -> None:
        self._graph = graph
        self._node = node
        self._tunable = tunable
        self._sent = tunable.value
        explanation, unit = help_and_unit(tunable.description)
        name = f'<span class="name">{escape(tunable.name)}</span> <span class="unit">{escape(unit)}</span>'
        with ui.element("div").classes("tunable"):
            ui.html(name, sanitize=False)
            self._entry = self._field()
            if isinstance(tunable.value, float):
                self._slider(tunable.value)
            ui.label(explanation).classes("help")
            self._refused = ui.label("").classes("refused")
            # Set as an item, here and below: NiceGUI parses a string of properties, and the browser evaluates some of them.
            self._refused.props["data-name"] = f"refused-{tunable.name}"
            self._refused.set_visibility(False)

    def _field(self) -> Any:
        """Make the input field; values out of range are sent too, so that the node returns its reason for the refusal."""
        value = self._tunable.value
        if isinstance(value, bool):
            entry: Any = ui.switch(value=value, on_change=self._typed)
        elif isinstance(value, str):
            entry = ui.input(value=value)
        else:
            entry = ui.number(value=value)
        entry.props("dense outlined step=any")
        entry.props["data-name"] = f"value-{self._tunable.name}"
        for event in () if isinstance(value, bool) else ("keydown.enter", "blur"):
            entry.on(event, self._typed)
        return entry

    def _slider(self, value: float) -> None:
        """Make a slider that fills the field and sends the value when released."""
        low, high = reach(value, self._tunable.minimum, self._tunable.maximum)
        slider = ui.slider(min=0, max=STEPS, value=round(STEPS * place_of(value, low, high)))
        slider.props["data-name"] = f"slider-{self._tunable.name}"
        slider.on_value_change(lambda: self._entry.set_value(value_at(slider.value / STEPS, low, high)))
        slider.on("change", self._typed)

    async def _typed(self) -> None:
        value = self._entry.value
        if value is None or value == self._sent:
            return
        self._sent = value
        typed = type(self._tunable.value)(value)
        answer = await asyncio.to_thread(self._graph.set_parameter, self._node, self._tunable.name, typed)
        if answer.done:
            show(answer)
        self._refused.set_text("" if answer.done else answer.message)
        self._refused.set_visibility(not answer.done)


def reach(value: float, minimum: float | None, maximum: float | None) -> tuple[float, float]:
    """Return the ends of a slider that starts at a value: a decade either way, within the node's limits."""
    if value == 0.0:
        low, high = (minimum if minimum is not None else -1.0), (maximum if maximum is not None else 1.0)
    else:
        low, high = sorted((value / REACH, value * REACH))
    return max(low, -math.inf if minimum is None else minimum), min(high, math.inf if maximum is None else maximum)


def place_of(value: float, low: float, high: float) -> float:
    """Return a value's place between the ends of a slider, 0 to 1; logarithmic if both ends have the same sign."""
    if low * high > 0.0:
        return math.log(value / low) / math.log(high / low) if high != low else 0.0
    return (value - low) / (high - low) if high != low else 0.0


def value_at(place: float, low: float, high: float) -> float:
    """Return the value at a slider's place, rounded to three digits and within its ends."""
    value = low * (high / low) ** place if low * high > 0.0 else low + place * (high - low)
    return min(max(float(f"{value:.3g}"), low), high)


def help_and_unit(description: str) -> tuple[str, str]:
    """Split a descriptor's text into help and the unit in brackets at the end of its first part; the unit 1 is left out."""
    match = _UNIT.fullmatch(description)
    if match is None:
        return description, ""
    return f"{match['help']}{match['rest'] or ''}", "" if match["unit"] == "1" else match["unit"]
