"""Age and rate of a device's samples, from its own clock and sequence numbers: a sample that queued on the way is not fresh."""

import math

WINDOW = 1.0
"""Delays are relative to the fastest sample of the last one to two windows, since clocks drift apart [s]."""

COUNTED = 0.25
"""Samples counted for a rate, as time at the expected one [s]."""

WANDER = 0.5
"""Largest deviation of the device's clock from the sequence numbers, as a fraction of the interval they give."""


class SampleClock:
    """Compares the device's clock with this computer's.

    The device's clock may have any offset and may be set during a run. Only its increments are used; an implausible increment
    is replaced by that of the sequence numbers.

    Attributes:
        elapsed: time between the last two samples [s].
        lag: delay of the last sample relative to the fastest recent one [s].
        rate: samples per second of the device's clock in the last :data:`COUNTED` seconds of samples; 0 before, and the
            expected rate if that clock stands still.
    """

    def __init__(self, period: float) -> None:
        """Start before the first sample; ``period`` is the sampling period [s]."""
        self._period = period
        self.begin()

    def begin(self) -> None:
        """Forget the samples so far."""
        self.elapsed = self._period
        self.lag = 0.0
        self._sequence = -1
        self._time_ns = 0
        self._taken = 0.0
        self._window = -math.inf
        self._least = self._least_before = math.inf
        self.rate = 0.0
        self._counted_from = (0, 0)

    def take(self, sequence: int, time_ns: int, now: float) -> None:
        """Account for a sample.

        Args:
            sequence: number of the sample; a number not above the last one means that the device restarted.
            time_ns: time of the sample by the device's clock [ns].
            now: this computer's monotonic time [s].
        """
        if sequence <= self._sequence:
            self.begin()
        if self._sequence >= 0:
            counted = (sequence - self._sequence) * self._period
            measured = 1e-9 * (time_ns - self._time_ns)
            self.elapsed = measured if abs(measured - counted) <= WANDER * counted else counted
            self._taken += self.elapsed
        else:
            self._counted_from = sequence, time_ns
        self._sequence, self._time_ns = sequence, time_ns
        self._count(sequence, time_ns)
        delay = now - self._taken
        if now - self._window > WINDOW:
            self._window, self._least_before, self._least = now, self._least, math.inf
        self._least = min(self._least, delay)
        self.lag = delay - min(self._least, self._least_before)

    def _count(self, sequence: int, time_ns: int) -> None:
        """Find the rate once enough samples have come; a clock that was set spoils one count."""
        first, since_ns = self._counted_from
        samples, elapsed_ns = sequence - first, time_ns - since_ns
        if samples * self._period >= COUNTED:
            self.rate = 1e9 * samples / elapsed_ns if elapsed_ns > 0 else 1.0 / self._period
            self._counted_from = sequence, time_ns
