"""The monitor's samples: cycles assembled on an axis that only increases."""

import numpy as np
import pytest

from ehls_ros.experiments.monitoring.cycle_assembly import MIN_PAUSE, SETTLING, Anchor, CycleAssembler, LoaderSnapshot

PERIOD = 1e-3
WALL = 1_700_000_000 * 10**9


def snapshots(first: int, count: int, epoch_ns: int = WALL, sent_ns: int | None = None) -> list[LoaderSnapshot]:
    """Return snapshots whose position is their cycle; they were sent at their stamps' time, unless given otherwise."""
    stamps = [epoch_ns + round(cycle * PERIOD * 1e9) for cycle in range(first, first + count)]
    sent = stamps if sent_ns is None else [sent_ns + round(i * PERIOD * 1e9) for i in range(count)]
    return [
        LoaderSnapshot(stamp, first + i, (float(first + i), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), own)
        for i, (stamp, own) in enumerate(zip(stamps, sent, strict=True))
    ]


def commands(first: int, count: int, sender: str = "fasmc", spool: float = 1.0) -> list[tuple[int, float, str, int]]:
    return [(cycle, spool, sender, WALL + round(cycle * PERIOD * 1e9)) for cycle in range(first, first + count)]


def test_a_cycle_waits_for_its_command_and_goes_without_after_a_while():
    assembler = CycleAssembler(PERIOD)
    assembler.add_commands(commands(0, 40))
    [first] = assembler.add_snapshots(snapshots(0, 50))
    assert first.interrupted
    assert first.signals["position_m"].tolist() == list(range(40))
    assert np.all(first.signals["valve_command_m"] == 1.0)
    assembler.add_commands(commands(50, 400))
    [second] = assembler.add_snapshots(snapshots(50, 400))
    assert not second.interrupted
    assert np.flatnonzero(np.isnan(second.signals["valve_command_m"])).tolist() == list(range(10))
    assert assembler.unanswered == 10
    assert second.time_s[0] - first.time_s[-1] == pytest.approx(PERIOD)


def test_a_command_that_was_never_sent_is_not_waited_for_once_later_ones_are_there():
    assembler = CycleAssembler(PERIOD, max_wait=10.0)
    assembler.add_commands(commands(50, 100))
    assert not assembler.add_snapshots(snapshots(0, 150))
    assembler.add_commands(commands(150, 250))
    [stretch] = assembler.add_snapshots(snapshots(150, 250))
    assert len(stretch.time_s) == 399
    assert np.flatnonzero(np.isnan(stretch.signals["valve_command_m"])).tolist() == list(range(50))


def test_only_the_command_of_the_driving_controller_counts():
    assembler = CycleAssembler(PERIOD)
    assembler.add_controller(0, "sic")
    assembler.add_controller(20, "fasmc")
    assembler.add_commands(commands(0, 41, "fasmc", 2.0))
    assembler.add_commands(commands(0, 41, "sic", 1.0))
    [stretch] = assembler.add_snapshots(snapshots(0, 41))
    assert stretch.signals["valve_command_m"].tolist() == [1.0] * 20 + [2.0] * 20


@pytest.mark.parametrize(
    ("epoch_ns", "pause"),
    [(WALL + 3600 * 10**9, 3599.8), (WALL - 3600 * 10**9, MIN_PAUSE)],
    ids=["later", "clock set back"],
)
def test_the_axis_goes_on_over_a_restart_of_the_rig(epoch_ns: int, pause: float):
    assembler = CycleAssembler(PERIOD)
    assembler.add_commands(commands(100, 101))
    [before] = assembler.add_snapshots(snapshots(100, 101))
    sent_ns = before_ns = WALL + 10**12
    assembler.add_commands([(cycle, 5.0, "fasmc", before_ns + 1) for cycle in range(101)])
    left, after = assembler.add_snapshots(snapshots(0, 101, epoch_ns, sent_ns))
    assert len(left.time_s) == 1
    assert after.interrupted
    assert np.all(after.signals["valve_command_m"] == 5.0)
    assert after.time_s[0] - left.time_s[-1] == pytest.approx(pause, abs=0.2)
    assert assembler.runs == 1
    assert assembler.stamp_ns(float(after.time_s[50])) == pytest.approx(epoch_ns + 50 * 10**6, abs=1e6)
    assert assembler.stamp_ns(float(before.time_s[50])) == pytest.approx(WALL + 150 * 10**6, abs=1e6)


def test_a_clock_that_is_set_moves_no_sample_and_an_earlier_axis_goes_on():
    assembler = CycleAssembler(PERIOD, [Anchor(10.0, WALL)], 20.0)
    assembler.add_commands(commands(0, 200))
    epoch_ns = WALL + 100 * 10**9
    stretches = assembler.add_snapshots([*snapshots(0, 100, epoch_ns), *snapshots(100, 101, epoch_ns - 7200 * 10**9)])
    time = np.concatenate([stretch.time_s for stretch in stretches])
    assert np.allclose(np.diff(time), PERIOD)
    assert time[0] == pytest.approx(110.0)
    assert assembler.stamp_ns(110.15) == epoch_ns - 7200 * 10**9 + 150 * 10**6
    assert assembler.stamp_ns(110.05) == epoch_ns + 50 * 10**6


def test_samples_of_a_closed_gate_are_left_out_until_it_has_settled():
    assembler = CycleAssembler(PERIOD)
    assembler.add_commands(commands(0, 4000))
    assembler.add_driving(True, WALL - 1)
    assembler.add_driving(False, WALL + 500 * 10**6 + 1)
    assembler.add_driving(True, WALL + 1000 * 10**6 + 1)
    first, second = assembler.add_snapshots(snapshots(0, 4000))
    # The command of the cycle in which it closed did not reach the valve.
    assert first.signals["position_m"][-1] == 499.0
    assert second.signals["position_m"][0] == pytest.approx(1000.0 + SETTLING / PERIOD, abs=2)
    assert second.interrupted
    assert assembler.driving


def test_lost_cycles_are_counted_and_leave_a_gap():
    assembler = CycleAssembler(PERIOD)
    assembler.add_commands(commands(0, 400))
    [stretch] = assembler.add_snapshots([*snapshots(0, 100), *snapshots(250, 101)])
    assert assembler.lost == 150
    assert np.max(np.diff(stretch.time_s)) == pytest.approx(0.151)
