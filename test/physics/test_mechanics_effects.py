"""Effects of the mechanics: free play, stops, a mass on a spring."""

import math

import numpy as np
import pytest
from rig_runs import PERIOD, run, stage_effects

from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.plant import FRICTION, INPUTS, V, X
from ehls_ros.physics.simulator import Simulator

# Oil that exerts no pressure and a compliant contact: only the test's forces act on the piston.
LOOSE = {"bulk_modulus": 1e-6, "leakage_coefficient": 0.0, "viscous_damping": 0.0, "gravity": 0.0, "spring_stiffness": 0.0}
SLIPPERY = {
    "coulomb_force": 1.0,
    "static_force": 1.0,
    "viscous_coefficient": 0.0,
    "element_stiffness": [1e-12, 1e-12, 1e-12],
    "element_weight": [0.5, 0.3, 0.2],
}
MECHANICS = [use["name"] for use in stage_effects("mechanics", {})]
OWN = FRICTION + 3 + sum(getattr(EFFECTS.load(name), "STATES", 0) for name in MECHANICS[: MECHANICS.index("flexible_mode")])
"""Index of the flexible mode's first state; the states of effects before it by name come first."""


@pytest.fixture
def loose(make_rig):
    """Return a simulator of a free piston, with effects of the mechanics."""

    def make(changed, period=PERIOD, **plant):
        effects = stage_effects("mechanics", changed)
        return Simulator(make_rig(plant={**LOOSE, **plant}, friction=SLIPPERY, effects=effects), period, 1e-5)

    return make


@pytest.mark.long
def test_a_stop_pushes_back_and_never_pulls_and_takes_energy(loose):
    stop = {"upper": 0.01, "stiffness": 1e6, "damping": 2e3}
    simulator = loose({"end_stop": stop}, 1e-4)
    simulator.y[V] = 0.5
    states = run(simulator, np.zeros((1000, 3)))
    push = np.diff(states[:, V]) * 70.0 / 1e-4
    assert np.all(push <= 1e-6)
    assert np.max(states[:, X]) > 0.012
    # Half a swing: ringing down by exp(-ζω t) on the way in, at ω back out.
    assert -0.5 < states[-1, V] < -0.3
    outside = states[:, X] < 0.01
    assert np.ptp(states[outside & (states[:, V] > 0.0), V]) < 1e-9


def test_a_stop_with_hunt_and_crossleys_loss_gives_back_what_they_say(loose):
    """m v dv = -k d (1 + c v) dd: the depths on the way in and out have (v/c - ln(1 + c v)/c²) in common at either end."""
    loss, speed = 0.8, 0.5
    simulator = loose({"end_stop": {"upper": 0.01, "stiffness": 1e6, "damping": 0.0, "loss": loss}}, 1e-4)
    simulator.y[V] = speed
    states = run(simulator, np.zeros((1500, 3)))
    assert states[-1, X] < 0.01

    def taken(v):
        return v / loss - math.log1p(loss * v) / loss**2

    assert taken(states[-1, V]) == pytest.approx(taken(speed), rel=2e-3)
    deepest = math.sqrt(2.0 * 70.0 / 1e6 * taken(speed))
    assert np.max(states[:, X]) - 0.01 == pytest.approx(deepest, rel=2e-3)


def test_a_piston_pressed_against_a_stop_stands_as_deep_as_the_stop_gives(loose):
    simulator = loose({"end_stop": {"lower": -0.01, "stiffness": 1e6, "damping": 1e4}})
    for _ in range(3000):
        simulator.advance(0.0, 500.0, 0.0, 0.0, 0.0)
    assert simulator.y[X] == pytest.approx(-0.01 - 500.0 / 1e6, rel=1e-4)


def test_free_play_leaves_the_piston_alone_around_the_middle(loose):
    """With ks the piston oscillates; half a cycle of it lies on either side of the gap."""
    simulator = loose({"hinge_backlash": {"gap": 0.01}}, 1e-4, spring_stiffness=4e4)
    simulator.y[X] = 0.02
    x = run(simulator, np.zeros((8000, 3)))[:, X]
    # From rest at 15 mm beyond the gap: a quarter cycle, the gap at constant speed, a quarter cycle.
    omega = math.sqrt(4e4 / 70.0)
    half = math.pi / omega + 0.01 / (0.015 * omega)
    crossings = np.flatnonzero(np.diff(np.sign(x)) != 0) * 1e-4
    np.testing.assert_allclose(np.diff(crossings), half, atol=2.1e-4)
    assert np.abs(x).max() == pytest.approx(0.02, rel=1e-4)


def test_a_held_far_side_stays_where_it_is_until_the_play_is_taken_up():
    """The spring's force over the way out and back is a loop as wide as the gap."""
    backlash = EFFECTS.load("hinge_backlash")
    p = backlash.Parameters(held_gap=0.01)
    plant = type("Plant", (), {"spring_stiffness": 4e4})
    y, w, z, dz = np.zeros(7), np.zeros(INPUTS), np.zeros(backlash.STATES), np.zeros(backlash.STATES)
    path = np.concatenate([np.linspace(0.0, 0.05, 501), np.linspace(0.05, -0.05, 1001), np.linspace(-0.05, 0.05, 1001)])
    forces = []
    for x in path:
        y[X] = x
        for _ in range(40):
            backlash.derivatives.py_func(0.0, 0.0, y, w, z, p, plant, dz)
            z += 1e-4 * dz
        forces.append(backlash.force.py_func(0.0, 0.0, y, w, z, p, plant) - 4e4 * x)
    forces = -np.array(forces) / 4e4
    out, back, again = forces[:501], forces[501:1502], forces[1502:]
    np.testing.assert_allclose(out, np.maximum(path[:501] - 0.005, 0.0), atol=1e-9)
    np.testing.assert_allclose(back, np.minimum(path[501:1502] + 0.005, 0.045), atol=1e-9)
    np.testing.assert_allclose(again, np.maximum(path[1502:] - 0.005, -0.045), atol=1e-9)


@pytest.mark.parametrize(("mass", "frequency"), [(20.0, 12.0), (150.0, 40.0)])
def test_a_flexible_mass_on_a_free_piston_keeps_momentum_and_rings_at_its_frequency(mass, frequency, loose):
    simulator = loose({"flexible_mode": {"mass": mass, "frequency": frequency, "damping": 0.0}}, 1e-4)
    simulator.y[V] = 0.3
    states = run(simulator, np.zeros((6000, 3)))
    momentum = 70.0 * states[:, V] + mass * states[:, OWN + 1]
    np.testing.assert_allclose(momentum, 21.0, rtol=1e-9)
    omega = 2.0 * math.pi * frequency * math.sqrt(1.0 + mass / 70.0)
    t = np.arange(6001) * 1e-4
    np.testing.assert_allclose(states[:, OWN], -0.3 / omega * np.sin(omega * t), atol=1e-8)
    energy = 35.0 * states[:, V] ** 2 + 0.5 * mass * states[:, OWN + 1] ** 2
    energy += 0.5 * mass * (2.0 * math.pi * frequency * states[:, OWN]) ** 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)


def test_a_flexible_mass_on_a_held_piston_rings_down_by_its_damping(loose):
    simulator = loose({"flexible_mode": {"mass": 1.0, "frequency": 15.0, "damping": 0.1}}, 1e-4, moving_mass=1e9)
    simulator.y[OWN] = 1e-3
    r = run(simulator, np.zeros((3000, 3)))[:, OWN]
    omega, t = 2.0 * math.pi * 15.0, np.arange(3001) * 1e-4
    damped = omega * math.sqrt(1.0 - 0.01)
    expected = 1e-3 * np.exp(-0.1 * omega * t) * (np.cos(damped * t) + 0.1 * omega / damped * np.sin(damped * t))
    np.testing.assert_allclose(r, expected, atol=1e-9)


def test_a_mass_taken_over_changes_nothing_where_the_mode_is_stiff(loose):
    """At a frequency far above the motion's, both masses move as the rig file's single one."""
    t = np.arange(300) * PERIOD
    inputs = np.column_stack([np.zeros_like(t), 2e3 * np.sin(20.0 * t), 4e4 * np.cos(20.0 * t)])
    mode = {"mass": 30.0, "frequency": 300.0, "damping": 0.3, "taken": 1.0}
    split, whole = (run(loose({"flexible_mode": m}, spring_stiffness=4e4, gravity=9.81), inputs) for m in (mode, {}))
    assert np.max(np.abs(split[:, X] - whole[:, X])) < 1e-3 * np.max(np.abs(whole[:, X]))


@pytest.mark.parametrize(("share", "frequency"), [(0.2, 15.0), (0.6, 40.0)])
def test_a_load_on_an_elastic_beam_keeps_momentum_and_swings_against_the_piston(share, frequency, loose):
    simulator = loose({"flexible_mode": {"piston_share": share, "frequency": frequency, "damping": 0.0}}, 1e-4)
    simulator.y[V] = 0.3
    states = run(simulator, np.zeros((6000, 3)))
    momentum = 70.0 * ((1.0 - share) * states[:, V] + share * states[:, OWN + 1])
    np.testing.assert_allclose(momentum, 70.0 * (1.0 - share) * 0.3, rtol=1e-9)
    omega = 2.0 * math.pi * frequency / math.sqrt(share)
    np.testing.assert_allclose(states[:, OWN], -0.3 / omega * np.sin(omega * np.arange(6001) * 1e-4), atol=1e-8)


def test_a_loose_load_flies_through_the_play_and_is_thrown_back_by_the_piston(loose):
    hinge = {"load_gap": 2e-3, "piston_share": 0.3, "stiffness": 1e7, "damping": 0.0, "rounding": 0.0}
    simulator = loose({"hinge_backlash": hinge}, 1e-4)
    simulator.y[V] = 0.1
    states = run(simulator, np.zeros((400, 3)))
    # The hinge's states follow the flexible mode's two: the held far side, then the piston.
    ahead, piston = states[:, OWN + 3], states[:, OWN + 4]
    np.testing.assert_allclose(0.7 * states[:, V] + 0.3 * piston, 0.07, rtol=1e-9)
    # 1 mm at 0.1 m/s; then half an oscillation of both on the faces' spring.
    assert np.ptp(states[:100, V]) < 1e-12
    bounced = 100 + math.ceil(math.pi * math.sqrt(0.7 * 0.3 * 70.0 / 1e7) / 1e-4) + 1
    np.testing.assert_allclose(states[bounced : bounced + 100, V] - piston[bounced : bounced + 100], -0.1, rtol=1e-5)
    assert np.max(np.abs(ahead)) == pytest.approx(1e-3 + 0.1 * math.sqrt(0.7 * 0.3 * 70.0 / 1e7), rel=1e-3)


def test_sensors_see_the_piston_and_not_the_load(loose):
    simulator = loose({"flexible_mode": {"piston_share": 0.3}})
    simulator.y[X], simulator.y[V], simulator.y[OWN], simulator.y[OWN + 1] = 0.01, 0.2, 0.003, -0.1
    read = simulator.measure(np.zeros(7))
    assert read[:2].tolist() == pytest.approx([0.013, -0.1])


def test_at_most_one_effect_of_a_rig_separates_the_load_from_the_piston(make_rig):
    with pytest.raises(BadInput, match="hinge_backlash and flexible_mode"):
        make_rig(effects=[{"name": "hinge_backlash", "load_gap": 1e-3}, {"name": "flexible_mode", "piston_share": 0.2}])
    shut = make_rig(effects=[{"name": "hinge_backlash", "load_gap": 1e-3}, {"name": "flexible_mode", "mass": 5.0}])
    assert shut.effective().piston_mass() == pytest.approx(0.2 * 70.0)
