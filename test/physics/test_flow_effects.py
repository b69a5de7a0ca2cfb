"""Effects of the flow in steady motion and by the oil balance."""

import numpy as np
import pytest
from rig_runs import PERIOD, run, stage_effects

from ehls_ros.physics.plant import PL, XV, V
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator

FREE = {"gravity": 0.0, "viscous_damping": 0.0, "spring_stiffness": 0.0}
SUPPLY = SENSED.index("supply_pressure")


@pytest.fixture
def steady(make_rig):
    """Return the state and the supply sensor's reading in steady state."""

    def settle(spool, **changed):
        simulator = Simulator(make_rig(plant=FREE, effects=stage_effects("flow", changed)), PERIOD)
        for _ in range(8000):
            simulator.advance(spool, 0.0, 0.0, 0.0, 0.0)
        return simulator.y, simulator.measure(np.zeros(len(SENSED)))[SUPPLY]

    return settle


@pytest.mark.parametrize("spool", [3e-4, -3e-4])
@pytest.mark.parametrize("time_constant", [0.0, 0.1])
@pytest.mark.parametrize(("resistance", "quadratic"), [(4e9, 0.0), (0.0, 6e12), (2e9, 3e12)])
def test_the_supply_sensor_reads_what_the_flow_leaves(resistance, quadratic, time_constant, spool, steady):
    loss = {"resistance": resistance, "quadratic": quadratic, "time_constant": time_constant}
    y, reading = steady(spool, supply_pressure_droop=loss)
    # The cylinder's flow and leakage, and the flow by (1) at the pressure read.
    flow = abs(2.6e-3 * y[V] + 4.7e-12 * y[PL])
    assert reading == pytest.approx(7e6 - resistance * flow - quadratic * flow**2, rel=1e-9)
    assert 7e6 - reading > 4e5
    through = 0.62 * 0.0267 * 3e-4 * np.sqrt((reading - np.sign(spool) * y[PL]) / 840.0)
    assert flow == pytest.approx(through, rel=1e-9)


def test_the_supply_sensor_reads_the_nominal_pressure_without_flow(steady):
    y, reading = steady(0.0, supply_pressure_droop={"resistance": 4e9})
    assert y[XV] == 0.0
    assert reading == 7e6


@pytest.mark.parametrize("spool", [1e-4, -1e-4])
def test_turbulent_leakage_is_taken_from_the_motion(spool, steady):
    y, _ = steady(spool, turbulent_leakage={"coefficient": 5e-8})
    entered = 0.62 * 0.0267 * abs(y[XV]) * np.sqrt((7e6 - abs(y[PL])) / 840.0)
    left = 2.6e-3 * abs(y[V]) + 4.7e-12 * abs(y[PL]) + 5e-8 * np.sqrt(abs(y[PL]))
    assert entered == pytest.approx(left, rel=1e-9)
    assert np.sign(y[PL]) == np.sign(spool)


def motion(rig):
    """Return the states of a motion that loads both ways."""
    t = np.arange(300) * PERIOD
    return run(
        Simulator(rig, PERIOD), np.column_stack([3e-4 * np.sin(30.0 * t), 3e3 * np.sin(50.0 * t), 15e4 * np.cos(50.0 * t)])
    )


def test_leakage_of_both_chambers_to_the_outside_is_half_as_much_across_the_piston(make_rig):
    """Merritt 1967, ch. 6: Ctp = Cip + Cep/2."""
    outside = motion(make_rig(effects=stage_effects("flow", {"external_leakage": {"each": 4e-11}})))
    effects = [*stage_effects("flow", {}), {"name": "internal_leakage_shift", "added": 2e-11}]
    across = motion(make_rig(effects=effects))
    np.testing.assert_allclose(outside[:, :4], across[:, :4], rtol=1e-9, atol=1e-12)
    assert np.max(np.abs(motion(make_rig(effects=stage_effects("flow", {})))[:, PL] - across[:, PL])) > 1e4


def test_air_presses_together_most_where_pressure_is_least(make_rig):
    """A cylinder held fast and fed at constant flow: pL rises by dpL/dt = 4 βe(pL)/Vt Q, slowly at first."""
    rig = make_rig(
        plant={"moving_mass": 1e12, "leakage_coefficient": 0.0, "gravity": 0.0, "supply_pressure": 7e6},
        effects=stage_effects("flow", {"entrained_air": {"load": 0.02}}),
    )
    simulator = Simulator(rig, PERIOD)
    pressures, spools = [], []
    for _ in range(120):
        simulator.advance(3e-5, 0.0, 0.0, 0.0, 0.0)
        pressures.append(simulator.y[PL])
        spools.append(simulator.y[XV])
    pressures, spools = np.array(pressures), np.array(spools)
    middle = 0.5 * (pressures[1:] + pressures[:-1])
    flow = 0.62 * 0.0267 * 0.5 * (spools[1:] + spools[:-1]) * np.sqrt((7e6 - middle) / 840.0)
    modulus = np.diff(pressures) / PERIOD * 1.5e-3 / 4.0 / flow
    absolute = middle + 101325.0
    air = 0.02 * (101325.0 / absolute) ** (1.0 / 1.4) / (1.4 * absolute)
    late = slice(20, None)
    np.testing.assert_allclose(modulus[late], 1.0 / (1.0 / 6.9e8 + air[late]), rtol=1e-3)
    assert modulus[-1] > 5.0 * modulus[20]
