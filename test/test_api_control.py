"""The controller and the plant that are stepped in a loop of one's own."""

import math

import numpy as np
import pytest

import ehls_ros as ehls
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_process

RIG = "rig_paper_measured"
SINE = {"name": "sine", "amplitude": 3e3, "frequency": 1.0}
EXPERIMENT = {
    "title": "short",
    "rig": RIG,
    "duration": 0.1,
    "seed": 5,
    "reference": SINE,
    "disturbance": {"name": "force", "signal": {**SINE, "amplitude": 500.0}},
}
WANTED = ("force_reference_n", "force_reference_rate_n_s", "force_reference_acceleration_n_s2")
ACTING = ("disturbance_force_n", "disturbance_force_rate_n_s", "disturbance_displacement_m", "disturbance_velocity_m_s")


@pytest.mark.parametrize("law", ["fasmc", "fasmc_predictive", "sic"])
def test_a_loop_in_python_gives_the_numbers_of_the_experiment(law):
    content = {**EXPERIMENT, "controller": law}
    controller, plant = ehls.controller(content), ehls.plant(RIG, seed=5)
    run = run_in_process(controller.spec)
    wanted, acting = (np.column_stack([run.signals[name] for name in names]) for names in (WANTED, ACTING))
    for k, command in enumerate(run.signals["valve_command_m"]):
        assert plant.measured["force"] == run.signals["force_n"][k]
        assert controller.step(plant.measured, wanted[k]) == command
        plant.step(command, acting[k])
    assert controller.cycle == len(wanted)
    assert plant.time == pytest.approx(controller.cycle * controller.period)
    assert controller.status["force_error_n"] == run.signals["force_error_n"][-1]


def test_a_ten_line_law_of_ones_own_holds_the_force():
    plant, integral = ehls.plant("rig_paper"), 0.0
    for _ in range(2000):
        error = 5e3 - plant.measured["force"]
        integral += 5e-7 * error * plant.period
        plant.step(5e-8 * error + integral)
    assert plant.measured["force"] == pytest.approx(5e3, rel=0.02)
    assert plant.truth["force"] == pytest.approx(plant.measured["force"])
    assert plant.trouble == ""


def test_controllers_share_nothing_and_start_anew_after_a_reset():
    one, other = ehls.controller(RIG, "fasmc", k=6.0), ehls.controller(RIG, "fasmc", k=6.0)
    reading = dict.fromkeys(ehls.plant(RIG).measured, 0.0) | {"supply_pressure": 7e6, "oil_temperature": 313.0}
    first = [one.step({**reading, "force": force}, 1e3) for force in (0.0, 50.0, 120.0)]
    assert len(set(first)) == 3
    assert other.step({**reading, "force": 0.0}, (1e3, 0.0, 0.0)) == first[0]
    one.reset()
    assert [one.step({**reading, "force": force}, 1e3) for force in (0.0, 50.0, 120.0)] == first


def test_a_controller_of_a_rig_knows_the_delay_and_coupling_of_its_file():
    effects = [{"name": "command_delay", "delay": 1e-3}, {"name": "coupling_stiffness", "stiffness": 2e6, "damping": 300.0}]
    rig = ehls.simulate("constant_fd2", effects=effects, duration=0.01, progress=False).spec.rig
    model = ehls.controller(rig)._law.model
    assert (model.command_delay, model.coupling_stiffness, model.coupling_damping) == (1e-3, 2e6, 300.0)


@pytest.mark.parametrize(
    ("measured", "error"),
    [
        ({"pressure": 1.0}, "the reading 'pressure' is unknown"),
        ({"force": 1.0}, r"load_pressure \[Pa\].* missing"),
    ],
)
def test_a_reading_that_is_unknown_or_missing_is_named(measured, error):
    with pytest.raises(BadInput, match=error):
        ehls.controller(RIG, "fasmc").step(measured, 0.0)


def test_too_many_values_are_refused():
    with pytest.raises(BadInput, match="reference: it has 4 values"):
        ehls.controller(RIG, "fasmc").step(ehls.plant(RIG).measured, (1.0, 0.0, 0.0, 0.0))
    with pytest.raises(BadInput, match="disturbance: it has 5 values"):
        ehls.plant(RIG).step(0.0, np.zeros(5))


def test_a_command_that_is_no_number_is_refused():
    with pytest.raises(BadInput, match="the command is nan"):
        ehls.plant(RIG).step(math.nan)


def test_a_law_that_does_not_exist_is_named():
    with pytest.raises(BadInput, match="fasmd"):
        ehls.controller(RIG, "fasmd")
