"""The static fit in its parts, on sliding with known friction."""

import numpy as np
import pytest
from made_motions import motion
from static_data import DAMPING, SPEEDS, TRUTH, steady_force

from ehls_ros.errors import BadInput
from ehls_ros.identification import static, stribeck
from ehls_ros.identification.balance import Recorded
from ehls_ros.identification.optimisers import least_squares
from ehls_ros.identification.static import Blocks, Search, averaged, linear_part, settle_time, sliding, steady_fit

HOW = Search("least_squares", least_squares.Parameters(), 1)
SPRING, CONSTANT = 4e4, 700.0
LINEAR = ("spring", "constant")


def strokes(speeds=SPEEDS, blocks=150, noise=0.0, settling=0.0):
    """Return strokes to and fro at each speed, with friction that settles after each turn."""
    random = np.random.default_rng(7)
    velocity = np.concatenate([np.full(blocks, way * speed) for speed in speeds for way in (1.0, -1.0)])
    made = motion(velocity)
    since = np.tile(np.arange(blocks), 2 * len(speeds)) * made.period
    force = steady_force(velocity) + SPRING * made.position + CONSTANT + noise * random.standard_normal(len(velocity))
    force += settling * np.sign(velocity) * np.exp(-since / 0.15)
    return made._replace(force=force, acceleration=np.zeros(len(velocity)), force_noise=max(noise, 1e-3))


def recorded(*made, linear=LINEAR):
    return Recorded(made, tuple(m.resolved for m in made), linear)


def blocks_of(made):
    return sliding(recorded(made))


def test_noise_free_sliding_gives_the_friction():
    found = steady_fit(recorded(strokes()), DAMPING, HOW)
    np.testing.assert_allclose(found.friction, TRUTH, rtol=2e-3)
    assert found.linear == pytest.approx({"spring": SPRING, "constant": CONSTANT}, rel=1e-3)
    assert found.settle_time == static.SETTLE_TIMES[0]
    assert found.search.converged


def test_b0_and_sigma_f_share_what_is_viscous():
    found = steady_fit(recorded(strokes()), DAMPING + 1000.0, HOW)
    assert found.friction.viscous_coefficient == pytest.approx(TRUTH.viscous_coefficient - 1000.0, rel=2e-3)
    assert found.friction.coulomb_force == pytest.approx(TRUTH.coulomb_force, rel=2e-3)


def test_the_order_of_recordings_does_not_matter():
    random = np.random.default_rng(10)
    first, second = (
        made._replace(velocity=made.velocity * (1.0 + 1e-6 * random.standard_normal(len(made.velocity))))
        for made in (strokes(SPEEDS[::2], noise=1.0), strokes(SPEEDS[1::2], noise=1.0))
    )
    one, other = (steady_fit(recorded(*pair), DAMPING, HOW) for pair in ((first, second), (second, first)))
    np.testing.assert_allclose(other.friction, one.friction, rtol=1e-6)


def test_forces_in_another_unit_give_friction_in_that_unit():
    made = strokes(noise=1.0)
    scaled = made._replace(force=1e-3 * made.force, force_noise=1e-3 * made.force_noise)
    one, other = steady_fit(recorded(made), DAMPING, HOW), steady_fit(recorded(scaled), 1e-3 * DAMPING, HOW)
    for name in ("coulomb_force", "static_force", "viscous_coefficient"):
        assert getattr(other.friction, name) == pytest.approx(1e-3 * getattr(one.friction, name), rel=1e-3)
    assert other.friction.stribeck_velocity == pytest.approx(one.friction.stribeck_velocity, rel=1e-3)


def test_a_stray_class_is_left_out():
    made = strokes(noise=1.0)
    spoilt = made.force.copy()
    spoilt[1500:1650] += 200.0
    found = steady_fit(recorded(made._replace(force=spoilt)), DAMPING, HOW)
    assert found.friction.coulomb_force == pytest.approx(TRUTH.coulomb_force, rel=5e-3)
    assert made.velocity[1500] not in found.velocity


def test_nothing_to_fit_is_none():
    assert steady_fit(recorded(), DAMPING, HOW) is None
    assert steady_fit(recorded(motion(np.zeros(500))), DAMPING, HOW) is None
    assert steady_fit(recorded(motion(np.repeat([0.1, -0.1], 250))), DAMPING, HOW) is None  # one speed
    assert steady_fit(recorded(strokes(SPEEDS[:2], blocks=4)), DAMPING, HOW) is None


@pytest.mark.parametrize(("way", "said"), [(1.0, "forwards"), (-1.0, "backwards")])
def test_one_way_is_refused(way, said):
    made = motion(way * np.repeat(SPEEDS, 100))
    with pytest.raises(BadInput, match=f"position_m slides {said} only") as refused:
        steady_fit(recorded(made), DAMPING, HOW)
    assert "strokes in both directions" in str(refused.value)


def test_the_time_since_a_turn_starts_at_turns_gaps_and_stops():
    velocity = np.array([0.1] * 50 + [-0.1] * 50 + [0.0] * 10 + [-0.1] * 40)
    made = motion(velocity)
    usable = made.resolved.copy()
    usable[20] = False
    found = sliding(Recorded((made,), (usable,), LINEAR))
    starts = np.flatnonzero(np.diff(found.since) < 0.0)
    assert len(starts) == 3
    assert np.all(found.since[starts + 1] <= 2.0 * made.period)
    assert len(found.velocity) == len(velocity) - 10 - 1 - 4  # stops, the gap, and the first block after each start
    assert found.columns[:, 1].tolist() == [1.0] * len(found.velocity)


def test_the_linear_part_is_exact_where_the_grid_holds_the_curve():
    made = strokes()
    friction = stribeck.StaticFriction(600.0, 900.0, static.VELOCITIES[6], static.EXPONENTS[1], 5000.0)
    blocks = blocks_of(made._replace(force=stribeck.steady_force(made.velocity, friction) + SPRING * made.position + CONSTANT))
    np.testing.assert_allclose(linear_part(blocks), [SPRING, CONSTANT], rtol=1e-7)
    heavier = Blocks(blocks.velocity, blocks.since, blocks.force, blocks.columns, 7.0 * blocks.noise)
    np.testing.assert_allclose(linear_part(heavier), [SPRING, CONSTANT], rtol=1e-7)


@pytest.mark.parametrize(("settling", "least", "most"), [(0.0, 0.1, 0.1), (300.0, 0.4, 1.0)])
def test_settling_is_waited_for(settling, least, most):
    made = strokes(noise=1.0, blocks=300, settling=settling)
    assert least <= settle_time(blocks_of(made)) <= most


def test_classes_hold_equal_speeds_and_know_their_scatter():
    random = np.random.default_rng(8)
    speeds = np.array([-0.1, -0.01, 0.01, 0.1])
    velocity = np.repeat(speeds, 4000)
    noise = np.full(len(velocity), 5.0)
    spread = [averaged(velocity, 5.0 * random.standard_normal(len(velocity)), noise).force for _ in range(10)]
    classes = averaged(velocity, noise, noise)
    assert set(np.round(classes.velocity, 12)) == set(speeds)
    assert np.std(np.concatenate(spread)) == pytest.approx(float(classes.deviation[0]), rel=0.1)


def test_classes_do_not_depend_on_order_and_ignore_stragglers():
    random = np.random.default_rng(9)
    velocity = np.repeat(np.linspace(0.01, 0.1, 30), 50)
    force, noise = 1e3 * velocity, np.ones(len(velocity))
    force[::50] = 1e6
    order = random.permutation(len(velocity))
    here, there = averaged(velocity, force, noise), averaged(velocity[order], force[order], noise)
    np.testing.assert_allclose(here.force, 1e3 * here.velocity, rtol=1e-9)
    np.testing.assert_allclose(there.force, here.force, rtol=1e-9)


@pytest.mark.parametrize("blocks", [4, 10, 60, 300])
def test_few_blocks_make_classes_too(blocks):
    speeds = np.array([-0.02, -0.01, 0.01, 0.02, 0.03])
    velocity = np.repeat(speeds, blocks)
    classes = averaged(velocity, 1e3 * velocity, np.ones(len(velocity)))
    assert sorted(set(np.round(classes.velocity, 9))) == speeds.tolist()
    np.testing.assert_allclose(classes.force, 1e3 * classes.velocity)


def test_a_class_of_too_few_blocks_is_dropped():
    velocity = np.concatenate([np.full(100, 0.01), np.full(2, 0.05), np.full(100, 0.1)])
    classes = averaged(velocity, velocity, np.ones(len(velocity)))
    assert sorted(set(np.round(classes.velocity, 9))) == [0.01, 0.1]
