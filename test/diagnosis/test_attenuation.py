"""Correction of fitted parameters for the noise in their derivatives."""

import numpy as np
import pytest

from ehls_ros.diagnosis.attenuation import SHARES, corrected, noise_part
from ehls_ros.diagnosis.held_out import assess

SLOPE, SCATTER = 2.0, 0.5
"""Slope of a line, and standard deviation of the noise of its abscissa, whose own is 1."""


def line(rng, count=200_000):
    """Return abscissa and ordinate of points on a line, both with noise."""
    x = rng.standard_normal(count)
    return x + SCATTER * rng.standard_normal(count), SLOPE * x + 0.1 * rng.standard_normal(count)


def equations(x, y, slope):
    """Return residuals and derivatives of a line, as a fit has them."""
    return slope * x - y, x[:, np.newaxis]


def test_a_slope_that_noise_attenuates_is_restored():
    rng = np.random.default_rng(1)
    x, y = line(rng)
    fitted = float(x @ y / (x @ x))
    assert fitted == pytest.approx(SLOPE / (1.0 + SCATTER**2), rel=0.01)
    e, jacobian = equations(x, y, fitted)
    scale = np.std(e)
    more = [sign * SCATTER * noise for noise in rng.standard_normal((3, len(x))) for sign in (1.0, -1.0)]
    noisy = [tuple(part / scale for part in equations(x + m, y, fitted)) for m in more]
    information = jacobian.T @ jacobian / scale**2
    part = noise_part(e / scale, jacobian / scale, noisy, information, np.zeros((1, 1)))
    step = np.linalg.solve(information - part.lost, part.pulls.mean(axis=0))
    assert fitted + step[0] == pytest.approx(SLOPE, rel=0.02)


def test_noise_does_not_pull_along_a_derivative_that_diverges_with_it():
    rng = np.random.default_rng(2)
    jacobian, e = rng.standard_normal((2000, 2)), rng.standard_normal(2000)
    diverging = jacobian.copy()
    diverging[1000, 1] = 1e9
    part = noise_part(e, jacobian, [(e, diverging), (e, jacobian)], information := jacobian.T @ jacobian, np.zeros((2, 2)))
    step = np.linalg.solve(information - part.lost, part.pulls[0])
    assert np.all(np.abs(step) < 1e-3)
    assert np.max(np.linalg.eigvals(np.linalg.solve(information, part.lost)).real) == pytest.approx(SHARES[1])


def test_a_lag_is_told_without_what_noise_takes_from_it(worker_of):
    true = 0.004
    worker, found = worker_of({"pressure_sensor_lag": {"time_constant": true}}, seed=5)
    lag = found["pressure_sensor_lag", 0]
    fit = worker.fit(worker.linearise((lag,), lag.starts[1]))
    covariance = assess(worker.evidence, fit).held_out.covariance
    told = corrected(worker.evidence, fit, covariance)
    assert told.values[0] == pytest.approx(true, rel=0.02)
    assert told.covariance[0, 0] > 0.0


def test_a_fit_without_parameters_is_as_it_was(worker_of):
    worker, _ = worker_of({}, seed=5)
    fit = worker.linearise((), np.empty(0))
    told = corrected(worker.evidence, fit, np.empty((0, 0)))
    assert told.values is fit.values
