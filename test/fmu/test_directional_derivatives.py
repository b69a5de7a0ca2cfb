"""Directional derivatives of Model Exchange, against differences."""

import shutil

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.simulation import instantiate_fmu
from stepped_fmu import stepped

STATE = [0.01, 0.05, 1.5e6, 4e-4, 560.0, 60.0, 56.0]

KNOWN = {
    "state.position": 1e-5,
    "state.velocity": 1e-5,
    "state.load_pressure": 10.0,
    "state.spool_position": 1e-8,
    "state.friction_force[2]": 1e-3,
    "valve_command": 1e-7,
    "disturbance_force": 1.0,
    "plant.moving_mass": 1e-3,
    "friction.element_weight[3]": 1e-6,
    "friction.attraction_rate": 1e-2,
}
"""Variables, and the steps of their differences."""

UNKNOWN = [
    "der(state.velocity)",
    "der(state.load_pressure)",
    "der(state.spool_position)",
    "der(state.friction_force[3])",
    "force",
]


@pytest.fixture
def moving(exported):
    """An instance for Model Exchange in a state of motion, all elements slipping."""
    unpacked = extract(str(exported))
    described = read_model_description(unpacked)
    third = described.fmiVersion == "3.0"
    fmu = instantiate_fmu(unpacked, described, "ModelExchange")
    if not third:
        fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    references = {variable.name: variable.valueReference for variable in described.modelVariables}

    class Moving:
        set_values = fmu.setFloat64 if third else fmu.setReal
        get_values = fmu.getFloat64 if third else fmu.getReal

        def state(self, values):
            fmu.setContinuousStates((np.ctypeslib.ctypes.c_double * len(values))(*values), len(values))

        def rates(self):
            return np.array(self.get_values([references[name] for name in UNKNOWN]))

        def derivative(self, name):
            unknown, known = [references[one] for one in UNKNOWN], [references[name]]
            return np.array(fmu.getDirectionalDerivative(unknown, known, [1.0]))

        def set(self, name, value):
            if name.startswith("state."):
                values = list(STATE)
                values[references[name] - references["state.position"]] = value
                self.state(values)
            else:
                self.set_values([references[name]], [value])

        def get(self, name):
            return self.get_values([references[name]])[0]

    made = Moving()
    made.state(STATE)
    for _ in range(3):
        (fmu.updateDiscreteStates if third else fmu.newDiscreteStates)()
    yield made
    fmu.freeInstance()
    shutil.rmtree(unpacked, ignore_errors=True)


@pytest.mark.parametrize("name", KNOWN)
def test_derivatives_are_the_limit_of_differences(moving, name):
    own, step = moving.derivative(name), KNOWN[name]
    middle = moving.get(name)
    sides = []
    for side in (1.0, -1.0):
        moving.set(name, middle + side * step)
        sides.append(moving.rates())
    moving.set(name, middle)
    moving.state(STATE)
    difference = (sides[0] - sides[1]) / (2.0 * step)
    scale = np.abs(moving.rates()) / step
    assert np.all(np.abs(own - difference) <= 1e-5 * np.abs(difference) + 1e-11 * scale + 1e-12)
    assert np.any(own != 0.0)


def test_none_in_co_simulation(exported):
    with stepped(exported) as rig:
        rig.begin()
        with pytest.raises(FMICallException):
            rig.fmu.getDirectionalDerivative([rig.references["force"]], [rig.references["state.load_pressure"]], [1.0])
