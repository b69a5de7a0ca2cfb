"""Age and rate of a device's samples, from its clock and sequence numbers: a sample that queued on the way is not fresh.

A sample gives three numbers: its sequence number, its time by the device's clock and its time of arrival by this computer's.
Arrival minus device time is the transport delay plus a constant, since the clocks have any offset. The age of a sample is
this difference above a baseline, which

* falls at once to a sample that came faster,
* rises no faster than two free-running clocks drift apart (:data:`MAX_DRIFT`), whatever the samples do,
* starts anew only when the device does.

So a delay that grows, however slowly beyond :data:`MAX_DRIFT`, adds up to an age, and one that jitters is measured from its
fastest samples. A true sampling period that differs from the nominal one is no delay, as the device's clock shows it. A
device clock wrong by more than :data:`MAX_DRIFT` is indistinguishable from a delay that grows or shrinks, by any rule; the
:attr:`SampleClock.drift` includes both.
"""

import math
import time

UNDISTURBED = 20e-6
"""Longest time to read the three clocks of :func:`free_running_time` without an interruption [s]."""


MAX_DRIFT = 200e-6
"""Largest difference in rate between two free-running clocks; crystals are within 100 ppm each."""

DRIFT_WINDOW = 10.0
"""Window of the measured drift [s]."""

JITTER = 2e-3
"""Largest difference between the fastest samples of two such windows that does not count as drift [s]."""

COUNTED = 0.25
"""Length of the sample count for a rate, as time at the expected rate [s]."""

WANDER = 0.5
"""Largest deviation of the device's clock from the sequence numbers, as a fraction of the interval they give."""

PAUSE = 0.5
"""Silence after which a device may have paused its sampling [s]: the longest time that a gate waits for a sample."""


def free_running_time() -> float:
    """Return a monotonic time that includes suspension and that no time server adjusts [s].

    Linux adjusts the rate of ``CLOCK_MONOTONIC`` and ``CLOCK_BOOTTIME`` to a time server's, by up to 10 % with chrony.
    """
    for _ in range(3):
        before = time.clock_gettime(time.CLOCK_MONOTONIC)
        boot = time.clock_gettime(time.CLOCK_BOOTTIME)
        raw = time.clock_gettime(time.CLOCK_MONOTONIC_RAW)
        after = time.clock_gettime(time.CLOCK_MONOTONIC)
        if after - before < UNDISTURBED:
            break
    return raw + (boot - 0.5 * (before + after))


class SampleClock:
    """Compares the device's clock with this computer's.

    The device's clock may have any offset and may be set during a run. Only its increments are used; an implausible increment
    is replaced by that of the sequence numbers.

    Attributes:
        elapsed: time between the last two samples [s].
        lag: delay of the last sample relative to the baseline [s].
        rate: samples per second of the device's clock in the last :data:`COUNTED` seconds of samples; 0 before, and the
            expected rate if that clock stands still.
        drift: growth of the fastest samples' delay between the last two windows of :data:`DRIFT_WINDOW`; 0 before. Positive
            if the delay grows or the device's clock loses.
    """

    def __init__(self, period: float) -> None:
        """Start before the first sample; ``period`` is the sampling period [s]."""
        self._period = period
        self._session = 0
        self._begin()

    def _begin(self) -> None:
        self.elapsed = self._period
        self.lag = 0.0
        self._sequence = -1
        self._time_ns = 0
        self._now = 0.0
        # In integers, since 24 h at 4 kHz are 3.5e8 increments.
        self._taken_ns = 0
        self._baseline = math.inf
        self._window = 0
        self._least, self._least_before = math.inf, math.nan
        self.drift = 0.0
        self.rate = 0.0
        self._counted_from = (0, 0)

    def take(self, sequence: int, time_ns: int, now: float, session: int = 0) -> None:
        """Account for a sample.

        Args:
            sequence: number of the sample; a number not above the last one means that the device restarted.
            time_ns: time of the sample by the device's clock [ns].
            now: this computer's :func:`~ehls_ros.hardware.sample_clock.free_running_time` [s].
            session: of the device; another number means that it restarted.
        """
        if sequence <= self._sequence or session != self._session:
            self._begin()
            self._session = session
        if self._sequence >= 0:
            elapsed_ns = self._increment(sequence, time_ns, now)
            self.elapsed = 1e-9 * elapsed_ns
            self._taken_ns += elapsed_ns
            self._baseline += MAX_DRIFT * self.elapsed
        else:
            self._counted_from = sequence, time_ns
        self._sequence, self._time_ns, self._now = sequence, time_ns, now
        self._count(sequence, time_ns)
        delay = now - 1e-9 * self._taken_ns
        self._baseline = min(self._baseline, delay)
        self.lag = delay - self._baseline
        self._compare(delay)

    @property
    def strays(self) -> bool:
        """Whether the device's clock and the arrivals differ in rate by more than two clocks and jitter explain."""
        return abs(self.drift) > MAX_DRIFT + JITTER / DRIFT_WINDOW

    def _increment(self, sequence: int, time_ns: int, now: float) -> int:
        """Return the time since the last sample [ns]: by the device's clock if plausible, else by the sequence numbers."""
        counted, measured = (sequence - self._sequence) * self._period, 1e-9 * (time_ns - self._time_ns)
        silence = now - self._now
        plausible = abs(measured - counted) <= WANDER * counted
        # Both clocks show a silence longer than the missing samples account for: the device stood still.
        paused = silence > PAUSE and abs(measured - silence) < abs(counted - silence)
        return time_ns - self._time_ns if plausible or paused else round(1e9 * counted)

    def _count(self, sequence: int, time_ns: int) -> None:
        """Compute the rate once enough samples have arrived; a clock that was set spoils one count."""
        first, since_ns = self._counted_from
        samples, elapsed_ns = sequence - first, time_ns - since_ns
        if samples * self._period >= COUNTED:
            self.rate = 1e9 * samples / elapsed_ns if elapsed_ns > 0 else 1.0 / self._period
            self._counted_from = sequence, time_ns

    def _compare(self, delay: float) -> None:
        """Compare the fastest samples of two successive windows."""
        window = int(1e-9 * self._taken_ns / DRIFT_WINDOW)
        if window > self._window:
            successive = window == self._window + 1
            growth = self._least - self._least_before
            self.drift = growth / DRIFT_WINDOW if successive and math.isfinite(growth) else 0.0
            self._least_before = self._least if successive else math.nan
            self._window, self._least = window, math.inf
        self._least = min(self._least, delay)
