"""What every friction model has to do."""

import numpy as np
import pytest
from reference_solver import Constants

from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.simulator import Simulator

MODELS = FRICTION_MODELS.names()


def test_the_models_are_found():
    assert {"gms", "lugre", "stribeck"} <= set(MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_says_what_it_is(name):
    model = FRICTION_MODELS.load(name)
    assert model.EQUATION.strip()
    assert model.SOURCE.strip()
    for part in ("states", "rates", "force", "event", "switch"):
        assert callable(getattr(model, part))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("velocity", [-0.15, -0.01, -2e-3, 2e-3, 0.01, 0.15])
def test_at_constant_velocity_it_ends_on_the_stribeck_curve(name, velocity, drive, make_rig):
    driven = drive(name, np.full(12_000, velocity), make_rig().friction, steps=2)
    paper = Constants()
    assert driven.total[-1] == pytest.approx(np.sign(velocity) * paper.s(velocity) + paper.sigma_f * velocity, rel=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_it_is_odd_in_velocity(name, drive, make_rig):
    t = np.arange(2000) * 1e-3
    velocity = 0.01 * np.sin(9.0 * t) + 0.004 * np.sin(31.0 * t)
    there, back = drive(name, velocity, make_rig().friction), drive(name, -velocity, make_rig().friction)
    assert np.ptp(there.total) > 1000.0
    np.testing.assert_array_equal(there.total, -back.total)
    np.testing.assert_array_equal(there.modes, -back.modes)


@pytest.mark.parametrize("name", MODELS)
def test_it_never_drives_the_motion(name, drive, make_rig):
    """Over a closed path friction takes work, and a standing contact holds no more than Fs."""
    t = np.arange(4001) * 1e-3
    velocity = 0.01 * np.sin(2.0 * np.pi * t)
    driven = drive(name, velocity, make_rig().friction)
    last_cycle = slice(3000, 4001)
    work = np.trapezoid(driven.total[last_cycle] * velocity[last_cycle], t[last_cycle])
    path = np.trapezoid(np.abs(velocity[last_cycle]), t[last_cycle])
    assert 300.0 * path < work < 1.1 * (865.4 + 7265.0 * 0.01) * path
    assert np.abs(driven.total - 7265.0 * velocity).max() <= 865.4 * (1 + 1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_mirrored_rig_runs_mirrored(name, make_rig):
    rig = make_rig(plant={"gravity": 0.0}, friction={"model": name})
    there, back = Simulator(rig, position=0.01), Simulator(rig, position=-0.01)
    back.mode[0] = -1.0
    for k in range(400):
        t = k * 1e-3
        u, fd, rate = 3e-5 * np.sin(25.0 * t) + 1e-5, 900.0 * np.sin(40.0 * t), 36e3 * np.cos(40.0 * t)
        there.advance(u, fd, rate, 0.0, 0.0)
        back.advance(-u, -fd, -rate, 0.0, 0.0)
        np.testing.assert_array_equal(there.y, -back.y)
    assert abs(there.y[1]) > 0.0
