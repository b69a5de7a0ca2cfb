"""Distinguishing features of the generalised Maxwell slip model."""

import numpy as np
import pytest

from ehls_ros.physics.friction.gms import Parameters
from ehls_ros.physics.simulator import Simulator

# Level curve flat, break-away at 0.05, 0.15 and 0.4 mm: a pure Maxwell slip model, whose force is known in closed form.
FLAT = Parameters(
    coulomb_force=800.0,
    static_force=800.0,
    stribeck_velocity=2e-3,
    stribeck_exponent=1.0,
    viscous_coefficient=0.0,
    element_stiffness=(0.2 * 800 / 5e-5, 0.3 * 800 / 1.5e-4, 0.5 * 800 / 4e-4),
    element_weight=(0.2, 0.3, 0.5),
    attraction_rate=1650.0,
)
SPEED = 1e-3


def path(*turns, speed=SPEED):
    """Return velocities that visit positions one after the other from 0, and the samples at which it is there.

    Each leg starts and ends with a sample of no velocity; between samples the velocity is a straight line.
    """
    velocity, arrivals, here = [0.0], [], 0.0
    for turn in turns:
        distance = turn - here
        samples = round(abs(distance) / (speed * 1e-3))
        velocity += [np.sign(distance) * speed] * samples + [0.0]
        arrivals.append(len(velocity) - 1)
        here = turn
    return np.array(velocity), arrivals


def maxwell_slip(friction, turns):
    """Return the force at each turn: every element a spring behind a slider."""
    level = friction.static_force
    forces, total, here = np.zeros(len(friction.element_weight)), [], 0.0
    for turn in turns:
        bound = np.array(friction.element_weight) * level
        forces = np.clip(forces + np.array(friction.element_stiffness) * (turn - here), -bound, bound)
        total.append(forces.sum())
        here = turn
    return np.array(total)


def test_presliding_follows_the_closed_form(drive):
    turns = [1e-4, -5e-5, 2.4e-4, -1.2e-4, 2e-5, 6e-4, -6e-4]
    velocity, arrivals = path(*turns)
    driven = drive("gms", velocity, FLAT)
    np.testing.assert_allclose(driven.total[arrivals], maxwell_slip(FLAT, turns), rtol=1e-9)


def test_inner_loops_close_and_are_wiped_out(drive):
    velocity, (_, low, _, again, high) = path(2e-4, -5e-5, 1.2e-4, -5e-5, 2e-4)
    driven = drive("gms", velocity, FLAT)
    plain_velocity, (_, _, plain_high) = path(2e-4, -5e-5, 2e-4)
    plain = drive("gms", plain_velocity, FLAT)
    inside = driven.total[low : again + 1]
    assert np.ptp(inside) > 300.0
    assert driven.total[again] == pytest.approx(driven.total[low], rel=1e-9)
    assert driven.total[high] == pytest.approx(plain.total[plain_high], rel=1e-9)
    # The way out of the inner loop is not the way in: a memory, not a spring.
    up, down = driven.total[low + 80], driven.total[again - 80]
    assert down < up - 50.0


def test_presliding_does_not_depend_on_speed(drive):
    turns = [2e-4, -5e-5, 1.2e-4]
    (slow, slow_at), (fast, fast_at) = path(*turns), path(*turns, speed=5e-3)
    np.testing.assert_allclose(drive("gms", slow, FLAT).total[slow_at], drive("gms", fast, FLAT).total[fast_at], rtol=1e-9)


def test_friction_lags_behind_velocity(drive, make_rig):
    """In slip it is higher while the velocity rises than while it falls, and more so the faster it changes."""
    friction = make_rig().friction
    t = np.arange(40_000) * 1e-3
    widths = []
    for period in (6.0, 2.0):
        velocity = 5e-3 + 4e-3 * np.sin(2.0 * np.pi / period * t)
        driven = drive("gms", velocity, friction, steps=2)
        force = driven.states.sum(axis=1)
        rising = 30_000
        falling = rising + round(500 * period)
        assert velocity[rising] == pytest.approx(velocity[falling], rel=1e-9)
        widths.append(force[rising] - force[falling])
        assert np.all(driven.modes[1000:] == 1.0)
    assert 1.0 < widths[0] < widths[1]
    # A loop wider than the Stribeck curve's fall between 1 and 9 mm/s would be no lag.
    assert max(widths) < 865.4 - 640.8


def test_an_element_that_is_being_unloaded_does_not_slip(drive, make_rig):
    """Even if a fast reversal leaves it above the Stribeck curve, which is lower at speed."""
    friction = make_rig().friction
    velocity = np.concatenate([np.full(6000, 2e-4), [0.0, -0.2]])
    driven = drive("gms", velocity, friction)
    before, after = driven.states[-2], driven.states[-1]
    assert before.sum() > 830.0
    assert np.all(driven.modes[-1] == 0.0)
    np.testing.assert_allclose(after, before - 1e-4 * np.array(friction.element_stiffness), rtol=1e-9)


def test_elements_stay_within_their_share(drive, make_rig):
    seed = np.random.SeedSequence().entropy
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    rig = make_rig()
    for _ in range(20):
        scale = 10.0 ** random.uniform(-4, -0.5)
        corner = random.uniform(0.01, 0.9)
        velocity = np.zeros(3000)
        for k in range(1, velocity.size):
            velocity[k] = corner * velocity[k - 1] + scale * random.standard_normal()
        driven = drive("gms", velocity, rig.friction, steps=4)
        share = np.array(rig.friction.element_weight) * rig.friction.static_force
        assert np.all(np.abs(driven.states) <= share * (1 + 1e-9))
        assert np.all(np.abs(driven.states.sum(axis=1)) <= rig.friction.static_force * (1 + 1e-9))


def test_no_step_ends_slipping_against_the_motion(make_rig):
    simulator = Simulator(make_rig(), period=1e-4, step=1e-4)
    reversals, before = 0, simulator.mode[1:].copy()
    for k in range(1500):
        command = 4e-5 * np.sin(20.0 * k * 1e-3)
        for _ in range(10):
            simulator.advance(command, 0.0, 0.0, 0.0, 0.0)
            slipping = simulator.mode[1:]
            assert np.all(slipping * simulator.y[1] >= -1e-9)
            reversals += int(np.any(before != 0.0) and np.all(slipping == 0.0))
            before = slipping.copy()
    assert reversals >= 5
