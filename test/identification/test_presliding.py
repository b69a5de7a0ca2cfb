"""The hysteresis loop: ramps of known elements, reduction of their number, and reversals missed by the sensor."""

import numpy as np
import pytest
from made_motions import PERIOD, motion

from ehls_ros.identification.presliding import Branch, corrected_turns, mean_branch, merged, nodes, ramps
from ehls_ros.physics.friction.gms import Parameters as Friction

FRICTION = Friction(
    coulomb_force=600.0,
    static_force=600.0,
    stribeck_velocity=2e-3,
    stribeck_exponent=1.0,
    viscous_coefficient=0.0,
    element_stiffness=(3e6, 5e5),
    element_weight=(0.6, 0.4),
    attraction_rate=1e3,
)
ENDS = 2.0 * np.array(FRICTION.element_weight) * FRICTION.coulomb_force / np.array(FRICTION.element_stiffness)


def gained(travel):
    """Force gained since a reversal, the sum of the elements' ramps."""
    return np.minimum(np.asarray(travel)[..., np.newaxis], ENDS) @ np.array(FRICTION.element_stiffness)


def loop(periods=6, blocks=400, amplitude=1.2e-3):
    """A small sine around 0.1 m with the elements' force."""
    phase = 2.0 * np.pi * np.arange(periods * blocks) / blocks
    position = -amplitude * np.cos(phase)
    made = motion(amplitude * 2.0 * np.pi / (blocks * PERIOD) * np.sin(phase + 1e-9))
    rising = made.velocity > 0.0
    edge = np.where(rising, -amplitude, amplitude)
    force = np.where(rising, -600.0, 600.0) + np.where(rising, 1.0, -1.0) * gained(np.abs(position - edge))
    return made._replace(position=position + 0.1, force=force)


def test_the_mean_branch_is_the_sum_of_the_ramps():
    made = loop()
    branch = mean_branch([made], [made.resolved], [np.zeros(len(made.force))])
    assert branch.branches == len(made.turns) - 1
    assert branch.way[-1] == pytest.approx(2.4e-3, rel=1e-3)
    np.testing.assert_allclose(branch.force, gained(branch.way), atol=0.01 * 1200.0)


def test_what_is_known_of_the_rest_is_taken_off():
    made = loop()
    rest = 4e4 * made.position + 700.0
    loaded = made._replace(force=made.force + rest)
    zero = np.zeros(len(rest))
    np.testing.assert_allclose(
        mean_branch([loaded], [made.resolved], [rest]).force, mean_branch([made], [made.resolved], [zero]).force, atol=1e-9
    )


def test_too_few_whole_branches_are_none():
    made = loop(periods=3)
    assert mean_branch([made], [made.resolved], [np.zeros(len(made.force))]) is not None
    usable = made.resolved.copy()
    usable[made.turns[:-1:2] + 20] = False
    assert mean_branch([made], [usable], [np.zeros(len(made.force))]) is None
    assert mean_branch([], [], []) is None


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_ramps_make_up_the_branch(unit):
    travel = np.linspace(0.0, 2.4e-3, 200)
    ends, stiffness = ramps(Branch(travel, unit * gained(travel), 10))
    np.testing.assert_allclose(np.minimum(travel[:, np.newaxis], ends) @ stiffness, unit * gained(travel), atol=12.0 * unit)
    assert np.all(stiffness > 0.0)
    d, k = merged(ends, stiffness, 2)
    np.testing.assert_allclose(d, np.sort(ENDS), rtol=0.05)
    np.testing.assert_allclose(k, unit * np.array(FRICTION.element_stiffness), rtol=0.05)


@pytest.mark.parametrize("elements", [1, 2, 3, 5, 8])
def test_another_number_of_elements_holds_as_much(elements):
    ends, stiffness = np.array([1e-4, 3e-4, 1e-3, 2e-3]), np.array([4e6, 1e6, 3e5, 1e5])
    d, k = merged(ends, stiffness, elements)
    assert len(d) == len(k) == elements
    assert np.all(k > 0.0)
    assert np.sum(d * k) == pytest.approx(np.sum(ends * stiffness), rel=1e-12)
    assert np.sum(k) == pytest.approx(np.sum(stiffness), rel=1e-12)


def test_nodes_lie_where_elements_give_way():
    stiffness = np.array(FRICTION.element_stiffness)
    first, second = nodes(ENDS[::-1], stiffness[::-1])
    assert (first.way, second.way) == pytest.approx(np.sort(ENDS))
    assert (first.force, second.force) == pytest.approx(gained(np.sort(ENDS)))
    assert first.slope == pytest.approx(3.5e6)
    assert second.slope == pytest.approx(5e5)  # (22): k_2 = K_2


def test_a_missed_turn_is_corrected_by_what_the_force_says():
    made = loop()
    missed = 2e-6
    turn, end = made.turns[1], made.turns[2]
    left = np.full(len(made.force), np.nan)
    direction = np.sign(made.velocity[turn - 1])
    left[turn:end] = -direction * missed * 3.5e6
    corrected = corrected_turns(made, left, FRICTION)
    change = (corrected.velocity - made.velocity) * made.period
    assert change[turn - 1] == pytest.approx(direction * missed)
    assert change[turn] == pytest.approx(-direction * missed)
    assert np.count_nonzero(change) == 2


def test_a_turn_is_moved_no_further_than_the_sensor_can_have_missed_it():
    made = loop()
    left = np.where(np.arange(len(made.force)) >= made.turns[1], 1e6, np.nan)
    change = (corrected_turns(made, left, FRICTION).velocity - made.velocity) * made.period
    assert np.max(np.abs(change)) == pytest.approx(made.turn_doubt)


def test_without_residuals_nothing_is_corrected():
    made = loop()
    unknown = np.full(len(made.force), np.nan)
    np.testing.assert_array_equal(corrected_turns(made, unknown, FRICTION).velocity, made.velocity)
