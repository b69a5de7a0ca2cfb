"""Friction of a piston in steady motion, with the effects on it, in closed form."""

import math

import pytest
from rig_runs import PERIOD, stage_effects

from ehls_ros.physics.plant import PL, V, X
from ehls_ros.physics.simulator import Simulator

# Only friction holds the piston: in steady motion the force Ac pL is the friction.
FREE = {"gravity": 0.0, "leakage_coefficient": 0.0, "viscous_damping": 0.0, "spring_stiffness": 0.0}


def stribeck(v):
    return 640.8 + 224.6 * math.exp(-((abs(v) / 2.031e-3) ** 0.8764))


@pytest.fixture
def steady(make_rig):
    """Return velocity [m/s], force Ac pL [N] and position [m] in steady motion."""

    def settle(spool, effects):
        simulator = Simulator(make_rig(plant=FREE, effects=effects), PERIOD, position=-math.copysign(0.3, spool))
        for _ in range(12000):
            simulator.advance(spool, 0.0, 0.0, 0.0, 0.0)
        y = simulator.y
        return y[V], 2.6e-3 * y[PL], y[X]

    return settle


@pytest.mark.parametrize("spool", [5e-5, -5e-5])
def test_what_depends_on_the_direction(spool, steady):
    changed = {"coulomb_asymmetry": {"offset": 50.0}, "viscous_asymmetry": {"asymmetry": 600.0}}
    v, force, _ = steady(spool, stage_effects("friction", changed))
    expected = math.copysign(stribeck(v), v) + 50.0 + 7265.0 * v + 600.0 * abs(v)
    assert force == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("spool", [5e-5, -5e-5])
@pytest.mark.parametrize("slope", [1e-4, -2e-4])
def test_what_the_pressure_adds(slope, spool, steady):
    v, force, _ = steady(spool, stage_effects("friction", {"pressure_dependent_friction": {"slope": slope}}))
    level = stribeck(v) + slope * abs(force) / 2.6e-3
    assert force == pytest.approx(math.copysign(level, v) + 7265.0 * v, rel=1e-7)


@pytest.mark.parametrize("spool", [5e-5, -5e-5])
def test_what_the_position_adds(spool, steady):
    v, force, x = steady(spool, stage_effects("friction", {"position_dependent_friction": {"slope": 300.0}}))
    # The elements lag behind the curve by s/C = 0.5 s.
    level = stribeck(v) + 300.0 * x
    lag = level / 1650.0
    assert force == pytest.approx(math.copysign(level - 300.0 * v * lag, v) + 7265.0 * v, abs=0.05)
    assert abs(300.0 * x) > 10.0


@pytest.mark.parametrize("spool", [3e-6, 5e-5])
def test_shifted_curves(spool, steady):
    """Effects without hooks, for which the rig's own kernel is the one without effects."""
    effects = [
        {"name": "coulomb_shift", "offset": 40.0},
        {"name": "stribeck_shift", "static_offset": 60.0, "velocity_factor": 2.0},
        {"name": "viscous_shift", "added": -1265.0},
    ]
    v, force, _ = steady(spool, effects)
    level = 680.8 + (284.6) * math.exp(-((v / 4.062e-3) ** 0.8764))
    assert force == pytest.approx(level + 6000.0 * v, rel=1e-6)
