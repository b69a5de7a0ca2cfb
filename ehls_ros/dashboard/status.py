"""Status of the graph on the page: one sentence, one level and one remedy, all from the same snapshot.

Diagnostics arrive once a second and on change, cycles a thousand times a second. Side by side they could contradict each other
for a moment, so only the most severe finding is shown.
"""

import math
import re
from collections.abc import Iterable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from ehls_ros.dashboard.graph import GraphSnapshot, NodeHealth
from ehls_ros.dashboard.panels import UNITS
from ehls_ros.hardware.gate_parameters import REACTIONS
from ehls_ros.hardware.gate_parameters import Parameters as GateParameters
from ehls_ros.hardware.safety_gate import DISABLED, POSITION_CONTROL, READING_LOST, UNLOADING
from ehls_ros.recording.topics import OF_GATE, TRIPPED_BY
from ehls_ros.schema import declarations

STATE = "state"
"""Diagnostics key of the safety gate's state."""

STOP = "stop"
"""Diagnostics key that names the emergency stop while one is engaged."""

TOO_SLOW = "too slow"
"""Part of a node's message when this machine cannot keep its cycle time."""

NODE = "programme_node"
"""Node that runs test programmes."""

STOPPED_BECAUSE = "stopped_because"
"""Diagnostics key of the reason for which the programme is stopped."""

PROGRAMME_BUTTONS: Mapping[str, str] = MappingProxyType(
    {"stop": "Stop programme", "resume": "Resume programme", "skip": "Skip block"}
)
"""Requests to the programme, and the labels of their buttons."""

GONE = "No more snapshots: the graph was stopped, or the plant node has died."

LARGE = 1e4
"""Value from which a larger unit is chosen."""

SAME = 0.1
"""Deviation from real time that is not reported."""

GOOD, WARNING, BAD = range(3)
"""Levels, as in :class:`Health`."""


class Remedy(Enum):
    """Button that resolves the trouble; the value is its label."""

    ACKNOWLEDGE = "Acknowledge stop"
    UNLOAD = "Unload"
    RESET = "Reset and enable"
    ENABLE = "Enable"


class Status(NamedTuple):
    """Status shown on the page.

    Attributes:
        text: state of the graph, in a few words.
        level: 0 good, 1 warning, 2 bad.
        trouble: fault, cause and remedy; empty without a fault.
        remedy: the button to press; None: there is none.
    """

    text: str
    level: int
    trouble: str = ""
    remedy: Remedy | None = None


def status_of(snapshot: GraphSnapshot, *, graph_seen: bool) -> Status:
    """Return the status to show.

    Args:
        snapshot: of the graph.
        graph_seen: whether this page has seen a running graph before.
    """
    return _running(snapshot) if snapshot.rate else _absent(snapshot, graph_seen=graph_seen)


def _absent(snapshot: GraphSnapshot, *, graph_seen: bool) -> Status:
    """Return the status while no cycles arrive."""
    if snapshot.starting:
        return Status(f"starting, {snapshot.starting.seconds:.0f} s", WARNING, snapshot.complaint)
    if graph_seen:
        return Status("graph gone", BAD, snapshot.complaint or GONE)
    return Status("no graph", BAD if snapshot.complaint else WARNING, snapshot.complaint)


def _running(snapshot: GraphSnapshot) -> Status:
    """Return the status while cycles arrive."""
    gate = next((node for node in snapshot.health if OF_GATE in node.figures), None)
    speed = f"{snapshot.rate:.0f} cycles/s{_pace(snapshot)}"
    if gate is not None and gate.figures.get(TRIPPED_BY):
        tripped = "stopped" if gate.figures.get(STOP) else "tripped"
        return Status(f"{tripped}, {_doing(gate)}, {speed}", BAD, *_trip(gate, snapshot))
    if snapshot.complaint:
        return Status(f"a node died, {speed}", BAD, snapshot.complaint)
    slow = next((f"{node.node}: {node.message}" for node in snapshot.health if TOO_SLOW in node.message), "")
    held = next((node for node in snapshot.health if node.level and STOPPED_BECAUSE in node.figures), None)
    worst = max((node for node in snapshot.health if node is not held), key=lambda node: node.level, default=None)
    wrong = f"{worst.node}: {worst.message}" if worst is not None and worst.level else ""
    closed = gate is not None and gate.figures[STATE] == DISABLED
    steps = (*((Remedy.ENABLE.value,) if closed else ()), PROGRAMME_BUTTONS["resume"])
    stopped = f"The programme is stopped: {held.figures[STOPPED_BECAUSE]}. {_to_go_on(steps)}" if held is not None else ""
    # The cause before its consequence.
    trouble = ". ".join(dict.fromkeys(filter(None, (slow, wrong, stopped))))
    if closed:
        return Status(f"valve closed, {speed}", WARNING, trouble or "The safety gate is closed.", Remedy.ENABLE)
    if gate is not None and gate.figures[STATE] == UNLOADING:
        return Status(f"{_doing(gate)}, {speed}", WARNING, trouble)
    level = min(max((node.level for node in snapshot.health), default=GOOD), BAD)
    return Status(f"{TOO_SLOW if slow else 'running'}, {speed}", level, trouble)


def _pace(snapshot: GraphSnapshot) -> str:
    """Return the pace of the rig's time relative to the wall clock, as text; empty in real time."""
    pace = snapshot.rate * snapshot.period
    return f", {pace:.2g} times real time" if snapshot.period and abs(pace - 1.0) > SAME else ""


def _trip(gate: NodeHealth, snapshot: GraphSnapshot) -> tuple[str, Remedy]:
    """Return the description of a trip and its remedy."""
    explanation = explained(gate.figures[TRIPPED_BY])
    stopped = gate.figures.get(STOP)
    held = gate.figures[STATE] == POSITION_CONTROL
    remedies = (Remedy.ACKNOWLEDGE, Remedy.RESET) if stopped else (Remedy.UNLOAD, Remedy.RESET) if held else (Remedy.RESET,)
    resume = (PROGRAMME_BUTTONS["resume"],) if STOPPED_BECAUSE in programme_figures(snapshot.health) else ()
    again = " If it trips again: stop and start under Experiment." if snapshot.started_here and not stopped else ""
    steps = (*(remedy.value for remedy in remedies), *resume)
    return f"{explanation} {valve_text(gate.figures[STATE])} {_to_go_on(steps)}{again}", remedies[0]


def _doing(gate: NodeHealth) -> str:
    """Return how the gate moves the valve after a trip or a request, in two words."""
    return {POSITION_CONTROL: "piston held", UNLOADING: UNLOADING}.get(gate.figures[STATE], "valve closed")


def valve_text(state: str) -> str:
    """Return how the gate moves the valve after a trip, as a sentence.

    Args:
        state: of the gate.
    """
    taken = {
        POSITION_CONTROL: "The gate holds the piston in its position.",
        UNLOADING: "The gate unloads the rig, and then closes the valve.",
    }
    return taken.get(state, "The valve is closed.")


def _to_go_on(buttons: Iterable[str]) -> str:
    """Return the buttons to press, as a sentence."""
    return f"To go on: {', then '.join(buttons)}."


_CAUSE = re.compile(
    r"(?P<name>[\w ]+?)(?: of (?P<subject>[\w/]+))?(?:: (?P<value>\S+)(?: (?P<unit>\S+))?, limit (?P<limit>\S+)(?: \S+)?)?"
    r" at (?P<time>\S+) s, \w+"
)
"""Text form of :class:`ehls_ros.hardware.safety_gate.Cause`, with time and reaction."""

_SHARED = {"force_mismatch": "sensor_mismatch", "position_mismatch": "sensor_mismatch", "supply_mismatch": "sensor_mismatch"}
"""Detectors that share one declaration."""

_UNDECLARED = MappingProxyType(
    {
        "emergency stop": "emergency stop requested",
        READING_LOST.replace("_", " "): "no plausible reading to hold the piston or to unload by",
        "left active": "the plant node ended its loop while commands reached the valve",
        "gap": "the plant's loop paused",
        "services_silent": "the plant node could not receive an emergency stop",
        "device_null": "the device itself keeps the valve closed",
    }
)
"""Causes without a parameter, and so without a declaration."""


def explained(cause: str) -> str:
    """Return a trip's cause as a sentence, with value and limit in one unit; a cause of another form is quoted.

    Args:
        cause: text from the gate's diagnostics.
    """
    match = _CAUSE.fullmatch(cause)
    if match is None:
        return f"Tripped by {cause}."
    label = _declared().get(match["name"]) or _UNDECLARED.get(match["name"]) or match["name"].replace("_", " ")
    subject = f" ({match['subject']})" if match["subject"] else ""
    figures = ""
    if match["value"]:
        unit, factor = _readable(match["unit"] or "", abs(float(match["limit"])))
        value, limit = (f"{factor * float(match[which]):.4g} {unit}".rstrip() for which in ("value", "limit"))
        figures = f": {value}, allowed {limit}"
    return f"Tripped: {label}{subject}{figures}, at {float(match['time']):.3f} s."


def _readable(own: str, value: float) -> tuple[str, float]:
    """Return the display unit of a value and the factor to it: the first unit that needs no power of ten."""
    units = UNITS.get(own, {own: 1.0})
    return next(((unit, factor) for unit, factor in units.items() if factor * value < LARGE), next(iter(units.items())))


def _declared() -> dict[str, str]:
    """Return a description of each detector, from the declaration of its reaction."""
    suffix = re.compile(rf"(;[^;]*)?: ({'|'.join(REACTIONS)}).*")
    found = {
        declared.name.removeprefix("on_"): suffix.sub("", declared.description)
        for declared in declarations(GateParameters)
        if declared.name.startswith("on_")
    }
    return found | {name: found[shared] for name, shared in _SHARED.items()}


def programme_figures(health: Iterable[NodeHealth]) -> Mapping[str, str]:
    """Return the figures of the programme node among the nodes' diagnostics; empty where none runs."""
    return next((node.figures for node in health if node.node == NODE), {})


def programme_requests(figures: Mapping[str, str]) -> frozenset[str]:
    """Return the requests that the programme would follow at present: ``stop``, ``resume``, ``skip``.

    Args:
        figures: diagnostics of the programme node; empty: no programme.
    """
    state = figures.get("programme_state", "finished")
    if state == "finished":
        return frozenset()
    return frozenset({"skip", "resume" if STOPPED_BECAUSE in figures else "stop"})


def programme_line(figures: Mapping[str, str]) -> str:
    """Return title, block, load cycles, last peak and valley, state and pacing of a programme.

    Args:
        figures: diagnostics of the programme node; empty: no programme.
    """
    if "programme" not in figures:
        return ""
    block = f"block {figures.get('block', '')} {figures.get('block_name', '')}"
    count = f"{figures.get('load_cycles', '')} of {figures.get('of_load_cycles', '')} load cycles"
    state = figures.get("programme_state", "")
    return " · ".join(filter(None, [figures["programme"], block, count, _last_peak(figures), state, figures.get("pacing")]))


def _last_peak(figures: Mapping[str, str]) -> str:
    """Return peak and valley of the last load cycle with their unit, as text; empty before the first."""
    try:
        values = [float(figures[name]) for name in ("peak", "valley")]
    except (KeyError, ValueError):
        return ""
    if not all(map(math.isfinite, values)):
        return ""
    unit, factor = _readable(figures.get("unit", ""), max(map(abs, values)))
    peak, valley = (f"{factor * value:.4g} {unit}".rstrip() for value in values)
    return f"peak {peak}, valley {valley}"
