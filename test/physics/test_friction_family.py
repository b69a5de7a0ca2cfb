"""Contract of every friction model."""

import math

import numpy as np
import pytest
from reference_solver import Constants
from scipy.integrate import solve_ivp, trapezoid

from ehls_ros.arrays import in_python
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import declarations

MODELS = FRICTION_MODELS.names()
COMPILED = ("level", "rates", "force", "event", "switch", "begin")
PERIOD = 1e-3


@pytest.fixture
def friction_of(make_rig):
    """Return the parameters of a model on the paper's rig, with some keys changed."""
    return lambda name, **keys: make_rig(friction={**keys, "model": name}).friction


def level_of(rig):
    """Return s(v): the Stribeck curve written out anew where the model has one, otherwise the model's own level."""
    return Constants().s if hasattr(rig.friction, "stribeck_exponent") else rig.friction_level


def test_the_models_are_found():
    assert {"gms", "lugre", "stribeck"} <= set(MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_has_its_parts(name, friction_of):
    model, friction = FRICTION_MODELS.load(name), friction_of(name)
    assert model.EQUATION.strip()
    assert model.SOURCE.strip()
    assert all(callable(in_python(getattr(model, part))) for part in COMPILED)
    assert model.states(friction) >= 1
    assert "viscous_coefficient" in friction._fields
    for declared in declarations(model.Parameters):
        assert declared.unit, declared.name
        assert declared.description, declared.name
    assert model.stiffness(friction) > 0.0
    assert 0.0 <= model.break_away(friction) < 1e-3


@pytest.mark.parametrize("name", MODELS)
def test_the_level_is_positive_even_and_highest_at_rest(name, make_rig):
    rig = make_rig(friction={"model": name})
    expected = level_of(rig)
    velocities = np.array([0.0, 1e-5, 2e-3, 0.05, 2.0])
    found = np.array([rig.friction_level(v) for v in velocities])
    np.testing.assert_allclose(found, [expected(v) for v in velocities], rtol=1e-12)
    assert np.array_equal(found, [rig.friction_level(-v) for v in velocities])
    assert np.all(np.diff(found) <= 0.0)
    assert found[-1] > 0.0
    assert rig.friction_level(math.inf) == rig.friction.coulomb_force


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("velocity", [-0.15, -0.01, -2e-3, 2e-3, 0.01, 0.15])
def test_at_constant_velocity_it_ends_on_its_level(name, velocity, drive, make_rig):
    rig = make_rig(friction={"model": name})
    driven = drive(name, np.full(12_000, velocity), rig.friction, steps=2)
    expected = np.sign(velocity) * level_of(rig)(velocity) + rig.friction.viscous_coefficient * velocity
    assert driven.total[-1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_it_is_odd_in_velocity(name, drive, friction_of):
    t = np.arange(2000) * PERIOD
    velocity = 0.01 * np.sin(9.0 * t) + 0.004 * np.sin(31.0 * t)
    there, back = drive(name, velocity, friction_of(name)), drive(name, -velocity, friction_of(name))
    assert np.ptp(there.total) > 1000.0
    np.testing.assert_array_equal(there.total, -back.total)
    np.testing.assert_array_equal(there.modes, -back.modes)


@pytest.mark.parametrize("name", MODELS)
def test_it_never_drives_the_motion(name, drive, make_rig):
    """Over a closed path friction dissipates work, and the contact holds no more than its force at break-away."""
    rig = make_rig(friction={"model": name})
    t = np.arange(4001) * PERIOD
    velocity = 0.01 * np.sin(2.0 * np.pi * t)
    driven = drive(name, velocity, rig.friction)
    viscous, most = rig.friction.viscous_coefficient, rig.friction_level(0.0)
    last_cycle = slice(3000, 4001)
    work = trapezoid(driven.total[last_cycle] * velocity[last_cycle], t[last_cycle])
    path = trapezoid(np.abs(velocity[last_cycle]), t[last_cycle])
    assert 300.0 * path < work < 1.1 * (most + viscous * 0.01) * path
    assert np.abs(driven.total - viscous * velocity).max() <= most * (1 + 1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_at_a_flat_level_the_force_depends_on_the_path_alone(name, drive, friction_of):
    friction = friction_of(name, static_force=640.8, viscous_coefficient=0.0)
    t = np.arange(400) * PERIOD
    knots = 0.02 * np.sin(19.0 * t) + 0.01 * np.sin(83.0 * t)
    slow = np.interp(np.arange(799) / 2, np.arange(400), knots)
    there, faster = drive(name, slow, friction), drive(name, 2.0 * knots, friction, steps=20)
    moving = knots != 0.0
    assert np.ptp(there.total) > 1200.0
    np.testing.assert_allclose(faster.total[moving], there.total[::2][moving], rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_the_scheme_is_of_fourth_order_through_reversals(name, drive, friction_of):
    """With an exponent that leaves the level smooth at standstill."""
    friction = friction_of(name, stribeck_exponent=2.0, attraction_rate=1e5)
    t = np.arange(600) * PERIOD
    velocity = 0.02 * np.sin(17.0 * t) + 0.01 * np.sin(41.0 * t)
    exact = drive(name, velocity, friction, steps=64).total
    coarse, fine = (np.abs(drive(name, velocity, friction, steps=n).total - exact).max() for n in (2, 8))
    assert coarse < 20.0
    assert fine < max(coarse / 4.0**3.5, 1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_it_agrees_with_another_integrator(name, drive, friction_of):
    """Its equations between events by scipy, its events where scipy finds them."""
    model, friction = FRICTION_MODELS.load(name), friction_of(name)
    level, rates, event, switch = (in_python(getattr(model, part)) for part in ("level", "rates", "event", "switch"))
    t = np.arange(120) * PERIOD
    velocity = 0.02 * np.sin(70.0 * t)
    forces, mode = np.zeros(model.states(friction)), np.zeros(model.states(friction))

    def pushed(v):
        return math.copysign(1e9, v)

    for k in range(len(t) - 1):
        slope = (velocity[k + 1] - velocity[k]) / PERIOD

        def v_at(time, start=velocity[k], slope=slope):
            return start + slope * time

        def slopes(time, y):
            rate = np.zeros(len(y))
            rates(v_at(time), level(v_at(time), friction), y, mode, friction, rate)
            return rate

        def crossing(time, y):
            v = v_at(time)
            return event(v, pushed(v), level(v, friction), y, mode, friction)

        crossing.terminal, crossing.direction = True, 1.0
        now = 0.0
        while now < PERIOD:
            part = solve_ivp(slopes, (now, PERIOD), forces, events=crossing, rtol=1e-10, atol=1e-9, max_step=PERIOD / 4)
            forces, now = part.y[:, -1].copy(), part.t[-1]
            if part.status == 1 or crossing(now, forces) > 0.0:
                # Just behind the event, like the package's scheme.
                v = v_at(now + 1e-12)
                switch(v, pushed(v), level(v, friction) * (1.0 - 1e-12), forces, mode, friction)
                now += 1e-12
    driven = drive(name, velocity, friction, steps=20)
    np.testing.assert_allclose(driven.states[-1], forces, rtol=1e-5, atol=1e-3)
    np.testing.assert_array_equal(driven.modes[-1], mode)


@pytest.mark.parametrize("name", MODELS)
def test_near_rest_it_is_as_stiff_as_it_says(name, drive, friction_of):
    model, friction = FRICTION_MODELS.load(name), friction_of(name, viscous_coefficient=0.0)
    stiffness, way = model.stiffness(friction), 1e-4 * model.break_away(friction)
    if not math.isfinite(stiffness):
        assert way == 0.0
        return
    driven = drive(name, np.full(11, 100.0 * way), friction)
    assert driven.total[-1] / way == pytest.approx(stiffness, rel=1e-3)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("velocity", [1e-3, -0.2])
def test_no_force_relaxes_faster_than_the_relaxation_rate(name, velocity, friction_of):
    """Some force relaxes that fast: the largest slope of the rates over the force, at a flat level."""
    model, friction = FRICTION_MODELS.load(name), friction_of(name, static_force=640.8)
    count, step = model.states(friction), 1e-3

    def rate_at(force):
        rate = np.zeros(count)
        in_python(model.rates)(velocity, 640.8, np.full(count, force), np.full(count, np.sign(velocity)), friction, rate)
        return rate

    forces = np.linspace(-640.8, 640.8, 101)
    slopes = [np.abs(rate_at(force + step) - rate_at(force)).max() / step for force in forces]
    assert max(slopes) == pytest.approx(model.relaxation_rate(friction, abs(velocity)), rel=1e-4)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("balance", [-2000.0, -300.0, 0.0, 500.0])
def test_it_begins_with_the_balance_it_can_hold(name, balance, friction_of):
    model, friction = FRICTION_MODELS.load(name), friction_of(name)
    forces, mode = np.full(model.states(friction), math.nan), np.zeros(model.states(friction))
    in_python(model.begin)(balance, 600.0, friction, forces)
    held = in_python(model.force)(0.0, balance, 600.0, forces, mode, friction)
    assert np.all(np.isfinite(forces))
    assert held == pytest.approx(balance if not math.isfinite(model.stiffness(friction)) else np.clip(balance, -600.0, 600.0))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("mode", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("velocity", [-1e-3, 0.0, 1e-3])
def test_only_a_contact_that_is_rigid_at_rest_uses_the_applied_force(name, mode, velocity, friction_of):
    """The diagnosis keeps a run of any other model although the applied force has changed."""
    model, friction = FRICTION_MODELS.load(name), friction_of(name)

    def told(applied):
        forces, modes = np.full(model.states(friction), 300.0), np.full(model.states(friction), mode)
        state = velocity, applied, 600.0, forces, modes, friction
        values = [in_python(getattr(model, part))(*state) for part in ("force", "event", "switch")]
        return [*values, *modes]

    if math.isfinite(model.stiffness(friction)):
        assert told(-2000.0) == told(0.0) == told(2000.0)
    elif mode == 0.0 and velocity == 0.0:
        assert told(-2000.0) != told(2000.0)


@pytest.mark.parametrize("name", MODELS)
def test_mirrored_rig_runs_mirrored(name, make_rig):
    rig = make_rig(plant={"gravity": 0.0}, friction={"model": name})
    there, back = Simulator(rig, position=0.01), Simulator(rig, position=-0.01)
    back.mode[0] = -1.0
    for k in range(400):
        t = k * PERIOD
        u, fd, rate = 3e-5 * np.sin(25.0 * t) + 1e-5, 900.0 * np.sin(40.0 * t), 36e3 * np.cos(40.0 * t)
        there.advance(u, fd, rate, 0.0, 0.0)
        back.advance(-u, -fd, -rate, 0.0, 0.0)
        np.testing.assert_array_equal(there.y, -back.y)
    assert abs(there.y[1]) > 0.0
