"""Standstill of the Stribeck model, presliding of LuGre."""

import numpy as np
import pytest
from rig_runs import run

from ehls_ros.physics.simulator import Simulator

CLOSED = {"gravity": 0.0, "leakage_coefficient": 0.0}


def ramp(rate, cycles):
    """Return inputs with the valve closed and a force that grows."""
    t = np.arange(cycles) * 1e-3
    return np.column_stack([np.zeros(cycles), rate * t, np.full(cycles, rate)])


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_stribeck_stands_still_up_to_the_static_force(make_rig, direction):
    rig = make_rig(plant=CLOSED, friction={"model": "stribeck"})
    states = run(Simulator(rig, position=0.0), ramp(direction * 1000.0, 900))
    breaks_away = 865.4 / 1000.0
    still, moving = states[: int(breaks_away * 1000) + 1], states[int(breaks_away * 1000) + 1 :]
    assert np.all(still[:, :3] == 0.0)
    assert np.sign(moving[0, 1]) == -direction


def test_stribeck_stops_and_stands_to_the_bit(make_rig):
    """Released at speed with the valve closed, it swings out and then stays at rest."""
    simulator = Simulator(make_rig(plant=CLOSED, friction={"model": "stribeck"}))
    simulator.y[1], simulator.mode[1] = 0.2, 1.0
    states = run(simulator, ramp(0.0, 300))
    assert simulator.mode[1] == 0.0
    stopped = int(np.flatnonzero(states[:, 1] != 0.0)[-1]) + 1
    assert stopped < 250
    assert np.all(states[stopped:, :3] == states[-1, :3])


def test_a_spool_that_changes_sides_neither_stops_nor_starts_a_stribeck_contact(make_rig):
    rig = make_rig(plant={"gravity": 0.0}, friction={"model": "stribeck"})
    sliding = Simulator(rig)
    sliding.y[1], sliding.y[3], sliding.mode[1] = 0.3, 2e-6, 1.0
    velocities = run(sliding, np.array([[-4e-5, 0.0, 0.0]]))[:, 1]
    assert sliding.mode[0] == -1.0
    assert velocities[1] > 0.7 * velocities[0]

    standing = Simulator(rig)
    standing.y[3] = 2e-6
    states = run(standing, np.tile([-4e-6, 0.0, 0.0], (30, 1)))
    assert standing.mode[0] == -1.0
    assert np.all(states[:, 1] == 0.0)


def test_a_stribeck_contact_pushed_hard_goes_straight_through_a_reversal(make_rig):
    simulator = Simulator(make_rig(plant=CLOSED, friction={"model": "stribeck"}))
    simulator.y[1], simulator.mode[1] = 1e-3, 1.0
    states = run(simulator, np.tile([0.0, 3000.0, 0.0], (3, 1)))
    assert np.all(states[1:, 1] < 0.0)
    assert simulator.mode[1] == -1.0


def test_lugre_presliding_stiffness_is_that_of_all_elements(drive, make_rig):
    friction = make_rig(friction={"model": "lugre"}).friction
    velocity = np.full(11, 1e-6)
    driven = drive("lugre", velocity, friction)
    distance = 1e-6 * 10e-3
    assert driven.states[-1, 0] / distance == pytest.approx(1884e3 + 196.9e3 + 184.1e3, rel=1e-4)


def test_lugre_force_depends_on_distance_alone_at_constant_level(drive, make_rig):
    """F = s (1 - exp(-sigma0 x/s)), the closed form while s is constant."""
    friction = make_rig(
        friction={"model": "lugre", "coulomb_force": 700.0, "static_force": 700.0, "viscous_coefficient": 0.0}
    ).friction
    sigma = friction.presliding_stiffness
    driven = drive("lugre", np.full(201, 4e-3), friction)
    distance = 4e-3 * np.arange(201) * 1e-3
    np.testing.assert_allclose(driven.total, 700.0 * (1.0 - np.exp(-sigma * distance / 700.0)), rtol=1e-8, atol=1e-6)
