"""When a device's samples were taken, told by its own clock and count: what waited somewhere on its way is not fresh."""

import math

WINDOW = 1.0
"""The promptest sample of the last one to two of these is what delay is reckoned from; clocks drift apart meanwhile [s]."""

WANDER = 0.5
"""The device's clock is believed while it is within this fraction of the time that the sequence numbers say has passed."""


class SampleClock:
    """Holds the samples' times against this computer's.

    A device's clock need not agree with this computer's, and may even be set in the middle of a run: only how it advances from
    one sample to the next counts, and where that cannot be, the sequence numbers count instead.

    Attributes:
        elapsed: time from the sample before to the last one [s].
        lag: how much longer the last sample took to get here than the promptest one of late [s].
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

    def take(self, sequence: int, time_ns: int, now: float) -> None:
        """Take a sample.

        Args:
            sequence: its number; one no larger than the last: the device began anew.
            time_ns: its time by the device's clock [ns].
            now: this computer's monotonic time [s].
        """
        if sequence <= self._sequence:
            self.begin()
        if self._sequence >= 0:
            counted = (sequence - self._sequence) * self._period
            told = 1e-9 * (time_ns - self._time_ns)
            self.elapsed = told if abs(told - counted) <= WANDER * counted else counted
            self._taken += self.elapsed
        self._sequence, self._time_ns = sequence, time_ns
        delay = now - self._taken
        if now - self._window > WINDOW:
            self._window, self._least_before, self._least = now, self._least, math.inf
        self._least = min(self._least, delay)
        self.lag = delay - min(self._least, self._least_before)
