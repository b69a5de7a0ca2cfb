"""Margins of the pressure loop against the eigenvalues of the sampled loop itself."""

import math

import numpy as np
import pytest
import scipy.signal

from ehls_ros.control.margins import pressure_loop, pressure_loop_margins

VALVE, PERIOD = 111.46, 1e-3


def test_frequency_response_is_that_of_the_sampled_plant():
    numerator, denominator, _ = scipy.signal.cont2discrete(([VALVE], [1.0, VALVE, 0.0]), PERIOD)
    omega = np.array([5.0, 80.0, 400.0, 2500.0])
    z = np.exp(1j * omega * PERIOD)
    expected = 300.0 * np.polyval(numerator.ravel(), z) / np.polyval(denominator, z)
    assert pressure_loop(omega, 300.0, 0.0, VALVE, PERIOD) == pytest.approx(expected, rel=1e-6)


def spectral_radius(proportional: float, integral: float, gain: float = 1.0) -> float:
    """Largest eigenvalue of pressure, spool and integral under the loop, from its equations."""
    decay = math.exp(-VALVE * PERIOD)
    # Over a period: spool follows the held command, pressure integrates the spool.
    spool_to_pressure = (1.0 - decay) / VALVE
    command_to_pressure = PERIOD - spool_to_pressure
    p, i = -gain * proportional, -gain * integral
    total = p + i * PERIOD  # the integral counts the present error
    rows = [
        [1.0 + command_to_pressure * total, spool_to_pressure, command_to_pressure * i],
        [(1.0 - decay) * total, decay, (1.0 - decay) * i],
        [PERIOD, 0.0, 1.0],
    ]
    return float(np.max(np.abs(np.linalg.eigvals(np.array(rows)))))


@pytest.mark.parametrize(("proportional", "integral"), [(100.0, 0.0), (280.0, 100.0), (280.0, 3000.0), (1000.0, 500.0)])
def test_gain_margin_is_the_gain_at_which_the_loop_turns_unstable(proportional, integral):
    factor = 10.0 ** (pressure_loop_margins(proportional, integral, VALVE, PERIOD).gain_db / 20.0)
    # Without an integral part its own pole stays on the unit circle.
    above = 1.0 if integral == 0.0 else 0.0
    assert spectral_radius(proportional, integral, 0.99 * factor) <= 1.0 + 1e-9
    assert spectral_radius(proportional, integral, 1.01 * factor) > 1.0 + 1e-9 * (1.0 + above)


def test_an_unstable_loop_has_negative_margins():
    margins = pressure_loop_margins(3000.0, 0.0, VALVE, PERIOD)
    assert margins.gain_db < 0.0
    assert margins.phase_deg < 0.0


def test_phase_margin_shrinks_by_what_the_integral_part_turns():
    plain, with_integral = (pressure_loop_margins(280.0, i, VALVE, PERIOD).phase_deg for i in (0.0, 1000.0))
    # At the crossover, 160 rad/s, an integral of 1000 beside 280 turns by atan(1000/280/160).
    assert plain - with_integral == pytest.approx(math.degrees(math.atan(1000.0 / 280.0 / 160.0)), rel=0.05)
