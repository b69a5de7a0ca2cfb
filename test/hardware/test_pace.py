"""A computer that is too slow for its cycles is found out within a second; one whose controller is away is not slow."""

import pytest

from ehls_ros.hardware.pace import WINDOW, Pace

PERIOD = 1e-3


def run(pace: Pace, seconds: float, part: float, start: float = 0.0, answered: float = 0.0) -> tuple[float | None, float]:
    """Let a part of the cycles be answered; return when the first complaint came, and how many are answered in all."""
    told = None
    for cycle in range(round(seconds / PERIOD)):
        now = start + cycle * PERIOD
        answered += part
        pace.look(now, now / PERIOD, int(answered))
        if pace.complaint and told is None:
            told = now - start
    return told, answered


@pytest.mark.parametrize("part", [0.05, 0.33, 0.72, 0.85])
def test_too_slow_a_computer_is_found_out_within_a_second(part):
    pace = Pace()
    told, _ = run(pace, 2.0, part)
    assert told is not None
    assert told < 1.0
    assert pace.asked == pytest.approx(1000.0, rel=0.01)
    assert pace.reached == pytest.approx(1000.0 * part, rel=0.02)
    assert pace.complaint == f"too slow: {pace.reached:.0f} of {pace.asked:.0f} cycles/s"


@pytest.mark.parametrize("part", [1.0, 0.95, 0.0])
def test_some_misses_are_no_complaint_and_nobody_there_is_another(part):
    assert run(Pace(), 3.0, part)[0] is None


def test_a_stall_shorter_than_the_missing_tenth_of_a_window_is_none():
    pace = Pace()
    _, answered = run(pace, 0.6, 1.0)
    pace.look(0.6 + 0.08 * WINDOW, 600 + 80 * WINDOW, int(answered))
    assert run(pace, 1.0, 1.0, start=0.6 + 0.08 * WINDOW, answered=answered)[0] is None


def test_the_complaint_stays_as_it_was_told_until_the_pace_changes_or_is_well():
    pace = Pace()
    _, answered = run(pace, 1.1, 0.5)
    told = pace.complaint
    _, answered = run(pace, 1.1, 0.55, start=1.1, answered=answered)
    assert pace.complaint == told
    _, answered = run(pace, 1.1, 0.8, start=2.2, answered=answered)
    assert pace.complaint not in {told, ""}
    # Enough not to have complained, too little to stop.
    _, answered = run(pace, 1.1, 0.95, start=3.3, answered=answered)
    assert pace.complaint
    run(pace, 1.1, 1.0, start=4.4, answered=answered)
    assert not pace.complaint


def test_where_samples_set_the_pace_a_device_that_pauses_is_not_a_slow_computer():
    pace = Pace()
    for sample in range(3000):
        # Half the samples a second that were agreed on, and each is answered.
        pace.look(2.0 * sample * PERIOD, sample, sample)
    assert not pace.complaint
    assert pace.figures()["cycles_per_second_asked"] == pytest.approx(500.0, rel=0.01)
