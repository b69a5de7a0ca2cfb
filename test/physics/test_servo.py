"""The position servo coupled to the loader, against a solution that shares no code with it, balances and closed forms."""

import math

import numpy as np
import pytest
from reference_servo import Coupling, both_turning, solve_pair
from reference_solver import Constants
from rig_runs import PERIOD

from ehls_ros.control.disturbances import position_servo
from ehls_ros.errors import BadInput
from ehls_ros.physics.integration_step import SHORTEST_STEP, check_step, rates, steps_per_period
from ehls_ros.physics.plant import PL, V, X
from ehls_ros.physics.simulator import Simulator

PARAMETERS = position_servo.Parameters()


INPUTS = both_turning(300, PERIOD)


def joined(rig, p=PARAMETERS, start=0.0, step=None, **more):
    """Return loader and servo at rest."""
    servo = position_servo.servo(p, rig, start)
    return Simulator(rig.with_effects(position_servo.loader_effects(p)), PERIOD, step, servo=servo, **more)


def run(simulator, inputs):
    """Run commands and servo references; return the states of both from the start on, shape (cycles + 1, states)."""
    states = [simulator.state.y.copy()]
    for command, wanted, rate in inputs.tolist():
        assert simulator.advance(command, 0.0, 0.0, wanted, rate) == 0
        states.append(simulator.state.y.copy())
    return np.array(states)


def deviation(states, reference):
    return float(np.max(np.abs(states - reference).max(axis=0) / np.abs(reference).max(axis=0)))


@pytest.fixture(scope="module")
def reference():
    return solve_pair(Constants(), "gms", INPUTS, PERIOD)


def test_both_pistons_are_those_of_the_reference(make_rig, reference):
    assert reference.events > 20
    for velocity in (reference.y[:, V], reference.y[:, 7 + V]):
        assert np.count_nonzero(np.diff(np.sign(velocity))) >= 3
    states = run(joined(make_rig()), INPUTS)
    assert deviation(states, reference.y) < 1e-6


def test_another_servo_that_starts_elsewhere_is_the_references(make_rig):
    p = PARAMETERS._replace(stiffness=8e5, damping=500.0, moving_mass=40.0, supply_pressure=1.4e7, position_gain=60.0)
    coupling = Coupling(8e5, 500.0, 40.0, 1.4e7, 60.0)
    expected = solve_pair(Constants(), "gms", INPUTS[:200], PERIOD, (2e-3, -1e-3), coupling)
    states = run(joined(make_rig(), p, start=-1e-3, position=2e-3), INPUTS[:200])
    assert deviation(states, expected.y) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize(("model", "own", "tolerance"), [("lugre", 5, 1e-7), ("stribeck", 4, 1e-5)])
def test_other_friction_of_both_is_the_references(make_rig, model, own, tolerance):
    expected = solve_pair(Constants(), model, INPUTS, PERIOD)
    states = run(joined(make_rig(friction={"model": model})), INPUTS)
    # A rigid contact has a state that is never used.
    used = [*range(own), *range(5, 5 + own)]
    assert deviation(states[:, used], expected.y) < tolerance


def test_shorter_steps_change_nothing(make_rig):
    """No quantity is exchanged only once per step or cycle: the order is the integrator's."""
    rig = make_rig(friction={"stribeck_exponent": 2.0})
    exact, coarse, fine = (run(joined(rig, step=step), INPUTS) for step in (2.5e-5, 1e-3, 2.5e-4))
    assert deviation(fine, exact) < 1e-7
    assert 4.0 < np.log(deviation(coarse, exact) / deviation(fine, exact)) / np.log(4.0) < 6.0


# Neither oil nor friction: only two masses and the spring between them remain.
FREE = {"bulk_modulus": 1e-6, "leakage_coefficient": 0.0, "viscous_damping": 0.0, "spring_stiffness": 0.0, "gravity": 0.0}
SMOOTH = {
    "coulomb_force": 1e-9,
    "static_force": 1e-9,
    "viscous_coefficient": 0.0,
    "element_stiffness": [1e-7, 1e-7, 1e-7],
    "attraction_rate": 1e-9,
}


def test_the_spring_pulls_both_alike(make_rig):
    """Separated by 5 mm and released, they oscillate about their centre of mass, which stays where it was."""
    p = PARAMETERS._replace(moving_mass=30.0, damping=0.0, position_gain=0.0)
    simulator = joined(make_rig(plant=FREE, friction=SMOOTH), p, start=5e-3)
    states = run(simulator, np.zeros((200, 3)))
    loader, servo = states[:, [X, V]], states[:, [7 + X, 7 + V]]
    momentum = 70.0 * loader[:, 1] + 30.0 * servo[:, 1]
    assert np.max(np.abs(momentum)) < 1e-11 * 30.0 * np.max(np.abs(servo[:, 1]))
    omega = math.sqrt(2e6 * (1.0 / 70.0 + 1.0 / 30.0))
    apart = 5e-3 * np.cos(omega * np.arange(201) * PERIOD)
    assert np.max(np.abs(servo[:, 0] - loader[:, 0] - apart)) < 1e-8
    assert np.ptp(loader[:, 0]) == pytest.approx(2.0 * 0.3 * 5e-3, rel=1e-2)


def test_the_damper_takes_what_both_lose(make_rig):
    p = PARAMETERS._replace(moving_mass=30.0, position_gain=0.0)
    simulator = joined(make_rig(plant=FREE, friction=SMOOTH), p, start=5e-3)
    states = run(simulator, np.zeros((200, 3)))
    apart, closing = states[:, 7 + X] - states[:, X], states[:, 7 + V] - states[:, V]
    energy = 0.5 * (70.0 * states[:, V] ** 2 + 30.0 * states[:, 7 + V] ** 2 + 2e6 * apart**2)
    # Simpson's rule over pairs of cycles.
    power = 2e3 * closing**2
    lost = PERIOD / 3.0 * np.sum(power[:-1:2] + 4.0 * power[1::2] + power[2::2])
    assert energy[0] - energy[-1] == pytest.approx(lost, rel=1e-3)
    assert energy[-1] < 0.1 * energy[0]


@pytest.mark.long
def test_a_coupling_of_the_rigs_own_pulls_both_too(make_rig):
    rig = make_rig(plant=FREE, friction=SMOOTH, effects=[{"name": "coupling_stiffness", "stiffness": 1e6, "damping": 300.0}])
    simulator = joined(rig, PARAMETERS._replace(position_gain=0.0), start=5e-3)
    states = run(simulator, np.zeros((50, 3)))
    momentum = 70.0 * (states[:, V] + states[:, 7 + V])
    assert np.max(np.abs(momentum)) < 1e-12 * 70.0 * np.max(np.abs(states[:, V]))


def test_what_it_is_to_follow_is_held_for_a_cycle_and_its_command_within_the_valves_limit(make_rig):
    simulator = joined(make_rig())
    simulator.advance(0.0, 0.0, 0.0, 1e-3, 0.0)
    plant = simulator.constants.servo.plant
    spool = plant.piston_area * 30.0 * 1e-3 / (0.62 * 0.0267 * math.sqrt(2.1e7 / 840.0))
    assert simulator.servo[3] == pytest.approx(-math.expm1(-plant.valve_bandwidth * PERIOD) * spool, rel=1e-9)
    simulator.advance(0.0, 0.0, 0.0, 10.0, 0.0)
    reached = simulator.constants.servo.spool_limit
    expected = reached + (spool * -math.expm1(-plant.valve_bandwidth * PERIOD) - reached) * math.exp(
        -plant.valve_bandwidth * PERIOD
    )
    assert simulator.servo[3] == pytest.approx(expected, rel=1e-9)
    assert simulator.servo[PL] > 0.0


def test_the_step_resolves_the_servo_too(make_rig):
    rig, p = make_rig(), PARAMETERS._replace(moving_mass=0.5)
    loader, light = rig.with_effects(position_servo.loader_effects(p)), position_servo.servo(p, rig, 0.0)
    found = {part.what: part for part in rates(loader, light)}
    # Both pistons oscillate against each other, where the loader's alone would be slower.
    stiff = [part for part in rates(loader, light) if part.further.startswith("stiffness")]
    assert [part.rate for part in stiff] == [pytest.approx(math.sqrt(2e6 * (2.0 + 1.0 / 70.0)))]
    assert found["position servo's oil column"].rate == pytest.approx(math.sqrt(140.0) * found["oil column"].rate)
    assert steps_per_period(loader, PERIOD) == 4
    assert steps_per_period(loader, PERIOD, servo=light) > 4
    lighter = position_servo.servo(p._replace(moving_mass=0.1), rig, 0.0)
    with pytest.raises(BadInput) as caught:
        check_step(loader, SHORTEST_STEP, "rig.yaml", lighter)
    assert "position servo's damping" in caught.value.what
    assert "on 0.1 kg" in caught.value.what
