"""Control peaks, valleys and phase of the force by three numbers of the reference: mean, amplitude and time shift.

This is the peak-valley and amplitude-phase control of test machines. It uses no model of the rig and learns no waveform. The
force lags its reference w by the tau at which their correlation is largest. The difference between force and w(t - tau) is
smoothed over a short part of the load cycle. The errors of peak and valley are taken where w(t - tau) is near its extremes. The
three errors are half their sum, half their difference, and tau. Each is controlled by one number of

    w + c,  c(t) = (1 + amplitude / A) (w(t - delay) - m) + m + mean - w(t)

with m the mean of w and A half its range. An error x changes by G du with its number u, independently of the others, and G is
near 1: for a linear loop and a sine the three are decoupled, and G = 1 for the delay. G is the mean of 1 and the secant, which
is the observed effect of changes of the number. x is estimated by a Kalman filter over the load cycles, and
du = -x / (G (1 + W^2)) with W = :data:`UNCERTAINTY`. This converges for every response of the loop between 0 and
2 (1 + W^2) times the G in use. A number is limited to its bound. It is reset to zero if the error does not respond, or responds
with the wrong sign.

Source: the same filter as :mod:`ehls_ros.control.learning.corrector`. The secant with forgetting is recursive least squares of
one coefficient, Åström, Wittenmark, Adaptive Control, 2nd edition, 1995, section 2.2.
"""

import math
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.learning.corrector import Corrector
from ehls_ros.control.learning.robustness import MARGIN
from ehls_ros.control.references._signals import quintic
from ehls_ros.errors import BadInput

MEAN, AMPLITUDE, DELAY = range(3)
"""Indices in a vector of numbers or of their errors: [N], [N], [s]."""

NAMES = ("mean", "amplitude", "phase")

NEAR = 0.1
"""Distance from the reference's peak or valley within which that of the force may lie, as a fraction of its range."""

TOP, SMOOTHED = 0.01, 0.25
"""Fraction of the range within which a reference is at its peak, and fraction of that time over which force is smoothed."""

QUARTER = 0.25
"""Largest lag that is searched, in periods of the reference."""

SINGULAR = 1e-9
"""Smallest singular value, relative to the largest, used in solving equations."""

FADE = 0.1
"""Fraction of a load cycle over which a change is faded in, and in which extremes are ignored if there are others."""

SETTLE = 0.25
"""Settling time of the force after a change before it is evaluated [s]; at least to the end of the fade."""

UNCERTAINTY = 0.5
"""Relative uncertainty of the response."""

REMEMBERED = 0.7
"""Fraction of the evidence on the response that is kept over a change."""

SECANT_WEIGHT, MAX_SECANT = 0.5, 2.5
"""Weight of the secant relative to 1, as a loop may follow a change slowly at first, and the secant's upper bound."""

MIN_RESPONSE, RESET_AFTER = 0.2, 3
"""Secant below which a number is reset, and the number of consecutive changes required for this."""

REST = 50
"""Changes after which a reset number is tried again."""

MIN_WEIGHT = 0.3
"""Least weight of a load cycle, as a loop may follow a change slowly, and a specimen drifts."""

PACE = 0.3
"""Weight of one load cycle in the variance between load cycles."""

BLOCKS = 6
"""Least number of parts of a load cycle from which its noise is estimated."""

MEDIAN_OF_SQUARES = 0.4549
"""Median of the square of a normal variable of variance 1."""

UNKNOWN = 1e6
"""Variance of an unknown error, relative to that of the noise."""

MIN_NOISE = 1e-12
"""Lower bound of the noise's variance, relative to the squared bound, as noise-free simulations repeat exactly."""


class PeakValley(Corrector):
    """Correction by mean, amplitude and delay.

    Attributes:
        numbers: added mean [N], amplitude [N] and delay [s].
    """

    STORED = ("numbers", "_estimate", "_variance", "_wander", "_secant", "_cross", "_power", "_useless", "_rest")

    def __init__(self, wanted: Array, period: float, gain: float, reach: float) -> None:
        """Start with no correction.

        Args:
            wanted: reference over the load cycle, shape (size,) [N].
            period: length of the load cycle [s].
            gain: fraction of an error corrected by one change; 0 to derive it from the uncertainty of the response.
            reach: largest change of mean and amplitude, over half the range, and of the phase [rad].

        Raises:
            BadInput: convergence is not guaranteed with this gain.
        """
        if gain > 0.0 and abs(1.0 - gain) + gain * UNCERTAINTY > 1.0 - MARGIN:
            expected = f"gain 0, or {MARGIN / (1.0 - UNCERTAINTY):.2g} to {(2.0 - MARGIN) / (1.0 + UNCERTAINTY):.2g}"
            raise BadInput(f"gain {gain:g}: the errors of peak and valley need not fall", "companion learning", expected)
        super().__init__(len(wanted), period)
        self._wanted, self._period, self._gain = wanted, period, gain
        self._mean = float(np.mean(wanted))
        self._shape = np.fft.rfft(wanted - self._mean)
        slope = self._delayed(0.0, 1)
        self._half = 0.5 * float(np.ptp(wanted))
        self._slope, self._steepest = float(np.mean(slope**2)), float(np.max(np.abs(slope)))
        self._swings = self._half > 0.0 and self._slope > 0.0
        self._turn = math.sqrt(self._slope / float(np.var(wanted))) if self._swings else 0.0
        """Equivalent frequency of the reference [rad/s], that of a sine."""
        largest = float(np.max(np.abs(wanted)))
        self._bounds = reach * (
            np.array([self._half, self._half, 1.0 / self._turn]) if self._swings else np.array([largest, 0.0, 0.0])
        )
        self._least = MIN_NOISE * np.maximum(self._bounds, MIN_NOISE) ** 2
        self._settling = max(math.ceil(SETTLE / period) - 1, 0)
        self.numbers = np.zeros(3)
        self._seen = np.zeros(3)
        self._estimate, self._variance = np.zeros(3), np.full(3, np.inf)
        self._noise, self._wander, self._missed = np.zeros(3), np.zeros(3), np.zeros(3)
        self._secant = np.ones(3)
        self._cross, self._power = np.zeros(3), np.zeros(3)
        self._before, self._change = np.zeros(3), np.zeros(3)
        self._useless, self._rest = np.zeros(3), np.zeros(3)
        self._wait, self._fresh = 0, False
        self._anew = True

    def observe(self, error: Array, *, settled: bool = True) -> None:
        """Process the error of one load cycle, under the present correction.

        Args:
            error: error [N], shape (size,).
            settled: whether it repeats; a cycle with a transition is ignored.
        """
        if not settled:
            return
        self.cycles += 1
        self._seen, self._noise = self._measured(error)
        self._fresh = self._wait == 0
        if not self._fresh:
            self._wait -= 1
            return
        if self._anew or not np.all(np.isfinite(self._variance)):
            self._estimate, self._variance, self._anew = self._seen, self._noise.copy(), False
        else:
            self._identify()
            missed = self._seen - self._estimate
            # Differences between successive load cycles change sign more often than the lag of the estimate.
            opposed = math.pi * np.maximum(-missed * self._missed, 0.0)
            self._wander, self._missed = self._wander + PACE * (opposed - self._wander), missed
            weight = np.maximum(self._variance / (self._variance + self._noise + self._wander), MIN_WEIGHT)
            self._estimate = self._estimate + weight * missed
            self._variance = self._variance * (1.0 - weight)
        self._change = np.zeros(3)

    def _identify(self) -> None:
        """Learn the response from the effect of the last change; the prior is weighted by its uncertainty over the noise."""
        change, changed = self._change, self._change != 0.0
        noise = 2.0 * (self._noise + self._wander)
        prior = noise / UNCERTAINTY**2
        self._cross[changed] = (REMEMBERED * self._cross + change * (self._seen - self._before))[changed]
        self._power[changed] = (REMEMBERED * self._power + change**2)[changed]
        before = self._response
        self._secant = np.where(changed, (prior + self._cross) / (prior + self._power), self._secant)
        self._estimate = self._estimate + (self._response - before) * change

    @property
    def _response(self) -> Array:
        """Damped estimate of an error's change over the change of its number, shape (3,)."""
        believed: Array = 1.0 + SECANT_WEIGHT * (np.clip(self._secant, 0.0, MAX_SECANT) - 1.0)
        return believed

    def correct(self) -> bool:
        """Update the numbers from the estimated errors; return whether there is any correction."""
        if not self._fresh:
            return bool(np.any(self.numbers))
        self._reset_unresponsive()
        share = self._gain or 1.0 / (1.0 + UNCERTAINTY**2)
        change = -share * self._estimate / self._response
        numbers = np.where(self._rest > 0.0, 0.0, np.clip(self.numbers + change, -self._bounds, self._bounds))
        self._before, self._change = self._estimate, numbers - self.numbers
        effect = self._response * self._change
        self._estimate = self._estimate + effect
        self._variance = self._variance + (UNCERTAINTY * effect) ** 2
        self.numbers, self._wait = numbers, self._settling
        self._apply()
        return bool(np.any(numbers))

    def _reset_unresponsive(self) -> None:
        """Reset a number to which its error does not respond, and retry one whose waiting time has passed."""
        tried = self._rest == 1.0
        self._rest = np.maximum(self._rest - 1.0, 0.0)
        self._useless = np.where((self._secant < MIN_RESPONSE) & (self._rest == 0.0), self._useless + 1.0, 0.0)
        useless = self._useless >= RESET_AFTER
        self._rest[useless] = REST
        begun = tried | useless
        self._secant[begun] = 1.0
        self._cross[begun] = self._power[begun] = 0.0
        self._variance[begun] = UNKNOWN * self._noise[begun]

    def _apply(self) -> None:
        """Fill the table from the numbers."""
        mean, amplitude, delay = self.numbers
        scale = 1.0 + amplitude / self._half if self._swings else 1.0
        spectrum = (scale * np.exp(-self._derivative * delay) - 1.0) * self._shape
        spectrum[0] = mean * self.size
        self._tabulate(spectrum)

    def _measured(self, error: Array) -> tuple[Array, Array]:
        """Return the three errors of a load cycle, and their variances due to its noise."""
        if not self._swings:
            return np.array([np.mean(error), 0.0, 0.0]), np.maximum([_noise_of(error, self.size), 0.0, 0.0], self._least)
        lag = self._lag(error)
        delayed = self._mean + self._delayed(lag, 0)
        remaining = self._wanted + error - delayed
        samples = max(round(SMOOTHED * min(np.sum(self._near(delayed, TOP)), np.sum(self._near(-delayed, TOP)))), 1)
        force = delayed + scipy.ndimage.uniform_filter1d(remaining, samples, mode="wrap")
        top, bottom = self._judged(self._near(delayed, NEAR)), self._judged(self._near(-delayed, NEAR))
        peak = float(np.max(force[top]) - np.max(delayed[top]))
        valley = float(np.min(force[bottom]) - np.min(delayed[bottom]))
        noise = _noise_of(remaining, samples)
        variances = [0.5 * noise, 0.5 * noise, noise * samples / (self.size * self._slope)]
        return np.array([0.5 * (peak + valley), 0.5 * (peak - valley), lag]), np.maximum(variances, self._least)

    def _lag(self, error: Array) -> float:
        """Return the time by which the force lags its reference [s]."""
        force = np.fft.rfft(self._wanted + error)
        correlation = np.fft.irfft(force * np.conj(self._shape), self.size)
        step = self._period / self.size
        farthest = min(max(math.ceil(QUARTER * 2.0 * math.pi / (self._turn * step)), 1), (self.size - 1) // 2 - 1)
        near = np.arange(-farthest - 1, farthest + 2)
        at = int(np.argmax(correlation[near[1:-1]]))
        left, middle, right = correlation[near[at : at + 3]]
        bend = left - 2.0 * middle + right
        part = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
        lag = step * (float(near[at + 1]) + min(max(part, -0.5), 0.5))
        # The correlation includes part of the fade; refine with mean, size and lag of the samples after it.
        after = math.ceil(FADE * self.size)
        delayed, slope = self._delayed(lag, 0)[after:], self._delayed(lag, 1)[after:]
        columns = np.column_stack([np.full(len(delayed), self._half), delayed, -slope / self._turn])
        (_, scale, missed), *_ = np.linalg.lstsq(
            columns.T @ columns, columns.T @ (self._wanted + error)[after:], rcond=SINGULAR
        )
        return lag + missed / (scale * self._turn) if scale > MIN_RESPONSE and abs(missed) < scale else lag

    def _delayed(self, lag: float, derivative: int) -> Array:
        """Return the reference about its mean, or a derivative of it, delayed by a lag [s], shape (size,)."""
        spectrum = self._derivative**derivative * np.exp(-self._derivative * lag) * self._shape
        delayed: Array = np.fft.irfft(spectrum, self.size)
        return delayed

    def _near(self, values: Array, part: float) -> NDArray[np.bool_]:
        """Return a mask of the values within a fraction of the reference's range of the largest."""
        near: NDArray[np.bool_] = values >= np.max(values) - 2.0 * part * self._half
        return near

    def _judged(self, extreme: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the samples at an extreme after the fade, if they are at least half of all."""
        later = extreme & (np.arange(self.size) >= FADE * self.size)
        return later if 2 * np.sum(later) >= np.sum(extreme) else extreme

    def start_over(self) -> None:
        """Re-estimate the errors from the next load cycle alone, as another change has affected them."""
        self._anew, self._wait, self._fresh = True, 0, False

    def without(self) -> Array:
        """Return the expected errors without any correction, in the form of :meth:`kept`."""
        return self._as_forces(self._estimate - self._response * self.numbers)

    def kept(self, error: Array) -> Array:
        """Return the errors of peak and valley, and that due to the lag at the steepest reference, shape (3,) [N]."""
        return self._as_forces(self._measured(error)[0])

    def _as_forces(self, errors: Array) -> Array:
        mean, amplitude, lag = errors
        return np.array([mean + amplitude, mean - amplitude, lag * self._steepest])

    def report(self) -> Mapping[str, float | str]:
        """Return the last errors, the three numbers, and those at their bound or reset."""
        mean, amplitude, lag = self._seen
        at_bound = (np.abs(self.numbers) >= self._bounds) & (self._bounds > 0.0)
        limits = [f"{name} at its reach" for name, stopped in zip(NAMES, at_bound, strict=True) if stopped]
        limits += [f"the force does not follow the {name}" for name, rest in zip(NAMES, self._rest, strict=True) if rest > 0.0]
        return {
            "peak_error_n": float(mean + amplitude),
            "valley_error_n": float(mean - amplitude),
            "phase_error_deg": -math.degrees(float(lag) * self._turn),
            "mean_added_n": float(self.numbers[MEAN]),
            "amplitude_added_n": float(self.numbers[AMPLITUDE]),
            "lead_s": -float(self.numbers[DELAY]),
            **({"limits": "; ".join(limits)} if limits else {}),
        }

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> bool:
        """Restore arrays returned by :meth:`stored`; return whether they fit."""
        if not super().restore(stored):
            return False
        self.numbers = np.clip(self.numbers, -self._bounds, self._bounds)
        self._anew = False
        self._apply()
        return True


def _noise_of(values: Array, samples: int) -> float:
    """Return the variance of a mean of contiguous samples, from the differences between neighbouring such means."""
    width = max(min(samples, len(values) // BLOCKS), 1)
    count = len(values) // width
    means = values[: count * width].reshape(count, width).mean(axis=1)
    variance = float(np.median(np.diff(means, 2) ** 2)) / (6.0 * MEDIAN_OF_SQUARES)
    return variance * width / samples


class Bumpless:
    """Smooth transition from one correction to the next.

    When the source of the correction changes, the old one is continued along a straight line and faded into the new one.
    """

    def __init__(self, period: float) -> None:
        """Start without correction; ``period`` is the control period [s]."""
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Reset to no correction."""
        self._source: Hashable = None
        self._cycle, self._value, self._rate = -1, 0.0, 0.0
        self._began, self._length, self._usual = 0, 0, 0
        self._apart, self._speed = 0.0, 0.0

    def smooth(self, first: int, rows: Array, bare: Array, source: Hashable, length: int) -> None:
        """Smooth the correction in some rows, as a continuation of that in previous rows.

        Args:
            first: number of their first control cycle.
            rows: reference with its two derivatives, shape (n, 3 or more); changed in place.
            bare: the reference without correction, shape (n, 3).
            source: origin of the correction; rows without correction have the source None.
            length: control cycles of a transition; a change to another source takes the longer of both.
        """
        if source is None and self._source is None and first - self._began >= self._length:
            return
        for i, (row, plain) in enumerate(zip(rows, bare, strict=True)):
            cycle, added = first + i, row[:3] - plain
            here = source if np.any(added) else None
            if here != self._source:
                passed = (cycle - self._cycle) * self._period
                self._apart = self._value + self._rate * passed - added[0]
                self._speed = self._rate - added[1]
                self._source, self._began = here, cycle
                self._length, self._usual = max(self._usual, length), length
            if cycle - self._began < self._length:
                added += self._rest(cycle - self._began)
                row[:3] = plain + added
            self._cycle, self._value, self._rate = cycle, float(added[0]), float(added[1])

    def _rest(self, cycles: int) -> Array:
        """Return the remainder of the old correction to add to the new one, with its two derivatives, shape (3,)."""
        since = cycles * self._period
        fade, rate, bend = (float(part[0]) for part in quintic(np.array([since]), self._length * self._period))
        apart = self._apart + self._speed * since
        return np.array(
            [(1.0 - fade) * apart, (1.0 - fade) * self._speed - rate * apart, -2.0 * rate * self._speed - bend * apart]
        )
