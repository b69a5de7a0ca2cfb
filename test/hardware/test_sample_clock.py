"""Age of samples by the device's clock and sequence numbers."""

import pytest

from ehls_ros.hardware.sample_clock import SampleClock

PERIOD = 1e-3


def fed(samples):
    """Return lags and intervals of samples given as sequence number, device time and local time [s]."""
    clock = SampleClock(PERIOD)
    seen = []
    for sequence, device, here in samples:
        clock.take(sequence, round(1e9 * device), here)
        seen.append((clock.lag, clock.elapsed))
    return seen


def prompt(count, start=0):
    return [(k, k * PERIOD, 5.0 + k * PERIOD) for k in range(start, start + count)]


def test_prompt_samples_have_no_lag():
    assert all(lag == pytest.approx(0.0, abs=1e-9) and dt == pytest.approx(PERIOD) for lag, dt in fed(prompt(5000)))


def test_samples_queued_while_this_computer_slept_have_their_true_age():
    # After 2 s of sleep, a sample sent 1.9 s ago is read first.
    seen = fed([*prompt(100), (200, 0.2, 5.0 + 2.1), (2100, 2.1, 5.0 + 2.1)])
    assert seen[-2][0] == pytest.approx(1.9)
    assert seen[-1][0] == pytest.approx(0.0, abs=1e-9)


def test_a_lasting_delay_is_a_lasting_lag():
    samples = prompt(1000) + [(k, k * PERIOD, 5.0 + k * PERIOD + 0.03) for k in range(1000, 1500)]
    assert [lag for lag, _ in fed(samples)[1000:]] == pytest.approx([0.03] * 500)


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.5, -0.5])
def test_a_step_of_the_devices_clock_is_bridged_by_its_sequence_numbers(step):
    samples = prompt(500) + [(k, k * PERIOD + step, 5.0 + k * PERIOD) for k in range(500, 1000)]
    assert all(lag == pytest.approx(0.0, abs=1e-9) and dt == pytest.approx(PERIOD) for lag, dt in fed(samples))


def test_clock_drift_is_not_a_delay():
    drift = 1.0 + 1e-4
    samples = [(k, k * PERIOD, 5.0 + k * PERIOD * drift) for k in range(20_000)]
    assert max(lag for lag, _ in fed(samples)) < 3e-4


def test_plausible_intervals_are_those_of_the_devices_clock():
    seen = fed([(0, 0.0, 5.0), (1, 1.2e-3, 5.001), (2, 9e-3, 5.002), (4, 10.9e-3, 5.004)])
    assert [interval for _, interval in seen[1:]] == pytest.approx([1.2e-3, 1e-3, 1.9e-3])


@pytest.mark.parametrize("slower", [1.0, 3.0])
def test_the_rate_is_the_devices_own_however_late_its_samples_come(slower):
    clock = SampleClock(PERIOD)
    for k in range(249):
        clock.take(k, round(5e8 * k * PERIOD), slower * k * PERIOD)
    assert clock.rate == 0.0
    # Every tenth sample is lost, and the clock is set meanwhile.
    for k in range(249, 2000):
        if k % 10:
            clock.take(k, round(5e8 * k * PERIOD) + (3600 * 10**9 if k > 900 else 0), slower * k * PERIOD)
        if k in (300, 850, 1999):
            assert clock.rate == pytest.approx(2000.0)


def test_a_restarted_device_restarts_the_clock():
    seen = fed([*prompt(100), *[(k, k * PERIOD, 9.0 + k * PERIOD) for k in range(100)]])
    assert all(lag == pytest.approx(0.0, abs=1e-9) for lag, _ in seen)
