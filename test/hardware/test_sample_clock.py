"""Age of samples by the device's clock and sequence numbers."""

import numpy as np
import pytest
from safety_gate_bench import PERIOD, Bench

from ehls_ros.hardware.safety_gate import ACTIVE, CUT
from ehls_ros.hardware.sample_clock import MAX_DRIFT, SampleClock, free_running_time

TIMEOUT = 0.02


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
    assert seen[-2][0] == pytest.approx(1.9, abs=0.2 * MAX_DRIFT)
    assert seen[-1][0] == pytest.approx(0.0, abs=1e-9)


def test_a_lasting_delay_is_a_lasting_lag():
    samples = prompt(1000) + [(k, k * PERIOD, 5.0 + k * PERIOD + 0.03) for k in range(1000, 20_000)]
    lags = [lag for lag, _ in fed(samples)[1000:]]
    assert lags == pytest.approx((0.03 - MAX_DRIFT * PERIOD * np.arange(1, 19_001)).tolist())


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.5, -0.5])
def test_a_step_of_the_devices_clock_is_bridged_by_its_sequence_numbers(step):
    samples = prompt(500) + [(k, k * PERIOD + step, 5.0 + k * PERIOD) for k in range(500, 1000)]
    assert all(lag == pytest.approx(0.0, abs=1e-9) and dt == pytest.approx(PERIOD) for lag, dt in fed(samples))


def arrivals(device, drift, delays):
    """Return times of arrival by a clock that drifts against the device's by the given rates [1] up to each sample."""
    steps = np.diff(device, prepend=device[0]) * (1.0 + drift)
    return 5.0 + np.cumsum(steps) + delays


@pytest.mark.parametrize("seed", range(20))
def test_a_day_of_drift_and_jitter_adds_no_age(seed):
    random = np.random.default_rng(seed)
    count = 5000
    # Bursts of samples between gaps of up to 34 s: 24 h at 1 kHz; drift that wanders within its bound.
    gaps = np.where(random.random(count) < 0.5, 1, random.integers(1, 69_000, count))
    sequence = np.cumsum(gaps)
    drift = MAX_DRIFT * np.clip(random.uniform(-1.2, 1.2) + 0.3 * np.sin(np.linspace(0.0, random.uniform(0, 30), count)), -1, 1)
    jitter = random.uniform(0.0, TIMEOUT) * random.random(count) ** random.uniform(0.5, 8.0)
    here = arrivals(sequence * PERIOD, drift, jitter)
    assert here[-1] > 20 * 3600.0
    lags = np.array([lag for lag, _ in fed(zip(sequence.tolist(), sequence * PERIOD, here, strict=True))])
    assert (lags <= jitter + 1e-7).all()


@pytest.mark.parametrize("timeout", [0.02, 0.3])
@pytest.mark.parametrize(("growth", "highest"), [(0.025, 0.35), (0.06, 0.48)])
def test_a_delay_that_grows_slowly_closes_the_valve_at_the_timeout(growth, highest, timeout):
    clock, bench = SampleClock(PERIOD), Bench(sensor_timeout=timeout, command_timeout=timeout)
    delays = np.clip(growth * PERIOD * (np.arange(18_000) - 3000), 0.0, highest).tolist()
    bench.run()
    for k, delay in enumerate(delays):
        now = 5.0 + k * PERIOD + delay
        clock.take(k, k * 10**6, now)
        bench.turn(lag=clock.lag)
        if bench.gate.state != ACTIVE:
            break
    # The baseline rises by MAX_DRIFT meanwhile: 0.8 % and 0.3 % of these rates.
    assert delay == pytest.approx(timeout, rel=0.02)
    assert (bench.gate.state, bench.gate.output) == (CUT, 0.0)
    assert bench.gate.causes[0].detector == "sensor_stale"


@pytest.mark.parametrize("seed", range(20))
def test_any_growth_beyond_two_drifts_is_an_age(seed):
    random = np.random.default_rng(seed)
    growth, drift = 10.0 ** random.uniform(-3, 0), random.uniform(-MAX_DRIFT, MAX_DRIFT)
    # Long enough for the excess of the growth over the drift to reach twice the timeout.
    count = int(2.0 * TIMEOUT / (growth - 2.0 * MAX_DRIFT) / PERIOD)
    sequence = np.cumsum(random.integers(1, 4, count))
    device = sequence * PERIOD
    delays = growth * (device - device[0]) + 1e-3 * random.random(count)
    lags = np.array([lag for lag, _ in fed(zip(sequence.tolist(), device, arrivals(device, drift, delays), strict=True))])
    late = growth * (device - device[0])
    assert (lags[late > TIMEOUT / (1.0 - 2.0 * MAX_DRIFT / growth) + 1e-3] >= TIMEOUT).all()
    assert (lags <= late + 2.0 * MAX_DRIFT * device + 1e-3).all()


@pytest.mark.parametrize("off", [-1e-3, 1e-3])
def test_a_period_that_is_not_the_nominal_one_is_no_delay(off):
    true = PERIOD * (1.0 + off)
    clock = SampleClock(PERIOD)
    for k in range(100_000):
        clock.take(k, round(1e9 * k * true), 5.0 + k * true)
        assert clock.lag < 1e-6
    assert not clock.strays


@pytest.mark.parametrize(("off", "strays"), [(-1e-3, True), (1e-3, True), (-1e-4, False), (1e-4, False)])
def test_a_device_clock_that_runs_at_another_rate_is_seen(off, strays):
    random = np.random.default_rng(3)
    clock = SampleClock(PERIOD)
    for k in range(21_000):
        clock.take(k, k * 10**6, k * PERIOD * (1.0 + off) + 1e-3 * random.random())
    assert clock.strays is strays
    assert clock.drift == pytest.approx(off, abs=1e-5)


def test_a_device_that_stood_still_is_not_late_afterwards():
    # It stops for 4 s, as an emulator does on a computer that is suspended; its clock does not stop.
    samples = prompt(1000) + [(k, k * PERIOD + 4.0, 9.0 + k * PERIOD) for k in range(1000, 1500)]
    assert fed(samples)[-1] == (pytest.approx(0.0, abs=1e-9), pytest.approx(PERIOD))


def test_a_device_that_restarts_unseen_counts_anew():
    clock = SampleClock(PERIOD)
    clock.take(1000, 10**9, 1.0, 7)
    clock.take(5000, 5 * 10**9, 600.0, 8)
    assert clock.lag == 0.0


def test_this_computers_clock_is_monotonic():
    seen = [free_running_time() for _ in range(1000)]
    assert np.diff(seen).min() > -1e-4
    assert 0.0 < seen[-1] - seen[0] < 60.0


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
