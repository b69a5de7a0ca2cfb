"""FMUs of controllers and observers: the closed loop of two FMUs against our own."""

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from stepped_fmu import stepped

from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.loop import run_in_process, sampled
from ehls_ros.experiments.spec import load_spec
from ehls_ros.fmu.archive import fmu
from ehls_ros.fmu.control_model import law_model, observer_model
from ehls_ros.physics.rig import SENSED

PERIOD = 1e-3


@pytest.fixture(scope="module")
def spec():
    found = load_spec(configured("sine_fd2", "experiments"))
    return found._replace(settings=found.settings._replace(duration=0.5))


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def law(request, spec, tmp_path_factory):
    use, watching = spec.controller, spec.compensation
    model = law_model(spec.controller_rig, "law", PERIOD, use.name, use.parameters, watching.name, watching.parameters)
    path = tmp_path_factory.mktemp("law") / "law.fmu"
    path.write_bytes(fmu(model, request.param, {}, "test", ["linux"]))
    return path


def test_validation_has_no_remarks(law):
    assert validate_fmu(str(law)) == []


def test_loop_of_two_fmus_is_the_simulated_one_to_the_bit(law, exported, spec):
    wanted = run_in_process(spec)
    cycles = spec.cycles
    reference = sampled(spec.reference, PERIOD).rows(0, cycles)
    disturbance = np.column_stack([wanted.signals["disturbance_force_n"], wanted.signals["disturbance_force_rate_n_s"]])
    commands, forces, sliding = np.empty((3, cycles))
    with stepped(law) as controller, stepped(exported) as plant:
        controller.begin()
        plant.begin()
        for cycle in range(cycles):
            readings = dict(zip(SENSED, plant.get(*SENSED), strict=True))
            given = dict(zip(("reference", "reference_rate", "reference_acceleration"), reference[cycle], strict=True))
            controller.set(**readings, **given)
            controller.step()
            commands[cycle], sliding[cycle] = controller.get("valve_command", "status.s")
            forces[cycle] = readings["force"]
            force, rate = disturbance[cycle]
            plant.set(valve_command=commands[cycle], disturbance_force=force, disturbance_force_rate=rate)
            plant.step()
    assert np.array_equal(commands, wanted.signals["valve_command_m"])
    assert np.array_equal(forces, wanted.signals["force_n"])
    assert np.array_equal(sliding, wanted.signals["s_pa_s"])


def test_observer_is_the_estimator_to_the_bit(spec, tmp_path):
    rig, use = spec.controller_rig, spec.compensation
    path = tmp_path / "observer.fmu"
    path.write_bytes(fmu(observer_model(rig, "observer", PERIOD, use.name, use.parameters), "3.0", {}, "test", ["linux"]))
    assert validate_fmu(str(path)) == []
    own = FrictionEstimator(use.name, rig, PERIOD, use.parameters)
    with stepped(path) as observer:
        observer.begin()
        for velocity in 0.01 * np.sin(0.05 * np.arange(200)):
            observer.set(velocity=velocity)
            observer.step()
            names = ("friction_force", "viscous_force", "element_force[1]", "element_force[2]", "slipping[3]")
            assert np.array_equal(observer.get(*names), own.update(velocity)[[0, 1, 2, 3, 7]])
