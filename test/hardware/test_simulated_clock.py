"""The time of a simulated rig is the wall's on a computer that keeps up, and slower on one that does not."""

import pytest

from ehls_ros.hardware.simulated_clock import HOPE, SPARE, SimulatedClock

PERIOD = 1e-3
LATE = 5e-6
"""How much later than wanted whoever waits is awake [s]."""


class Rig:
    """A clock and a controller that takes its time."""

    def __init__(self) -> None:
        self.now = 10.0
        self.clock = SimulatedClock(PERIOD, self.now)
        self.cycles = 0
        self.told: list[tuple[float, str]] = []

    def run(self, cycles: int, takes: float | None) -> float:
        """Let cycles pass, each answered after a time, or never; return how long they took."""
        start = self.now
        for _ in range(cycles):
            comes = self.now + takes if takes is not None else float("inf")
            while (remaining := self.clock.remaining(self.now, answered=comes <= self.now)) > 0.0:
                wakes = self.now + remaining
                self.now = (comes if self.now < comes < wakes else wakes) + LATE
            if self.clock.end(self.now, answered=comes <= self.now, expected=True):
                self.told.append((self.now - 10.0, self.clock.pace.complaint))
            self.cycles += 1
        return self.now - start


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_a_computer_that_keeps_up_keeps_the_wall_clock_to_the_last_cycle(rig):
    assert rig.run(3000, 0.4e-3) == pytest.approx(3.0, abs=2 * LATE)
    assert (rig.clock.missed, rig.clock.slipped, rig.told) == (0, 0.0, [])


def test_one_late_answer_is_met_by_holding_and_costs_no_time(rig):
    for _ in range(100):
        rig.run(19, 0.4e-3)
        rig.run(1, 1.5e-3)
    assert rig.clock.missed == 100
    assert rig.clock.slipped == 0.0
    assert rig.now - 10.0 == pytest.approx(2.0, abs=2 * LATE)


@pytest.mark.parametrize("takes", [2.5e-3, 5e-3, 20e-3])
def test_too_slow_a_computer_is_waited_for_and_told_of_within_a_second(rig, takes):
    took = rig.run(1000, takes)
    assert rig.clock.missed == 2
    assert took == pytest.approx(1000 * takes * (1.0 + SPARE), rel=0.02)
    assert rig.clock.slipped == pytest.approx(took - 1.0, abs=0.01)
    assert rig.told[0][0] < 1.0
    assert rig.told[0][1].startswith("too slow: ")


def test_once_the_computer_keeps_up_again_so_does_the_time(rig):
    rig.run(500, 3e-3)
    assert rig.clock.waiting
    slipped = rig.clock.slipped
    assert rig.run(2000, 0.4e-3) == pytest.approx(2.0, abs=2 * LATE + PERIOD)
    assert rig.clock.slipped == slipped
    assert not rig.clock.waiting
    assert rig.told[-1][1] == ""


def test_a_controller_that_is_gone_is_waited_for_once(rig):
    rig.run(100, 0.4e-3)
    assert rig.run(1000, None) == pytest.approx(1.0 + HOPE, abs=0.01)
    assert rig.told == []
    rig.run(100, 0.4e-3)
    assert rig.run(100, None) == pytest.approx(0.1 + HOPE, abs=0.01)


def test_a_computer_that_was_away_goes_on_from_now(rig):
    rig.run(100, 0.4e-3)
    rig.now += 0.3
    assert rig.run(100, 0.4e-3) == pytest.approx(0.1, abs=2 * PERIOD)
    assert rig.clock.slipped == pytest.approx(0.3, abs=2 * PERIOD)
    assert rig.clock.missed <= 1
