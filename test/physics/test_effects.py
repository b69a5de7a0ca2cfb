"""Contract of every effect's file, and neutrality by default."""

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
import yaml
from rig_runs import PERIOD, rig_file_for
from tiers import tiered

from ehls_ros.arrays import kernel
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS, Group, Peak, Period, Quantile, Share, acts_on_one_pressure
from ehls_ros.physics.plant import INPUTS, Coefficients, U, system
from ehls_ros.physics.rig import rig_from_mapping, rig_to_mapping
from ehls_ros.physics.simulator import parts_of
from ehls_ros.schema import declarations
from ehls_ros.trajectory import SIGNALS

NAMES = EFFECTS.names()
# The names used in rig files and diagnoses, by group.
CONTRACT = {
    "valve": """valve_dead_zone valve_null_bias valve_gain_asymmetry valve_gain_shift valve_saturation valve_bandwidth_shift
        valve_second_order valve_hysteresis command_delay edge_gain edge_wear""",
    "flow": """supply_pressure_shift supply_pressure_droop bulk_modulus_shift entrained_air internal_leakage_shift
        turbulent_leakage external_leakage hose_compliance tank_pressure_shift""",
    "friction": """coulomb_shift coulomb_asymmetry viscous_shift viscous_asymmetry stribeck_shift presliding_stiffness_shift
        pressure_dependent_friction position_dependent_friction temperature_dependent_friction""",
    "mechanics": "mass_shift spring_rate_shift spring_hardening hinge_backlash end_stop flexible_mode",
    "sensors": """pressure_sensor_bias pressure_sensor_gain pressure_sensor_lag position_sensor_bias position_sensor_gain
        sensor_delay""",
    "environment": "periodic_disturbance constant_load coupling_stiffness",
}
HOOK_ARGUMENTS = ["value", "t", "y", "w", "z", "p", "plant"]


def mapping_for(name):
    return yaml.safe_load(rig_file_for(name).read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def uncompiled(request, tmp_path_factory):
    """Changes due to each effect under test, run without compiling."""
    names = {
        item.callspec.params["name"] for item in request.session.items if "uncompiled" in getattr(item, "fixturenames", ())
    }
    script = Path(__file__).with_name("effects_uncompiled.py")
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "EHLS_CACHE_DIR": str(tmp_path_factory.mktemp("kernels"))}
    done = subprocess.run([sys.executable, str(script), *names], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("group", CONTRACT)
def test_the_names_promised_are_there(group):
    assert [name for name in CONTRACT[group].split() if group != EFFECTS.load(name).GROUP] == []


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_says_what_it_is(name):
    effect = EFFECTS.load(name)
    assert effect.GROUP in get_args(Group)
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
    hooks = [getattr(effect, hook) for hook in HOOKS if hasattr(effect, hook)]
    assert hooks or hasattr(effect, "shift") or hasattr(effect, "shift_chambers")
    for hook in hooks:
        assert list(inspect.signature(hook.py_func).parameters) == HOOK_ARGUMENTS
    assert hasattr(effect, "derivatives") == (getattr(effect, "STATES", 0) > 0)
    if hasattr(effect, "derivatives"):
        assert list(inspect.signature(effect.derivatives.py_func).parameters) == ["u", *HOOK_ARGUMENTS[1:], "dz"]
    assert hasattr(effect, "received") == hasattr(effect, "jump") == hasattr(effect, "REACH") == hasattr(effect, "reach")


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_needs_signals_that_there_are(name):
    assert set(getattr(EFFECTS.load(name), "NEEDS", ())) <= set(SIGNALS)


@pytest.mark.parametrize("name", NAMES)
def test_the_ways_to_fit_an_effect_start_off_the_neutral_values_and_within_range(name):
    effect = EFFECTS.load(name)
    declared = {parameter.name: parameter for parameter in declarations(effect.Parameters)}
    forms = effect.forms(rig_from_mapping(mapping_for(name), "rig"))
    assert bool(forms) != getattr(effect, "LEARNT", False)
    for form in forms:
        assert form.free
        assert not set(form.free) & {*form.fixed, *getattr(effect, "FIXED", ())}
        assert set(form.free) | set(form.fixed) <= set(declared)
        assert len({len(starts) for starts in form.free.values() if starts}) <= 1
        for key, value in form.fixed.items():
            assert declared[key].minimum <= value <= declared[key].maximum
            assert value != declared[key].default
        for key, starts in form.free.items():
            for start in starts:
                match start:
                    case Share(signal, fraction):
                        assert signal in SIGNALS
                        assert fraction > 0.0
                    case Quantile(signal, fraction):
                        assert signal in SIGNALS
                        assert 0.0 < fraction < 1.0
                    case Peak(rank):
                        assert rank >= 1
                    case Period(signal, _):
                        assert signal in SIGNALS
                    case _:
                        assert declared[key].minimum <= start <= declared[key].maximum
        # From the neutral values alone no fit would start.
        for point in zip(*(starts for starts in form.free.values() if starts), strict=True):
            named = zip((key for key, starts in form.free.items() if starts), point, strict=True)
            assert any(start != declared[key].default for key, start in named)


@pytest.mark.parametrize("name", tiered(NAMES, *NAMES[::6]))
def test_the_neutral_value_changes_nothing(name, uncompiled):
    assert uncompiled[name]["neutral_is_neutral"]


@pytest.mark.parametrize("name", tiered(NAMES, *NAMES[::6]))
def test_another_value_changes_something(name, uncompiled):
    assert uncompiled[name]["changed_by"] is not None


@pytest.mark.parametrize("name", NAMES)
def test_a_rig_file_holds_an_effect(name):
    middle = {
        p.name: p.default + 0.01 * ((p.maximum if p.maximum != p.default else p.minimum) - p.default)
        for p in declarations(EFFECTS.load(name).Parameters)
    }
    rig = rig_from_mapping({**mapping_for(name), "effects": [{"name": name, **middle}]}, "rig")
    written = rig_to_mapping(rig)
    neutral = EFFECTS.load(name).Parameters()._asdict() if getattr(EFFECTS.load(name), "LEARNT", False) else {}
    assert written["effects"] == [{"name": name, **{key: value for key, value in middle.items() if neutral.get(key) != value}}]
    assert rig_from_mapping(json.loads(json.dumps(written)), "rig") == rig


def once(cylinder, valve, friction, elements, states, chains):
    """Build one evaluation of the equations."""
    evaluate, _ = system(cylinder, valve, friction, elements, chains)

    @kernel
    def rates(t, y, mode, c, rate):
        return evaluate(t, y, mode, c, rate)

    return SimpleNamespace(rates=rates)


@pytest.mark.long
def test_all_effects_compile_together_and_neutral_change_nothing(make_rig):
    """One evaluation of the equations: a whole integrator of all effects takes long to compile."""
    names = [name for name in NAMES if acts_on_one_pressure(EFFECTS.load(name))]
    rigs = [make_rig(), make_rig(effects=[{"name": name} for name in names])]
    parts = [parts_of(rig) for rig in rigs]
    kernels = [compiled(once, {"rates": "t, y, mode, c, rate"}, **part._asdict()) for part in parts]
    effective = [rig.effective() for rig in rigs]
    settings = [part.effects.parameters(rig.effects) for part, rig in zip(parts, rigs, strict=True)]
    random = np.random.default_rng(5)
    for _ in range(200):
        inputs = random.standard_normal(INPUTS) * [1e-3, 5e3, 1e4, 1e-2, 0.1, 10.0, 0.0, 0.0]
        inputs += [0.0, 0.0, 0.0, 0.0, 0.0, 313.15, 0.0, PERIOD]
        start = random.standard_normal(7) * [0.05, 0.1, 2e6, 1e-3, 300.0, 40.0, 40.0]
        answers = []
        for module, part, rig, parameters in zip(kernels, parts, effective, settings, strict=True):
            y = np.concatenate([start, np.zeros(part.numbers["states"])])
            rate, mode = np.empty(y.size), np.array([np.sign(start[3]), 0.0, 1.0, -1.0])
            given = [values.copy() for values in (y, inputs, parameters)]
            c = Coefficients(rig.plant, rig.friction, inputs, parameters, inputs[U], (), ())
            event = module.rates(0.5, y, mode, c, rate)
            answers.append([event, *rate[:7]])
            assert np.all(np.isfinite(rate))
            for values, before in zip((y, inputs, parameters), given, strict=True):
                np.testing.assert_array_equal(values, before)
        assert answers[0] == answers[1]
