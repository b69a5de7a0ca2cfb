"""Policies of the safety gate, the target's watchdog and the bridge between them, over the rig's log."""

from collections.abc import Callable, Iterable

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.hardware.detectors import SPEED_TIME, SPREAD
from ehls_ros.hardware.gate_bounds import bounds_of
from ehls_ros.hardware.gate_parameters import Change
from ehls_ros.hardware.packet import Status
from ehls_ros.hardware.safety_gate import (
    ACTIVE,
    CUT,
    DISABLED,
    DRIVING,
    HOLDING,
    MAX_PERIODS,
    MAX_SILENCE,
    RAMPING,
    STOP_TIME,
    STOPPED,
    TAKEN_OVER,
)
from policies.policy import Policy
from policies.temporal import NOTHING, Condition, During, Flags, Margins, Quantity, always, constant, each
from policies.trace import ROUNDING, Call, Spans, Trace, name_of_stop

RIG = "hardware.md"
SWITCHING = "how_to/switching.md"

LASTING = 0.05
"""Minimum time at null that is no mere zero crossing, at least 20 cycles [s]."""

SMOOTHED = 3.0 * SPEED_TIME
"""Time after which a speed computed from positions is known to 5 % [s]."""

NEARLY = 1.05
"""Relative excess of the speed over a limit that is certainly detected within that time [1]."""

TOLD = 3
"""Measurements after which the bridge has certainly read their content, unless it sleeps; then it reads the newest first."""

WITHIN = 0.5
"""Longest time until a change of the gate's state is reported, half of that between two reports in any case [s]."""

STARTED = 3
"""Reports after which a node counts as started."""

UNTIL_TOLD = 1.0
"""Longest time between two reports of a node [s]."""


def lasting(trace: Trace) -> int:
    """Return the number of rows at null that are no mere zero crossing."""
    return max(20, round(LASTING / trace.setup.period))


# Terms of conditions and bounds

OPEN = Condition("open", lambda trace: trace.open)
ALWAYS = Condition("true", lambda trace: np.ones(trace.command.size, dtype=bool))
ARRIVED = Condition("a command was accepted", lambda trace: trace.arrived)
IN_REALTIME = Condition("in realtime", lambda trace: np.full(trace.command.size, not trace.setup.lockstep))
GENTLE = Condition("commands are gentle", lambda trace: np.full(trace.command.size, trace.setup.gentle))

COMMAND = Quantity("|command|", "m", lambda trace: np.abs(trace.command))
PERIOD = constant("period", "s", lambda trace: trace.setup.period)
TWO_PERIODS = constant("2 periods", "s", lambda trace: 2.0 * trace.setup.period)


def parameter(name: str) -> Quantity:
    """Return a time among the gate's parameters [s]."""
    return Quantity(name, "s", lambda trace: trace.parameter(name))


def limit(name: str, unit: str, of: Callable[[Trace], float]) -> Quantity:
    """Return one of the rig's limits."""
    return constant(f"limits.{name}", unit, of)


def reaction_time(name: str) -> Quantity:
    """Return the longest time until a fault's reaction closes the valve [s]: none, the ramp, hold or unloading before it.

    Position control does not close it.
    """

    def of(trace: Trace) -> Array:
        holds, unloads = trace.was(name, "hold"), trace.was(name, "unload")
        ramps = trace.was(name, "ramp") | holds | unloads
        closing = holds * trace.parameter("hold_time") + unloads * trace.parameter("unload_time")
        return np.where(trace.was(name, "position"), np.inf, closing + ramps * trace.parameter("ramp_time"))

    return Quantity(f"{name}'s reaction", "s", of)


def column(name: str) -> Callable[[Trace], Array]:
    """Return a function that selects a column of the log."""
    return lambda trace: trace.log[name]


# Commands


def _opened_by(trace: Trace) -> Array:
    """Return how far the command moved away from null since the previous row [m]; across null, its full change."""
    before = np.concatenate([trace.command[:1], trace.command[:-1]])
    turned = trace.command * before < 0.0
    return np.where(turned, np.abs(trace.command - before), np.abs(trace.command) - np.abs(before))


def _reach(trace: Trace) -> Array:
    """Return how far the gate may open in the commands sent since the last one accepted [m]."""
    sent = np.diff(trace.sequence, prepend=trace.sequence[:1])
    # A new session counts from the beginning.
    sent = np.where(sent < 0.0, trace.sequence, sent)
    return MAX_PERIODS * trace.setup.period * trace.parameter("command_rate") * sent + trace.setup.resolution


def _accepted_age(trace: Trace) -> Array:
    return trace.since(trace.time[trace.arrived])


def _after_watchdog(trace: Trace) -> Flags:
    """Return the rows in which a command acts again after the watchdog had closed the valve."""
    status = trace.log["output_status"]
    return (status == Status.COMMANDED) & (np.concatenate([status[:1], status[:-1]]) == Status.WATCHDOG)


def _first_open(trace: Trace) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return the rows in which the valve opens after a lasting null."""
    moving = np.flatnonzero(trace.open)
    found: np.ndarray[tuple[int, ...], np.dtype[np.int64]] = moving[
        np.diff(moving, prepend=-lasting(trace) - 1) > lasting(trace)
    ]
    return found


def _opening_number(trace: Trace) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return for each row the number of the last opening before it, if it is still blended in; -1 otherwise."""
    first = _first_open(trace)
    number = np.searchsorted(first, np.arange(trace.command.size), side="right") - 1
    since = trace.since(trace.time[first])
    return np.where(since <= trace.parameter("enable_time", least=True) + trace.setup.period, number, -1)


def _ramp_of_opening(trace: Trace) -> Array:
    """Return the largest command while the gate blends it in [m].

    It is the fraction of the largest command meanwhile that corresponds to the time since the first opening. Allowed for are
    one step's catch-up of the gate and losses on the wire.
    """
    first, number = _first_open(trace), _opening_number(trace)
    wanted = np.array([_largest_commanded(trace, row) for row in first] or [0.0])
    late = MAX_PERIODS * trace.setup.period + trace.parameter("command_timeout")
    blended = (trace.since(trace.time[first]) + late) / trace.parameter("enable_time", least=True)
    return np.minimum(1.0, blended) * wanted[number] + trace.setup.resolution


def _largest_commanded(trace: Trace, row: int) -> float:
    """Return the largest command of any controller around an opening [m]; the rig's limit if none was received."""
    spool = trace.setup.rig.limits.spool
    begin, until = trace.moments[row] - 1.0, trace.moments[min(row + round(10.0 / trace.setup.period), len(trace.moments) - 1)]
    heard = [abs(m[3]) for m in trace.heard("valve_command") if begin <= m[0] <= until and np.isfinite(m[3])]
    clamps = bool(np.any(trace.was("on_command_range", "warn")))
    sound = [min(value, spool) for value in heard if clamps or value <= spool]
    return max(sound, default=spool)


# Causes that close the valve


def _answers(calls: Iterable[Call]) -> list[float]:
    return [call.answered for call in calls]


def _transitions(trace: Trace) -> list[float]:
    node = f"{trace.setup.plant}/change_state"
    return [c.answered for label in ("deactivate", "cleanup", "shutdown") for c in trace.called(node, transition=label)]


def _ends(trace: Trace, what: str) -> list[float]:
    return [happening.time for happening in trace.happenings_of(what, trace.setup.hosts)]


def _gaps(trace: Trace) -> list[float]:
    """Return the times at which the loop woke up after sleeping for longer than the gate allows."""
    if trace.setup.lockstep:
        return []
    slept = [(woken, woken - since) for since, woken in trace.frozen(trace.setup.hosts)]
    times = ("command_timeout", "sensor_timeout")
    most = [min(float(trace.parameter(name)[trace.moments <= woken][-1]) for name in times) for woken, _ in slept]
    return [woken for (woken, asleep), longest in zip(slept, most, strict=True) if asleep > longest + trace.setup.period]


def _reported(trace: Trace, *states: str) -> list[float]:
    """Return the times at which the plant's diagnostics reported its gate in one of some states."""
    return [r.time for r in trace.reports if r.node == trace.setup.plant and r.values.get("state") in states]


def _untold(trace: Trace) -> list[float]:
    """Return the times at which the plant announced that commands do not reach the valve."""
    return [message[0] for message in trace.driving if not message[1]]


def _closed_by_gate(trace: Trace) -> list[float]:
    """Return the times at which the plant announced that commands do not reach the valve, and did not drive it itself."""
    taken = np.array(_reported(trace, *TAKEN_OVER))
    return [when for when in _untold(trace) if not np.any((taken >= when - WITHIN) & (taken <= when + WITHIN))]


def _taken_over(trace: Trace) -> Flags:
    """Return the rows in which the gate may drive the valve itself, according to its reports."""
    reports = sorted((r.time, r.values["state"]) for r in trace.reports if r.node == trace.setup.plant and "state" in r.values)
    times = [when for when, _ in reports]
    taken = np.array([False, *(state in TAKEN_OVER for _, state in reports)])
    # A report of the beginning may come later.
    before, after = (taken[np.searchsorted(times, trace.moments + ahead)] for ahead in (0.0, WITHIN))
    rows: Flags = before | after
    return rows


AS_COMMANDED = Condition("the gate does not take over", lambda trace: ~_taken_over(trace))


def _shut(trace: Trace) -> list[float]:
    """Return the times at which the target had closed the valve for some cycles while its measurements reported it."""
    if not trace.command.size:
        return []
    shut = (trace.log["output_status"] == Status.WATCHDOG) & ~_spoilt(trace)
    edges = np.flatnonzero(np.diff(shut, prepend=False, append=False))
    return [float(trace.moments[first]) for first, last in zip(edges[::2], edges[1::2], strict=True) if last - first >= TOLD]


def _closing(text: str, begins: Callable[[Trace], list[float]]) -> During:
    """Return the spans from an event until the gate may be open again."""
    return During(f"{text}, until enable", lambda trace: trace.until_opened(begins(trace)))


STOP = _closing("emergency_stop answered", lambda trace: _answers(trace.called("emergency_stop")))
DISABLE = _closing("enable false answered", lambda trace: _answers(trace.called("enable", data=False)))
LEFT = _closing("deactivate, cleanup or shutdown answered", _transitions)
ENDED = _closing("process ended on a signal or an exception", lambda trace: _ends(trace, "ended"))
KILLED = _closing("process killed", lambda trace: _ends(trace, "killed"))
SLEPT = _closing("loop asleep for longer than a timeout", _gaps)
HUNG = _closing("services hang", lambda trace: _ends(trace, "deaf"))
REPORTED_CUT = _closing("diagnostics say cut or stopped", lambda trace: _reported(trace, CUT, STOPPED))
REPORTED_RAMP = _closing("diagnostics say ramping or disabled", lambda trace: _reported(trace, RAMPING, DISABLED))
NOT_DRIVING = During(
    "driving is false and the gate does not take over, until enable or driving is true",
    lambda trace: _cut_short(trace.until_opened(_closed_by_gate(trace)), [m[0] for m in trace.driving if m[1]]),
)
SHUT = _closing("the target has closed the valve itself", _shut)


def _cut_short(spans: Spans, ends: Iterable[float]) -> Spans:
    """End spans at the first of some instants after their beginning."""
    known = np.append(np.sort(np.array(list(ends), dtype=float)), np.inf)
    return Spans(spans.begins, np.minimum(spans.ends, known[np.searchsorted(known[:-1], spans.begins, side="right")]))


UNHEARD = constant(f"{MAX_SILENCE:g} s + a second", "s", lambda trace: MAX_SILENCE + 1.0)


# Inputs


def _faults(trace: Trace) -> list[tuple[str, float, float]]:
    """Return each injected fault with the start and end of its effect, by this computer's clock [s]."""
    lines = trace.happenings_of("fault")
    found = []
    for number, fault in enumerate(lines):
        ends = (h.time for h in lines[number + 1 :] if h.whom == "clear")
        found.append((fault.whom, fault.time, next(ends, np.inf)))
    return found


def _lasted(trace: Trace, since: float, until: float) -> float:
    """Return the duration of a fault by the rig's time [s]."""
    first, last = trace.at(np.array([since, until]))
    return float(last - first)


def _largest_setting(trace: Trace, name: str, moment: float) -> float:
    rows = trace.moments <= moment
    return float(trace.parameter(name)[rows][-1]) if np.any(rows) else float(getattr(trace.setup.gate, name))


def _may_warn(trace: Trace, name: str, moment: float) -> bool:
    rows = (trace.moments >= moment - trace.setup.period) & (trace.moments <= moment + 1.0)
    return bool(np.any(trace.was(name, "warn")[rows]))


def _blind(trace: Trace) -> list[float]:
    """Return the starts of periods without measurements that lasted longer than the gate allows."""
    words = ("silent", "nan ")
    return [
        since
        for line, since, until in _faults(trace)
        if line.startswith(words)
        and _lasted(trace, since, until) > _largest_setting(trace, "sensor_timeout", since) + 2.0 * trace.setup.period
    ]


def _lies(trace: Trace) -> list[float]:
    """Return the starts of contradictions between sensors that lasted longer than the gate allows."""
    found = []
    for line, since, until in _faults(trace):
        match line.split():
            case ["bias", "force", value]:
                force = abs(float(value))
            case ["bias", "load_pressure", value]:
                force = abs(float(value)) * trace.setup.rig.plant.piston_area
            case _:
                continue
        permitted = _largest_setting(trace, "mismatch_time", since) + 3.0 * trace.setup.period
        seen = force > 2.0 * _largest_setting(trace, "force_mismatch", since) and _lasted(trace, since, until) > permitted
        if seen and not _may_warn(trace, "on_sensor_mismatch", since):
            found.append(since)
    return found


def _stuck(trace: Trace) -> list[float]:
    """Return the times at which a sensor had been stuck long enough, over a large enough command span, to be faulty."""
    found = []
    for line, since, until in _faults(trace):
        if not line.startswith("stick") or _may_warn(trace, "on_sensor_frozen", since):
            continue
        rows = np.flatnonzero((trace.moments >= since) & (trace.moments < until))[3:]
        if not rows.size or np.any(trace.log["output_status"][rows] != Status.COMMANDED):
            continue
        command = trace.command[rows]
        wide = np.maximum.accumulate(command) - np.minimum.accumulate(command) >= trace.parameter("frozen_command")[rows]
        long = trace.time[rows] - trace.time[rows[0]] >= trace.parameter("frozen_time")[rows] - ROUNDING
        if np.any(wide & long):
            found.append(float(trace.moments[rows[np.argmax(wide & long)]]))
    return found


BLIND = _closing("no measurement", _blind)
LYING = _closing("a sensor contradicts the others", _lies)
STUCK = _closing("a sensor stuck while the command moved", _stuck)


# Limits


def _spoilt(trace: Trace, *signals: str) -> Flags:
    """Return the rows in which the gate could not see the true value of a signal."""
    found = np.zeros(trace.command.size, dtype=bool)
    for line, since, until in _faults(trace):
        words = line.split()
        if words[0] in {"silent", "nan"} or (len(words) > 1 and words[1] in signals):
            found |= (trace.moments >= since) & (trace.moments < until + LASTING)
    return found


def _beyond(name: str, exceeds: Callable[[Trace], Flags], *signals: str) -> During:
    """Return the spans that begin once a limit has been exceeded for ``limit_time`` by correctly measured signals."""

    def begins(trace: Trace) -> list[float]:
        if not trace.command.size:
            return []
        over = exceeds(trace) & ~_spoilt(trace, *signals)
        edges = np.flatnonzero(np.diff(over, prepend=False, append=False))
        found = []
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            least = trace.parameter("limit_time")[first] + trace.setup.period - ROUNDING
            seen = trace.time[first:last] - trace.time[first] >= least
            if np.any(seen):
                found.append(float(trace.moments[first + int(np.argmax(seen))]))
        return found

    return _closing(f"{name} beyond its limit for limit_time", begins)


def _exceeds(signal: str, name: str, limit_of: Callable[[Trace], float]) -> Callable[[Trace], Flags]:
    def exceeds(trace: Trace) -> Flags:
        sensor = trace.setup.rig.sensors.get(name)
        scatter = 0.0 if sensor is None else SPREAD * sensor.noise_std + sensor.resolution
        return np.abs(trace.log[signal]) > trace.parameter("trip_level") * limit_of(trace) + scatter

    return exceeds


def _moves_out(trace: Trace) -> Flags:
    """Return the rows in which the piston is beyond the gate's margin and the command drives it further out."""
    low, high = trace.setup.rig.limits.position
    position, margin = trace.log["position_m"], trace.parameter("position_margin", least=True)
    scatter = 1e-4
    out = (position > high - margin + scatter) & (trace.command > 0.0)
    return out | ((position < low + margin - scatter) & (trace.command < 0.0))


def _from_middle(trace: Trace) -> Array:
    low, high = trace.setup.rig.limits.position
    return np.abs(trace.log["position_m"] - 0.5 * (low + high))


def _too_fast(trace: Trace) -> Flags:
    speed = np.abs(trace.log["velocity_m_s"])
    return speed > NEARLY * trace.parameter("trip_level") * trace.setup.rig.limits.velocity


FORCE = _beyond("force", _exceeds("force_n", "force", lambda trace: trace.setup.rig.limits.force), "force")
PRESSURE = _beyond(
    "load pressure",
    _exceeds("load_pressure_pa", "load_pressure", lambda trace: trace.setup.rig.limits.load_pressure),
    "load_pressure",
)
SPEED = _beyond("speed", _too_fast, "position", "velocity")
POSITION = _beyond("position, moving out,", _moves_out, "position")

SEEN = Quantity("sensor_timeout + 2 periods", "s", lambda trace: trace.parameter("sensor_timeout") + 2.0 * trace.setup.period)
"""Time after which the gate has received a sample, or has tripped for lack of one [s]."""

SEEN_SMOOTHED = SEEN + constant(f"{SMOOTHED:g} s", "s", lambda trace: SMOOTHED)


# The driver


def _candidates(trace: Trace) -> tuple[Array, Array]:
    """Return the commands that may reach the valve, and their sending times.

    They are those of the driver at that time, and the first answer to each cycle. A command sent before the plant had opened
    its cycle may be refused, as it lies in the future, or be read only after that.
    """
    drivers = trace.heard("driver")
    grace = float(np.max(trace.parameter("command_timeout"), initial=0.0)) + LASTING
    turns: dict[str, list[tuple[float, float]]] = {}
    for number, message in enumerate(drivers):
        until = drivers[number + 1][0] + grace if number + 1 < len(drivers) else np.inf
        turns.setdefault(message[4], []).append((message[0] - grace, until))
    states = trace.of_plant()
    opened = {(trace.run_of(state[0]), state[2]): state[0] for state in reversed(states)}
    answered: set[tuple[str, int, int]] = set()
    times, values = [], []
    for sent, _, cycle, spool, sender in trace.heard("valve_command"):
        run = trace.run_of(sent)
        if (sender, run, cycle) in answered or not np.isfinite(spool):
            continue
        if sent >= opened.get((run, cycle), -np.inf):
            answered.add((sender, run, cycle))
        if any(since <= sent <= until for since, until in turns.get(sender, [])):
            times.append(sent)
            values.append(spool)
    return np.array(times), np.array(values)


def _active(states: Iterable[str]) -> list[bool]:
    """Return for each state of the gate whether it blends nothing in; while it holds, it does so if it did before."""
    found: list[bool] = []
    for state in states:
        found.append(state == ACTIVE or (state == HOLDING and bool(found) and found[-1]))
    return found


def _follows(trace: Trace) -> Flags:
    """Return the rows in which the output equals a received command: neither blended in, nor on a ramp, nor limited."""
    reports = sorted((r.time, r.values["state"]) for r in trace.reports if r.node == trace.setup.plant and "state" in r.values)
    driven = np.array([False, *_active(state for _, state in reports)])
    rows = trace.open & driven[np.searchsorted([when for when, _ in reports], trace.moments)]
    ramp = trace.parameter("ramp_time") + 2.0 * trace.setup.period + trace.setup.watchdog
    null = trace.moments[~trace.open]
    following = np.append(null, np.inf)[np.searchsorted(null, trace.moments)]
    rows &= following - trace.moments > ramp
    # A valve that is enabled again before it reaches null was on a ramp all the same; its reports may come later.
    told = sorted((when - (0.0 if drives else 2.0 * trace.setup.period), drives) for when, drives in trace.driving)
    rows &= np.array([True, *(drives for _, drives in told)])[
        np.searchsorted([when for when, _ in told], trace.moments, side="right")
    ]
    rows &= trace.commands_heard
    return rows & ~trace.was("on_command_rate", "warn") & (trace.log["output_status"] == Status.COMMANDED)


CHUNK = 4096
"""Rows compared with commands at a time."""


def _obeyed(trace: Trace) -> Margins:
    """Return the resolution less the distance of the output from the driver's nearest command that is not too old [m]."""
    if trace.setup.lockstep or not trace.command.size or not trace.messages.get("driver"):
        return NOTHING
    sent, spool = _candidates(trace)
    spool = np.clip(spool, -trace.setup.rig.limits.spool, trace.setup.rig.limits.spool)
    rows = np.flatnonzero(_follows(trace))
    if not sent.size or not rows.size:
        return NOTHING
    kept = ("command_timeout", "hold_time")
    oldest = sum(float(np.max(trace.parameter(name))) for name in kept) + trace.setup.watchdog + trace.lateness
    oldest = oldest + trace.transport_delay
    since = trace.moments[rows] - oldest[rows]
    depth = int(np.max(np.searchsorted(sent, trace.moments[rows]) - np.searchsorted(sent, since)))
    margins = []
    for begin in range(0, rows.size, CHUNK):
        some = rows[begin : begin + CHUNK]
        newest = np.searchsorted(sent, trace.moments[some], side="right") - 1
        number = newest[:, None] - np.arange(max(depth, 1))[None, :]
        old = trace.moments[some, None] - sent[np.maximum(number, 0)] > oldest[some, None]
        apart = np.abs(trace.command[some, None] - spool[np.maximum(number, 0)])
        margins.append(trace.setup.resolution - np.min(np.where((number < 0) | old, np.inf, apart), axis=1))
    return Margins(trace.moments[rows], np.concatenate(margins))


def _command_age(trace: Trace) -> Array:
    """Return the time since any controller last sent a command [s]."""
    return trace.since(np.array([message[0] for message in trace.heard("valve_command")]))


COMMANDS_HEARD = Condition("commands are heard", lambda trace: trace.commands_heard)
STALE = (
    Quantity("command_timeout", "s", lambda trace: trace.parameter("command_timeout"))
    + reaction_time("on_command_stale")
    + constant("watchdog + 3 periods", "s", lambda trace: trace.setup.watchdog + 3.0 * trace.setup.period)
)


# Requests


def _stops_lasted(trace: Trace) -> Margins:
    """Return for each acknowledgement the excess of the stop's age over its minimum [s]."""
    stops = {name_of_stop(call): call for call in trace.called("emergency_stop")}
    found = []
    for call in trace.called("acknowledge_stop"):
        stop = stops.get(str(call.fields.get("stop")))
        if stop is not None and stop.answered <= call.sent:
            found.append((call.answered, call.answered - stop.sent - STOP_TIME))
    return as_margins(found)


def _named(trace: Trace) -> Margins:
    """Return 1 for each acknowledgement that succeeded and named an engaged stop, and -1 for one that named another."""
    names = {name_of_stop(call) for call in trace.calls if call.service == "emergency_stop"}
    acknowledged = trace.called("acknowledge_stop")
    return as_margins((call.answered, 1.0 if call.fields.get("stop") in names else -1.0) for call in acknowledged)


def _enabled_after_stop(trace: Trace) -> Margins:
    """Return for each stop the lead of its acknowledgement and of a reset request over the next enabling [s]."""
    found = []
    started = [h.time for h in trace.happenings_of("started", trace.setup.hosts)]
    for stop in trace.called("emergency_stop"):
        enabled = next((call for call in trace.called("enable", data=True) if call.sent > stop.answered), None)
        if enabled is None or any(stop.sent < began < enabled.answered for began in started):
            continue
        steps = [
            [
                call.sent
                for call in trace.calls
                if call.service == service and call.success is not False and stop.sent < call.sent < enabled.answered
            ]
            for service in ("acknowledge_stop", "reset_trips")
        ]
        since = min(max(times, default=-np.inf) for times in steps)
        margin = enabled.answered - since if np.isfinite(since) else stop.answered - enabled.answered
        found.append((enabled.answered, margin))
    return as_margins(found)


def _bounded(trace: Trace) -> Margins:
    """Return for each accepted parameter with a bound its margin within it, as a fraction of the range [1]."""
    bounds = bounds_of(trace.setup.rig, trace.setup.period)
    found = []
    for call in trace.changes:
        bound = bounds.get(str(call.fields["name"]))
        if bound is None or not call.success:
            continue
        value = float(call.fields["value"])
        width = bound.high - bound.low if np.isfinite(bound.high) else max(abs(bound.low), 1e-3)
        found.append((call.answered, min(value - bound.low, bound.high - value) / width))
    return as_margins(found)


def _weaker(trace: Trace) -> Margins:
    """Return for each change that weakens the gate how long it had been closed, or -1 if it was open all the time."""
    told = trace.driving
    found = []
    values = trace.setup.gate._asdict()
    started = [happening.time for happening in trace.happenings_of("started", trace.setup.hosts)]
    for call in trace.changes:
        if started and started[0] < call.sent:
            started, values = [when for when in started if when >= call.sent], trace.setup.gate._asdict()
        name, value = str(call.fields["name"]), call.fields["value"]
        if name not in values:
            continue
        change = Change(name, values[name], float(value) if isinstance(value, int) and not isinstance(value, bool) else value)
        values[name] = change.after
        if not told or change.before == change.after or not change.weakens:
            continue
        before = [message for message in told if message[0] <= call.sent]
        driving = bool(before) and bool(before[-1][1])
        closes = any(not m[1] for m in told if call.sent < m[0] <= call.answered + UNTIL_TOLD)
        found.append((call.answered, -1.0 if driving and not closes else 1.0))
    return as_margins(found)


def _outside_active(trace: Trace) -> Margins:
    """Return 1 for each enabling of an active node, and -1 for one that was answered while not active."""
    changes = [
        (call.answered, call.fields.get("transition"))
        for call in trace.calls
        if call.service == f"{trace.setup.plant}/change_state" and call.success
    ]
    started = [(h.time, "activate") for h in trace.happenings_of("started", trace.setup.hosts)]
    known = sorted([*changes, *started], key=lambda change: change[0])
    found = []
    for call in trace.called("enable", data=True):
        labels = [label for when, label in known if when <= call.sent]
        active = not labels or labels[-1] == "activate"
        found.append((call.answered, 1.0 if active else -1.0))
    return as_margins(found)


def _changes_told(trace: Trace) -> Margins:
    """Return for each change between driving and not driving the margin of its report before the deadline [s]."""
    told = trace.driving
    reports = [r for r in trace.reports if r.node == trace.setup.plant and "state" in r.values]
    found = []
    times = np.array([report.time for report in reports])
    starts = [-np.inf, *(happening.time for happening in trace.happenings_of("started", trace.setup.hosts))]
    for number, (when, driving) in enumerate(told):
        # A node that has just started is busy otherwise, and its reports may not be heard yet.
        since = times[times > max(start for start in starts if start <= when)]
        just_started = since.size <= STARTED or when < since[STARTED]
        if number == 0 or just_started or bool(driving) == bool(told[number - 1][1]):
            continue
        following = told[number + 1][0] if number + 1 < len(told) else np.inf
        asleep = any(since < following and woken > when for since, woken in trace.frozen(trace.setup.hosts))
        ends = any(when < h.time < when + WITHIN for h in trace.happenings if h.whom in trace.setup.hosts)
        last = max((report.time for report in reports), default=-np.inf)
        if following - when < WITHIN or asleep or ends or when + WITHIN > last:
            continue
        # The service thread may have seen the change before the loop published it.
        said = [r.time for r in reports if r.time >= when - LASTING and (r.values["state"] in DRIVING) == bool(driving)]
        # A delayed machine, on which even the reports each second are late, cannot report at once.
        near = times[(times > when - 2.0 * UNTIL_TOLD) & (times < when + 2.0 * UNTIL_TOLD)]
        late = max(float(np.max(np.diff(near), initial=0.0)) - UNTIL_TOLD, 0.0) + trace.lateness
        found.append((when, WITHIN + 3.0 * late - max(min(said, default=np.inf) - when, 0.0)))
    return as_margins(found)


def _claims(trace: Trace) -> Margins:
    """Return for each report of a driven valve the remaining permitted time at null, against commands, unreported [s]."""
    if not trace.command.size or trace.setup.lockstep:
        return NOTHING
    commands = trace.heard("valve_command")
    sent, spool = np.array([m[0] for m in commands]), np.array([abs(m[3]) for m in commands])
    moving = sent[spool > trace.setup.resolution] if sent.size else sent
    opened = trace.moments[trace.open]
    found = []
    for report in trace.reports:
        if report.node != trace.setup.plant or report.values.get("state") != "active" or report.level:
            continue
        since = opened[opened <= report.time]
        begin = since[-1] if since.size else trace.moments[0]
        meant = moving[(moving > begin) & (moving <= report.time)]
        if report.time > trace.moments[-1]:
            continue
        found.append((report.time, UNTIL_TOLD - (report.time - meant[0] if meant.size else 0.0)))
    return as_margins(found)


def as_margins(found: Iterable[tuple[float, float]]) -> Margins:
    """Return times and margins as arrays."""
    table = np.array(list(found), dtype=float).reshape(-1, 2)
    return Margins(table[:, 0], table[:, 1])


def _answered_age(trace: Trace) -> Array:
    """Return the age of the measurement that the last accepted command answers [s]."""
    return trace.log["time_s"] - trace.log["output_answered"] * trace.setup.period


FRESHLY_ARRIVED = Condition(
    "a command was accepted and acts",
    lambda trace: trace.arrived & (trace.log["output_status"] == Status.COMMANDED) & (trace.log["output_answered"] >= 0.0),
)
ANSWERED_AGE = Quantity("age of the measurement it answers", "s", _answered_age)
WATCHDOG = constant("watchdog", "s", lambda trace: trace.setup.watchdog)

POLICIES = (
    # The command
    Policy(
        "spool_limit",
        always(ALWAYS, limit("spool", "m", lambda trace: trace.setup.rig.limits.spool) >= COMMAND),
        RIG,
        "a finite number within `limits: spool`",
        1e-3,
    ),
    Policy(
        "command_rate",
        always(
            ARRIVED,
            Quantity("opening since the last cycle", "m", _opened_by)
            <= Quantity(f"command_rate * {MAX_PERIODS} periods * commands sent", "m", _reach),
        ),
        RIG,
        "no further than in three periods",
        1e-3,
    ),
    Policy(
        "opens_gradually",
        always(
            Condition("blended in", lambda trace: _opening_number(trace) >= 0) & AS_COMMANDED,
            Quantity("commanded * time since opening / enable_time", "m", _ramp_of_opening) >= COMMAND,
        ),
        RIG,
        "blends in the command over `enable_time`",
        1e-4,
    ),
    Policy(
        "obeys_who_drives",
        each("always(open and not blended -> |output - a fresh first answer of who drives| <= resolution)", "m", _obeyed),
        RIG,
        "commands of others are ignored and reported",
        1e-6,
    ),
    Policy(
        "fresh_command",
        always(
            OPEN & IN_REALTIME & COMMANDS_HEARD & AS_COMMANDED,
            Quantity("time since a command was sent", "s", _command_age) <= STALE,
        ),
        RIG,
        "a stale snapshot and a stale command cannot be set to `warn`",
        1e-2,
    ),
    # The target
    Policy(
        "watchdog",
        always(OPEN & IN_REALTIME, Quantity("time since a command was accepted", "s", _accepted_age) <= WATCHDOG),
        RIG,
        "Close the valve when no command has been accepted for the watchdog time",
        1e-3,
    ),
    Policy(
        "null_after_watchdog",
        always(
            Condition("the first command after the watchdog acts", _after_watchdog),
            constant("0", "m", lambda trace: 0.0) >= COMMAND,
        ),
        RIG,
        "keep the valve closed until a command of exactly null arrives",
        1e-4,
    ),
    Policy(
        "late_command",
        always(FRESHLY_ARRIVED & IN_REALTIME, ANSWERED_AGE <= WATCHDOG + PERIOD),
        RIG,
        "is not older than the watchdog time",
        1e-2,
    ),
    Policy(
        "transport_delay",
        always(
            FRESHLY_ARRIVED & IN_REALTIME & OPEN,
            Quantity("sensor_timeout", "s", lambda trace: trace.parameter("sensor_timeout"))
            + Quantity(
                "delay of a command", "s", lambda trace: np.maximum(trace.parameter("sensor_timeout"), trace.transport_delay)
            )
            + constant("3 periods", "s", lambda trace: 3.0 * trace.setup.period)
            >= ANSWERED_AGE,
        ),
        RIG,
        "the age of a snapshot includes its transport delay",
        1e-2,
    ),
    # Causes that close the valve, and keep it closed
    Policy("emergency_stop", always(STOP.holds, STOP.null_within()), RIG, "`emergency_stop`, from anywhere in the graph", 1e-3),
    Policy(
        "disable",
        always(DISABLE.holds, DISABLE.null_within(parameter("ramp_time") + TWO_PERIODS)),
        RIG,
        "`ramp` to null in `ramp_time`",
        1e-3,
    ),
    Policy("outside_active", always(LEFT.holds, LEFT.null_within()), RIG, "the valve is driven in `active` only", 1e-3),
    Policy(
        "end_of_process",
        always(ENDED.holds, ENDED.null_within()),
        RIG,
        "an exception, SIGINT and SIGTERM close it at once",
        1e-3,
    ),
    Policy("killed", always(KILLED.holds, KILLED.null_within()), RIG, "after SIGKILL the target's watchdog does", 1e-3),
    Policy(
        "gap",
        always(SLEPT.holds, SLEPT.null_within()),
        RIG,
        "the loop slept longer than `command_timeout` or `sensor_timeout`",
        1e-3,
    ),
    Policy(
        "services_silent",
        always(HUNG.holds, HUNG.null_within(UNHEARD)),
        RIG,
        "the service thread has been silent for 1 s",
        1e-1,
    ),
    Policy(
        "device_null",
        always(SHUT.holds, SHUT.null_within()),
        RIG,
        "the device reports that it closed the valve itself",
        1e-3,
    ),
    Policy(
        "latched",
        always(REPORTED_CUT.holds, REPORTED_CUT.null_within()),
        RIG,
        "Ramp and cut are latched",
        1e-3,
    ),
    Policy(
        "ramped",
        always(REPORTED_RAMP.holds, REPORTED_RAMP.null_within(parameter("ramp_time") + TWO_PERIODS)),
        RIG,
        "Disabled, ramping, cut and stopped lead to null",
        1e-3,
    ),
    Policy(
        "driving_is_true",
        always(NOT_DRIVING.holds, NOT_DRIVING.null_within(parameter("ramp_time") + TWO_PERIODS)),
        "design.md",
        "tells controllers whether the valve follows them",
        1e-3,
    ),
    # Inputs and limits
    Policy(
        "no_measurement",
        always(
            BLIND.holds,
            BLIND.null_within(parameter("sensor_timeout") + reaction_time("on_sensor_stale") + TWO_PERIODS + PERIOD),
        ),
        RIG,
        "a stale snapshot and a stale command cannot be set to `warn`",
        1e-2,
    ),
    Policy(
        "sensor_contradiction",
        always(
            LYING.holds,
            LYING.null_within(parameter("mismatch_time") + reaction_time("on_sensor_mismatch") + SEEN),
        ),
        RIG,
        "readings that contradict each other for `mismatch_time`",
        1e-2,
    ),
    Policy(
        "sensor_stuck",
        always(STUCK.holds, STUCK.null_within(reaction_time("on_sensor_frozen") + SEEN)),
        RIG,
        "a reading unchanged for `frozen_time` while the command spans `frozen_command`",
        1e-2,
    ),
    Policy(
        "force_trips",
        always(FORCE.holds, FORCE.null_within(reaction_time("on_force") + SEEN)),
        RIG,
        "force, load pressure, velocity, position",
        1e-2,
    ),
    Policy(
        "pressure_trips",
        always(PRESSURE.holds, PRESSURE.null_within(reaction_time("on_load_pressure") + SEEN)),
        RIG,
        "force, load pressure, velocity, position",
        1e-2,
    ),
    Policy(
        "speed_trips",
        always(SPEED.holds, SPEED.null_within(reaction_time("on_velocity") + SEEN_SMOOTHED)),
        RIG,
        "force, load pressure, velocity, position",
        1e-2,
    ),
    Policy(
        "position_trips",
        always(POSITION.holds, POSITION.null_within(reaction_time("on_position") + SEEN)),
        RIG,
        "force, load pressure, velocity, position",
        1e-2,
    ),
    Policy(
        "force_limit",
        always(
            GENTLE,
            Quantity("|force|", "N", lambda trace: np.abs(trace.log["force_n"]))
            <= limit("force", "N", lambda trace: trace.setup.rig.limits.force),
        ),
        RIG,
        "The rig itself keeps its limits of force, speed and position",
        1e3,
    ),
    Policy(
        "speed_limit",
        always(
            GENTLE,
            Quantity("|velocity|", "m/s", lambda trace: np.abs(trace.log["velocity_m_s"]))
            <= limit("velocity", "m/s", lambda trace: trace.setup.rig.limits.velocity),
        ),
        RIG,
        "The rig itself keeps its limits of force, speed and position",
        0.1,
    ),
    Policy(
        "stroke",
        always(
            GENTLE,
            Quantity("distance from mid-stroke", "m", _from_middle)
            <= limit(
                "position", "m", lambda trace: 0.5 * (trace.setup.rig.limits.position[1] - trace.setup.rig.limits.position[0])
            ),
        ),
        RIG,
        "The rig itself keeps its limits of force, speed and position",
        1e-2,
    ),
    # Requests
    Policy(
        "stop_lasts",
        each("always(acknowledged -> time since emergency_stop >= 1 s)", "s", _stops_lasted),
        RIG,
        "It lasts at least a second",
        1e-2,
    ),
    Policy(
        "stop_is_named",
        each("always(acknowledged -> the stop named is engaged)", "1", _named),
        RIG,
        "released only by `acknowledge_stop` with its name",
        1.0,
    ),
    Policy(
        "stop_needs_acknowledgement",
        each("always(enabled after a stop -> acknowledge_stop and reset_trips came between)", "s", _enabled_after_stop),
        RIG,
        "released only by `acknowledge_stop` with its name",
        1e-3,
    ),
    Policy(
        "enabled_in_active",
        each("always(enabled -> the node is active)", "1", _outside_active),
        RIG,
        "the valve is driven in `active` only",
        1.0,
    ),
    Policy(
        "parameters_bounded",
        each("always(a parameter is accepted -> it is within its bounds)", "1", _bounded),
        RIG,
        "The bounds of times and rates follow from the rig file",
        0.1,
    ),
    Policy(
        "open_gate_not_weakened",
        each("always(a parameter that weakens is accepted -> not driving)", "1", _weaker),
        RIG,
        "A change that weakens the protection is refused while the gate is open",
        1.0,
    ),
    Policy(
        "changes_are_reported",
        each(f"always(driving changes -> diagnostics say so within {WITHIN:g} s)", "s", _changes_told),
        RIG,
        "Each change of the gate's state is in `/diagnostics` at once",
        0.1,
    ),
    Policy(
        "reports_are_true",
        each("always(diagnostics say active and OK -> not at null against commands for 1 s)", "s", _claims),
        RIG,
        "a valve that stays at null against the commands is not reported as OK",
        0.1,
    ),
)
"""All policies of the gate; `docs/policies.md` lists them."""
