"""What every effect's file has to provide, and that it does nothing until it is asked to."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from rig_runs import PAPER_RIG

from ehls_ros.physics.composition import kernel_module, plant_source
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS, Stage
from ehls_ros.physics.plant import INPUTS
from ehls_ros.physics.rig import rig_from_mapping, rig_to_mapping
from ehls_ros.schema import declarations

NAMES = EFFECTS.names()


@pytest.fixture(scope="session")
def uncompiled(tmp_path_factory):
    """What each effect changes, run without compiling."""
    script = Path(__file__).with_name("effects_uncompiled.py")
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "EHLS_CACHE_DIR": str(tmp_path_factory.mktemp("kernels"))}
    done = subprocess.run(
        [sys.executable, str(script), str(PAPER_RIG)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_says_what_it_is(name):
    effect = EFFECTS.load(name)
    assert effect.STAGE in get_args(Stage)
    assert effect.EQUATION.strip()
    assert effect.SOURCE.strip()
    assert (effect.__doc__ or "").strip()


@pytest.mark.parametrize("name", NAMES)
def test_parameters_are_declared_with_unit_range_help_and_neutral_default(name):
    declared = list(declarations(EFFECTS.load(name).Parameters))
    assert declared
    for parameter in declared:
        assert parameter.kind is float, parameter.name
        assert parameter.unit, parameter.name
        assert parameter.description, parameter.name
        assert parameter.default is not None, parameter.name
        assert parameter.minimum is not None, parameter.name
        assert parameter.maximum is not None, parameter.name
        assert parameter.minimum <= parameter.default <= parameter.maximum, parameter.name


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_acts_somewhere(name):
    effect = EFFECTS.load(name)
    assert hasattr(effect, "shift") or any(hasattr(effect, hook) for hook in HOOKS)
    assert hasattr(effect, "derivatives") == (getattr(effect, "STATES", 0) > 0)


@pytest.mark.parametrize("name", NAMES)
def test_the_neutral_value_changes_nothing(name, uncompiled):
    assert uncompiled[name]["neutral_is_neutral"]


@pytest.mark.parametrize("name", NAMES)
def test_another_value_changes_something(name, uncompiled):
    assert uncompiled[name]["changed_by"] is not None


@pytest.mark.parametrize("name", NAMES)
def test_a_rig_file_holds_an_effect(name, make_rig):
    middle = {
        p.name: p.default + 0.01 * ((p.maximum if p.maximum != p.default else p.minimum) - p.default)
        for p in declarations(EFFECTS.load(name).Parameters)
    }
    rig = make_rig(effects=[{"name": name, **middle}])
    written = rig_to_mapping(rig)
    assert written["effects"] == [{"name": name, **middle}]
    assert rig_from_mapping(json.loads(json.dumps(written)), "rig") == rig


_RATES = """

@njit(cache=True, error_model="numpy")
def rates(t, y, mode, plant, friction, inputs, effects, rate):
    return evaluate(t, y, mode, model.Coefficients(plant, friction, inputs, effects), rate)
"""


def test_all_effects_compile_together_and_neutral_change_nothing(make_rig):
    """One evaluation of the equations: a whole integrator of all effects takes long to compile."""
    plain, loaded = make_rig(), make_rig(effects=[{"name": name} for name in NAMES])
    random = np.random.default_rng(5)
    for _ in range(200):
        inputs = random.standard_normal(INPUTS) * [1e-3, 5e3, 1e4, 1e-2, 0.1, 10.0, 0.0] + [0, 0, 0, 0, 0, 313.15, 0]
        start = random.standard_normal(7) * [0.05, 0.1, 2e6, 1e-3, 300.0, 40.0, 40.0]
        answers = []
        for rig in (plain, loaded):
            kernel = kernel_module(plant_source(rig) + _RATES)
            y = np.concatenate([start, np.zeros(kernel.EFFECT_STATES)])
            rate, mode = np.empty(y.size), np.array([np.sign(start[3]), 0.0, 1.0, -1.0])
            parameters = np.array([value for use in rig.effects for value in use.parameters], dtype=np.float64)
            effective = rig.effective()
            event = kernel.rates(0.5, y, mode, effective.plant, effective.friction, inputs, parameters, rate)
            answers.append([event, *rate[:7]])
        assert answers[0] == answers[1]
