"""Effects with a table found in data: the table itself, and its neutral default."""

import math

import numpy as np
import pytest

from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects._table import KNOTS, VALUES
from ehls_ros.physics.effects.base import HOOKS
from ehls_ros.physics.plant import INPUTS, PL, XV, V, X
from ehls_ros.physics.rig import EffectUse, rig_from_mapping, rig_to_mapping

FORCE = EFFECTS.load("empirical_force")
VALUE = np.random.default_rng(1).uniform(-200.0, 300.0, KNOTS)


@pytest.fixture(scope="module")
def force():
    """Return the force of a table at a position and velocity."""

    def at(position, velocity=0.0, pressure=0.0, **parameters):
        y = np.zeros(5)
        y[X], y[V], y[PL] = position, velocity, pressure
        given = {"per_position": 10.0, "offset": 0.5, **dict(zip(VALUES, VALUE.tolist(), strict=True)), **parameters}
        return FORCE.force(0.0, 0.0, y, np.zeros(INPUTS), np.zeros(1), FORCE.Parameters(**given), None)

    return at


def test_a_rig_file_lists_only_the_parameters_in_use(make_rig):
    use = EffectUse("empirical_force", FORCE.Parameters(per_velocity=5.0, power=-240.0, exponent=2.0, knots=0.0))
    written = rig_to_mapping(make_rig().with_effects((use,)))["effects"]
    assert written == [{"name": "empirical_force", "per_velocity": 5.0, "power": -240.0, "exponent": 2.0, "knots": 0.0}]
    assert rig_from_mapping(rig_to_mapping(make_rig().with_effects((use,))), "extended").effects == (use,)


def test_between_the_knots_a_table_is_linear(force):
    for position in np.linspace(-0.05, 0.05, 37):
        expected = np.interp(10.0 * position + 0.5, np.linspace(0.0, 1.0, KNOTS), VALUE)
        assert force(position) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_with_fewer_knots_the_first_values_count(force):
    for position in (-0.05, -0.013, 0.05):
        expected = np.interp(10.0 * position + 0.5, np.linspace(0.0, 1.0, 5), VALUE[:5])
        assert force(position, knots=5.0) == pytest.approx(expected, rel=1e-9)


def test_beyond_the_knots_it_goes_on_as_far_as_the_data_and_no_further(force):
    step = (VALUE[-1] - VALUE[-2]) * (KNOTS - 1)
    assert force(0.052, highest=1.04) == pytest.approx(VALUE[-1] + 0.02 * step, rel=1e-9)
    assert force(0.08, highest=1.04) == pytest.approx(VALUE[-1] + 0.04 * step, rel=1e-9)
    assert force(-0.9) == pytest.approx(VALUE[0], rel=1e-12)


def test_a_periodic_table_repeats_without_a_step(force):
    closed = np.append(VALUE[:8], VALUE[0])
    for position in np.linspace(-0.4, 0.4, 41):
        expected = np.interp((10.0 * position + 0.5) % 1.0, np.linspace(0.0, 1.0, 9), closed)
        assert force(position, periodic=1.0, knots=8.0) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_its_sign_may_follow_the_direction_of_motion(force):
    still = force(0.01)
    for velocity in (-0.3, -0.01, 0.02):
        assert force(0.01, velocity, direction=0.02) == pytest.approx(still * math.tanh(velocity / 0.02), rel=1e-9)


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ({"level": 7.0}, lambda s: 7.0),
        ({"power": 50.0, "exponent": 1.7}, lambda s: 50.0 * abs(s) ** 1.7 * math.copysign(1.0, s)),
        ({"power": 50.0, "exponent": 1.7, "even": 1.0, "power_at": 0.2}, lambda s: 50.0 * abs(s - 0.2) ** 1.7),
        ({"bump": 30.0, "bump_at": -0.1, "bump_width": 0.2}, lambda s: 30.0 * math.exp(-(((s + 0.1) / 0.2) ** 2))),
        (
            {"bump": 30.0, "bump_at": -0.1, "bump_width": 0.2, "bump_odd": 1.0},
            lambda s: 30.0 * math.sqrt(2.0 * math.e) * (s + 0.1) / 0.2 * math.exp(-(((s + 0.1) / 0.2) ** 2)),
        ),
        ({"step": 30.0, "step_at": 0.1, "step_width": 0.3}, lambda s: 30.0 * math.tanh((s - 0.1) / 0.3)),
        ({"beyond": 30.0, "beyond_at": 0.1}, lambda s: 30.0 * (max(s - 0.1, 0.0) - max(-s - 0.1, 0.0))),
        ({"beyond": 30.0, "beyond_at": 0.1, "beyond_side": 1.0}, lambda s: 30.0 * max(s - 0.1, 0.0)),
        ({"beyond": 30.0, "beyond_at": -0.1, "beyond_side": -1.0}, lambda s: 30.0 * min(s + 0.1, 0.0)),
        (
            {"wave": 9.0, "wave_number": 3.0, "wave_phase": 0.4, "wave_2": 2.0, "wave_2_phase": 1.0},
            lambda s: 9.0 * math.sin(6.0 * math.pi * s + 0.4) + 2.0 * math.sin(12.0 * math.pi * s + 1.0),
        ),
    ],
)
def test_a_formula_has_the_value_it_declares(force, formula, expected):
    for position in (-0.08, -0.03, -0.01, 0.0, 0.02, 0.05):
        found = force(position, knots=0.0, offset=0.0, lowest=-1.0, **formula)
        assert found == pytest.approx(expected(10.0 * position), rel=1e-9, abs=1e-9)


def test_beyond_the_data_a_formula_keeps_its_value(force):
    formula = {"knots": 0.0, "offset": 0.0, "power": 50.0, "exponent": 2.0, "lowest": -0.5, "highest": 1.0}
    assert force(0.3, **formula) == force(0.1, **formula) == pytest.approx(50.0)
    assert force(-0.3, **formula) == pytest.approx(-12.5)


def test_a_term_may_be_proportional_to_a_further_signal(force):
    assert force(0.01, pressure=2e6, times_pressure=1e-6) == pytest.approx(2.0 * force(0.01), rel=1e-12)
    assert force(0.01, 0.3, times_velocity=-2.0) == pytest.approx(-0.6 * force(0.01), rel=1e-12)
    assert force(0.01, pressure=0.0, times_pressure=1e-6) == 0.0


def test_its_argument_may_be_without_its_slow_part_or_what_a_play_keeps():
    y, table = np.zeros(5), {"per_position": 10.0, "power": 1.0, "knots": 0.0, "lowest": -1.0}
    y[X] = 0.03

    def at(state, **more):
        p, z, dz = FORCE.Parameters(**table, **more), np.full(1, state), np.zeros(1)
        FORCE.derivatives(0.0, 0.0, y, np.zeros(INPUTS), z, p, None, dz)
        return FORCE.force(0.0, 0.0, y, np.zeros(INPUTS), z, p, None), dz[0]

    assert at(0.1) == pytest.approx((0.3, 0.0))
    assert at(0.1, memory=0.5) == pytest.approx((0.2, 0.4))
    # The play of 0.1 has reached the argument less half its width.
    value, rate = at(0.25, play=0.1)
    assert (value, rate) == pytest.approx((0.05, 0.0))
    value, rate = at(0.1, play=0.1)
    assert value == pytest.approx(0.05)
    assert rate > 0.0


@pytest.mark.parametrize("name", [name for name in EFFECTS.names() if getattr(EFFECTS.load(name), "LEARNT", False)])
def test_without_values_a_table_changes_nothing(name):
    effect = EFFECTS.load(name)
    (hook,) = (getattr(effect, n) for n in HOOKS if hasattr(effect, n))
    y = np.zeros(5)
    y[X], y[V], y[PL], y[XV] = 0.01, 0.2, 1e6, 1e-4
    p = effect.Parameters(per_position=3.0, per_velocity=2.0, per_spool=100.0, times_pressure=1e-6, memory=0.1, direction=0.01)
    assert hook(12.5, 3.0, y, np.zeros(INPUTS), np.zeros(1), p, None) == 12.5
