"""Simulated time follows wall time on a computer that keeps up, and is slower on one that does not."""

import pytest

from ehls_ros.hardware.pace import WINDOW
from ehls_ros.hardware.simulated_clock import CATCH_UP, IDLE_RATIO, MAX_WAIT, SimulatedClock

PERIOD = 1e-3
LATE = 5e-6
"""Delay of a wake-up [s]."""


class Rig:
    """A clock and a controller with a given response time, counted from the start of each cycle if it is prompt."""

    def __init__(self, period: float = PERIOD, prompt: bool = False) -> None:
        self.now = self.start = 10.0
        self.clock = SimulatedClock(period, self.now)
        self.prompt = prompt
        self.expected = False
        self.cycles = 0
        self.reported: list[tuple[float, str]] = []

    def run(self, cycles: int, takes: float | None) -> float:
        """Run cycles, each answered after a time or never; return their total duration."""
        start = self.now
        for _ in range(cycles):
            comes = self.now + takes if takes is not None else float("inf")
            while (remaining := self.clock.remaining(self.now, answered=comes <= self.now)) > 0.0:
                wakes = self.now + remaining
                self.now = (comes if self.now < comes < wakes else wakes) + LATE
            if self.prompt:
                # The plant asks for the answer even if the cycle is over already.
                self.now = max(self.now, comes)
            self.expected |= comes <= self.now
            if self.clock.end(self.now, answered=comes <= self.now, expected=self.expected, prompt=self.prompt):
                self.reported.append((self.now - self.start, self.clock.pace.complaint))
            self.cycles += 1
        return self.now - start


def settled(period: float = PERIOD, prompt: bool = False) -> Rig:
    """Return a rig whose computer has kept up for more than the window in which it is counted."""
    rig = Rig(period, prompt)
    rig.run(round(1.2 * WINDOW / period), 0.4 * period)
    rig.start = rig.now
    return rig


@pytest.fixture
def rig() -> Rig:
    return settled()


def test_the_first_answers_are_awaited():
    rig = Rig()
    rig.run(100, 2.5e-3)
    assert rig.clock.missed == 0


def test_the_start_is_held_up_once_if_nobody_answers():
    assert Rig().run(100, None) == pytest.approx(0.1 + MAX_WAIT, abs=0.01)


@pytest.mark.parametrize("period", [1e-3, 2.5e-4])
def test_time_catches_up_after_a_delay_that_delays_no_answer(period):
    rig = settled(period, prompt=True)
    rig.now += 0.8 * CATCH_UP
    cycles = round(0.1 / period)
    assert rig.run(cycles, 0.4 * period) == pytest.approx(0.1 - 0.8 * CATCH_UP, abs=2 * period)
    assert (rig.clock.missed, rig.clock.slipped) == (0, 0.0)
    rig.now += 1.5 * CATCH_UP
    assert rig.run(cycles, 0.4 * period) == pytest.approx(0.1, abs=2 * period)
    assert rig.clock.slipped == pytest.approx(1.5 * CATCH_UP, abs=2 * period)


def test_on_a_computer_that_keeps_up_no_time_is_lost(rig):
    assert rig.run(3000, 0.4e-3) == pytest.approx(3.0, abs=2 * LATE)
    assert (rig.clock.missed, rig.clock.slipped, rig.reported) == (0, 0.0, [])


def test_a_single_late_answer_costs_no_time(rig):
    for _ in range(100):
        rig.run(19, 0.4e-3)
        rig.run(1, 1.5e-3)
    assert rig.clock.missed == 100
    assert rig.clock.slipped == 0.0
    assert rig.now - rig.start == pytest.approx(2.0, abs=2 * LATE)


@pytest.mark.parametrize("takes", [2.5e-3, 5e-3, 20e-3])
def test_time_waits_for_a_slow_computer_and_reports_it_within_a_second(rig, takes):
    took = rig.run(1000, takes)
    assert rig.clock.missed == 2
    assert took == pytest.approx(1000 * takes * (1.0 + IDLE_RATIO), rel=0.02)
    assert rig.clock.slipped == pytest.approx(took - 1.0, abs=0.01)
    assert rig.reported[0][0] < 1.0
    assert rig.reported[0][1].startswith("too slow: ")


def test_time_stops_waiting_once_the_computer_keeps_up_again(rig):
    rig.run(500, 3e-3)
    assert rig.clock.waiting
    slipped = rig.clock.slipped
    assert rig.run(2000, 0.4e-3) == pytest.approx(2.0, abs=2 * LATE + PERIOD)
    assert rig.clock.slipped == slipped
    assert not rig.clock.waiting
    assert rig.reported[-1][1] == ""


def test_a_missing_controller_is_waited_for_once(rig):
    rig.run(100, 0.4e-3)
    assert rig.run(1000, None) == pytest.approx(1.0 + MAX_WAIT, abs=0.01)
    assert rig.reported == []
    rig.run(100, 0.4e-3)
    assert rig.run(100, None) == pytest.approx(0.1 + MAX_WAIT, abs=0.01)


def test_after_a_suspension_time_continues_without_catching_up(rig):
    rig.run(100, 0.4e-3)
    rig.now += 0.3
    assert rig.run(100, 0.4e-3) == pytest.approx(0.1, abs=2 * PERIOD)
    assert rig.clock.slipped == pytest.approx(0.3, abs=2 * PERIOD)
    assert rig.clock.missed <= 1


def test_a_controller_that_left_the_graph_is_not_waited_for(rig):
    rig.run(100, 0.4e-3)
    rig.run(2, None)
    assert rig.clock.waiting
    rig.now += PERIOD
    assert rig.clock.remaining(rig.now, answered=False) == pytest.approx(MAX_WAIT, abs=PERIOD)
    assert rig.clock.remaining(rig.now, answered=False, present=False) == 0.0


def test_a_controller_that_is_held_up_for_a_second_finds_the_rig_as_it_left_it(rig):
    rig.run(100, 0.4e-3)
    rig.run(2, None)
    assert rig.run(1, 1.0) >= 1.0
    rig.run(100, 0.4e-3)
    assert rig.clock.missed == 2
