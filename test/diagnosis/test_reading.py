"""The shape of a table found in data, read from its values and their errors."""

import numpy as np
import pytest

from ehls_ros.diagnosis.reading import read

AT = np.linspace(-0.2, 0.2, 16)


def read_noisy(values, noise, at=AT, **kind):
    scattered = values + noise * np.random.default_rng(3).standard_normal(len(values))
    return read(at, scattered, noise**2 * np.eye(len(values)), **{"periodic": False, **kind})


@pytest.mark.parametrize(("exponent", "symmetry"), [(2.0, "odd"), (2.0, "even"), (0.6, "odd"), (1.5, "even")])
def test_the_exponent_of_a_power_is_found_within_its_error(exponent, symmetry):
    values = 3e4 * np.abs(AT) ** exponent * (np.sign(AT) if symmetry == "odd" else 1.0)
    found = read_noisy(values, 0.01 * np.ptp(values)).power
    assert found is not None
    assert found.symmetry == symmetry
    assert abs(found.exponent - exponent) < 4.0 * found.std < 0.8


def test_a_table_that_only_rises_is_told_from_one_that_does_not():
    rising = np.tanh(20.0 * (AT - 0.1))
    assert read_noisy(rising, 1e-3).rise == pytest.approx(rising[-1] - rising[0], abs=0.01)
    assert read_noisy(np.cos(30.0 * AT), 1e-3).rise is None


def test_a_bump_has_a_place():
    bump = 500.0 * np.exp(-(((AT - AT[11]) / 0.03) ** 2))
    found = read_noisy(bump, 5.0)
    assert found.place == pytest.approx(AT[11])
    assert found.power is None
    assert read_noisy(np.sin(40.0 * AT), 1e-3).place is None


def test_a_periodic_table_has_an_amplitude_alone():
    found = read_noisy(7.0 * np.sin(2.0 * np.pi * np.arange(16) / 16), 0.1, periodic=True)
    assert found.amplitude == pytest.approx(7.0, rel=0.05)
    assert (found.rise, found.power, found.place) == (None, None, None)


def test_a_table_of_nothing_has_no_shape():
    found = read(AT, np.zeros(16), np.eye(16), periodic=False)
    assert (found.amplitude, found.rise, found.power, found.place) == (0.0, None, None, None)
