"""Faults that the safety gate detects in the readings, and harmless readings that it accepts."""

import math

import pytest
from safety_gate_bench import AREA, PERIOD, RIG, Bench

from ehls_ros.hardware.safety_gate import Gate
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import SENSED

QUIET = {"pressure_rate": 1e11, "acceleration": 1e5, "force_mismatch": 1e5, "position_mismatch": 1.0, "supply_mismatch": 1e8}
"""Disables all checks except the limit under test."""

UNMEASURED = tuple(signal for signal in SENSED if signal != "velocity")


# Limits


LIMITS = [("force", 0.9 * 1.82e4), ("load_pressure", 0.9 * 7e6), ("velocity", 0.9 * 2.0)]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("signal", "limit"), LIMITS)
def test_a_limit_trips_once_it_has_been_exceeded_for_its_time(signal, limit, side):
    bench = Bench(**QUIET).run()
    bench.turns(100, **{signal: side * 0.9999 * limit})
    assert bench.gate.state == "active"
    bench.turn(**{signal: side * 1.0001 * limit})
    bench.turn(**{signal: side * 0.9999 * limit})
    bench.turn(**{signal: side * 1.0001 * limit})
    assert bench.gate.state == "active"
    bench.turn(**{signal: side * 1.0001 * limit})
    assert bench.causes_named() == [signal]
    assert bench.gate.causes[0].value == side * 1.0001 * limit
    assert bench.gate.causes[0].limit == pytest.approx(limit)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_beyond_an_end_of_the_stroke_only_commands_back_are_permitted(side):
    bench = Bench().run(side * 1e-3, position=side * 0.27, velocity=0.1 * side)
    while bench.gate.state == "active":
        position = side * (0.27 + 1e-4 * bench.cycle)
        bench.turn(side * 1e-3, position=position, velocity=side * (0.1 + 1e-9 * bench.cycle))
    assert bench.causes_named() == ["position"]
    assert 0.285 < abs(position) < 0.2853
    # At null no command leads further out: the gate may be reset and the piston driven back, but not on.
    bench.turns(5, 0.0, position=position)
    assert bench.gate.reset() is None
    bench.turn(-side * 1e-3, position=position)
    assert bench.gate.enable() is None
    for k in range(50):
        bench.turn(-side * 1e-3, position=position - 1e-6 * side * k)
    assert bench.gate.state == "active"
    bench.turns(4, side * 1e-3, position=position)
    assert bench.causes_named() == ["position"]


def test_velocity_is_computed_from_positions_if_it_is_not_measured():
    bench = Bench(UNMEASURED).run(position=-0.25)
    speed, position = 0.0, -0.25
    while bench.gate.state == "active" and position < 0.25:
        speed += 0.02
        position += speed * PERIOD
        bench.turn(position=position, velocity=math.nan)
    assert bench.causes_named() == ["velocity"]
    # The smoothing delays by its time constant.
    assert 1.8 < speed < 1.8 + 0.02 * 10


def test_a_slow_piston_with_a_coarse_position_is_not_taken_for_a_fast_one():
    bench = Bench(UNMEASURED).run()
    for k in range(2000):
        bench.turn(position=5e-6 * round(0.1 * k * PERIOD / 5e-6) + 5e-6 * (k % 2), velocity=math.nan)
    assert bench.counts() == {}


def test_an_error_of_the_force_must_last():
    bench = Bench(force_error=1e3, force_error_time=0.5, force_mismatch=1e5).run()
    bench.turns(499, reference=1.1e3)
    bench.turn(reference=0.0)
    bench.turns(499, reference=-1.1e3)
    assert bench.gate.state == "active"
    bench.turn(reference=-1.1e3)
    assert bench.causes_named() == ["force_error"]


def test_no_force_error_without_a_reference_or_before_enabling():
    bench = Bench()
    bench.turns(5000, reference=1e4)
    assert bench.gate.enable() is None
    bench.turns(5000, reference=math.nan)
    assert bench.counts() == {}


def test_after_a_trip_there_is_no_force_error():
    bench = Bench(force_error_time=0.1).run()
    bench.turns(200, reference=5e3)
    assert bench.causes_named() == ["force_error"]
    bench.turns(200, reference=5e3)
    assert bench.gate.reset() is None


# Implausible readings


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("signal", SENSED)
def test_a_non_finite_reading_is_bridged_and_trips_when_it_lasts(signal, bad):
    bench = Bench().run(1e-3)
    assert bench.turn(1.5e-3, **{signal: bad}) == 1e-3
    assert bench.turn(1.5e-3) == 1.5e-3
    bench.turns(40, **{signal: bad})
    assert bench.gate.causes[0].detector == "sensor_not_finite"
    assert bench.gate.causes[0].subject == signal
    assert bench.gate.output == 0.0


@pytest.mark.parametrize("signal", SENSED)
def test_an_unmeasured_signal_is_ignored(signal):
    bench = Bench(tuple(other for other in SENSED if other != signal)).run()
    for value in (math.nan, math.inf, 1e30, -1e30, 0.0) * 20:
        bench.turn(**{signal: value})
    assert bench.counts() == {}


@pytest.mark.parametrize(
    ("signal", "value"),
    [
        ("position", 0.46), ("velocity", -3.1), ("load_pressure", 1.06e7), ("spool_position", 0.016), ("force", -2.8e4),
        ("supply_pressure", -1e6), ("supply_pressure", 1.1e7), ("oil_temperature", 0.0), ("oil_temperature", 500.0),
    ],
)  # fmt: skip
def test_a_reading_out_of_its_range_is_seen(signal, value):
    bench = Bench().run()
    bench.turn(**{signal: value})
    assert bench.gate.causes[0].detector == "sensor_range"
    assert bench.gate.causes[0].subject == signal


JUMPS = {
    "position": 0.05,
    "velocity": 1.2,
    "load_pressure": 4.5e6,
    "spool_position": 9e-3,
    "force": 1.2e4,
    "supply_pressure": 9.5e6,
}


@pytest.mark.parametrize("signal", JUMPS)
def test_an_implausible_step_is_detected_at_once(signal):
    bench = Bench().run()
    bench.turn(**{signal: JUMPS[signal]})
    assert bench.gate.causes[0].detector == "sensor_jump"
    assert bench.gate.causes[0].subject == signal


def test_a_step_is_compared_with_the_time_since_the_last_good_reading():
    bench = Bench(position_mismatch=1.0).run()
    bench.turns(10, position=math.nan, velocity=0.0)
    bench.turn(position=0.03)
    assert "sensor_jump" not in bench.counts()
    bench.turn(position=0.05)
    assert bench.counts()["sensor_jump"] == 1


def test_value_and_limit_of_a_lasting_fault_are_those_of_one_signal():
    bench = Bench(on_sensor_jump="warn", on_sensor_mismatch="warn").run()
    bench.turn(velocity=1.5)
    bench.turn(load_pressure=6e6)
    detector = bench.gate.detectors["sensor_jump"]
    assert (detector.subject, detector.unit, detector.limit, detector.count) == ("velocity", "m/s/s", 1e3, 1)


def test_noise_is_not_a_jump():
    gate = Gate(RIG._replace(sensors={"position": Sensor(noise_std=1e-3)}), PERIOD)
    gate.begin()
    for k in range(100):
        gate.sense(k, [4e-3 * (-1) ** k, 0.0, 0.0, 0.0, 0.0, 7e6, 313.0])
    assert gate.detectors["sensor_jump"].count == 0


# Frozen readings


MOVING = SENSED[:5]


@pytest.mark.parametrize("signal", MOVING)
def test_an_unchanged_reading_is_frozen_if_the_command_moves(signal):
    bench = Bench().run(0.0)
    for k in range(100):
        bench.turn(1e-5 * k, **{signal: 0.0})
    assert bench.gate.causes[0].detector == "sensor_frozen"
    assert bench.gate.causes[0].subject == signal
    # Still frozen, although the command is at null now.
    bench.turns(100, **{signal: 0.0})
    assert bench.gate.reset() == "sensor_frozen persists"
    bench.turns(5)
    assert bench.gate.reset() is None


def test_unchanged_readings_of_a_rig_at_rest_are_accepted():
    still = dict.fromkeys(MOVING, 0.0)
    bench = Bench().run(1e-4, **still)
    for k in range(5000):
        bench.turn(1e-4 + 5e-5 * math.sin(0.01 * k), **still)
    assert bench.counts() == {}


def test_a_reading_without_noise_has_time_to_answer_a_step():
    bench, value = Bench().run(0.0), 0.0
    for command in (1e-3, 0.0, -1e-3, 0.0):
        for cycle in range(100):
            # The reading answers after two cycles, and is then as steady as the command.
            value = command if cycle == 2 else value
            bench.turn(command, spool_position=value)
    assert "sensor_frozen" not in bench.counts()


def test_a_coarse_reading_that_changes_now_and_then_is_not_frozen():
    bench = Bench().run(0.0)
    for k in range(5000):
        bench.turn(2e-3 * math.sin(0.006 * k), position=1e-3 * (k // 40 % 2))
    assert bench.counts() == {}


def test_supply_pressure_and_oil_temperature_may_stay_constant():
    bench = Bench().run(0.0)
    for k in range(2000):
        bench.turn(2e-3 * math.sin(0.01 * k))
    assert bench.counts() == {}


# Contradictory readings


def test_force_and_load_pressure_must_agree():
    bench = Bench(mismatch_time=0.01).run()
    bench.turns(100, force=AREA * 5e5, load_pressure=5e5)
    bench.turns(100, force=AREA * 5e5 + 990.0, load_pressure=5e5)
    assert bench.gate.state == "active"
    bench.turns(9, force=AREA * 5e5 - 1010.0, load_pressure=5e5)
    assert bench.gate.state == "active"
    bench.turn(force=AREA * 5e5 - 1010.0, load_pressure=5e5)
    assert bench.causes_named() == ["force_mismatch"]


def test_travel_and_velocity_must_agree():
    bench = Bench().run(velocity=0.6, cycles=1)
    for k in range(2000):
        bench.turn(position=0.1 * math.sin(0.006 * k), velocity=0.6 * math.cos(0.006 * k))
    assert bench.counts() == {}
    bench = Bench().run()
    for k in range(200):
        bench.turn(position=1e-4 * k, velocity=1e-9 * k)
    assert bench.causes_named() == ["position_mismatch"]


def test_load_pressure_must_stay_below_the_supply():
    bench = Bench(force_mismatch=1e5).run()
    for k in range(1000):
        bench.turn(supply_pressure=7e6 - 6e3 * k, load_pressure=2e6, force=AREA * 2e6)
    assert bench.gate.causes[0].detector == "supply_mismatch"
    # The supply was then 0.7 MPa below the load pressure, and fell further during mismatch_time.
    assert 7e5 < bench.gate.causes[0].value < 9e5


# Silence


def test_missing_snapshots_trip_after_their_timeout():
    bench = Bench(on_command_stale="hold", hold_time=0.1, sensor_timeout=0.01).run(1e-3)
    written = [bench.step() for _ in range(20)]
    assert written[:9] == [1e-3] * 9
    assert set(written[9:]) == {0.0}
    assert bench.causes_named()[0] == "sensor_stale"


def test_a_repeated_snapshot_is_not_new():
    bench = Bench(on_command_stale="hold", hold_time=0.1).run(1e-3)
    old = bench.cycle - 1
    for _ in range(25):
        bench.gate.sense(old, [0.0] * 5 + [7e6, 313.0])
        bench.gate.sense(old - 3, [0.0] * 5 + [7e6, 313.0])
        bench.step()
    assert bench.gate.causes[0].detector == "sensor_stale"


@pytest.mark.parametrize("readings", [[], [0.0] * 6, [0.0] * 8, None])
def test_a_snapshot_of_another_length_holds_no_readings(readings):
    bench = Bench(on_sensor_not_finite="cut").run()
    bench.gate.sense(bench.cycle, readings)
    assert bench.step() == 0.0
    assert bench.causes_named()[0] == "sensor_not_finite"
