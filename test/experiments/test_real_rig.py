"""Assumptions for a law on a real rig: a rig file that lacks delay and coupling and has a wrong area."""

import pytest
import yaml

from ehls_ros.experiments.files import configured
from ehls_ros.experiments.real_rig import for_real_rig, usual_sensors
from ehls_ros.experiments.spec import load_rig, spec_from_mapping, spec_to_mapping
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.experiments.yaml_files import spec_text
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import rig_to_mapping

RIG = load_rig(configured("rig_paper_measured"))


def experiment(known=(), law="fasmc_predictive", area=1.0, **more):
    """Return an experiment on the emulated rig; ``area``: the controller's over the rig's."""
    content = {
        "rig": rig_to_mapping(RIG),
        "controller_rig": rig_to_mapping(RIG.with_plant(piston_area=area * RIG.plant.piston_area)),
        "effects": [{"name": "command_delay", "delay": 1e-3}],
        "known_effects": list(known),
        "duration": 6.0,
        "reference": {"name": "sine", "amplitude": 1e4, "frequency": 0.5},
        "disturbance": {"name": "position_servo", "signal": {"name": "sine", "amplitude": 0.125, "frequency": 1.0}},
        "controller": {"name": law},
        **more,
    }
    return spec_from_mapping(content, "test", configured("rig_paper").parent)


@pytest.mark.long
def test_numbers_that_the_file_lacks_or_has_wrong_do_not_cost_the_force():
    told = stepped_run(experiment(["command_delay", "coupling_stiffness"])).largest()
    untold = experiment(area=1.2)
    assert not stepped_run(untold).largest() < 1e3
    assert stepped_run(for_real_rig(untold).spec).largest() < 1.5 * told


def test_assumptions_are_said_and_survive_the_run_folder():
    real = for_real_rig(experiment(control_period=5e-4))
    effects = {use.name: use.parameters for use in real.spec.controller_rig.effects}
    assert effects["command_delay"].delay == 5e-4
    assert effects["coupling_stiffness"].stiffness == pytest.approx(2e6)
    assert [use.name for use in real.spec.companions] == ["adaptation"]
    for word in ("command_delay", "coupling_stiffness", "adaptation"):
        assert any(word in remark for remark in real.remarks)
    again = spec_from_mapping(yaml.safe_load(spec_text(spec_to_mapping(real.spec))), "spec", configured("rig_paper").parent)
    assert again.controller_rig.effects == real.spec.controller_rig.effects
    assert again.companions == real.spec.companions


def test_numbers_told_and_companions_chosen_are_kept():
    told = experiment(["command_delay", "coupling_stiffness"], companions=[{"name": "adaptation", "reach": 0.1}])
    assert for_real_rig(told).spec == told
    quiet = for_real_rig(experiment(["command_delay", "coupling_stiffness"]), adapt=False)
    assert quiet.spec.companions == ()
    assert "adaptation is off" in quiet.remarks[-1]


def test_the_defaults_of_a_law_follow_the_assumed_delay():
    real = for_real_rig(experiment(law="fasmc_output_feedback", control_period=5e-4)).spec
    assert real.controller.parameters.command_delay == pytest.approx(5e-4)
    own = for_real_rig(
        experiment(law="fasmc_output_feedback", controller={"name": "fasmc_output_feedback", "command_delay": 3e-3})
    )
    assert own.spec.controller.parameters.command_delay == 3e-3


def test_a_law_on_a_single_rod_adapts():
    rig = rig_to_mapping(load_rig(configured("rig_single_rod")))
    real = for_real_rig(experiment(rig=rig, controller_rig=None, known_effects=["command_delay"]))
    assert [use.name for use in real.spec.companions] == ["adaptation"]


def test_a_law_for_positions_assumes_nothing():
    position = experiment(law="pid", reference={"name": "sine", "amplitude": 0.01, "frequency": 0.5})
    assert for_real_rig(position) == (position, ())


def test_noise_that_the_file_lacks_is_assumed_and_said():
    exact = RIG._replace(sensors={**RIG.sensors, "force": Sensor(bias=3.0)})
    known = experiment(["command_delay", "coupling_stiffness"])
    told = known._replace(controller_rig=exact.with_effects(known.controller_rig.effects))
    real = for_real_rig(told)
    (said,) = [remark for remark in real.remarks if "noise_std" in remark]
    assert "no noise_std of force:" in said
    assert real.spec.controller_rig.sensors == {**RIG.sensors, "force": RIG.sensors["force"]._replace(bias=3.0)}
    larger = RIG.with_plant(piston_area=10.0 * RIG.plant.piston_area)._replace(sensors={})
    noise = RIG.sensors["force"].reading_std
    assert usual_sensors(larger)["force"].reading_std == pytest.approx(10.0 * noise)
