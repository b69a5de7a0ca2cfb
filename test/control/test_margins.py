"""Margins of the pressure loop against the eigenvalues of the sampled loop itself."""

import math

import numpy as np
import pytest
import scipy.signal

from ehls_ros.control.margins import loop_margins, pressure_loop, pressure_loop_margins

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
    # Without an integral part its pole stays on the unit circle.
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


def test_margins_of_a_loop_with_known_ones():
    # 2 exp(-0.01 s)/s: crosses 1 at 2 rad/s, -180 degrees at 50 pi rad/s.
    omega = np.geomspace(0.1, 1e3, 4000)
    found = loop_margins(omega, 2.0 * np.exp(-0.01j * omega) / (1j * omega))
    turned = 50.0 * math.pi
    assert found.gain_db == pytest.approx(20.0 * math.log10(turned / 2.0), abs=0.01)
    assert found.fall_db == math.inf
    assert found.phase_deg == pytest.approx(90.0 - math.degrees(0.02), abs=0.01)
    assert found.delay == pytest.approx((0.5 * math.pi - 0.02) / 2.0, rel=1e-4)


def test_a_loop_that_needs_its_gain_says_how_far_it_may_fall():
    # k/(s - 1) is stable for k > 1 only; with k = 4 it crosses 1 at sqrt(15) rad/s, at -180 + atan(sqrt 15) degrees.
    omega = np.append(1e-9, np.geomspace(1e-3, 1e3, 4000))
    found = loop_margins(omega, np.append(-4.0 + 0.0j, 4.0 / (1j * omega[1:] - 1.0)))
    assert found.gain_db == math.inf
    assert found.fall_db == pytest.approx(20.0 * math.log10(4.0), abs=1e-3)
    assert found.phase_deg == pytest.approx(math.degrees(math.atan(math.sqrt(15.0))), abs=0.01)


def test_measured_margins_of_the_pressure_loop_are_the_computed_ones():
    omega = np.geomspace(0.1, math.pi / PERIOD, 20_000, endpoint=False)
    computed = pressure_loop_margins(280.0, 100.0, VALVE, PERIOD)
    found = loop_margins(omega, pressure_loop(omega, 280.0, 100.0, VALVE, PERIOD))
    assert found.gain_db == pytest.approx(computed.gain_db, abs=0.01)
    assert found.phase_deg == pytest.approx(computed.phase_deg, abs=0.05)


def test_a_margin_at_the_nyquist_frequency_counts():
    # 0.5/(z + 0.2) turns by -180 degrees only where z = -1.
    omega = np.append(np.linspace(0.01, 3.14, 500), math.pi)
    response = 0.5 / (np.exp(1j * omega) + 0.2)
    response[-1] = response[-1].real
    found = loop_margins(omega, response)
    assert found.gain_db == pytest.approx(20.0 * math.log10(0.8 / 0.5))
    assert found.delay == math.inf
