"""The how-to followed: a friction model in a separate folder is parsed, simulated, observed and found everywhere."""

import sys

import docs_snippets
import numpy as np
import pytest
from rig_runs import PERIOD

from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.observers import default_observer
from ehls_ros.physics import friction
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.integration_step import LONGEST_STEP, check_step
from ehls_ros.physics.plant import FRICTION, V
from ehls_ros.physics.plausibility import check_rig
from ehls_ros.physics.rig import EffectUse
from ehls_ros.physics.simulator import Simulator

PAGE = "docs/how_to/friction_model.md"


@pytest.fixture
def model(tmp_path, monkeypatch):
    """Put the page's model into a folder that the family searches, and return its name."""
    [block] = [block for block in docs_snippets.blocks(PAGE) if block.mark == "file" and block.language == "python"]
    name = block.note.rsplit("/", 1)[1].removesuffix(".py")
    (tmp_path / f"{name}.py").write_text(block.text, encoding="utf-8")
    monkeypatch.setattr(friction, "__path__", [*friction.__path__, str(tmp_path)])
    yield name
    FRICTION_MODELS._loaded.pop(name, None)
    sys.modules.pop(f"ehls_ros.physics.friction.{name}", None)


@pytest.mark.long
def test_the_model_of_the_page_runs(model, make_rig):
    rig = make_rig(friction={"model": model})
    check_rig(rig, "rig")
    check_step(rig, LONGEST_STEP, "rig")
    assert rig.friction.presliding_stiffness == 1.884e6 + 1.969e5 + 1.841e5
    for effect in ("coulomb_shift", "viscous_shift", "presliding_stiffness_shift", "stribeck_shift"):
        member = EFFECTS.load(effect)
        for form in member.forms(rig):
            use = EffectUse(effect, member.Parameters(**form.fixed, **dict.fromkeys(form.free, 1.5)))
            assert rig.with_effects((use,)).effective().friction != rig.friction

    simulator, estimator = Simulator(rig, PERIOD), FrictionEstimator(default_observer(rig), rig, PERIOD)
    true, found = [], []
    for k in range(1500):
        found.append(estimator.update(simulator.y[V])[0])
        true.append(simulator.y[FRICTION])
        simulator.advance(2e-4 * np.sin(9.0 * k * PERIOD), 0.0, 0.0, 0.0, 0.0)
    assert 2.0 * 640.8 < np.ptp(true) < 2.0 * 865.4
    assert np.sqrt(np.mean(np.subtract(found, true) ** 2)) < 5.0
