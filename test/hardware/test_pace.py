"""A computer too slow for its cycles is detected within a second; a missing controller does not count as slow."""

import pytest

from ehls_ros.hardware.pace import WINDOW, Pace

PERIOD = 1e-3


def run(pace: Pace, seconds: float, part: float, start: float = 0.0, answered: float = 0.0) -> tuple[float | None, float]:
    """Answer a fraction of the cycles; return the time of the first complaint and the total number answered."""
    complained = None
    for cycle in range(round(seconds / PERIOD)):
        now = start + cycle * PERIOD
        answered += part
        pace.look(now, now / PERIOD, int(answered))
        if pace.complaint and complained is None:
            complained = now - start
    return complained, answered


@pytest.mark.parametrize("part", [0.05, 0.33, 0.72, 0.85])
def test_a_slow_computer_is_detected_within_a_second(part):
    pace = Pace()
    complained, _ = run(pace, 2.0, part)
    assert complained is not None
    assert complained < 1.0
    assert pace.asked == pytest.approx(1000.0, rel=0.01)
    assert pace.reached == pytest.approx(1000.0 * part, rel=0.02)
    assert pace.complaint == f"too slow: {pace.reached:.0f} of {pace.asked:.0f} cycles/s"


@pytest.mark.parametrize("part", [1.0, 0.95, 0.0])
def test_a_few_misses_or_a_missing_controller_cause_no_complaint(part):
    assert run(Pace(), 3.0, part)[0] is None


def test_a_stall_shorter_than_a_tenth_of_a_window_causes_no_complaint():
    pace = Pace()
    _, answered = run(pace, 0.6, 1.0)
    pace.look(0.6 + 0.08 * WINDOW, 600 + 80 * WINDOW, int(answered))
    assert run(pace, 1.0, 1.0, start=0.6 + 0.08 * WINDOW, answered=answered)[0] is None


def test_the_complaint_stays_until_the_pace_changes_or_recovers():
    pace = Pace()
    _, answered = run(pace, 1.1, 0.5)
    first = pace.complaint
    _, answered = run(pace, 1.1, 0.55, start=1.1, answered=answered)
    assert pace.complaint == first
    _, answered = run(pace, 1.1, 0.8, start=2.2, answered=answered)
    assert pace.complaint not in {first, ""}
    # Above the limit for a complaint, but below the one for dropping it.
    _, answered = run(pace, 1.1, 0.95, start=3.3, answered=answered)
    assert pace.complaint
    run(pace, 1.1, 1.0, start=4.4, answered=answered)
    assert not pace.complaint


def test_a_slow_device_is_not_taken_for_a_slow_computer():
    pace = Pace()
    for sample in range(3000):
        # Half the agreed sampling rate, with every sample answered.
        pace.look(2.0 * sample * PERIOD, sample, sample)
    assert not pace.complaint
    assert pace.figures()["cycles_per_second_asked"] == pytest.approx(500.0, rel=0.01)
