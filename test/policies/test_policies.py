"""The monitor: a log that violates a policy slightly is caught, one that comes as close without a violation is not."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.control.programme.motion import State
from ehls_ros.hardware.safety_gate import MAX_PERIODS, MAX_SILENCE, STOP_TIME
from policies.monitor import POLICIES, check, judge, listed
from policies.of_gate import LYING, WITHIN
from policies.of_graph import EXACT, HANDOVER, REFUSED_WITHIN
from policies.synthetic import (
    AMPLITUDE,
    COMMANDER,
    EVENT,
    GATE,
    OPENED,
    PERIOD,
    PLANT,
    RIG,
    WATCHDOG,
    answered,
    at,
    commands,
    driven,
    happening,
    opened,
    report,
    trace,
    until,
)

DOCS = Path(__file__).resolve().parents[2] / "docs"
NAMES = {policy.name: policy for policy in POLICIES}
ROWS = 4000
SEEN = GATE.sensor_timeout + 2.0 * PERIOD
"""Time after which the gate has received a sample, as in the policies [s]."""

IN_FLIGHT = 2
"""Rows in which the valve may be open after it had to be closed, if a command arrives in each."""


def with_row(row, value, command=None):
    changed = opened() if command is None else command.copy()
    changed[row] = value
    return changed


def closes(takes, **parts):
    """Return the run in which the valve is open after an event for too long, by whole rows, or for the permitted time."""

    def make(excess, begins=EVENT):
        last = begins + round(takes / PERIOD) + IN_FLIGHT - 1 + (excess > 0.0)
        return trace(until(last), **parts)

    return make


def beyond(column, value, takes):
    """Return the run in which a signal exceeds a limit from an event on, and the valve closes too late or in time."""

    def make(excess):
        signal = np.where(np.arange(ROWS) >= EVENT, value, 0.0)
        begins = EVENT + round((GATE.limit_time + PERIOD) / PERIOD)
        return closes(takes, columns={column: signal})(excess, begins)

    return make


def stop(row=EVENT, name="stop-1"):
    return answered("emergency_stop", row, message=f"{name}; after 1 s")


def parameter(row, name, value):
    return answered("hardware_bridge_node/set_parameters", row, name=name, value=value)


# One function per policy that needs more than a line: it returns a run that exceeds the bound by `excess`.


def opens_gradually(excess):
    row = OPENED + 20
    blended = (20 * PERIOD + MAX_PERIODS * PERIOD + GATE.command_timeout) / GATE.enable_time
    return trace(with_row(row, blended * AMPLITUDE + 2e-7 + excess))


def obeys(excess):
    return trace(with_row(EVENT, AMPLITUDE + 2e-7 + excess), messages=driven(), reports=[report("active", 300)])


def fresh(excess):
    last = EVENT + round((GATE.command_timeout + WATCHDOG + 3.0 * PERIOD + excess) / PERIOD)
    return trace(until(last), messages={"valve_command": [*commands(EVENT), (at(EVENT), 0, EVENT, AMPLITUDE, COMMANDER)]})


def watchdog(excess):
    arrived = np.minimum(np.arange(ROWS), EVENT) + 1.0
    return trace(until(EVENT + round((WATCHDOG + excess) / PERIOD)), columns={"output_sequence": arrived})


def shut(command, first=EVENT, last=EVENT + 10):
    rows = np.arange(ROWS)
    closed = (rows >= first) & (rows < last)
    return trace(np.where(closed, 0.0, command), columns={"output_status": np.where(closed, 2.0, 0.0)})


def null_after_watchdog(excess):
    return shut(with_row(EVENT + 10, max(excess, 0.0)))


def device_null(excess):
    # The valve is opened again, or stays closed.
    return shut(opened() if excess > 0.0 else until(EVENT))


def answers_late(age, watchdog):
    def make(excess):
        old = np.arange(ROWS) - 1.0
        old[EVENT] = EVENT - round((age + excess) / PERIOD)
        return trace(columns={"output_answered": old}, watchdog=watchdog)

    return make


def stuck(excess):
    command = 3e-4 * np.sin(2.0 * np.pi * 5.0 * PERIOD * np.arange(ROWS))
    begins = EVENT + 3 + round(GATE.frozen_time / PERIOD)
    last = begins + round((GATE.ramp_time + SEEN) / PERIOD) + IN_FLIGHT - 1 + (excess > 0.0)
    return trace(np.where(np.arange(ROWS) <= last, command, 0.0), happenings=[happening("fault", EVENT, "stick force")])


def stop_needs_acknowledgement(excess):
    acknowledged = answered("acknowledge_stop", EVENT + 1100, stop="stop-1")
    reset = answered("reset_trips", EVENT + 1200)
    enabled = answered("enable", EVENT + 1300, data=True)
    calls = [stop(), acknowledged, *([] if excess > 0.0 else [reset]), enabled]
    return trace(until(EVENT), calls=calls)


def weakened(excess):
    told = [(at(OPENED), True), *([] if excess > 0.0 else [(at(EVENT + 1), False)])]
    return trace(until(EVENT), calls=[parameter(EVENT, "force_error", 1e5)], messages={"driving": told})


def told_late(excess):
    told = [(at(0), False), (at(OPENED), True), (at(EVENT), False)]
    reports = [*(report("disabled", row) for row in (0, 10, 20)), report("active", OPENED)]
    reports += [report("active", EVENT - 10), report("cut", EVENT + (WITHIN + excess) / PERIOD), report("cut", 2300)]
    return trace(until(EVENT), messages={"driving": told}, reports=reports)


def claims(excess):
    # The first command since is in the row after.
    return trace(until(EVENT), reports=[report("active", EVENT + 0.5 + (1.0 + excess) / PERIOD)])


def answered_cycle(followed, sources, **parts):
    """Return a run with one answered cycle, in which a law followed a reference while sources sent theirs."""
    force = 2000.0
    status = (at(5), 0, 4, *(0.0,) * 8, force - followed, 0.0, False, False, "/ehls/fasmc_node-3")
    messages = {
        "driver": [(at(0), 0, 0, True, COMMANDER, PLANT)],
        "loader_state": [(at(4), 0, 4, 0.0, 0.0, 0.0, 0.0, force, 0.0, 0.0, PLANT)],
        "force_reference": [(at(1), 0, 4, value, 0.0, 0.0, sender) for sender, value in sources.items()],
        "controller_status": [status],
        **parts,
    }
    return trace(messages=messages)


FIRST, SECOND = "/ehls/reference_node-1", "/ehls/programme_node-2"


def refused(excess):
    late = (at(EVENT) + REFUSED_WITHIN + excess, 0, 7, 0.0, 0.0, 0.0, SECOND)
    return trace(messages={"refused": [(at(EVENT), 0, "force_reference", SECOND, FIRST)], "force_reference": [late]})


def switched(excess, step=0.0):
    """Return a run in which another controller takes over in a cycle, requested or not, with a step beside the usual change."""
    usual = 1e-6
    values = {cycle: usual * (cycle % 2) for cycle in range(EVENT - 300, EVENT)}
    sent = [(at(cycle), 0, cycle, value, "/ehls/a-1") for cycle, value in values.items()]
    sent += [(at(cycle), 0, cycle, usual + step + usual * (cycle % 2), "/ehls/b-2") for cycle in range(EVENT, EVENT + 300)]
    messages = {
        "driver": [(at(0), 0, 0, True, "/ehls/a-1", PLANT), (at(EVENT), 0, EVENT, True, "/ehls/b-2", PLANT)],
        "standby_command": [(at(5), 0, 5, 0.0, "/ehls/b-2")],
        "controller_status": [(at(EVENT + 5), 0, EVENT + 5, *(0.0,) * 10, False, False, "/ehls/b-2")],
        "valve_command": sent,
        "driving": [(at(0), True), *([(at(EVENT + 5), False)] if excess > 0.0 else [])],
    }
    asked = [answered("switch_controller", EVENT - 5, controller="b", message="b takes over")]
    return trace(messages=messages, calls=[] if excess > 0.0 and not step else asked, lockstep=True)


def handover(excess):
    return switched(-1.0, HANDOVER * 1e-6 + excess)


def switch_closes(excess):
    found = switched(excess, 1e-9)
    assert found.called("switch_controller")
    return found


def standing_by(excess):
    grace = round(GATE.command_timeout / PERIOD)
    late = (at(EVENT), 0, EVENT + grace + (excess > 0.0), 0.0, "/ehls/a-1")
    messages = {
        "driver": [(at(0), 0, 0, True, "/ehls/a-1", PLANT), (at(EVENT), 0, EVENT, True, "/ehls/b-2", PLANT)],
        "standby_command": [(at(5), 0, 5, 0.0, "/ehls/a-1")],
        "valve_command": [late],
    }
    return trace(messages=messages, lockstep=True)


def in_order(excess):
    messages = driven()
    row = messages["loader_state"][EVENT]
    # It is repeated, unchanged or changed.
    again = (at(EVENT), *row[1:3], 1.0, *row[4:]) if excess > 0.0 else (at(EVENT), *row[1:])
    return trace(messages={**messages, "loader_state": [*messages["loader_state"][: EVENT + 1], again]})


def one_computer(excess):
    silent = round((0.1 - excess) / PERIOD)
    rows = np.arange(ROWS)
    counted = np.where(rows <= EVENT, rows + 1.0, np.where(rows < EVENT + silent, EVENT + 1.0, rows - EVENT - silent + 1.0))
    return trace(until(EVENT), columns={"output_sequence": counted})


def programme(points, references):
    """Return a run with a programme: points (cycle, count, state), references (time, cycle, force, rate, acceleration)."""
    messages = {
        "programme_point": [(at(cycle), 0, cycle, 0, 0, count, 0.0, state, SECOND) for cycle, count, state in points],
        "force_reference": [(when, 0, *row, SECOND) for when, *row in references],
    }
    return trace(messages=messages, lockstep=True)


RUNNING = [(1, 0, State.RUNNING)]


def continuous(excess):
    bound = PERIOD**2 * 200.0 + EXACT
    return programme(RUNNING, [(at(1), 1, 0.0, 10.0, 100.0), (at(2), 2, 10.0 * PERIOD + bound + excess, 10.0, 100.0)])


def same_again(excess):
    return programme(RUNNING, [(at(1), 1, 5.0, 0.0, 0.0), (at(9), 1, 5.0 + EXACT + excess, 0.0, 0.0)])


def stands(excess):
    return programme([(1, 7, State.STOPPED), (2, 7 + (excess > 0.0), State.STOPPED)], [])


def states(excess):
    changed = answered("reference_node/change_state", EVENT, transition="deactivate")
    state = "active" if excess > 0.0 else "inactive"
    seen = [happening("state", row, f"reference_node reference_node {now}") for row, now in ((0, "active"), (EVENT + 1, state))]
    return trace(calls=[changed], happenings=seen)


def ends(excess):
    asked = [] if excess > 0.0 else [happening("stopped", EVENT)]
    return trace(happenings=[happening("started", 0, code=7), *asked, happening("gone", EVENT + 1, code=7)])


ACKNOWLEDGED = "acknowledge_stop"
BLIND = GATE.sensor_timeout + 3.0 * PERIOD
RAMPED = GATE.ramp_time + 2.0 * PERIOD
FORCE = 0.9 * RIG.limits.force + 100.0
MORE, ROW = 1e-9 + 1e-12, PERIOD
"""Excesses: just beyond rounding, and a row of the log."""

CASES = {
    "spool_limit": (lambda e: trace(with_row(EVENT, RIG.limits.spool + e)), 1e-8),
    "command_rate": (lambda e: trace(with_row(EVENT, AMPLITUDE + MAX_PERIODS * PERIOD * GATE.command_rate + 2e-7 + e)), 1e-8),
    "opens_gradually": (opens_gradually, 1e-8),
    "obeys_who_drives": (obeys, 1e-8),
    "fresh_command": (fresh, ROW),
    "watchdog": (watchdog, ROW),
    "null_after_watchdog": (null_after_watchdog, 1e-8),
    "late_command": (answers_late(WATCHDOG + PERIOD, WATCHDOG), ROW),
    "transport_delay": (answers_late(2.0 * GATE.sensor_timeout + 3.0 * PERIOD, 0.5), ROW),
    "emergency_stop": (closes(0.0, calls=[stop()]), ROW),
    "disable": (closes(RAMPED, calls=[answered("enable", EVENT, data=False)]), ROW),
    "outside_active": (closes(0.0, calls=[answered("hardware_bridge_node/change_state", EVENT, transition="deactivate")]), ROW),
    "end_of_process": (closes(0.0, happenings=[happening("ended", EVENT)]), ROW),
    "killed": (closes(0.0, happenings=[happening("killed", EVENT)]), ROW),
    "gap": (closes(0.0, happenings=[happening("frozen", EVENT - 50), happening("woken", EVENT)]), ROW),
    "services_silent": (closes(MAX_SILENCE + 1.0, happenings=[happening("deaf", EVENT)]), ROW),
    "device_null": (device_null, ROW),
    "latched": (closes(0.0, reports=[report("cut", EVENT)]), ROW),
    "ramped": (closes(RAMPED, reports=[report("ramping", EVENT)]), ROW),
    "driving_is_true": (closes(RAMPED, messages={"driving": [(at(EVENT), False)]}), ROW),
    "no_measurement": (closes(BLIND, happenings=[happening("fault", EVENT, "silent")]), ROW),
    "sensor_contradiction": (
        closes(GATE.mismatch_time + GATE.ramp_time + SEEN, happenings=[happening("fault", EVENT, "bias force 3000")]),
        ROW,
    ),
    "sensor_stuck": (stuck, ROW),
    "force_trips": (beyond("force_n", FORCE, SEEN), ROW),
    "pressure_trips": (beyond("load_pressure_pa", 0.95 * RIG.limits.load_pressure, SEEN), ROW),
    "speed_trips": (beyond("velocity_m_s", 0.97 * RIG.limits.velocity, SEEN + GATE.ramp_time + 0.015), ROW),
    "position_trips": (beyond("position_m", RIG.limits.position[1] - 0.01, SEEN), ROW),
    "force_limit": (lambda e: trace(columns={"force_n": np.full(ROWS, RIG.limits.force + e)}), 1e-3),
    "speed_limit": (lambda e: trace(columns={"velocity_m_s": np.full(ROWS, -RIG.limits.velocity - e)}), 1e-6),
    "stroke": (lambda e: trace(columns={"position_m": np.full(ROWS, RIG.limits.position[1] + e)}), 1e-6),
    "stop_lasts": (
        lambda e: trace(
            until(EVENT), calls=[stop(), answered(ACKNOWLEDGED, EVENT - 0.1 + (STOP_TIME - e) / PERIOD, stop="stop-1")]
        ),
        1e-4,
    ),
    "stop_is_named": (
        lambda e: trace(
            until(EVENT), calls=[stop(), answered(ACKNOWLEDGED, EVENT + 1100, stop="stop-2" if e > 0.0 else "stop-1")]
        ),
        1.0,
    ),
    "stop_needs_acknowledgement": (stop_needs_acknowledgement, ROW),
    "enabled_in_active": (
        lambda e: trace(
            until(EVENT),
            calls=[
                answered("hardware_bridge_node/change_state", EVENT, transition="deactivate" if e > 0.0 else "activate"),
                answered("enable", EVENT + 5, data=True),
            ],
        ),
        1.0,
    ),
    "parameters_bounded": (lambda e: trace(calls=[parameter(EVENT, "ramp_time", 0.03 * (1.0 + e))]), 1e-6),
    "open_gate_not_weakened": (weakened, 1.0),
    "changes_are_reported": (told_late, ROW),
    "reports_are_true": (claims, ROW),
    "one_reference": (lambda e: answered_cycle(600.0, {FIRST: 600.0 + EXACT + e}), 1e-4),
    "refused_is_silent": (refused, 1e-3),
    "driver_changes_for_a_reason": (switched, 1.0),
    "handover_step": (handover, 1e-8),
    "standing_by_is_silent": (standing_by, 1.0),
    "switch_leaves_gate_open": (switch_closes, 1.0),
    "cycles_in_order": (in_order, 1.0),
    "one_computer": (one_computer, ROW),
    "counts_once": (lambda e: trace(load_cycles=[(1, 1, 50), (2, 51 - (e > 0.0), 100)]), 1.0),
    "programme_continuous": (continuous, 1e-6),
    "programme_same_again": (same_again, 1e-6),
    "stopped_programme_stands": (stands, 1.0),
    "nobody_ends_unasked": (ends, 1.0),
    "partners_stay": (states, 1.0),
}


@pytest.mark.parametrize("name", NAMES)
def test_a_little_too_much_is_caught_and_a_little_less_is_not(name):
    make, excess = CASES[name]
    caught, borne = judge(make(excess), [NAMES[name]])[name], judge(make(-excess), [NAMES[name]])[name]
    assert caught.violations, str(caught)
    assert borne.evaluated, str(borne)
    assert not borne.violations, str(borne)


def test_a_run_without_events_violates_nothing():
    verdicts = check(trace())
    assert sum(verdict.evaluated > 0 for verdict in verdicts.values()) >= 10


def test_a_violation_is_reported_with_the_formula_and_the_distance():
    with pytest.raises(
        AssertionError, match=r"spool_limit: always\(true -> \|command\| <= limits.spool\); robustness -0.001 m"
    ):
        check(trace(with_row(EVENT, -RIG.limits.spool - 1e-3)))


@pytest.mark.parametrize(
    ("followed", "sources", "parts", "violated"),
    [
        (600.0, {FIRST: 600.0, SECOND: -300.0}, {}, False),
        (150.0, {FIRST: 600.0, SECOND: -300.0}, {}, True),
    ],
    ids=["of the first", "mixed"],
)
def test_of_two_references_the_law_follows_one(followed, sources, parts, violated):
    verdict = judge(answered_cycle(followed, sources, **parts), [NAMES["one_reference"]])["one_reference"]
    assert bool(verdict.violations) is violated


def test_a_packet_kept_on_the_wire_is_in_flight_for_as_long():
    policy = NAMES["driving_is_true"]

    def violations(delay):
        faults = [happening("fault", 0, f"delay {delay}")]
        told = {"driving": [(at(0), True), (at(EVENT), False)]}
        last = EVENT + round((GATE.ramp_time + 0.02) / PERIOD)
        return judge(trace(until(last), messages=told, happenings=faults), [policy])[policy.name].violations

    assert violations(0.0)
    assert not violations(0.02)


def test_a_valve_enabled_again_on_its_ramp_need_not_follow_before():
    policy, again = NAMES["obeys_who_drives"], EVENT + 10
    on_ramp = with_row(EVENT, 0.5 * AMPLITUDE)

    def violations(told):
        messages = {**driven(), "driving": told}
        return judge(trace(on_ramp, messages=messages, reports=[report("active", 300)]), [policy])[policy.name].violations

    assert violations([(at(0), True)])
    assert not violations([(at(0), True), (at(EVENT), False), (at(again), True)])


@pytest.mark.parametrize(("before", "violated"), [("active", True), ("enabling", False)])
def test_a_valve_held_while_it_is_blended_in_need_not_follow(before, violated):
    policy = NAMES["obeys_who_drives"]
    reports = [report(before, 300), report("holding", EVENT - 5), report("active", EVENT + 10)]
    found = trace(with_row(EVENT, 0.5 * AMPLITUDE), messages=driven(), reports=reports)
    assert bool(judge(found, [policy])[policy.name].violations) is violated


@pytest.mark.parametrize("leaves", [False, True])
def test_another_reference_is_followed_only_once_its_owner_has_left(leaves):
    force, senders = 2000.0, {4: (FIRST, 600.0), 5: (SECOND, -300.0)}
    messages = {
        "driver": [(at(0), 0, 0, True, COMMANDER, PLANT)],
        "loader_state": [(at(k), 0, k, 0.0, 0.0, 0.0, 0.0, force, 0.0, 0.0, PLANT) for k in senders],
        "force_reference": [
            (at(1), 0, k, value, 0.0, 0.0, sender) for k in senders for sender, value in ((FIRST, 600.0), (SECOND, -300.0))
        ],
        "controller_status": [
            (at(k + 0.5), 0, k, *(0.0,) * 8, force - value, 0.0, False, False, "/ehls/fasmc_node-3")
            for k, (_, value) in senders.items()
        ],
        "leaving": [(at(4.7), FIRST)] if leaves else [],
    }
    verdict = judge(trace(messages=messages), [NAMES["one_reference"]])["one_reference"]
    assert bool(verdict.violations) is not leaves


def test_what_was_sent_before_the_valve_was_closed_does_not_count_however_late_it_arrives():
    policy = NAMES["emergency_stop"]

    def violations(last, arrivals):
        arrived = np.isin(np.arange(ROWS), [*range(EVENT), *(EVENT + row for row in arrivals)])
        found = trace(until(EVENT + last), calls=[stop()], columns={"output_sequence": np.cumsum(arrived).astype(float)})
        return judge(found, [policy])[policy.name].violations

    held = round(WATCHDOG / PERIOD) + 1
    assert not violations(1, range(3))
    assert violations(2, range(3))
    assert not violations(held, ())
    assert violations(held + 1, ())
    assert not violations(5 + held, (5,))
    assert violations(6 + held, (5,))


def test_a_request_to_enable_ends_a_stop_only_after_its_acknowledgement():
    enabled = answered("enable", EVENT + 10, data=True)
    opens = np.where(np.arange(ROWS) > EVENT + 20, AMPLITUDE, until(EVENT))
    assert judge(trace(opens, calls=[stop(), enabled]))["emergency_stop"].violations
    acknowledged = answered("acknowledge_stop", EVENT + 5, stop="stop-1")
    assert not judge(trace(opens, calls=[stop(), acknowledged, enabled]))["emergency_stop"].violations


def test_a_weaker_parameter_counts_for_the_time_in_which_it_held():
    slow = parameter(EVENT - 5, "ramp_time", 0.03)
    disabled = answered("enable", EVENT, data=False)
    open_for = trace(until(EVENT + 30), calls=[slow, disabled])
    assert not judge(open_for)["disable"].violations
    assert judge(trace(until(EVENT + 30), calls=[disabled]))["disable"].violations


def test_a_sensor_that_contradicts_others_for_a_moment_only_is_no_fault():
    faults = [happening("fault", EVENT, "bias force 3000"), happening("fault", EVENT + 5, "clear")]
    assert not LYING.spans(trace(happenings=faults)).begins.size


def test_each_policy_is_promised_by_the_documentation():
    for policy in POLICIES:
        page = " ".join((DOCS / policy.page).read_text(encoding="utf-8").split())
        assert " ".join(policy.promise.split()).lower() in page.lower(), policy.name


def test_the_documentation_lists_the_policies():
    assert len(POLICIES) >= 20
    assert listed() in (DOCS / "policies.md").read_text(encoding="utf-8"), f"docs/policies.md has to have\n{listed()}"
