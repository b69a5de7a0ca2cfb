"""Friction elements: their coordinates, their force along a motion, and the blocks that determine each coefficient."""

import numpy as np
import pytest
from made_motions import motion

from ehls_ros.errors import BadInput
from ehls_ros.identification.balance import Recorded, check_unit, linear_columns
from ehls_ros.identification.elements import (
    EXPONENTS,
    STATIC,
    ElementCoordinates,
    ramps_of,
)
from ehls_ros.identification.friction_run import MAX_PARTS, force_along
from ehls_ros.identification.motion import slides
from ehls_ros.physics.friction.gms import Parameters as Friction

FRICTION = Friction(
    coulomb_force=640.0,
    static_force=865.0,
    stribeck_velocity=2e-3,
    stribeck_exponent=0.9,
    viscous_coefficient=0.0,
    element_stiffness=(3e6, 1e6, 3e5),
    element_weight=(0.35, 0.4, 0.25),
    attraction_rate=1650.0,
)


@pytest.mark.parametrize("elements", [1, 2, 3])
def test_coordinates_and_friction_are_each_others_inverse(elements):
    weight = np.array(FRICTION.element_weight[:elements]) / sum(FRICTION.element_weight[:elements])
    friction = FRICTION._replace(element_stiffness=FRICTION.element_stiffness[:elements], element_weight=tuple(weight.tolist()))
    coordinates = ElementCoordinates(elements)
    z = coordinates.pack(friction)
    assert z.shape == (len(coordinates.names),)
    for value, expected in zip(coordinates.unpack(z), friction, strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-12)


def test_any_coordinates_are_a_friction_that_a_rig_takes():
    random = np.random.default_rng(0)
    coordinates = ElementCoordinates(3)
    for z in random.normal(0.0, 5.0, (100, len(coordinates.names))):
        friction = coordinates.unpack(z)
        assert 0.0 < friction.coulomb_force <= friction.static_force
        assert sum(friction.element_weight) == pytest.approx(1.0, abs=1e-9)
        assert min(*friction.element_weight, *friction.element_stiffness, friction.attraction_rate) > 0.0


def test_static_friction_below_coulombs_starts_just_above_it():
    coordinates = ElementCoordinates(3)
    start = coordinates.unpack(coordinates.pack(FRICTION._replace(static_force=600.0)))
    assert start.coulomb_force == pytest.approx(640.0)
    assert start.static_force == pytest.approx(640.64)


def test_bounds_hold_the_start_the_exponents_range_and_what_a_block_resolves():
    coordinates = ElementCoordinates(3)
    z = coordinates.pack(FRICTION)
    low, high = coordinates.bounds(z, 0.02)
    assert np.all(low < high)
    assert np.all((low <= z) & (z <= high))
    exponent, rate = coordinates.names.index("stribeck_exponent"), coordinates.names.index("attraction_rate")
    np.testing.assert_allclose(np.exp([low[exponent], high[exponent]]), EXPONENTS)
    _, slow = coordinates.bounds(z, 10.0)
    assert np.exp(slow[rate]) == pytest.approx(MAX_PARTS / 10.0 * FRICTION.coulomb_force)
    assert len(STATIC) + 1 + 3 + 2 == len(z)


def test_sticking_elements_are_springs():
    velocity = np.full(50, 1e-5)
    force = force_along(motion(velocity), "gms", FRICTION)
    travel = 1e-5 * 0.01 * (np.arange(50) + 0.5)
    np.testing.assert_allclose(np.diff(force), sum(FRICTION.element_stiffness) * np.diff(travel), rtol=1e-6)


@pytest.mark.parametrize("speed", [1e-3, 0.05, -0.02])
def test_steady_sliding_is_the_stribeck_curve(speed):
    force = force_along(motion(np.full(2000, speed)), "gms", FRICTION)
    level = 640.0 + 225.0 * np.exp(-((abs(speed) / 2e-3) ** 0.9))
    assert force[-1] == pytest.approx(np.sign(speed) * level, rel=1e-6)


def test_a_gap_begins_with_elements_at_rest():
    velocity = np.tile(np.full(300, 0.01), 2)
    fresh = np.arange(600) % 300 == 0
    force = force_along(motion(velocity, fresh=fresh), "gms", FRICTION)
    np.testing.assert_allclose(force[300:], force[:300], rtol=1e-9)


def test_the_motion_turned_round_turns_the_force_round():
    velocity = 0.01 * np.sin(np.linspace(0.0, 30.0, 900))
    np.testing.assert_allclose(force_along(motion(-velocity), "gms", FRICTION), -force_along(motion(velocity), "gms", FRICTION))


def test_ramps_end_where_elements_have_gone_from_one_side_to_the_other():
    ends, stiffness = ramps_of(FRICTION)
    np.testing.assert_allclose(ends * stiffness / 2.0, np.array(FRICTION.element_weight) * FRICTION.static_force)


def test_sliding_needs_travel_and_time():
    made = motion(np.concatenate([np.full(200, 0.01), np.full(200, -0.1)]))
    usable = slides(made, 5e-3, 0.3)
    # 5 mm take 0.5 s at 10 mm/s, less than 0.3 s at 100 mm/s.
    assert np.flatnonzero(usable[:200])[0] == pytest.approx(50, abs=1)
    assert np.flatnonzero(usable[200:])[0] == pytest.approx(30, abs=1)
    assert usable[60:200].all()


def test_of_short_strokes_the_end_counts_unless_it_still_settles():
    made = motion(np.tile(np.repeat([0.1, -0.1], 100), 3))
    assert slides(made, 1e-3, 0.7)[60:100].any()
    assert np.mean(slides(made, 1e-3, 0.7)) == pytest.approx(0.4, abs=0.02)
    assert not slides(made, 1e-3, 1.5).any()


def test_standstill_is_no_sliding():
    made = motion(np.full(300, 1e-6), velocity_noise=1e-6)
    assert not slides(made, 0.0, 0.0).any()


def test_linear_columns_have_the_units_of_their_coefficients():
    made = motion(np.linspace(-1.0, 1.0, 50))
    columns = linear_columns(made, ("mass", "constant", "spring", "viscous"))
    for column, expected in zip(columns.T, (made.acceleration, np.ones(50), made.position, made.velocity), strict=True):
        np.testing.assert_array_equal(column, expected)


def test_recordings_are_chosen_by_number():
    parts = [motion(np.full(10, float(i)), name=str(i)) for i in range(3)]
    data = Recorded(tuple(parts), tuple(m.resolved for m in parts), ("constant",))
    assert [m.name for m in data.chosen([2, 0]).motions] == ["2", "0"]
    assert data.chosen([]).motions == ()


@pytest.mark.parametrize("ratio", [1e-3, 1e3, -1e3])
def test_only_a_wrong_unit_explains_a_factor_of_a_thousand(ratio):
    check_unit("spring", 50.0 * 4e4, 4e4, "sweep")
    with pytest.raises(BadInput, match="sweep: force_n and position_m make the spring"):
        check_unit("spring", ratio * 4e4, 4e4, "sweep")
