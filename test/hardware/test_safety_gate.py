"""States, commands, ownership, trips and reset of the safety gate."""

import math
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from safety_gate_bench import AREA, PERIOD, RIG, Bench

from ehls_ros.errors import BadInput
from ehls_ros.hardware.gate_parameters import PROTECTS_WHEN_LARGER, REACTIONS, Parameters
from ehls_ros.hardware.safety_gate import ERROR, OK, STATES, STOP_TIME, WARN, Gate
from ehls_ros.schema import declarations, parse

LIMIT = RIG.limits.spool

CLOCK = 1e-12
"""Error of a ramp due to the rounding of times [m]."""


# Enabling and disabling


def test_nothing_passes_before_it_is_enabled():
    bench = Bench()
    assert bench.turns(100) == [0.0] * 100
    assert bench.gate.state == "disabled"


def test_commands_pass_unaltered_while_it_is_active():
    bench = Bench().run(0.0)
    commands = [1e-3 * math.sin(0.1 * k) for k in range(500)]
    assert [bench.turn(command) for command in commands] == commands
    assert bench.counts() == {}


def test_enabling_blends_the_command_in_without_a_bump():
    bench = Bench(enable_time=0.1)
    bench.turn(4e-3)
    assert bench.gate.enable() is None
    written = bench.turns(99, 4e-3)
    assert bench.gate.driving
    assert not bench.gate.in_full
    written += bench.turns(1, 4e-3)
    assert written == pytest.approx([4e-3 * k / 100 for k in range(1, 101)], rel=1e-9)
    assert bench.gate.in_full
    assert bench.gate.state == "active"
    assert bench.turn(4e-3) == 4e-3


def test_a_command_may_move_while_it_is_blended_in():
    bench = Bench(enable_time=0.1)
    bench.turn(0.0)
    bench.gate.enable()
    commands = [2e-3 * math.sin(0.05 * k) for k in range(1, 101)]
    written = [bench.turn(command) for command in commands]
    assert written == pytest.approx([c * k / 100 for k, c in enumerate(commands, 1)], abs=CLOCK)


def test_enabling_again_starts_where_the_output_is():
    bench = Bench(enable_time=0.1, ramp_time=0.1).run(5e-3, cycles=101)
    bench.gate.disable()
    before = bench.turns(50, 5e-3)[-1]
    assert before == pytest.approx(2.5e-3)
    assert bench.gate.enable() is None
    assert bench.turn(5e-3) == pytest.approx(before + 0.01 * 2.5e-3)


def test_disabling_ramps_to_null():
    bench = Bench(ramp_time=0.01).run(5e-3)
    bench.gate.disable()
    assert bench.turns(12, 5e-3) == pytest.approx([5e-3 * max(0.0, 1.0 - 0.1 * k) for k in range(1, 13)], abs=CLOCK)
    assert bench.gate.state == "disabled"
    assert bench.gate.causes == []


def test_enabling_requires_a_fresh_snapshot_and_a_fresh_command():
    bench = Bench()
    assert bench.gate.enable() == "no fresh snapshot"
    bench.turn(None)
    assert bench.gate.enable() == "no fresh command"
    bench.turns(1)
    bench.turns(20, None)
    assert bench.gate.enable() == "no fresh command"
    bench.turns(1)
    for _ in range(20):
        bench.step()
    assert bench.gate.enable() == "sensor_stale persists"
    bench.turns(1)
    assert bench.gate.enable() is None


def test_enabling_is_refused_while_a_fault_is_present():
    bench = Bench()
    bench.turns(5, force=2e4)
    assert bench.gate.enable() == "force persists"
    assert bench.turn() == 0.0
    assert bench.gate.causes == []


# Commands


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e30, -1e30, 1.0001 * LIMIT])
def test_one_bad_command_is_bridged_by_the_last_good_one(bad):
    bench = Bench().run(1e-3)
    assert bench.turn(bad) == 1e-3
    assert bench.gate.state == "holding"
    assert bench.turn(1.1e-3) == 1.1e-3
    assert bench.gate.state == "active"
    assert bench.gate.causes == []
    assert sum(bench.counts().values()) == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e30])
def test_lasting_bad_commands_end_at_null(bad):
    bench = Bench(hold_time=0.01, ramp_time=0.01).run(2e-3)
    written = bench.turns(50, bad)
    assert written[:10] == [2e-3] * 10
    assert written[10:20] == pytest.approx([2e-3 * (1.0 - 0.1 * k) for k in range(1, 11)], abs=CLOCK)
    assert set(written[20:]) == {0.0}
    assert bench.turns(1000) == [0.0] * 1000


def test_alternating_bad_commands_use_up_the_hold_time():
    bench = Bench(hold_time=0.02).run()
    for k in range(100):
        bench.turn(math.nan if k % 2 else 1e-3)
    assert bench.causes_named() == ["command_not_finite"]


def test_one_bad_command_in_a_hundred_does_not_use_up_the_hold_time():
    bench = Bench(hold_time=0.005).run()
    written = [bench.turn(math.nan if k % 100 == 50 else 1e-3) for k in range(5000)]
    assert set(written) == {1e-3}
    assert bench.gate.state == "active"


def test_a_command_beyond_the_limit_is_clamped_if_set_to_warn():
    bench = Bench(on_command_range="warn", command_rate=20.0).run(0.0)
    assert bench.turn(1e30) == LIMIT
    assert bench.turn(-1e30) == -LIMIT
    assert bench.gate.state == "active"


def test_a_fast_command_is_rate_limited_if_set_to_warn():
    bench = Bench(on_command_rate="warn", command_rate=1.0).run(0.0)
    assert bench.turns(4, 3e-3) == pytest.approx([1e-3, 2e-3, 3e-3, 3e-3])


def test_a_nan_command_never_passes_even_if_set_to_warn():
    bench = Bench(on_command_not_finite="warn").run(1e-3)
    written = bench.turns(30, math.nan)
    assert written[:19] == [1e-3] * 19
    assert set(written[20:]) == {0.0}
    assert bench.causes_named() == ["command_stale"]


def test_a_jump_of_the_command_is_followed_once_the_rate_limit_allows_it():
    bench = Bench(command_rate=1.0).run(0.0)
    # Even then the output is rate-limited.
    expected = [0.0, 0.0, 0.0, 0.0, 1e-3, 2e-3, 3e-3, 4e-3, 4.5e-3]
    assert bench.turns(9, 4.5e-3) == pytest.approx(expected, abs=CLOCK)
    assert bench.gate.state == "active"


def test_the_rate_of_a_command_counts_the_cycles_since_the_last():
    bench = Bench(command_rate=1.0).run(0.0)
    bench.turns(4, None)
    bench.sense()
    assert bench.gate.take(bench.cycle - 1, 4.9e-3, "controller")
    assert bench.counts() == {}


@pytest.mark.parametrize(
    ("answers", "value"),
    [(-1, "duplicate"), (-2, "out of order"), (1, "in the future"), (None, "no cycle"), (10**400, "no cycle")],
)
def test_commands_for_another_cycle_are_ignored_and_counted(answers, value):
    bench = Bench().run(1e-3)
    bench.sense()
    bench.gate.take(bench.cycle - 1, 1e-3, "controller")
    bench.step()
    wrong = bench.cycle - 1 if answers == -1 else answers if answers in {None, 10**400} else bench.cycle - 1 + answers
    assert not bench.gate.take(wrong, 2e-3, "controller")
    assert bench.gate.detectors["command_order"].subject == value
    assert bench.turn(None) == 1e-3
    assert bench.counts() == {"command_order": 1}


def test_a_command_for_an_old_cycle_is_ignored():
    bench = Bench(command_timeout=0.01).run(1e-3)
    answered = bench.cycle
    for _ in range(11):
        bench.sense()
    assert not bench.gate.take(answered, 2e-3, "controller")
    assert bench.gate.detectors["command_order"].subject == "too old"


# The watchdog


@pytest.mark.parametrize("timeout", [0.002, 0.005, 0.02, 0.1])
def test_a_controller_that_dies_is_missed_after_the_timeout(timeout):
    bench = Bench(command_timeout=timeout).run(3e-3)
    cycles = round(timeout / PERIOD)
    written = bench.turns(cycles + 10, None)
    # The last command came one step before the first of these.
    assert written[: cycles - 1] == [3e-3] * (cycles - 1)
    assert set(written[cycles - 1 :]) == {0.0}
    assert bench.gate.state == "cut"
    assert bench.causes_named() == ["command_stale"]


def test_fewer_missed_cycles_than_the_timeout_pass():
    bench = Bench().run(1e-3)
    for _ in range(200):
        assert bench.turns(19, None) == [1e-3] * 19
        assert bench.turn(1e-3) == 1e-3
    assert bench.counts() == {}


def test_one_command_in_ten_lost_passes():
    bench = Bench().run(1e-3)
    written = [bench.turn(None if k % 10 == 3 else 1e-3) for k in range(2000)]
    assert set(written) == {1e-3}
    assert bench.gate.state == "active"


def late_turn(bench, late):
    bench.sense()
    bench.gate.take(bench.cycle - 1 - late, 1e-3, "controller")
    return bench.step()


def test_late_commands_are_as_old_as_the_snapshots_they_answer():
    bench = Bench(command_timeout=0.02).run(1e-3)
    # The answers to the first cycles are lost; later ones take 20 ms.
    written = [late_turn(bench, 20) for _ in range(30)]
    assert written[-1] == 0.0
    assert "command_stale" in bench.causes_named()


def test_commands_a_few_cycles_late_pass():
    bench = Bench(command_timeout=0.02).run(1e-3)
    assert {late_turn(bench, 5) for _ in range(100)} == {1e-3}
    assert bench.gate.state == "active"


def test_a_repeated_command_does_not_feed_the_watchdog():
    bench = Bench().run(1e-3)
    frozen = bench.cycle - 1
    for _ in range(25):
        bench.sense()
        bench.gate.take(frozen, 1e-3, "controller")
        bench.step()
    assert bench.gate.output == 0.0
    assert "command_stale" in bench.causes_named()


def test_a_stopped_process_counts_as_silence():
    bench = Bench().run(1e-3)
    bench.sense()
    assert bench.step(elapsed=0.5) == 0.0
    assert bench.causes_named() == ["gap", "command_stale"]


@pytest.mark.parametrize("prepare", ["active", "enabling", "holding"])
def test_a_loop_that_slept_beyond_its_timeouts_trips_even_with_fresh_data_on_waking(prepare):
    bench = Bench(enable_time=0.5 if prepare == "enabling" else 0.0)
    bench.turn(1e-3)
    bench.gate.enable()
    bench.turns(5, 1e-3)
    bench.turn(math.nan if prepare == "holding" else 1e-3)
    assert bench.gate.state == prepare
    bench.sense()
    bench.gate.take(bench.cycle - 1, 1e-3, "controller")
    assert bench.step(elapsed=0.021) == 0.0
    assert bench.causes_named() == ["gap"]
    assert bench.turns(100) == [0.0] * 100
    assert bench.gate.reset() is None
    assert bench.gate.enable() is None


def test_a_short_gap_does_not_extend_the_reach_of_the_output():
    bench = Bench(command_rate=1.0).run(0.0)
    bench.sense()
    bench.gate.take(bench.cycle - 1, 0.0, "controller")
    bench.step(elapsed=0.019)
    bench.turns(4, None)
    for _ in range(10):
        bench.sense()
    bench.gate.take(bench.cycle - 1, 9e-3, "controller")
    assert bench.step(elapsed=0.015) == pytest.approx(3e-3)


def test_delayed_snapshots_are_not_fresh():
    bench = Bench().run(1e-3)
    for _ in range(3):
        bench.gate.sense(bench.cycle, [1e-9] * 5 + [7e6, 313.0], lag=0.03)
        bench.cycle += 1
        bench.gate.take(bench.cycle - 1, 1e-3, "controller")
        assert bench.step() == 0.0
    assert {"sensor_stale", "command_stale"} == set(bench.causes_named())
    bench.turns(3)
    assert bench.gate.reset() is None


@pytest.mark.parametrize("open_", [False, True])
def test_a_device_that_closed_the_valve_itself_trips_the_gate_and_keeps_it_closed(open_):
    bench = Bench().run(1e-3) if open_ else Bench()
    bench.turn(1e-3)
    bench.gate.sense(bench.cycle, [1e-9] * 5 + [7e6, 313.0], at_null=True)
    bench.cycle += 1
    bench.gate.take(bench.cycle - 1, 1e-3, "controller")
    assert bench.step() == 0.0
    assert bench.causes_named() == (["device_null"] if open_ else [])
    assert (bench.gate.reset() if open_ else bench.gate.enable()) == "device_null persists"
    bench.turns(3)
    assert bench.gate.reset() is None
    assert bench.gate.enable() is None


def test_silent_services_trip_the_gate():
    bench = Bench().run(1e-3)
    bench.gate.set_service_silence(0.99)
    assert bench.turn(1e-3) == 1e-3
    bench.gate.set_service_silence(1.01)
    assert bench.turn(1e-3) == 0.0
    assert bench.causes_named() == ["services_silent"]
    assert bench.gate.reset() == "services_silent persists"
    bench.gate.set_service_silence(0.0)
    assert bench.gate.reset() is None


# The end of the loop, and its beginning


@pytest.mark.parametrize("left", [1, 7, 20])
def test_the_loop_ends_at_null_and_restarts_only_after_reset_and_enable(left):
    bench = Bench(ramp_time=0.1, enable_time=0.01)
    bench.turn(5e-3)
    bench.gate.enable()
    bench.turns(left, 5e-3)
    bench.gate.leave()
    assert bench.gate.output == 0.0
    assert bench.gate.enable() == "the node is not active"
    assert [bench.turn(5e-3) for _ in range(10)] == [0.0] * 10
    bench.gate.begin()
    assert [bench.turn(5e-3) for _ in range(10)] == [0.0] * 10
    assert "left active" in bench.gate.enable()
    assert bench.gate.health()[0] == OK
    assert bench.gate.reset() is None
    assert bench.gate.enable() is None
    assert bench.turn(5e-3) == pytest.approx(5e-4)


def test_a_ramp_interrupted_by_the_end_of_the_loop_does_not_continue():
    bench = Bench(ramp_time=0.2).run(8e-3)
    bench.gate.disable()
    assert bench.turn(8e-3) > 7e-3
    bench.gate.leave()
    bench.gate.begin()
    assert bench.turns(5, 8e-3) == [0.0] * 5


@pytest.mark.parametrize("latch", ["trip", "stop"])
def test_latched_faults_survive_the_loop(latch):
    bench = tripped() if latch == "trip" else Bench().run()
    if latch == "stop":
        bench.gate.emergency_stop()
    state, causes = bench.gate.state, bench.gate.causes[:1]
    bench.gate.leave()
    bench.gate.begin()
    bench.turns(5)
    assert (bench.gate.state, bench.gate.causes[:1]) == (state, causes)
    assert bench.gate.enable() is not None


def test_a_hold_of_a_dead_controller_ends_too():
    bench = Bench(on_command_stale="hold", hold_time=0.01, ramp_time=0.01).run(1e-3)
    written = bench.turns(20 + 10 + 10, None)
    assert written[-1] == 0.0
    assert bench.gate.state == "ramping"


# The clock


@pytest.mark.parametrize(
    "steps", [[0.0], [-1.0], [math.nan], [math.inf], [-math.inf], [1e-3, -0.5], [-1e9, 1e-3], [1e-9], [1.1e-5]]
)
@pytest.mark.parametrize("reaction", ["ramp", "cut"])
def test_a_dead_controller_is_detected_whatever_the_clock_does(steps, reaction):
    bench = Bench(on_command_stale=reaction, ramp_time=0.0).run(1e-3)
    written = []
    for k in range(22):
        bench.sense()
        time = bench.time + steps[k % len(steps)]
        bench.time = time if math.isfinite(time) else bench.time
        written.append(bench.gate.step(time))
    assert written[-1] == 0.0
    assert bench.gate.state == {"ramp": "ramping", "cut": "cut"}[reaction]


def test_a_stopped_clock_does_not_stop_the_ramp():
    bench = Bench(on_velocity="ramp", acceleration=1e5, ramp_time=0.01).run(1e-3)
    bench.turns(2, velocity=1.9)
    assert bench.gate.state == "ramping"
    for _ in range(10):
        bench.sense()
        bench.step(elapsed=1e-9)
    assert bench.gate.output == 0.0


def test_a_clock_that_steps_back_is_reported_and_the_loop_continues():
    bench = Bench().run(1e-3)
    bench.sense()
    bench.gate.take(bench.cycle - 1, 1e-3, "controller")
    assert bench.step(elapsed=-3600.0) == 1e-3
    assert bench.counts() == {"clock": 1}
    assert bench.turns(100) == [1e-3] * 100
    assert bench.gate.detectors["clock"].raised is False


# A second sender


def test_a_second_controller_is_refused_and_named():
    bench = Bench().run(1e-3)
    for _ in range(100):
        bench.sense()
        assert not bench.gate.take(bench.cycle - 1, -5e-3, "stranger")
        assert bench.gate.take(bench.cycle - 1, 1e-3, "controller")
        assert bench.step() == 1e-3
    assert bench.counts() == {"second_sender": 100}
    assert bench.gate.detectors["second_sender"].subject == "stranger"
    level, message, figures = bench.gate.health()
    assert level == WARN
    assert "second_sender" in message
    assert figures["owner"] == "controller"


def test_a_second_controller_cannot_slip_in_within_the_first_cycle():
    bench = Bench()
    bench.sense()
    assert bench.gate.take(0, 1e-3, "controller")
    assert not bench.gate.take(0, 2e-3, "stranger")
    assert bench.gate.owner == "controller"
    assert bench.counts() == {"second_sender": 1}


def test_bad_values_of_a_second_controller_do_not_count_as_the_owners():
    bench = Bench(on_command_not_finite="cut").run(1e-3)
    bench.sense()
    bench.gate.take(bench.cycle - 1, math.nan, "stranger")
    bench.gate.take(bench.cycle - 1, 1e-3, "controller")
    assert bench.step() == 1e-3


def test_the_actuator_is_free_once_its_owner_is_silent():
    bench = Bench().run(1e-3)
    bench.turns(25, None)
    bench.turn(1e-3, "successor")
    assert bench.gate.owner == "successor"
    assert bench.gate.state == "cut"


def test_the_actuator_is_free_once_the_gate_is_disabled():
    bench = Bench().run(1e-3)
    bench.gate.disable()
    bench.turn(1e-3, "successor")
    assert bench.gate.owner == "successor"


def handed_over(**parameters):
    """Return a rig whose actuator has just been handed over to the second controller."""
    bench = Bench(**parameters).run(1e-3)
    bench.gate.hand_over("successor")
    return bench


def test_a_hand_over_lets_the_successor_drive_at_once():
    bench = handed_over()
    assert bench.turn(1.1e-3, "successor") == 1.1e-3
    assert (bench.gate.owner, bench.gate.state, bench.counts()) == ("successor", "active", {})


def test_the_last_commands_of_the_one_that_left_are_dropped_and_later_ones_reported():
    bench = handed_over()
    for _ in range(2):
        bench.sense()
        assert not bench.gate.take(bench.cycle - 1, -1e-3, "controller")
        assert bench.gate.take(bench.cycle - 1, 1e-3, "successor")
        assert bench.step() == 1e-3
    assert bench.counts() == {}
    bench.turns(25, sender="successor")
    assert not bench.gate.take(bench.cycle - 1, -1e-3, "controller")
    assert bench.counts() == {"second_sender": 1}


def test_a_successor_that_never_answers_trips_the_gate_as_any_silence():
    bench = handed_over()
    bench.turns(25, sender="controller")
    assert bench.gate.state == "cut"
    assert bench.causes_named() == ["command_stale"]


def test_while_the_gate_holds_nobody_takes_a_silent_owners_place():
    bench = Bench(on_command_stale="hold", hold_time=0.05).run(1e-3)
    bench.turns(25, None)
    assert bench.gate.state == "holding"
    bench.turn(-1e-3, "stranger")
    assert (bench.gate.owner, bench.gate.vacant) == ("controller", False)
    bench.turns(80, None)
    bench.turn(1e-3, "stranger")
    assert bench.gate.owner == "stranger"


# Trips and reset


def tripped(**parameters):
    bench = Bench(**parameters).run(1e-3)
    bench.turns(5, force=2e4)
    return bench


def test_a_trip_records_its_first_cause_and_lists_later_ones():
    bench = Bench(pressure_rate=1e11).run(1e-3)
    bench.turns(2, force=1.7e4, load_pressure=6e6)
    first = bench.gate.causes[0]
    assert (first.detector, first.reaction, first.value, first.unit) == ("force", "cut", 1.7e4, "N")
    assert first.limit == pytest.approx(0.9 * RIG.limits.force)
    assert first.time == pytest.approx(bench.time)
    bench.turns(30, None, load_pressure=9e6)
    named = bench.causes_named()
    assert named[0] == "force"
    assert {"load_pressure", "command_stale"} <= set(named)
    assert len(named) == len(set(named))


def test_a_trip_never_clears_without_a_reset():
    bench = tripped()
    assert bench.turns(10_000) == [0.0] * 10_000
    assert bench.gate.state == "cut"
    assert bench.gate.enable() is not None
    bench.gate.disable()
    assert bench.turns(10) == [0.0] * 10
    assert bench.gate.state == "cut"


def test_reset_is_refused_while_the_cause_persists():
    bench = tripped()
    assert bench.gate.reset() == "force persists"
    assert bench.gate.state == "cut"
    bench.turn()
    # The step back from 20 kN was a jump.
    bench.turns(5)
    assert bench.gate.reset() is None
    assert bench.gate.state == "disabled"
    assert bench.gate.causes == []


def test_reset_is_refused_before_null_is_reached():
    bench = Bench(ramp_time=0.1, acceleration=1e4).run(5e-3)
    bench.turns(2, 5e-3, velocity=1.9)
    bench.turns(10, 5e-3)
    assert bench.gate.state == "ramping"
    assert bench.gate.reset() == "not at null yet"
    bench.turns(100)
    assert bench.gate.reset() is None


def test_after_a_reset_the_gate_must_be_enabled():
    bench = tripped()
    bench.turns(30)
    bench.gate.reset()
    assert bench.turns(50) == [0.0] * 50
    assert bench.gate.enable() is None
    assert bench.turns(5)[-1] == 1e-3


def test_a_cut_overrides_a_ramp_but_not_vice_versa():
    bench = Bench(on_velocity="ramp", on_force="cut", ramp_time=0.2).run(8e-3)
    bench.turns(3, 8e-3, velocity=1.9)
    assert bench.gate.state == "ramping"
    assert bench.gate.output > 7e-3
    bench.turns(2, 8e-3, force=1.7e4)
    assert (bench.gate.state, bench.gate.output) == ("cut", 0.0)
    bench.turns(3, 8e-3, velocity=1.9)
    assert bench.gate.state == "cut"


# Emergency stop


@pytest.mark.parametrize("prepare", [Bench, lambda: Bench().run(), tripped])
def test_emergency_stop_cuts_and_latches_in_any_state(prepare):
    bench = prepare()
    stop = bench.gate.emergency_stop()
    assert bench.turn() == 0.0
    assert bench.gate.state == "stopped"
    assert "emergency_stop" in bench.causes_named()
    bench.turns(50)
    assert bench.gate.enable() == bench.gate.reset() == f"{stop} is engaged; acknowledge_stop first"
    bench.wall += STOP_TIME
    assert bench.gate.acknowledge(stop) is None
    assert bench.turns(50) == [0.0] * 50
    assert bench.gate.state == "cut"
    assert bench.gate.reset() is None


def test_an_emergency_stop_shorter_than_a_cycle_counts():
    bench = Bench().run(5e-3)
    stop = bench.gate.emergency_stop()
    bench.wall += STOP_TIME
    bench.gate.acknowledge(stop)
    assert bench.turn(5e-3) == 0.0
    assert bench.gate.state == "cut"


def test_an_emergency_stop_is_released_only_by_its_name_and_not_at_once():
    bench = Bench().run(5e-3)
    assert bench.gate.acknowledge("stop-1") == "no emergency stop is engaged"
    first = bench.gate.emergency_stop()
    for name in ("", "stop", "stop-0", "stop-2", "emergency_stop"):
        assert f"is {first}, not" in bench.gate.acknowledge(name)
    bench.wall += 0.99 * STOP_TIME
    assert "old; it lasts" in bench.gate.acknowledge(first)
    second = bench.gate.emergency_stop()
    bench.wall += 0.5 * STOP_TIME
    assert f"is {second}, not '{first}'" in bench.gate.acknowledge(first)
    assert "old; it lasts" in bench.gate.acknowledge(second)
    bench.wall += 0.5 * STOP_TIME
    assert bench.gate.acknowledge(second) is None
    assert bench.causes_named() == ["emergency_stop"]


def test_faults_add_to_a_stop_and_do_not_end_it():
    bench = Bench().run(5e-3)
    bench.gate.emergency_stop()
    bench.turns(5, force=2e4)
    assert bench.gate.state == "stopped"
    assert bench.causes_named()[:2] == ["emergency_stop", "force"]


# Parameters


NUMBERS = [d.name for d in declarations(Parameters) if d.kind is float]
TEXTS = [d.name for d in declarations(Parameters) if d.kind is str]


def test_every_parameter_is_a_number_or_a_reaction_with_a_default_and_help():
    assert {*NUMBERS, *TEXTS} == set(Parameters._fields)
    assert all(d.default is not None and d.description for d in declarations(Parameters))
    assert all(name.startswith("on_") for name in TEXTS)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e30, -1e30, "off"])
@pytest.mark.parametrize("name", NUMBERS)
def test_no_parameter_accepts_an_invalid_or_out_of_range_number(name, bad):
    bench = Bench()
    before = bench.gate.parameters
    with pytest.raises(BadInput, match=name):
        bench.gate.retune(before._replace(**{name: bad}))
    assert bench.gate.parameters == before


@pytest.mark.parametrize("bad", ["", "WARN", "cut\n", "none", 1])
@pytest.mark.parametrize("name", TEXTS)
def test_no_reaction_accepts_an_unknown_word(name, bad):
    with pytest.raises(BadInput, match=name):
        Bench(**{name: bad})


PROTECTIVE = ("on_force", "on_load_pressure", "on_velocity", "on_position", "on_sensor_stale")


@pytest.mark.parametrize(
    ("name", "reaction"),
    [
        ("on_command_stale", "warn"),
        ("on_sensor_not_finite", "warn"),
        *((name, reaction) for name in PROTECTIVE for reaction in ("warn", "hold")),
    ],
)
def test_the_protection_of_the_rig_cannot_be_set_too_mild(name, reaction):
    with pytest.raises(BadInput, match=name):
        Bench(**{name: reaction})


@pytest.mark.parametrize("name", Parameters._fields)
def test_an_open_gate_accepts_stronger_protection_and_refuses_weaker(name):
    declared = {d.name: d for d in declarations(Parameters)}[name]
    if declared.kind is str:
        allowed = [word for word in REACTIONS if permitted(name, word)]
        weak, strong = allowed[0], allowed[-1]
    else:
        weak, strong = min(1.01 * declared.default, declared.maximum), 0.99 * declared.default
        if name in PROTECTS_WHEN_LARGER:
            weak, strong = strong, weak
    bench = Bench(enable_time=0.5, **({name: weak} if name != "enable_time" else {}))
    bench.turn(1e-3)
    bench.gate.enable()
    bench.turns(3, 1e-3)
    middle = bench.gate.parameters._replace(**{name: strong})
    bench.gate.retune(middle)
    with pytest.raises(BadInput, match=f"{name} .*weaker"):
        bench.gate.retune(middle._replace(**{name: weak}))
    assert bench.gate.parameters == middle
    bench.gate.disable()
    bench.gate.retune(middle._replace(**{name: weak}))
    assert any(name in line and "weaker" in line for key, line in bench.gate.health()[2].items() if key.startswith("change_"))


BOUND = {
    "command_timeout": 0.031,
    "sensor_timeout": 0.031,
    "hold_time": 0.031,
    "ramp_time": 0.031,
    "limit_time": 0.031,
    "command_rate": 4.01,
    "enable_time": 0.08,
    "position_margin": -0.001,
}
"""Just beyond the bounds of this rig: 0.6 m of stroke, 2 m/s, 10 mm of spool, 111 rad/s, 1 ms."""


@pytest.mark.parametrize(("name", "value"), [*BOUND.items(), ("command_rate", 1e-9), ("enable_time", 0.0)])
def test_no_parameter_exceeds_the_bounds_of_the_rig(name, value):
    gate = Gate(RIG, PERIOD)
    with pytest.raises(BadInput, match=f"{name}.*for this rig"):
        gate.retune(gate.parameters._replace(**{name: value}))
    with pytest.raises(BadInput, match=f"{name}.*for this rig"):
        Gate(RIG, PERIOD, Parameters(**{name: value}))


def test_the_defaults_follow_the_spool_and_are_clipped_for_a_faster_and_shorter_rig():
    limits = RIG.limits._replace(velocity=5.0, position=(-0.1, 0.1), spool=1e-3)
    short = RIG._replace(limits=limits)
    gate = Gate(short, PERIOD)
    assert gate.parameters.command_timeout == pytest.approx(0.004)
    # Scaled with the spool, 2 m/s for 10 mm, it would be 0.2 m/s.
    assert gate.parameters.command_rate == pytest.approx(0.25)
    for periods, rate in ((2.0, 0.2), (4.0, 0.1)):
        assert Gate(short, periods * PERIOD).parameters.command_rate == pytest.approx(rate)


def test_another_limit_applies_from_the_next_cycle():
    bench = Bench().run(1e-3)
    bench.turns(3, force=1e3)
    bench.gate.disable()
    bench.gate.retune(bench.gate.parameters._replace(trip_level=0.05, on_force="ramp"))
    bench.gate.enable()
    bench.turns(3, force=1e3)
    assert bench.gate.causes[0][:2] == ("force", "ramp")


@pytest.mark.parametrize("period", [0.0, -1e-3, math.nan, math.inf, 1.0, "1 ms"])
def test_an_invalid_period_is_refused(period):
    with pytest.raises(BadInput, match="period"):
        Gate(RIG, period)


@pytest.mark.parametrize(
    ("limit", "bad"), [("spool", math.nan), ("spool", math.inf), ("force", -1.0), ("velocity", 0.0), ("position", (0.3, -0.3))]
)
def test_a_rig_with_invalid_limits_is_refused(limit, bad):
    with pytest.raises(BadInput, match=limit):
        Gate(RIG._replace(limits=RIG.limits._replace(**{limit: bad})), PERIOD)


def test_an_unknown_signal_is_refused():
    with pytest.raises(BadInput, match="speed"):
        Gate(RIG, PERIOD, measured=("position", "speed"))


# Diagnostics


def test_diagnostics_show_every_limit_reaction_and_count():
    bench = Bench().run(1e-3)
    level, message, figures = bench.gate.health()
    assert (level, message) == (OK, "active")
    assert set(Parameters._fields) <= set(figures)
    assert {f"fault_{name}" for name in bench.gate.detectors} <= set(figures)
    assert figures["fault_force"] == "cut beyond 16380 N, 0 times"
    assert figures["output_limit_m"] == LIMIT


def test_diagnostics_name_the_first_cause_of_a_trip():
    bench = tripped()
    level, message, figures = bench.gate.health()
    assert level == ERROR
    assert message.startswith("cut, tripped by ")
    assert figures["cause_1"].endswith(("cut", "ramp"))


def test_a_past_fault_is_shown_for_a_while():
    bench = Bench().run(1e-3)
    bench.turn(math.nan)
    bench.turns(100)
    assert bench.gate.health()[0] == WARN
    bench.turns(2000)
    assert bench.gate.health()[0] == OK


# Each detector with each reaction


def fails(bench):
    """Load a specimen of 2e7 N/m cyclically, and then without force at the same motion."""
    bench.gate.disable()
    bench.gate.retune(bench.gate.parameters._replace(stiffness_drop=0.5, acceleration=1e5))
    bench.turns(30)
    assert bench.gate.enable() is None
    for k in range(1600):
        # 50 Hz; the moving mass has its share of the force.
        angle = 2.0 * math.pi * k / 20.0
        force = (6e3 - 70.0 * 3e-4 * (100.0 * math.pi) ** 2) * math.sin(angle)
        bench.turn(
            position=3e-4 * math.sin(angle),
            velocity=3e-4 * 100.0 * math.pi * math.cos(angle),
            force=force,
            load_pressure=force / AREA,
        )
    assert bench.gate.state == "active"
    bench.turns(3, position=3e-4, force=-70.0 * 3e-4 * (100.0 * math.pi) ** 2)


FAULTS = {
    "command_not_finite": lambda bench: bench.turn(math.nan),
    "command_range": lambda bench: bench.turn(0.02),
    "command_rate": lambda bench: bench.turn(6e-3),
    "command_stale": lambda bench: bench.turns(20, None),
    "command_order": lambda bench: (bench.gate.take(bench.cycle + 5, 1e-3, "controller"), bench.turn()),
    "second_sender": lambda bench: (bench.gate.take(bench.cycle - 1, 1e-3, "stranger"), bench.turn()),
    "force": lambda bench: bench.turns(2, force=1.7e4),
    "load_pressure": lambda bench: bench.turns(2, load_pressure=6.5e6),
    "velocity": lambda bench: bench.turns(2, velocity=1.9),
    "position": lambda bench: bench.turns(2, position=0.29),
    "force_error": lambda bench: bench.turns(2000, reference=2.1e3),
    "sensor_not_finite": lambda bench: bench.turn(force=math.nan),
    "sensor_range": lambda bench: bench.turn(force=1e6),
    "sensor_jump": lambda bench: bench.turn(position=0.1),
    "sensor_frozen": lambda bench: [bench.turn(1e-3 + 5e-6 * k, position=1e-4) for k in range(60)],
    "sensor_mismatch": lambda bench: bench.turns(20, force=1.1e3),
    "specimen": fails,
    "sensor_stale": lambda bench: [bench.step() for _ in range(20)],
    "clock": lambda bench: (bench.sense(), bench.gate.take(bench.cycle - 1, 1e-3, "controller"), bench.step(elapsed=-1.0)),
}


def permitted(name, reaction):
    """Return whether a reaction is allowed for a fault."""
    try:
        parse(Parameters, {name: reaction}, "test")
    except BadInput:
        return False
    return True


OWN_ONLY = {f"on_{name}": next(word for word in REACTIONS if permitted(f"on_{name}", word)) for name in FAULTS}
OWN_ONLY["on_command_stale"] = "cut"


def test_every_reaction_has_a_fault_here():
    assert {f"on_{name}" for name in FAULTS} == set(TEXTS)


CHOICES = [(name, reaction) for name in FAULTS for reaction in REACTIONS if permitted(f"on_{name}", reaction)]


@pytest.mark.parametrize(("name", "reaction"), CHOICES)
def test_each_fault_has_the_chosen_reaction(name, reaction):
    # All other reactions are as mild as possible, and the watchdog is slow.
    wide = {"command_timeout": 0.1} if name == "sensor_stale" else {}
    bench = Bench(**{**OWN_ONLY, f"on_{name}": reaction, "hold_time": 0.1, "ramp_time": 0.2, **wide}).run(1e-3)
    FAULTS[name](bench)
    states = {"warn": "active", "hold": "holding", "position": "position control", "unload": "unloading", "ramp": "ramping"}
    # These faults are in the position here, by which the piston would be held.
    blind = name in {"sensor_jump", "sensor_frozen"} and reaction == "position"
    assert bench.gate.state == ("ramping" if blind else states.get(reaction, reaction))
    found = [d.name for d in bench.gate.detectors.values() if d.count and d.parameter == f"on_{name}"]
    assert found
    if reaction not in {"warn", "hold"}:
        assert bench.gate.causes[0].detector == found[0]
        assert bench.gate.causes[0].reaction == reaction
    else:
        assert bench.gate.causes == []
    if reaction == "cut":
        assert bench.gate.output == 0.0
    assert bench.gate.state in STATES


# Garbage


@pytest.mark.parametrize("garbage", [None, "x", [], {}, object(), b"1", 10**400, (1, 2), 1j])
def test_no_call_raises_on_garbage(garbage):
    bench = Bench().run(1e-3)
    gate = bench.gate
    gate.sense(garbage, garbage, garbage)
    gate.sense(bench.cycle, garbage, garbage)
    gate.sense(bench.cycle + 1, [garbage] * 7, garbage)
    gate.take(garbage, garbage, "controller")
    gate.take(bench.cycle + 1, garbage, "controller")
    for _ in range(50):
        written = gate.step(garbage)
        assert math.isfinite(written)
        assert abs(written) <= LIMIT
    assert written == 0.0


def test_operators_in_other_threads_do_not_disturb_the_loop():
    bench = Bench().run(1e-3)
    done = threading.Event()

    def operate():
        while not done.is_set():
            bench.gate.health()
            bench.gate.retune(bench.gate.parameters)
            bench.gate.enable()
            bench.gate.reset()

    with ThreadPoolExecutor(2) as operators:
        operating = [operators.submit(operate) for _ in range(2)]
        try:
            assert set(bench.turns(3000)) == {1e-3}
            bench.gate.emergency_stop()
            assert set(bench.turns(100)) == {0.0}
        finally:
            done.set()
        assert [each.result() for each in operating] == [None, None]
    assert bench.causes_named() == ["emergency_stop"]
