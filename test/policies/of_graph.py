"""Policies of the graph: one source of each input, one driver, switches, the programme, independent nodes."""

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.motion import State
from ehls_ros.hardware.ownership import node_of, process_of
from ehls_ros.hardware.target import SILENCE
from policies.of_gate import IN_REALTIME, as_margins
from policies.policy import Policy
from policies.temporal import Condition, Flags, Margins, Quantity, always, constant, each
from policies.trace import Trace

SOURCES = "how_to/sources.md"
SWITCHING = "how_to/switching.md"
PROGRAMME = "how_to/programme.md"
COMPOSED = "how_to/composed.md"
DESIGN = "design.md"

EXACT = 1e-3
"""Tolerance for two equal references [N]; those of two sources differ by far more."""

REFUSED_WITHIN = 10.0
"""Longest time in which a refused node falls silent [s]; 0.1 s where the machine is not overloaded."""

PUBLISHED = 1.0
"""Longest time for which messages of a node in a shared process gather before they are published [s]."""

NEIGHBOURS = 250
"""Cycles on both sides of a switch in which the usual changes of the commands are determined."""

HANDOVER = 1.2
"""Permitted change of the command in a switch, as a multiple of the largest usual one [1]."""

GOALS = {
    "configure": "inactive",
    "activate": "active",
    "deactivate": "inactive",
    "cleanup": "unconfigured",
    "shutdown": "finalized",
}
"""State that a lifecycle transition leads to."""


# Sources


class Departures:
    """Departures of senders: announced, or by the end of their process."""

    def __init__(self, trace: Trace) -> None:
        """Find the departures in a trace."""
        self._times: dict[str, list[float]] = defaultdict(list)
        for message in trace.heard("leaving"):
            self._times[message[1]].append(message[0])
        # A killed process counts as gone once the signal is sent: its earlier messages may be read later.
        numbers = [(h.whom, h.code, h.time) for h in trace.happenings_of("started")]
        self._gone: dict[int, float] = {}
        for happening in trace.happenings:
            if happening.what in {"stopped", "killed", "ended"}:
                started = [number for name, number, when in numbers if name == happening.whom and when <= happening.time]
                if started:
                    self._gone.setdefault(started[-1], happening.time)

    def left(self, sender: str, since: float, until: float) -> bool:
        """Return whether a sender left in a period."""
        process = process_of(sender)
        gone = math.inf if process is None else self._gone.get(process, math.inf)
        return gone <= until or any(since <= when <= until for when in self._times.get(sender, []))


def _references(trace: Trace) -> Mapping[int, list[tuple[float, float, str]]]:
    """Return the references of each cycle: time [s], force [N] and sender."""
    found: dict[int, list[tuple[float, float, str]]] = defaultdict(list)
    for when, _, cycle, force, _, _, sender in trace.heard("force_reference"):
        found[cycle].append((when, force, sender))
    return found


def _one_reference(trace: Trace) -> Margins:
    """Return for each answered cycle the tolerance less the error of the followed reference against the owner's [N].

    The law's reference is the measured force less the reported force error.
    """
    references, departures = _references(trace), Departures(trace)
    named = {message[4] for message in trace.heard("refused") if message[2] == "force_reference"}
    measured: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for state in trace.of_plant():
        measured[state[2]].append((state[0], state[7]))
    owners: dict[str, str] = {}
    since: dict[str, float] = {}
    found = []
    for status in trace.heard("controller_status"):
        when, cycle, controller = status[0], status[2], status[-1]
        # Nodes of one process publish a little later than they act. The last message sent holds.
        known = {sender: force for sent, force, sender in references.get(cycle, []) if sent <= when + PUBLISHED}
        since_run = max((begun for begun in trace.runs if begun <= when), default=-math.inf)
        snapshots = [force for opened, force in measured.get(cycle, []) if since_run <= opened <= when]
        if not known or not snapshots:
            continue
        followed = snapshots[-1] - status[11]
        apart = {sender: abs(followed - force) for sender, force in known.items()}
        owner, nearest = owners.get(controller), min(apart, key=apart.__getitem__)
        if apart[nearest] > EXACT and named - set(known):
            # Not all messages of an owner that was refusing others already may have been received.
            continue
        if owner not in apart or apart[owner] > EXACT:
            restarted = owner is not None and node_of(owner) == node_of(nearest)
            if owner is None or restarted or departures.left(owner, since[controller], when):
                owner = owners[controller] = nearest
            elif owner not in apart:
                found.append((when, -max(EXACT, apart[nearest])))
                continue
        since[controller] = since.get(controller, when)
        found.append((when, EXACT - apart[owner]))
    return as_margins(found)


def _refused(trace: Trace) -> Margins:
    """Return for each refused sender the margin of its silence before the deadline [s]."""
    found = []
    refusals: dict[tuple[str, str], float] = {}
    for when, _, topic, sender, owner in trace.heard("refused"):
        mutual = any(message[2:] == (topic, owner, sender) for message in trace.heard("refused"))
        if not mutual or owner < sender:
            refusals.setdefault((topic, sender), when)
    activated = [call.sent for call in trace.calls if call.service.endswith("/change_state") and call.success is not False]
    for (topic, sender), when in refusals.items():
        again = min((sent for sent in activated if sent > when), default=math.inf)
        last = max((m[0] for m in trace.heard(topic) if m[-1] == sender and when < m[0] < again), default=when)
        found.append((last, REFUSED_WITHIN - (last - when)))
    return as_margins(found)


# The driver


def _turns(trace: Trace) -> list[tuple[float, int, bool, str, str]]:
    """Return each driver message: time [s], first cycle, whether commands reach the valve, sender and plant."""
    return [(when, first, driving, sender, plant) for when, _, first, driving, sender, plant in trace.heard("driver")]


def _changes_of_driver(trace: Trace) -> Iterable[tuple[tuple[Any, ...], tuple[Any, ...]]]:
    """Yield the driver messages before and after each change from one controller to another of the same plant."""
    turns = _turns(trace)
    for before, after in itertools.pairwise(turns):
        if before[4] == after[4] and before[3] and after[3] and before[3] != after[3]:
            yield before, after


def _driver_changes(trace: Trace) -> Margins:
    """Return 1 for each change of driver that was requested or followed a departure or a closed gate, and -1 for others."""
    departures = Departures(trace)
    asked = [call for call in trace.calls if call.service == "switch_controller" and call.success is not False]
    found = []
    for before, after in _changes_of_driver(trace):
        switched = any(call.sent <= after[0] and call.answered >= before[0] for call in asked)
        reasons = switched, departures.left(before[3], before[0] - 1.0, after[0]), not before[2] or not after[2]
        takes_over = any(call.fields.get("name") == "take_over_after" for call in trace.changes)
        found.append((after[0], 1.0 if any(reasons) or takes_over else -1.0))
    return as_margins(found)


def _handovers(trace: Trace) -> Margins:
    """Return for each hand-over between controllers that follow each other the margin of its step below the usual changes [m].

    Usual changes are those of both controllers, and those by which the new one would have continued the old one's commands
    while on standby. A sender of commands without a status is no controller of this package, and gives no guarantees. A step of
    the reference, which another source begins, is no step of the hand-over.
    """
    commands: dict[tuple[str, int], dict[int, float]] = defaultdict(dict)
    standby: dict[tuple[str, int], dict[int, float]] = defaultdict(dict)
    for topic, found in (("valve_command", commands), ("standby_command", standby)):
        for sent, _, cycle, spool, sender in trace.heard(topic):
            found[sender, trace.run_of(sent)][cycle] = spool
    ours = {message[-1] for message in trace.heard("controller_status")}
    sources: dict[tuple[int, int], set[str]] = defaultdict(set)
    for sent, _, cycle, *_, sender in trace.heard("force_reference"):
        sources[trace.run_of(sent), cycle].add(sender)
    margins = []
    for before, after in _changes_of_driver(trace):
        run, first = trace.run_of(after[0]), after[1]
        old, new, shadow = commands[before[3], run], commands[after[3], run], standby[after[3], run]
        if not (before[2] and after[2] and shadow and after[3] in ours) or first not in new or first - 1 not in old:
            continue
        if len(sources[run, first - 1] | sources[run, first]) > 1:
            continue
        usual = [
            abs(some[cycle] - some_before[cycle - 1])
            for some, some_before in ((old, old), (new, new), (shadow, old))
            for cycle in range(first - NEIGHBOURS, first + NEIGHBOURS)
            if cycle in some and cycle - 1 in some_before
        ]
        if len(usual) >= NEIGHBOURS:
            margins.append((after[0], HANDOVER * max(usual) - abs(new[first] - old[first - 1])))
    return as_margins(margins)


def _standing_by(trace: Trace) -> Margins:
    """Return for each standby controller's command the remaining cycles of permitted unawareness of the driver [cycles]."""
    ours = {message[-1] for message in (*trace.heard("standby_command"), *trace.heard("controller_status"))}
    grace = math.ceil(trace.setup.gate.command_timeout / trace.setup.period)
    turns, states, found = _turns(trace), trace.of_plant(), []
    opened = np.array([state[0] for state in states])
    for sent, _, cycle, _, sender in trace.heard("valve_command"):
        if not trace.setup.lockstep or sender not in ours:
            continue
        last = [turn for turn in turns if turn[0] <= sent and turn[1] <= cycle][-1:]
        if last and last[0][3] not in {"", sender}:
            # The message arrived in the cycle open at that time, or is about a later one.
            known = states[max(int(np.searchsorted(opened, last[0][0])) - 1, 0)][2] if states else 0
            found.append((sent, float(grace - (cycle - max(last[0][1], known)))))
    return as_margins(found)


def _switches(trace: Trace) -> Margins:
    """Return 1 for each switch of an open gate in lockstep that left it open, and -1 for one that closed it.

    A gate that closes for lack of a reference, without which no controller answers, was not closed by the switch; nor was one
    whose newest snapshot nobody had answered yet.
    """
    told = trace.driving
    closing = [
        call.sent
        for call in trace.calls
        if call.service in {"emergency_stop", "enable"} or call.service.endswith("/change_state")
    ]
    others = [*closing, *(happening.time for happening in trace.happenings)]
    references = _references(trace)
    starved = [state[0] for state in trace.of_plant() if references and state[2] not in references]
    found = []
    states, commands = trace.of_plant(), trace.heard("valve_command")
    for call in trace.called("switch_controller"):
        before = [message[1] for message in told if message[0] <= call.sent]
        if not trace.setup.lockstep or not before or not before[-1] or "takes over" not in call.message:
            continue
        newest = [state for state in states if state[0] <= call.sent][-1:]
        if newest and not any(message[2] == newest[0][2] and newest[0][0] <= message[0] <= call.sent for message in commands):
            continue
        until = min([when for when in (*others, *starved) if when > call.sent] + [call.answered + 1.0])
        closed = any(not message[1] for message in told if call.sent < message[0] < until)
        found.append((call.answered, -1.0 if closed else 1.0))
    return as_margins(found)


# The plant


def _in_order(trace: Trace) -> Margins:
    """Return the increment of each snapshot's cycle over the previous one, less 1; a repetition or a new run counts as 1.

    A simulated plant that was deactivated reopens the cycle in which it stopped.
    """
    newest: dict[str, tuple[Any, ...]] = {}
    departures, found = Departures(trace), []
    for state in trace.of_plant():
        last = newest.get(state[-1])
        newest[state[-1]] = state
        if last is not None and state[2] != 0 and state[1:] != last[1:]:
            again = state[2] == last[2] and departures.left(state[-1], last[0], state[0])
            found.append((state[0], 0.0 if again else float(state[2] - last[2] - 1)))
    return as_margins(found)


def _new_session(trace: Trace) -> Flags:
    return np.concatenate([[0.0], np.diff(trace.sequence)]) < 0.0


def _silence(trace: Trace) -> Array:
    """Return the time for which no command had been accepted before each row [s], less the possible rounding to rows."""
    accepted = trace.time[trace.arrived & (trace.sequence > 0.0)]
    before = np.searchsorted(accepted, trace.time, side="left") - 1
    return trace.time - np.concatenate([[-np.inf], accepted])[before + 1]


# The programme


def _by_programme(trace: Trace) -> list[tuple[Any, ...]]:
    """Return the force references that a programme's node sent."""
    senders = {message[-1] for message in trace.heard("programme_point")}
    return [message for message in trace.heard("force_reference") if message[-1] in senders]


def _counts_once(trace: Trace) -> Margins:
    """Return for each load cycle the gap in control cycles to the end of the previous one, less 1 [cycles].

    If its number is not consecutive, return the number of load cycles missing or counted twice, as a negative number.
    """
    if len(trace.happenings_of("started", trace.setup.hosts)) > 1:
        return as_margins([])
    found = []
    for last, following in zip(trace.load_cycles, trace.load_cycles[1:], strict=False):
        missing = -abs(float(following[0] - last[0] - 1))
        found.append((0.0, missing or float(following[1] - last[2] - 1)))
    return as_margins(found)


def _continuous(trace: Trace) -> Margins:
    """Return for each two consecutive references the margin of the step below the limits on rate and acceleration [N]."""
    period, found = trace.setup.period, []
    messages = _by_programme(trace)
    for last, message in itertools.pairwise(messages):
        if message[2] != last[2] + 1 or message[-1] != last[-1]:
            continue
        step = message[3] - last[3] - 0.5 * period * (message[4] + last[4])
        bound = period**2 * (abs(message[5]) + abs(last[5])) + EXACT
        found.append((message[0], bound - abs(step)))
    return as_margins(found)


def _same_again(trace: Trace) -> Margins:
    """Return for each reference repeated in lockstep the tolerance less its distance from the earlier one [N]."""
    plants = list(trace.happenings_of("started", trace.setup.hosts))
    if not trace.setup.lockstep or len(plants) > 1:
        return as_margins([])
    sent: dict[int, float] = {}
    found = []
    for message in _by_programme(trace):
        if message[2] in sent:
            found.append((message[0], EXACT - abs(message[3] - sent[message[2]])))
        sent[message[2]] = message[3]
    return as_margins(found)


def _stands(trace: Trace) -> Margins:
    """Return for each point of a stopped programme minus the number of load cycles that it counted."""
    found = []
    points = trace.heard("programme_point")
    for last, point in itertools.pairwise(points):
        if point[7] == last[7] == State.STOPPED and point[-1] == last[-1] and point[2] == last[2] + 1:
            found.append((point[0], -abs(float(point[5] - last[5]))))
    return as_margins(found)


# Partners


def _go_on(trace: Trace) -> Margins:
    """Return 1 for each process that ran until it was asked to end, and -1 for one that ended unprompted."""
    found = []
    started = trace.happenings_of("started")
    for begun in started:
        asked = any(h.what == "stopped" and h.whom == begun.whom and h.time >= begun.time for h in trace.happenings)
        gone = any(h.what == "gone" and h.code == begun.code for h in trace.happenings)
        found.append((begun.time, -1.0 if gone and not asked else 1.0))
    return as_margins(found)


def _expected_states(trace: Trace, node: str, process: str, until: float) -> set[str]:
    """Return the permitted lifecycle states of a node at a time: as requested, or inactive if it was refused."""
    began = max((h.time for h in trace.happenings_of("started", {process}) if h.time <= until), default=-math.inf)
    asked = [
        call
        for call in trace.calls
        if call.service == f"{node}/change_state" and began <= call.sent <= until and call.success is not False
    ]
    last = max(asked, key=lambda call: call.answered, default=None)
    expected = {"active" if last is None else GOALS.get(str(last.fields.get("transition")), "active")}
    since = -math.inf if last is None else last.sent
    refused = {node_of(message[3]).rpartition("/")[2] for message in trace.heard("refused") if message[0] >= since - 1.0}
    return expected | ({"inactive"} if node in refused else set())


def _stay(trace: Trace) -> Margins:
    """Return 1 for each lifecycle state that was as requested, and -1 for another."""
    found, active = [], set()
    for happening in trace.happenings_of("state"):
        node, process, state = happening.whom.split()
        begun = len([h for h in trace.happenings_of("started", {process}) if h.time <= happening.time])
        expected = _expected_states(trace, node, process, happening.time)
        if state in expected:
            active.add((node, begun))
        # A node that has just started is still in transition.
        if (node, begun) in active:
            found.append((happening.time, 1.0 if state in expected else -1.0))
    return as_margins(found)


POLICIES = (
    Policy(
        "one_reference",
        each("always(a cycle is answered -> |reference followed - its owner's| = 0)", "N", _one_reference),
        SOURCES,
        "The first node that sends it owns it",
        1.0,
    ),
    Policy(
        "refused_is_silent",
        each(f"always(refused -> silent within {REFUSED_WITHIN:g} s, until activated)", "s", _refused),
        SOURCES,
        "its messages are refused, it deactivates itself",
        1.0,
    ),
    Policy(
        "driver_changes_for_a_reason",
        each("always(the driver changes -> switched, or it left, or the gate was closed)", "1", _driver_changes),
        "hardware.md",
        "Another takes its place on request, or when the first one leaves",
        1.0,
    ),
    Policy(
        "handover_step",
        each(f"always(the driver changes -> |change of the command| <= {HANDOVER:g} * the largest usual one)", "m", _handovers),
        SWITCHING,
        "without a bump",
        1e-6,
    ),
    Policy(
        "standing_by_is_silent",
        each("always(a controller commands that stands by -> it could not know yet)", "cycles", _standing_by),
        SWITCHING,
        "It sends neither `valve_command` nor `controller_status`",
        1.0,
    ),
    Policy(
        "switch_leaves_gate_open",
        each("always(switched while driving -> driving)", "1", _switches),
        SWITCHING,
        "without closing the gate",
        1.0,
    ),
    Policy(
        "cycles_in_order",
        each("always(a snapshot -> its cycle follows the one before)", "cycles", _in_order),
        DESIGN,
        "The plant opens cycle k with one snapshot",
        1.0,
    ),
    Policy(
        "one_computer",
        always(
            Condition("another computer is served", _new_session) & IN_REALTIME,
            constant(f"{SILENCE:g} s", "s", lambda trace: SILENCE)
            <= Quantity("time since a command was accepted", "s", _silence),
        ),
        "hardware.md",
        "Refuse hellos of others until its commands have been absent for 0.1 s",
        1e-2,
    ),
    Policy(
        "counts_once",
        each(
            "always(a load cycle is logged -> it begins after the one before, whose number it follows)", "cycles", _counts_once
        ),
        PROGRAMME,
        "a line for each load cycle",
        1.0,
    ),
    Policy(
        "programme_continuous",
        each("always(a reference follows another -> |step| <= period^2 * acceleration)", "N", _continuous),
        PROGRAMME,
        "So force and rate have no step anywhere",
        1e-2,
    ),
    Policy(
        "programme_same_again",
        each("always(a reference is sent again in lockstep -> it is the same)", "N", _same_again),
        PROGRAMME,
        "what it publishes depends on the control cycle alone",
        1.0,
    ),
    Policy(
        "stopped_programme_stands",
        each("always(stopped -> load cycles unchanged)", "load cycles", _stands),
        PROGRAMME,
        "slows the programme's own time down to rest",
        1.0,
    ),
    Policy(
        "nobody_ends_unasked",
        each("always(a process ends -> it was asked to)", "1", _go_on),
        "hardware.md",
        "an exception that nobody foresaw ends the process",
        1.0,
    ),
    Policy(
        "partners_stay",
        each("always(a node's state is asked for -> it is the one last requested)", "1", _stay),
        COMPOSED,
        "Names, topics, parameters, services, lifecycle and diagnostics are those of the nodes apart",
        1.0,
    ),
)
"""All policies of the graph; `docs/policies.md` lists them."""
