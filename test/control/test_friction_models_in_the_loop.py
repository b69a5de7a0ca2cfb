"""Compensation of every friction model in closed loop, and refusal of members that do not serve a model."""

from pathlib import Path

import pytest
from tiers import tiered

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.observers import OBSERVERS, default_observer
from ehls_ros.control.observers.base import check_friction_support
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import check_spec, spec_from_mapping
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.rig import rig_from_mapping

MODELS = FRICTION_MODELS.names()

NO_COMPENSATION = {"name": "stribeck", "smoothing": 10.0}
"""So smooth that at the rig's velocities hardly any of the curve remains."""


@pytest.fixture
def make_spec(rig_mapping):
    """Return the paper's sine against the large disturbance on a rig of a friction model, with some keys changed."""

    def make(model, **keys):
        mapping = {
            "duration": 6.0,
            "rig": {**rig_mapping, "friction": {**rig_mapping["friction"], "model": model}},
            "reference": {"name": "sine", "amplitude": 1e4, "frequency": 0.5},
            "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 5e3, "frequency": 1.0}},
            "controller": "fasmc",
            **keys,
        }
        spec = spec_from_mapping(mapping, "spec.yaml", Path())
        check_spec(spec, "spec.yaml")
        return spec

    return make


@pytest.mark.parametrize("model", tiered(MODELS, "lugre"))
def test_the_observer_of_a_rig_serves_it_and_lowers_the_error(make_spec, model):
    compensated, plain = (
        evaluate(run_in_process(make_spec(model, **keys))) for keys in ({}, {"compensation": NO_COMPENSATION})
    )
    assert compensated.max_error_n < 0.9 * plain.max_error_n
    assert compensated.convergence_s is not None


@pytest.mark.parametrize("model", MODELS)
def test_without_a_word_a_rigs_own_model_is_run(make_spec, model):
    spec = make_spec(model)
    assert spec.compensation.name == default_observer(spec.controller_rig)
    assert spec.compensation.name in {model, "rig_model"}


def serving(family, served):
    """Yield each member that serves one model only, with each model that it does, or does not, serve."""
    for name in family.names():
        only = getattr(family.load(name), "FRICTION_MODEL", None)
        for model in MODELS:
            if only is not None and (model == only) == served:
                yield name, model


@pytest.mark.parametrize(("observer", "model"), list(serving(OBSERVERS, served=False)))
def test_an_observer_that_does_not_serve_a_model_is_refused(make_spec, observer, model):
    with pytest.raises(BadInput) as caught:
        make_spec(model, compensation=observer)
    line = str(caught.value)
    assert line.startswith(f"spec.yaml: compensation: friction observer '{observer}' does not support friction model '{model}'")
    assert "rig_model" in line
    with pytest.raises(BadInput, match=f"'{observer}' does not support friction model '{model}'"):
        FrictionEstimator(observer, make_spec(model).rig, 1e-3)


@pytest.mark.parametrize(("controller", "model"), list(serving(CONTROLLERS, served=False)))
def test_a_controller_that_does_not_serve_a_model_is_refused(make_spec, controller, model):
    with pytest.raises(BadInput) as caught:
        make_spec(model, controller=controller)
    line = str(caught.value)
    assert line.startswith(f"spec.yaml: controller: controller '{controller}' does not support friction model '{model}'")
    assert "fasmc" in line.split("expected", 1)[1]


@pytest.mark.parametrize("family", [OBSERVERS, CONTROLLERS], ids=lambda family: family.noun)
def test_one_that_serves_one_model_is_accepted_with_it(rig_mapping, family):
    pairs = list(serving(family, served=True))
    assert pairs
    for name, model in pairs:
        rig = rig_from_mapping({**rig_mapping, "friction": {**rig_mapping["friction"], "model": model}}, "rig")
        check_friction_support(family, name, rig, "spec.yaml")


def test_it_is_the_controllers_rig_that_counts(make_spec, rig_mapping):
    """The loader may have a friction that differs from the controller's model."""
    spec = make_spec("lugre", controller_rig=rig_mapping, compensation="gms", duration=0.5)
    assert run_in_process(spec)["friction_elements_n"].shape[1] == len(rig_mapping["friction"]["element_stiffness"])
