"""Formulas found for tables: the shape, its numbers, and the preference for few parameters."""

import numpy as np
import pytest

from ehls_ros.diagnosis.term_formula import Table, formulas

AT = np.linspace(-1.0, 0.9, 16)


def best(values, noise=2.0, **kind):
    scattered = values + noise * np.random.default_rng(1).standard_normal(len(values))
    return formulas(Table(kind.pop("at", AT), scattered, noise**2 * np.eye(len(values)), kind.pop("periodic", False), True))[0]


@pytest.mark.parametrize(
    ("values", "fixed", "expected"),
    [
        (-250.0 * AT * np.abs(AT), {}, {"power": -250.0, "exponent": 2.0}),
        (80.0 * AT**2 + 10.0, {"even": 1.0}, {"power": 80.0, "exponent": 2.0}),
        (300.0 * np.tanh(AT / 0.15), {}, {"step": 300.0, "step_width": 0.15}),
        (400.0 * np.exp(-(((AT - 0.3) / 0.2) ** 2)), {}, {"bump": 400.0, "bump_at": 0.3, "bump_width": 0.2}),
        (900.0 * (AT - 0.1) * np.exp(-(((AT - 0.1) / 0.3) ** 2)), {"bump_odd": 1.0}, {"bump_at": 0.1, "bump_width": 0.3}),
        (100.0 * (np.maximum(AT - 0.4, 0.0) - np.maximum(-AT - 0.4, 0.0)), {}, {"beyond": 100.0, "beyond_at": 0.4}),
        (120.0 * AT, {}, {"power": 120.0}),
    ],
)
def test_a_shape_is_found_with_its_numbers_and_no_other(values, fixed, expected):
    found = best(values)
    assert found.fixed == fixed
    assert set(found.free) <= {*expected, "level", "bump"}
    for name, number in expected.items():
        assert found.free[name] == pytest.approx(number, rel=0.15, abs=0.03), name


def test_a_wave_has_its_harmonic():
    part = np.arange(8) / 8.0
    values = 80.0 * np.sin(2.0 * np.pi * part + 0.4) + 32.0 * np.sin(4.0 * np.pi * part + 0.8)
    found = best(values, at=0.2 * part, periodic=True)
    assert found.free["wave"] == pytest.approx(80.0, rel=0.05)
    # Over a thousand periods it stays in step.
    assert found.free["wave_number"] == pytest.approx(5.0, rel=1e-5)
    assert found.free["wave_phase"] == pytest.approx(0.4, abs=0.1)
    assert found.free["wave_2"] == pytest.approx(32.0, rel=0.1)
    assert "level" not in found.free
    twice = best(np.tile(values[::2], 2), at=0.2 * part, periodic=True)
    assert twice.free["wave_number"] == pytest.approx(10.0, rel=1e-5)
    alone = best(80.0 * np.sin(2.0 * np.pi * part + 0.4), at=0.2 * part, periodic=True)
    assert "wave_2" not in alone.free


def test_values_that_the_data_hardly_determine_leave_a_formula():
    values = 120.0 * AT
    huge = 1e12 * np.outer(AT, AT)
    # Rounding makes such a covariance indefinite by far more than any noise.
    covariance = 4.0 * np.eye(len(AT)) + huge - 1e-3 * np.eye(len(AT))[::-1]
    covariance[0, 0] -= 1e6
    assert np.all(np.isfinite([found.cost for found in formulas(Table(AT, values, covariance, False, True))]))
