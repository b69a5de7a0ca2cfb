"""How old a sample is, told by the device's clock and count."""

import pytest

from ehls_ros.hardware.sample_clock import SampleClock

PERIOD = 1e-3


def fed(samples):
    """Return lags and intervals of samples, each a sequence number, the device's time and this computer's [s]."""
    clock = SampleClock(PERIOD)
    seen = []
    for sequence, device, here in samples:
        clock.take(sequence, round(1e9 * device), here)
        seen.append((clock.lag, clock.elapsed))
    return seen


def prompt(count, start=0):
    return [(k, k * PERIOD, 5.0 + k * PERIOD) for k in range(start, start + count)]


def test_prompt_samples_lag_by_nothing():
    assert all(lag == pytest.approx(0.0, abs=1e-9) and dt == pytest.approx(PERIOD) for lag, dt in fed(prompt(5000)))


def test_what_waited_while_this_computer_slept_is_as_old_as_it_is():
    # Asleep for 2 s: what was sent 1.9 s ago is read first.
    seen = fed([*prompt(100), (200, 0.2, 5.0 + 2.1), (2100, 2.1, 5.0 + 2.1)])
    assert seen[-2][0] == pytest.approx(1.9)
    assert seen[-1][0] == pytest.approx(0.0, abs=1e-9)


def test_samples_late_one_after_the_other_lag_by_what_they_are_late():
    samples = prompt(1000) + [(k, k * PERIOD, 5.0 + k * PERIOD + 0.03) for k in range(1000, 1500)]
    assert [lag for lag, _ in fed(samples)[1000:]] == pytest.approx([0.03] * 500)


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.5, -0.5])
def test_a_device_whose_clock_is_set_is_believed_by_its_count(step):
    samples = prompt(500) + [(k, k * PERIOD + step, 5.0 + k * PERIOD) for k in range(500, 1000)]
    assert all(lag == pytest.approx(0.0, abs=1e-9) and dt == pytest.approx(PERIOD) for lag, dt in fed(samples))


def test_clocks_that_drift_apart_are_no_delay():
    drift = 1.0 + 1e-4
    samples = [(k, k * PERIOD, 5.0 + k * PERIOD * drift) for k in range(20_000)]
    assert max(lag for lag, _ in fed(samples)) < 3e-4


def test_the_interval_is_the_devices_own_where_it_may_be_true():
    seen = fed([(0, 0.0, 5.0), (1, 1.2e-3, 5.001), (2, 9e-3, 5.002), (4, 10.9e-3, 5.004)])
    assert [interval for _, interval in seen[1:]] == pytest.approx([1.2e-3, 1e-3, 1.9e-3])


def test_a_device_that_began_anew_begins_anew_here():
    seen = fed([*prompt(100), *[(k, k * PERIOD, 9.0 + k * PERIOD) for k in range(100)]])
    assert all(lag == pytest.approx(0.0, abs=1e-9) for lag, _ in seen)
