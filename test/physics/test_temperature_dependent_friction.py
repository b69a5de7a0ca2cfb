"""Friction of a piston that slips steadily, against its closed form."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from rig_runs import PERIOD, stage_effects

from ehls_ros.physics.plant import PL, TEMPERATURE, V
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.physics.simulator import Simulator

# Only friction holds the piston: in steady motion the force Ac pL is the friction.
FREE = {"gravity": 0.0, "leakage_coefficient": 0.0, "viscous_damping": 0.0, "spring_stiffness": 0.0}
STEADY_CYCLES = 12000
"""Cycles after which the elements, at C/s(v) = 1.9 to 7.9 1/s, have forgotten their initial state."""


@pytest.fixture(scope="module")
def make_free_rig(make_rig: Callable[..., Rig]) -> Callable[..., Rig]:
    """Return the rig with only friction, changed by the temperature as given."""

    def make(coulomb_slope: float, viscous_slope: float, **values: float) -> Rig:
        slopes = {"coulomb_slope": coulomb_slope, "viscous_slope": viscous_slope}
        return make_rig(plant=FREE, effects=stage_effects("friction", {"temperature_dependent_friction": {**slopes, **values}}))

    return make


def steady(simulator: Simulator, spool: float, cycles: int = STEADY_CYCLES) -> tuple[float, float]:
    """Return velocity [m/s] and force Ac pL [N] after some cycles at a spool displacement."""
    for _ in range(cycles):
        simulator.advance(spool, 0.0, 0.0, 0.0, 0.0)
    return simulator.y[V], 2.6e-3 * simulator.y[PL]


def friction(v: float, coulomb_change: float, viscous_change: float) -> float:
    """Return sgn(v) (s(v) + change) + (sigma_f + change) v, (5), (7) and (9) with the paper's numbers [N]."""
    level = 640.8 + 224.6 * math.exp(-((abs(v) / 2.031e-3) ** 0.8764)) + coulomb_change
    return math.copysign(max(level, 1.0), v) + (7265.0 + viscous_change) * v


@pytest.mark.parametrize("spool", [5e-5, -5e-5, 2e-4, -2e-4])
@pytest.mark.parametrize(
    ("coulomb_slope", "viscous_slope", "kelvin"),
    [(-4.0, 0.0, 20.0), (0.0, -60.0, 20.0), (-4.0, -60.0, -20.0), (2.5, 40.0, 30.0), (-4.0, -60.0, 0.0), (-100.0, 0.0, 20.0)],
)
def test_steady_slip_is_that_of_the_shifted_curve(make_free_rig, coulomb_slope, viscous_slope, kelvin, spool):
    rig = make_free_rig(coulomb_slope, viscous_slope)
    v, force = steady(Simulator(rig, PERIOD, temperature=313.15 + kelvin), spool)
    assert v * spool > 0.0
    assert abs(v) > 0.02
    assert force == pytest.approx(friction(v, coulomb_slope * kelvin, viscous_slope * kelvin), rel=1e-7)


def test_the_rig_files_friction_holds_at_the_reference_temperature(make_free_rig):
    rig = make_free_rig(-4.0, -60.0, reference_temperature=293.15)
    v, force = steady(Simulator(rig, PERIOD, temperature=293.15), 5e-5)
    assert force == pytest.approx(friction(v, 0.0, 0.0), rel=1e-7)
    # By default the oil has 313.15 K, 20 K more.
    v, force = steady(Simulator(rig, PERIOD), 5e-5)
    assert force == pytest.approx(friction(v, -80.0, -1200.0), rel=1e-7)


@pytest.mark.parametrize("spool", [5e-5, -5e-5])
def test_friction_falls_while_the_oil_warms(make_free_rig, spool):
    simulator = Simulator(make_free_rig(-4.0, -60.0), PERIOD, temperature=303.15, warming=1.0)
    for second in range(20):
        assert simulator.inputs[TEMPERATURE] == pytest.approx(303.15 + second, abs=1e-9)
        assert simulator.measure(np.zeros(len(SENSED)))[-1] == simulator.inputs[TEMPERATURE]
        v, force = steady(simulator, spool, 1000)
        if second >= 8:
            kelvin = second + 1.0 - 10.0
            # The elements lag behind the curve by s/C = 0.36 to 0.42 s, at 4 N/s.
            behind = math.copysign(4.0 * (640.8 - 4.0 * kelvin) / 1650.0, v)
            assert force == pytest.approx(friction(v, -4.0 * kelvin, -60.0 * kelvin) + behind, abs=0.1)
    simulator.constants = simulator.constants._replace(warming=0.0)
    v, force = steady(simulator, spool)
    assert force == pytest.approx(friction(v, -40.0, -600.0), rel=1e-7)


def test_what_does_not_depend_on_the_temperature_is_the_same_at_any(make_rig):
    cold, warm = Simulator(make_rig(), PERIOD, temperature=283.15), Simulator(make_rig(), PERIOD, warming=5.0)
    for simulator in (cold, warm):
        steady(simulator, 2e-4, 300)
    assert cold.y.tobytes() == warm.y.tobytes()
