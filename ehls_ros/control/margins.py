"""Stability margins of sampled loops: the pressure loop of structure invariance compensation, and any measured loop.

With feedforward of the motion's flow, the path from spool command to load pressure is the valve's lag and an integrator behind
a sample and hold.

Source of the margins: Åström, Murray, Feedback Systems, 2nd edition, section 10.3.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array

FREQUENCIES = 20_000
"""Number of frequencies, from 0.1 rad/s to the Nyquist frequency, at which the loop is evaluated."""


class Margins(NamedTuple):
    """Stability margins of a loop.

    Attributes:
        gain_db: gain margin [dB]; infinite if no gain makes the loop unstable.
        phase_deg: phase margin [degree]; infinite if the gain is below 1 at all frequencies.
    """

    gain_db: float
    phase_deg: float


def pressure_loop(omega: Array, proportional: float, integral: float, valve_bandwidth: float, period: float) -> Array:
    """Return the frequency response of the open loop, shape as ``omega`` [rad/s].

    Args:
        omega: frequencies below the Nyquist frequency.
        proportional: proportional gain [1/s].
        integral: integral gain [1/s^2].
        valve_bandwidth: bandwidth of the servo valve [rad/s].
        period: sampling period [s].
    """
    z = np.exp(1j * omega * period)
    lag = valve_bandwidth * period
    decay = math.exp(-lag)
    # Zero-order hold of a/(s (s + a)).
    plant = ((lag - 1.0 + decay) * z + (1.0 - decay - lag * decay)) / (valve_bandwidth * (z - 1.0) * (z - decay))
    response: Array = (proportional + integral * period * z / (z - 1.0)) * plant
    return response


def pressure_loop_margins(proportional: float, integral: float, valve_bandwidth: float, period: float) -> Margins:
    """Return the margins of the pressure loop; the arguments are those of :func:`pressure_loop`."""
    omega = np.geomspace(0.1, math.pi / period, FREQUENCIES, endpoint=False)
    response = pressure_loop(omega, proportional, integral, valve_bandwidth, period)
    magnitude, phase = np.abs(response), np.unwrap(np.angle(response))
    phase -= 2.0 * math.pi * math.ceil((phase[-1] - 0.5 * math.pi) / (2.0 * math.pi))
    turned = np.flatnonzero((phase[:-1] > -math.pi) & (phase[1:] <= -math.pi))
    crossed = np.flatnonzero((magnitude[:-1] >= 1.0) & (magnitude[1:] < 1.0))
    gain = -20.0 * math.log10(float(magnitude[turned].max())) if turned.size else math.inf
    lead = math.degrees(float(phase[crossed].min()) + math.pi) if crossed.size else math.inf
    return Margins(gain, lead)


class LoopMargins(NamedTuple):
    """Stability margins of a stable loop; each is infinite if no change of its kind makes the loop unstable.

    Attributes:
        gain_db: factor by which the gain may rise [dB].
        fall_db: factor by which the gain may fall [dB].
        phase_deg: angle by which the phase may change, in either direction [degree].
        delay: additional delay that the loop tolerates [s].
    """

    gain_db: float
    fall_db: float
    phase_deg: float
    delay: float


def loop_margins(omega: Array, response: NDArray[np.complex128]) -> LoopMargins:
    """Return the margins of a loop that is known to be stable when closed.

    Args:
        omega: frequencies, ascending and so dense that the response changes little between neighbours, including the Nyquist
            frequency if the margin may be there, shape (n,) [rad/s].
        response: frequency response of the open loop at these, with negative feedback, shape (n,).
    """
    level, imaginary = np.log(np.abs(response)), response.imag
    # Linear interpolation between the frequencies.
    on_axis, at_axis = _crossings(imaginary)
    real = response.real[on_axis] + at_axis * np.diff(response.real)[on_axis]
    real = np.append(real, response.real[imaginary == 0.0])
    gains = -20.0 * np.log10(-real[real < 0.0])
    crossing, at_crossing = _crossings(level)
    there = response[crossing] + at_crossing * np.diff(response)[crossing]
    frequency = omega[crossing] + at_crossing * np.diff(omega)[crossing]
    lead = np.mod(np.angle(there) + math.pi, 2.0 * math.pi)
    return LoopMargins(
        min(gains[gains >= 0.0], default=math.inf),
        min(-gains[gains < 0.0], default=math.inf),
        math.degrees(min(np.minimum(lead, 2.0 * math.pi - lead), default=math.inf)),
        min(lead / frequency, default=math.inf),
    )


def _crossings(values: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the indices before sign changes, and the fraction of the step to each zero by linear interpolation."""
    before = np.flatnonzero((values[:-1] >= 0.0) != (values[1:] >= 0.0))
    return before, values[before] / (values[before] - values[before + 1])
