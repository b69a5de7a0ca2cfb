"""The causal limit against an independent filter in a simulation of the same linear rig, and in known cases."""

import math
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.control.limits import causal_limit, expected_largest, flow_pressure, horizon_cycles
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.effects.command_delay import Parameters as Delay
from ehls_ros.physics.effects.coupling_stiffness import Parameters as Coupling
from ehls_ros.physics.rig import EffectUse, Rig

PERIOD = 1e-3
CONFIG = Path(__file__).parents[2] / "config"


@pytest.fixture(scope="module")
def measured() -> Rig:
    """The paper's rig with realistic sensors."""
    return load_rig(CONFIG / "rig_paper_measured.yaml")


def rows(cycles=4000, force=np.zeros_like):
    """Return the rows of a disturbance force that is linear within a cycle."""
    t = PERIOD * np.arange(cycles + 1)
    out = np.zeros((cycles, 4))
    out[:, 0], out[:, 1] = force(t[:-1]), np.diff(force(t)) / PERIOD
    return out


def bump(t):
    """Return a force of 5 kN at 1 Hz that jerks by 300 N twice a second [N]."""
    return 5e3 * np.sin(2.0 * np.pi * t) + 300.0 * np.tanh(200.0 * np.sin(2.0 * np.pi * (t - 0.1)))


def delayed(rig, delay):
    return rig.with_effects((EffectUse("command_delay", Delay(delay)),))


def noisier(rig, factor):
    sensors = {
        name: sensor._replace(noise_std=factor * sensor.noise_std, resolution=factor * sensor.resolution)
        for name, sensor in rig.sensors.items()
    }
    return rig._replace(sensors=sensors)


def monte_carlo(rig, disturbance, ahead, limit, factor, runs):
    """Return the largest errors of a Kalman predictor of the force in the last halves of some runs, all in SI units [N].

    The rig is integrated by Runge-Kutta from (2) and (3), the filter is a recursion from a wide covariance, cycle by cycle.
    """
    order, intensity = limit.order, factor * limit.intensity
    contact = sum(rig.friction.element_stiffness) if limit.sticking else 0.0
    p, sigma = rig.plant, rig.friction.viscous_coefficient
    hydraulic = 4.0 * p.bulk_modulus / p.total_volume
    size = 4 + order
    a = np.zeros((size, size))
    a[0, 1] = 1.0
    a[1] = (
        np.array([-p.spring_stiffness - contact, -(p.viscous_damping + sigma), p.piston_area, -1.0] + [0.0] * order)
        / p.moving_mass
    )
    a[2, 1:3] = -hydraulic * p.piston_area, -hydraulic * p.leakage_coefficient
    for i in range(3, size - 1):
        a[i, i + 1] = 1.0
    noise = {name: math.hypot(s.noise_std, s.resolution / math.sqrt(12.0)) for name, s in rig.sensors.items()}
    reading = np.zeros((3, size))
    reading[0, 0], reading[1, 2], reading[2, 2] = 1.0, 1.0, p.piston_area
    deviation = np.array([noise["position"], noise["load_pressure"], noise["force"]])
    # The transition by its series; the process noise by the sum over short steps.
    transition, term = np.eye(size), np.eye(size)
    for power in range(1, 20):
        term = term @ a * PERIOD / power
        transition = transition + term
    steps = 200
    small, term = np.eye(size), np.eye(size)
    for power in range(1, 10):
        term = term @ a * PERIOD / steps / power
        small = small + term
    process, kick = np.zeros((size, size)), np.zeros((size, size))
    kick[-1, -1] = intensity**2 * PERIOD / steps
    for _ in range(steps):
        process = small @ process @ small.T + 0.5 * (kick + small @ kick @ small.T)

    def rate(y, force):
        return np.array([y[1], (a[1, :3] @ y[:3]) - force / p.moving_mass, a[2, 1:3] @ y[1:3]])

    random = np.random.default_rng(1).standard_normal((len(disturbance), runs, 3)) * deviation
    truth, mean = np.zeros(3), np.zeros((runs, size))
    covariance = np.diag([1e-6, 1e-2, 1e6, 1e6, 1e10, 1e14][:size])
    forces, foreseen = [], []
    for row, error in zip(disturbance, random, strict=True):
        forces.append(p.piston_area * truth[2])
        measured = np.array([truth[0], truth[2], p.piston_area * truth[2]]) + error
        seen = reading @ covariance @ reading.T + np.diag(deviation**2)
        gain = np.linalg.solve(seen, reading @ covariance).T
        mean = mean + (measured - mean @ reading.T) @ gain.T
        left = np.eye(size) - gain @ reading
        covariance = left @ covariance @ left.T + (gain * deviation**2) @ gain.T
        foreseen.append(p.piston_area * mean @ np.linalg.matrix_power(transition, ahead)[2])
        mean, covariance = mean @ transition.T, transition @ covariance @ transition.T + process
        for part in range(4):
            h, start = 0.25 * PERIOD, row[0] + 0.25 * part * PERIOD * row[1]
            k1 = rate(truth, start)
            k2 = rate(truth + 0.5 * h * k1, start + 0.5 * h * row[1])
            k3 = rate(truth + 0.5 * h * k2, start + 0.5 * h * row[1])
            k4 = rate(truth + h * k3, start + h * row[1])
            truth = truth + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    errors = np.array(forces[ahead:])[:, np.newaxis] - np.array(foreseen[:-ahead])
    return np.max(np.abs(errors[-(len(disturbance) // 2) :]), axis=0)


@pytest.mark.long
def test_an_independent_kalman_predictor_errs_by_the_limit(measured):
    disturbance = rows(3000, bump)
    limit = causal_limit(delayed(measured, 1e-3), PERIOD, disturbance, velocity_read=False)
    assert limit.horizon == 2e-3
    largest = monte_carlo(measured, disturbance, 2, limit, 1.0, 40)
    # Correlated cycles count as fewer independent ones: the limit is a little lower.
    assert 0.9 < limit.largest / np.mean(largest) < 1.02
    # Another intensity is no better.
    for factor in (0.2, 5.0):
        assert np.mean(monte_carlo(measured, disturbance, 2, limit, factor, 40)) > limit.largest


def test_without_noise_or_without_a_disturbance_hardly_anything_remains(measured):
    quiet = measured.quiet()
    assert causal_limit(quiet, PERIOD, rows(force=lambda t: 5e3 * np.sin(2.0 * np.pi * t))).largest < 0.01
    assert causal_limit(quiet, PERIOD, rows()).largest < 0.01
    assert causal_limit(measured, PERIOD, rows()).largest < 0.5


def test_the_limit_grows_with_delay_and_noise_and_with_what_is_not_read(measured):
    disturbance = rows(force=bump)
    by_delay = [causal_limit(delayed(measured, delay), PERIOD, disturbance).largest for delay in (0.0, 1e-3, 2e-3, 4e-3)]
    assert np.all(np.diff(by_delay) > 0.0)
    by_noise = [causal_limit(noisier(measured, factor), PERIOD, disturbance) for factor in (0.1, 1.0, 10.0)]
    assert np.all(np.diff([limit.largest for limit in by_noise]) > 0.0)
    assert np.all(np.diff([limit.noise_share for limit in by_noise]) > 0.0)
    assert causal_limit(measured, PERIOD, disturbance, velocity_read=False).largest > by_delay[0]
    for limit in by_noise:
        assert max(limit.noise_share, limit.rms) <= limit.largest


def test_the_limit_scales_as_its_units_do(measured):
    disturbance = rows(force=bump)
    once = causal_limit(measured, PERIOD, disturbance)
    twice = causal_limit(noisier(measured, 2.0), PERIOD, 2.0 * disturbance)
    for name in ("largest", "rms", "noise_share", "unforeseen", "intensity"):
        assert getattr(twice, name) == pytest.approx(2.0 * getattr(once, name), rel=0.02)
    assert twice.horizon == once.horizon == PERIOD


def test_a_servo_acts_through_its_coupling(measured):
    """A motion of the far end acts as the force of spring and damper, for an end without other constraints."""
    plant = measured.plant
    soft = measured.with_effects((EffectUse("coupling_stiffness", Coupling(1e3, 10.0)),))
    t = PERIOD * np.arange(4001)
    motion = bump(t) / 1e3
    by_motion = np.zeros((4000, 4))
    by_motion[:, 2], by_motion[:, 3] = motion[:-1], np.diff(motion) / PERIOD
    stiff = measured._replace(
        plant=plant._replace(spring_stiffness=plant.spring_stiffness + 1e3, viscous_damping=plant.viscous_damping + 10.0)
    )
    by_force = rows()
    by_force[:, 0], by_force[:, 1] = -1e3 * motion[:-1] - 10.0 * by_motion[:, 3], -1e3 * by_motion[:, 3]
    assert causal_limit(soft, PERIOD, by_motion) == causal_limit(stiff, PERIOD, by_force)


def test_the_horizon_is_the_first_sample_a_command_changes():
    cases = ((0.0, 1), (0.4e-3, 1), (0.999e-3, 1), (1e-3, 2), (3 * 1e-3, 4), (2.5e-3, 3))
    assert [horizon_cycles(delay, PERIOD) for delay, _ in cases] == [cycles for _, cycles in cases]


def test_the_expected_largest_is_that_of_samples():
    changes, deviations = np.array([0.0, 1.0, 3.0]), np.array([1.0, 0.5, 0.2])
    counts = np.array([400, 50, 2])
    random = np.random.default_rng(1).standard_normal((2000, counts.sum()))
    drawn = np.abs(np.repeat(changes, counts) + np.repeat(deviations, counts) * random).max(axis=1)
    found = expected_largest(changes, deviations, counts.astype(float))
    assert found == pytest.approx(drawn.mean(), abs=4.0 * drawn.std() / math.sqrt(len(drawn)))


def test_the_valve_passes_less_against_a_pressure(rig):
    plant = rig.plant
    small = 1.0
    flow = [0.62 * 0.0267 * 2e-4 * math.sqrt((7e6 - pressure) / 840.0) for pressure in (3e6 - small, 3e6 + small)]
    found = flow_pressure(np.array([2e-4]), np.array([3e6]), plant)
    assert found == pytest.approx(-np.diff(flow)[0] / (2.0 * small), rel=1e-6)


def test_rows_that_are_not_numbers_are_refused(measured):
    broken = rows()
    broken[7, 0] = np.nan
    with pytest.raises(ValueError, match="finite"):
        causal_limit(measured, PERIOD, broken)
