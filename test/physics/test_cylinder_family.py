"""The contract of cylinders and valves, over all members."""

import math

import numpy as np
import pytest

from ehls_ros.arrays import in_python
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.plant import FRICTION, PL, XV
from ehls_ros.physics.rig import SENSED, rig_from_mapping
from ehls_ros.physics.simulator import Simulator
from ehls_ros.physics.valve import VALVES
from ehls_ros.schema import notes


def typical_rig(rig_data, name):
    """Return the paper's rig with a cylinder of typical values."""
    law = CYLINDERS.load(name)
    needed = (name for name in law.Parameters._fields if name not in law.Parameters._field_defaults)
    keys = {name: notes(law.Parameters)[name].typical for name in needed}
    derived = law.derived(law.Parameters(**keys))
    plant = {key: value for key, value in rig_data["plant"].items() if key not in derived}
    return rig_from_mapping({**rig_data, "plant": plant, "cylinder": {"model": name, **keys}}, "rig")


@pytest.mark.parametrize("name", CYLINDERS.names())
def test_a_cylinder_is_at_rest_and_answers_the_valve(name, rig_data):
    rig = typical_rig({**rig_data, "plant": {**rig_data["plant"], "gravity": 0.0}}, name)
    law = rig.cylinder.law
    simulator = Simulator(rig)
    elements = len(rig.friction.element_stiffness)
    assert simulator.y.size == FRICTION + elements + law.STATES
    assert len(law.at_rest(rig.cylinder.parameters, rig.plant)) == law.STATES
    assert rig.sensed == (*SENSED, *law.SENSED)
    assert simulator.truth.size == len(rig.sensed)
    assert simulator.measure(np.zeros(len(rig.sensed)))[rig.sensed.index("force")] == pytest.approx(0.0, abs=1e-6)
    for command, sign in ((3e-4, 1.0), (-8e-4, -1.0)):
        for _ in range(100):
            simulator.advance(command, 0.0, 0.0, 0.0, 0.0)
        readings = simulator.measure(np.zeros(len(rig.sensed)))
        force = readings[rig.sensed.index("force")]
        assert readings[rig.sensed.index("load_pressure")] * rig.plant.piston_area == pytest.approx(force)
        assert simulator.y[PL] * rig.plant.piston_area == pytest.approx(force)
        assert simulator.y[XV] * sign >= 0.0
        assert force * sign > 0.0


@pytest.mark.parametrize("name", CYLINDERS.names())
def test_a_cylinder_has_a_default_valve_with_its_flow(name):
    law = CYLINDERS.load(name)
    assert hasattr(VALVES.load(law.DEFAULT_VALVE), law.FLOW)


@pytest.mark.parametrize("name", [name for name in VALVES.names() if hasattr(VALVES.load(name), "chamber_flows")])
def test_gains_are_the_slopes_of_the_flows(name, make_rig):
    """Beyond overlap and rounding, in turbulent flow."""
    valve, plant = VALVES.load(name), make_rig().plant
    p = valve.Parameters()._replace(transition_pressure=1.0, gain_pb=0.7, gain_at=1.3)
    supply, a, b, tank, opening = 7e6, 4e6, 2e6, 1e5, 1e-4
    for side, drops in ((1.0, (supply - a, b - tank)), (-1.0, (a - tank, supply - b))):
        slopes = in_python(valve.gains)(side, *drops, p, plant)
        edge = in_python(valve.edge_flow)
        gain = plant.discharge_coefficient * plant.valve_area_gradient * math.sqrt(2.0 / plant.oil_density)
        of_a, of_b = (p.gain_pa, p.gain_bt) if side > 0.0 else (p.gain_at, p.gain_pb)
        expected = [edge(gain * g, opening, 0.0, drop, 1.0) / opening for g, drop in ((of_a, drops[0]), (of_b, drops[1]))]
        assert (slopes[0], -slopes[1]) == pytest.approx(expected)
