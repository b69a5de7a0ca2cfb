"""Effects with a table found in data: the table itself, and its neutral default."""

import math

import numpy as np
import pytest

from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects._table import KNOTS, VALUES
from ehls_ros.physics.plant import INPUTS, PL, XV, V, X

FORCE = EFFECTS.load("empirical_force")
VALUE = np.random.default_rng(1).uniform(-200.0, 300.0, KNOTS)


@pytest.fixture(scope="module")
def force():
    """Return the force of a table at a position and velocity."""

    def at(position, velocity=0.0, **parameters):
        y = np.zeros(5)
        y[X], y[V] = position, velocity
        given = {"per_position": 10.0, "offset": 0.5, **dict(zip(VALUES, VALUE.tolist(), strict=True)), **parameters}
        return FORCE.force(0.0, 0.0, y, np.zeros(INPUTS), np.zeros(0), FORCE.Parameters(**given), None)

    return at


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


@pytest.mark.parametrize("name", [name for name in EFFECTS.names() if getattr(EFFECTS.load(name), "LEARNT", False)])
def test_without_values_a_table_changes_nothing(name):
    effect = EFFECTS.load(name)
    (hook,) = (getattr(effect, n) for n in ("force", "friction_level", "opening", "leakage", "command") if hasattr(effect, n))
    y = np.zeros(5)
    y[X], y[V], y[PL], y[XV] = 0.01, 0.2, 1e6, 1e-4
    p = effect.Parameters(per_position=3.0, per_velocity=2.0, per_spool=100.0, direction=0.01)
    assert hook(12.5, 3.0, y, np.zeros(INPUTS), np.zeros(0), p, None) == 12.5
