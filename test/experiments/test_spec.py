"""Every user error in a spec, a rig file or a reference file ends in one line: error, location, expected value."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.references import REFERENCES
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import (
    Spec,
    Use,
    for_simulated_rig,
    ignored_pacing,
    load_rig,
    load_spec,
    spec_from_mapping,
    spec_to_mapping,
    undeclared_effects,
)
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import acts_on_one_pressure
from ehls_ros.physics.rig import MAX_EFFECTS, SENSED, rig_from_mapping, rig_to_mapping
from ehls_ros.recording.yaml_text import read_yaml

REMOVED = object()


def changed(mapping: dict[str, Any], keys: tuple[str, ...], value: Any) -> dict[str, Any]:
    """Return a copy with one nested key set or removed."""
    copy = dict(mapping)
    if len(keys) > 1:
        copy[keys[0]] = changed(dict(copy.get(keys[0]) or {}), keys[1:], value)
    elif value is REMOVED:
        copy.pop(keys[0])
    else:
        copy[keys[0]] = value
    return copy


def refusal(make: Any, *arguments: Any) -> BadInput:
    with pytest.raises(BadInput) as caught:
        make(*arguments)
    line = str(caught.value)
    assert "\n" not in line
    assert line == f"{caught.value.where}: {caught.value.what}; expected {caught.value.expected}"
    assert "function" not in line
    assert "object at" not in line
    return caught.value


RIG_ERRORS = [
    (("plant", "moving_mass"), -70.0, "rig.yaml: plant", "moving_mass is -70.0", "greater than 0"),
    (("plant", "moving_mass"), 0, "rig.yaml: plant", "moving_mass is 0", "greater than 0"),
    (("plant", "bulk_modulus"), math.nan, "rig.yaml: plant", "bulk_modulus is nan", "finite"),
    (("plant", "bulk_modulus"), math.inf, "rig.yaml: plant", "bulk_modulus is inf", "finite"),
    (("plant", "bulk_modulus"), "stiff", "rig.yaml: plant", "bulk_modulus is 'stiff'", "number"),
    (("plant", "bulk_modulus"), None, "rig.yaml: plant", "bulk_modulus is None", "number"),
    (("plant", "bulk_modulus"), [6.9e8], "rig.yaml: plant", "bulk_modulus is [690000000.0]", "number"),
    (("plant", "moving_maas"), 70.0, "rig.yaml: plant", "'moving_maas' is unknown", "moving_mass"),
    (("plant",), [1, 2], "rig.yaml", "[1, 2]", "mapping"),
    (("friction",), REMOVED, "rig.yaml", "'friction'", "mapping"),
    (("pump",), {}, "rig.yaml", "'pump' is unknown", "plant"),
    (("friction", "model"), "coulomb", "rig.yaml: friction: model", "'coulomb'", "gms"),
    (("friction", "coulomb_force"), 900.0, "rig.yaml: friction", "coulomb_force is 900", "865.4"),
    (("friction", "element_weight"), [0.5, 0.5], "rig.yaml: friction", "2 element_weight", "same length"),
    (("friction", "element_weight"), [0.5, 0.5, 0.5], "rig.yaml: friction", "1.5", "sum of 1"),
    (("friction", "element_weight"), [1.5, -0.25, -0.25], "rig.yaml: friction", "-0.25", "above 0"),
    (("friction", "element_stiffness"), "stiff", "rig.yaml: friction", "'stiff'", "list"),
    (("friction", "element_stiffness"), [], "rig.yaml: friction", "0 element_stiffness", "at least one"),
    (("friction", "element_stiffness"), [math.nan, 1.0, 1.0], "rig.yaml: friction", "nan", ""),
    (("limits", "position"), [0.3, -0.3], "rig.yaml: limits", "[0.3, -0.3]", "min < max"),
    (("limits", "position"), [0.3], "rig.yaml: limits", "position", ""),
    (("limits", "spool"), 0.0, "rig.yaml: limits", "spool is 0.0", "greater than 0"),
    (("effects",), {"name": "valve_dead_zone"}, "rig.yaml: effects", "{'name'", "a list"),
    (("effects",), ["valve_dead_zone"], "rig.yaml: effects[0]", "'valve_dead_zone'", "a mapping"),
    (("effects",), [{"name": "gremlin"}], "rig.yaml: effects[0]", "'gremlin' is unknown", "valve_dead_zone"),
    (("effects",), [{"name": "valve_dead_zone", "depth": 1.0}], "rig.yaml: effects[0]: valve_dead_zone", "'depth'", "one of"),
    (("sensors",), [1], "rig.yaml: sensors", "[1]", "a mapping"),
    (("sensors",), {"speed": {}}, "rig.yaml: sensors", "'speed' is unknown", "velocity"),
    (("sensors",), {"velocity": {"noise_std": -1.0}}, "rig.yaml: sensors: velocity", "noise_std is -1.0", "0"),
    (("sensors",), {"velocity": {"nose": 1.0}}, "rig.yaml: sensors: velocity", "'nose' is unknown", "noise_std"),
]


@pytest.mark.parametrize(("keys", "value", "where", "what", "expected"), RIG_ERRORS)
def test_a_wrong_rig_is_refused(rig_mapping, keys, value, where, what, expected):
    error = refusal(rig_from_mapping, changed(rig_mapping, keys, value), "rig.yaml")
    assert error.where == where
    assert what in error.what
    assert expected in error.expected


SPEC_ERRORS = [
    (("rig",), REMOVED, "spec.yaml", "'rig' is missing", "rig file"),
    (("rig",), 7, "spec.yaml: rig", "int", "mapping"),
    (("rig", "plant", "moving_mass"), REMOVED, "spec.yaml: rig: plant", "'moving_mass' is missing", "kg"),
    (("rig", "plant"), REMOVED, "spec.yaml: rig: plant", "'supply_pressure' is missing", "such as 2.1e+07"),
    (("rig", "limits"), REMOVED, "spec.yaml: rig: limits", "'spool' is missing", "[m]"),
    (("rig",), "absent.yaml", "absent.yaml", "cannot be read", "YAML file"),
    (("rig", "plant", "moving_mass"), -1.0, "spec.yaml: rig: plant", "moving_mass is -1.0", "greater than 0"),
    (("reference",), REMOVED, "spec.yaml: reference", "None", "sine"),
    (("controller",), REMOVED, "spec.yaml: controller", "None", "fasmc"),
    (("controller", "name"), "lqr", "spec.yaml: controller", "'lqr' is unknown", "fasmc"),
    (("controller", "k"), "large", "spec.yaml: controller: fasmc", "k is 'large'", "number"),
    (("controller", "k"), -1.0, "spec.yaml: controller: fasmc", "k is -1.0", "0.1"),
    (("controller", "kk"), 1.0, "spec.yaml: controller: fasmc", "'kk' is unknown", "delta_f"),
    (("disturbance",), "force", "spec.yaml: disturbance", "'force'", "position_servo"),
    (("disturbance",), {"name": "earthquake"}, "spec.yaml: disturbance", "'earthquake'", "force"),
    (("disturbance",), {"name": "force"}, "spec.yaml: disturbance: signal", "None", "sine"),
    (("disturbance",), {"name": "force", "signal": {"name": "noise"}}, "spec.yaml: disturbance: signal", "'noise'", "sine"),
    (
        ("disturbance",),
        {"name": "position_servo", "stiffness": 0.0, "signal": {"name": "sine"}},
        "spec.yaml: disturbance: position_servo",
        "stiffness is 0.0",
        "greater than 0",
    ),
    (("duration",), 0.0, "spec.yaml", "duration is 0.0", "greater than 0"),
    (("duration",), math.nan, "spec.yaml", "duration is nan", "finite"),
    (("duration",), "long", "spec.yaml", "duration is 'long'", "number"),
    (("control_period",), 1.0, "spec.yaml", "control_period is 1.0", "0.1"),
    (("control_period",), 4000.0, "spec.yaml", "control_period is 4000.0", "time between two control cycles"),
    (("control_period",), 1e-7, "spec.yaml", "control_period is 1e-07", "greater than or equal to 1e-06"),
    (("seed",), 1.5, "spec.yaml", "seed is 1.5", "integer"),
    (("seed",), -1, "spec.yaml", "seed is -1", "0"),
    (("title",), 5, "spec.yaml", "title is 5", "string"),
    (("compensation",), "lugre", "spec.yaml: compensation", "'lugre' is unknown", "gms"),
    (("compensation",), {"name": "lugre"}, "spec.yaml: compensation", "'lugre' is unknown", "gms"),
    (("compensation",), {"steps": 4}, "spec.yaml: compensation", "{'steps': 4}", "gms"),
    (("compensation",), None, "spec.yaml: compensation", "None", "gms"),
    (("compensation",), ["gms"], "spec.yaml: compensation", "['gms']", "gms"),
    (("compensation",), {"name": "gms", "steps": 0}, "spec.yaml: compensation: gms", "steps is 0", "1"),
    (("compensation",), {"name": "gms", "steps": 2.5}, "spec.yaml: compensation: gms", "steps is 2.5", "integer"),
    (("compensation",), {"name": "gms", "smoothing": 0.1}, "spec.yaml: compensation: gms", "'smoothing' is unknown", "steps"),
    (
        ("compensation",),
        {"name": "stribeck", "smoothing": 0.0},
        "spec.yaml: compensation: stribeck",
        "smoothing is 0.0",
        "1e-06",
    ),
    (("compensation",), {"name": "stribeck", "steps": 4}, "spec.yaml: compensation: stribeck", "'steps'", "smoothing"),
    (("controller_rig",), 7, "spec.yaml: controller_rig", "int", "mapping"),
    (("controller_rig",), "absent.yaml", "absent.yaml", "cannot be read", "YAML file"),
    (("controller_rig",), {"plant": {}}, "spec.yaml: controller_rig", "'friction' is missing", "mapping"),
    (("controller", "implicitness"), 1.5, "spec.yaml: controller: fasmc", "implicitness is 1.5", "1"),
    (("controller", "rate_correction"), -0.1, "spec.yaml: controller: fasmc", "rate_correction is -0.1", "0"),
    (("oil_temperature",), 40.0, "spec.yaml", "oil_temperature is 40.0", "200"),
    (("oil_warming",), 11.0, "spec.yaml", "oil_warming is 11.0", "10"),
    (("durration",), 1.0, "spec.yaml", "'durration' is unknown", "duration"),
    ((7,), 1.0, "spec.yaml", "7 is unknown", "duration"),
    (("effects",), [{"name": "gremlin"}], "spec.yaml: effects[0]", "'gremlin'", "valve_dead_zone"),
    (("known_effects",), "command_delay", "spec.yaml: known_effects", "'command_delay'", "a list"),
    (("known_effects",), ["command_delay"], "spec.yaml: known_effects", "does not act on this rig", "a mapping"),
    (("known_effects",), [{"name": "gremlin"}], "spec.yaml: known_effects[0]", "'gremlin'", "command_delay"),
    (("companions",), "disturbance_preview", "spec.yaml: companions", "'disturbance_preview'", "a list"),
    (("companions",), ["oracle"], "spec.yaml: companions[0]", "'oracle' is unknown", "disturbance_preview"),
    (("companions",), 2 * ["disturbance_preview"], "spec.yaml: companions", "disturbance_preview, dist", "each name once"),
    (
        ("companions",),
        [{"name": "disturbance_preview", "moving_mass": 0.0}],
        "spec.yaml: companions[0]: disturbance_preview",
        "moving_mass is 0.0",
        "greater than 0",
    ),
]


@pytest.mark.parametrize(("keys", "value", "where", "what", "expected"), SPEC_ERRORS)
def test_a_wrong_spec_is_refused(rig_mapping, keys, value, where, what, expected):
    plain = {"rig": rig_mapping, "reference": {"name": "sine"}, "controller": {"name": "fasmc"}}
    error = refusal(spec_from_mapping, changed(plain, keys, value), "spec.yaml", Path())
    assert error.where == where
    assert what in error.what
    assert expected in error.expected


def test_a_wrong_value_in_the_controllers_rig_is_refused_with_its_place(rig_mapping):
    believed = changed(rig_mapping, ("plant", "valve_gain"), -1.0)
    plain = {"rig": rig_mapping, "controller_rig": believed, "reference": "sine", "controller": "fasmc"}
    error = refusal(spec_from_mapping, plain, "spec.yaml", Path())
    assert error.where == "spec.yaml: controller_rig: plant"
    assert "valve_gain is -1.0" in error.what


@pytest.mark.parametrize("content", [None, 3, "text", [], True])
@pytest.mark.parametrize("load", [load_rig, load_spec])
def test_a_file_that_holds_something_else_is_refused(tmp_path, content, load):
    path = tmp_path / "file.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    error = refusal(load, path)
    assert error.where.startswith(str(path))
    assert type(content).__name__ in error.what
    assert "mapping" in error.expected


@pytest.mark.parametrize("load", [load_rig, load_spec])
def test_a_file_that_cannot_be_read_is_refused(tmp_path, load):
    assert "No such file" in refusal(load, tmp_path / "absent.yaml").what
    assert "directory" in refusal(load, tmp_path).what
    (tmp_path / "empty.yaml").touch()
    assert "mapping" in refusal(load, tmp_path / "empty.yaml").expected
    (tmp_path / "binary.yaml").write_bytes(bytes(range(256)))
    assert refusal(load, tmp_path / "binary.yaml").where.startswith(str(tmp_path / "binary.yaml"))
    (tmp_path / "control.yaml").write_bytes(b"rig: a\x00b\n")
    assert "YAML" in refusal(load, tmp_path / "control.yaml").expected
    (tmp_path / "object.yaml").write_text("rig: !!python/object/apply:os.getcwd []\n", encoding="utf-8")
    assert "YAML" in refusal(load, tmp_path / "object.yaml").expected


@pytest.mark.parametrize(
    ("text", "line"), [("plant: {a: 1\nfriction: 2\n", 2), ("a: 1\n\tb: 2\n", 2), ("a: 1\nb: c: d\n", 2), ("*unknown\n", 1)]
)
@pytest.mark.parametrize("load", [load_rig, load_spec])
def test_broken_yaml_is_refused_with_its_line(tmp_path, text, line, load):
    path = tmp_path / "broken.yaml"
    path.write_text(text, encoding="utf-8")
    assert refusal(load, path).where == f"{path}:{line}"


SPECTRUM_ERRORS = [
    ("time_s,value\n0,1\n1,nan\n", ":3", "nan", "finite"),
    ("time_s,value\n0,1\ninf,1\n", ":3", "inf", "finite"),
    ("time_s,value\n0,1\n2,1\n1,1\n", ":4", "1.0 after 2.0", "increasing"),
    ("time_s,value\n0,1\n0,2\n", ":3", "0.0 after 0.0", "increasing"),
    ("time_s,force\n0,1\n1,2\n", ":2", "force", "value"),
    ("t,value\n0,1\n1,2\n", ":2", "'t'", "time_s"),
    ("time_s,value\n0,1\n1\n", ":3", "None", "numbers"),
    ("time_s,value\n0,one\n1,2\n", ":2", "one", "numbers"),
    ("time_s,value\n0,1\n", "", "1 rows", "two rows"),
    ("time_s,value\n", "", "0 rows", "two rows"),
    ("", "", "0 rows", "time_s"),
]


@pytest.mark.parametrize(("text", "line", "what", "expected"), SPECTRUM_ERRORS)
def test_a_wrong_load_spectrum_is_refused(tmp_path, rig_mapping, text, line, what, expected):
    path = tmp_path / "load.csv"
    path.write_text(text, encoding="utf-8")
    plain = {"rig": rig_mapping, "controller": {"name": "fasmc"}, "reference": {"name": "load_spectrum", "file": "load.csv"}}
    error = refusal(spec_from_mapping, plain, "spec.yaml", tmp_path)
    assert error.where == f"{path}{line}"
    assert what in error.what
    assert expected in error.expected


@pytest.mark.parametrize("name", ["absent.csv", "."])
def test_a_load_spectrum_that_cannot_be_read_is_refused(tmp_path, rig_mapping, name):
    plain = {"rig": rig_mapping, "controller": {"name": "fasmc"}, "reference": {"name": "load_spectrum", "file": name}}
    error = refusal(spec_from_mapping, plain, "spec.yaml", tmp_path)
    assert error.where == str(tmp_path / name)
    assert "CSV" in error.expected


def test_a_binary_load_spectrum_is_refused(tmp_path, rig_mapping):
    (tmp_path / "load.csv").write_bytes(b"time_s,value\n\xff\xfe,\x00\n")
    plain = {"rig": rig_mapping, "controller": {"name": "fasmc"}, "reference": {"name": "load_spectrum", "file": "load.csv"}}
    assert refusal(spec_from_mapping, plain, "spec.yaml", tmp_path).where.startswith(str(tmp_path / "load.csv"))


def test_a_load_spectrum_is_found_beside_its_spec(tmp_path, rig_mapping):
    (tmp_path / "load.csv").write_text("time_s,value,note\r\n0,1e3,a\r\n1.5,-2e3,b\r\n", encoding="utf-8")
    plain = {"rig": rig_mapping, "controller": {"name": "fasmc"}, "reference": {"name": "load_spectrum", "file": "load.csv"}}
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(plain), encoding="utf-8")
    assert load_spec(tmp_path / "spec.yaml").reference.parameters.points == ((0.0, 1e3), (1.5, -2e3))


def round_trip(plain: dict[str, Any]) -> Spec:
    spec = spec_from_mapping(plain, "spec", Path())
    text = yaml.safe_dump(yaml.safe_load(yaml.safe_dump(_lists(spec_to_mapping(spec)))))
    again = spec_from_mapping(yaml.safe_load(text), "again", Path())
    assert again == spec
    return again


def _lists(value: Any) -> Any:
    """Return a value that YAML can write: a tuple as a list."""
    if isinstance(value, dict):
        return {key: _lists(entry) for key, entry in value.items()}
    return [_lists(entry) for entry in value] if isinstance(value, list | tuple) else value


NEEDED: dict[str, dict[str, Any]] = {
    "load_spectrum": {"points": [[0.0, 0.1], [1.0, 0.2]]},
    "programme": {"blocks": [{"repeat": 2, "blocks": [{"block": "ramp", "to": 0.1, "time": 1.0}]}], "limits": {"settling": 3}},
}


def signal(name: str) -> dict[str, Any]:
    return {"name": name, **NEEDED.get(name, {})}


@pytest.mark.parametrize("name", REFERENCES.names())
def test_every_reference_survives_a_round_trip(rig_mapping, name):
    disturbance = {"name": "force", "signal": signal(name)}
    round_trip({"rig": rig_mapping, "controller": {"name": "fasmc"}, "reference": signal(name), "disturbance": disturbance})


@pytest.mark.parametrize("name", CONTROLLERS.names())
@pytest.mark.parametrize("observer", OBSERVERS.names())
def test_every_controller_survives_a_round_trip(rig_mapping, name, observer):
    round_trip(
        {"rig": rig_mapping, "controller": {"name": name}, "reference": signal("sine"), "compensation": observer, "seed": 3}
    )


@pytest.mark.parametrize("name", OBSERVERS.names())
def test_compensation_is_a_name_or_a_mapping(rig_mapping, name):
    plain = {"rig": rig_mapping, "reference": "sine", "controller": "fasmc"}
    parameters = OBSERVERS.load(name).Parameters()
    for given in (name, {"name": name}, {"name": name, **parameters._asdict()}):
        assert spec_from_mapping({**plain, "compensation": given}, "spec", Path()).compensation == Use(name, parameters)


@pytest.mark.parametrize(
    "given", [{"name": "gms", "steps": 17}, {"name": "stribeck", "smoothing": 0.003}, {"name": "stribeck", "smoothing": 1}]
)
def test_parameters_of_the_compensation_survive_a_round_trip(rig_mapping, given):
    again = round_trip({"rig": rig_mapping, "reference": "sine", "controller": "fasmc", "compensation": given})
    assert {"name": again.compensation.name, **again.compensation.parameters._asdict()} == given


def test_the_controllers_rig_and_the_oil_survive_a_round_trip(rig_mapping):
    believed = changed(rig_mapping, ("plant", "piston_area"), 2.5e-3)
    believed = changed(believed, ("friction", "coulomb_force"), 600.0)
    warm = {"name": "temperature_dependent_friction", "coulomb_slope": -4.0, "viscous_slope": -60.0}
    again = round_trip(
        {
            "rig": changed(rig_mapping, ("effects",), [{"name": "coulomb_shift"}]),
            "controller_rig": changed(believed, ("effects",), [{"name": "valve_dead_zone"}]),
            "effects": [warm],
            "reference": "sine",
            "controller": {"name": "fasmc", "implicitness": 0.7, "rate_correction": 0.4},
            "oil_temperature": 303.0,
            "oil_warming": -0.25,
        }
    )
    assert again.rig.plant.piston_area == 2.6e-3
    assert again.controller_rig.plant.piston_area == 2.5e-3
    assert again.controller_rig.friction.coulomb_force == 600.0
    assert [use.name for use in again.rig.effects] == ["coulomb_shift", "temperature_dependent_friction"]
    assert [use.name for use in again.controller_rig.effects] == ["valve_dead_zone"]
    assert again.settings.oil_temperature == 303.0
    assert again.settings.oil_warming == -0.25
    assert again.controller.parameters.implicitness == 0.7
    assert again.controller.parameters.rate_correction == 0.4


def test_the_effects_of_rig_and_experiment_are_counted_together(rig_mapping):
    half = [{"name": "constant_load"}] * (MAX_EFFECTS // 2)
    plain = {"rig": {**rig_mapping, "effects": half}, "reference": "sine", "controller": "fasmc"}
    assert len(spec_from_mapping({**plain, "effects": half}, "spec", Path()).rig.effects) == MAX_EFFECTS
    error = refusal(spec_from_mapping, {**plain, "effects": [*half, half[0]]}, "spec", Path())
    assert (error.where, error.what) == ("spec: effects", f"{MAX_EFFECTS + 1} effects")


@pytest.mark.parametrize("given", [{}, {"controller_rig": None}])
def test_the_controller_believes_in_the_rig_file_without_the_specs_effects_where_nothing_is_said(rig_mapping, given):
    rig = {**rig_mapping, "effects": [{"name": "coulomb_shift"}]}
    plain = {"rig": rig, "reference": "sine", "controller": "fasmc", "effects": [{"name": "valve_dead_zone"}]}
    spec = spec_from_mapping({**plain, **given}, "spec", Path())
    assert spec.controller_rig == rig_from_mapping(rig, "rig")
    assert spec.rig == spec.controller_rig.with_effects(spec.rig.effects[1:])


def test_the_controller_knows_effects_as_they_act_or_with_numbers_of_their_own(rig_mapping):
    servo = {"name": "position_servo", "stiffness": 3e6, "damping": 1e3, "signal": {"name": "constant", "value": 0.0}}
    known = ["coupling_stiffness", {"name": "command_delay", "delay": 1.5e-3}]
    again = round_trip(
        {
            "rig": rig_mapping,
            "effects": [{"name": "command_delay", "delay": 1e-3}],
            "known_effects": known,
            "reference": "sine",
            "disturbance": servo,
            "controller": "fasmc_predictive",
            "companions": ["disturbance_preview"],
        }
    )
    model = model_of(again.controller_rig, 1e-3)
    assert (model.command_delay, model.coupling_stiffness, model.coupling_damping) == (1.5e-3, 3e6, 1e3)
    assert [use.parameters.delay for use in again.rig.effects] == [1e-3]
    assert [use.name for use in again.companions] == ["disturbance_preview"]


def test_the_controllers_rig_is_found_beside_its_spec(tmp_path, rig_mapping):
    believed = changed(rig_mapping, ("plant", "valve_gain"), 1.3)
    (tmp_path / "believed.yaml").write_text(yaml.safe_dump(_lists(believed)), encoding="utf-8")
    plain = {"rig": _lists(rig_mapping), "controller_rig": "believed.yaml", "reference": "sine", "controller": "fasmc"}
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(plain), encoding="utf-8")
    spec = load_spec(tmp_path / "spec.yaml")
    assert (spec.rig.plant.valve_gain, spec.controller_rig.plant.valve_gain) == (1.0, 1.3)


@pytest.mark.parametrize("name", DISTURBANCES.names())
def test_every_disturbance_survives_a_round_trip(rig_mapping, name):
    disturbance = {"name": name, "signal": {"name": "sine", "amplitude": 0.01}}
    round_trip({"rig": rig_mapping, "controller": {"name": "sic"}, "reference": signal("sine"), "disturbance": disturbance})


@pytest.mark.parametrize("name", EFFECTS.names())
def test_every_effect_survives_a_round_trip(rig_mapping, name):
    effect = {"name": name, **EFFECTS.load(name).Parameters()._asdict()}
    rig = rig_mapping if acts_on_one_pressure(EFFECTS.load(name)) else dict(read_yaml(configured("rig_single_rod"), "rig"))
    round_trip({"rig": rig, "controller": {"name": "sic"}, "reference": signal("sine"), "effects": [effect]})


def test_every_sensor_survives_a_round_trip(rig_mapping):
    sensors = {name: {"noise_std": 0.1 * (i + 1), "delay": 1e-3, "bandwidth": 500.0} for i, name in enumerate(SENSED)}
    rig = rig_from_mapping({**rig_mapping, "sensors": sensors}, "rig")
    assert set(rig.sensors) == set(SENSED)
    assert rig_from_mapping(rig_to_mapping(rig), "again") == rig


def test_effects_of_the_spec_come_after_those_of_the_rig(rig_mapping):
    rig = {**rig_mapping, "effects": [{"name": "coulomb_shift"}]}
    plain = {"rig": rig, "reference": signal("sine"), "controller": {"name": "sic"}, "effects": [{"name": "valve_dead_zone"}]}
    spec = spec_from_mapping(plain, "spec", Path())
    assert [use.name for use in spec.rig.effects] == ["coulomb_shift", "valve_dead_zone"]
    servo = {**plain, "disturbance": {"name": "position_servo", "signal": {"name": "constant", "value": 0.0}}}
    loader = spec_from_mapping(servo, "spec", Path()).loader_rig()
    assert [use.name for use in loader.effects] == ["coulomb_shift", "valve_dead_zone", "coupling_stiffness"]


def test_a_spec_may_name_next_to_nothing(config):
    plain = {"rig": "rig_paper.yaml", "reference": signal("sine"), "controller": {"name": "fasmc"}}
    spec = spec_from_mapping(plain, "spec", config)
    assert spec.cycles == 10001
    assert spec.disturbance.name == "force"
    assert spec.compensation.name == "gms"


def test_the_papers_rig_is_the_papers(config):
    rig = load_rig(config / "rig_paper.yaml")
    # Table 2 and Table 1, with k in N/mm and the bandwidth of 17.74 Hz in rad/s
    assert rig.plant[:5] == (7e6, 840.0, 6.9e8, 0.62, 0.0267)
    assert rig.plant[5:12] == (4.7e-12, 1.5e-3, 70.0, 2.6e-3, 0.5, 4e4, 60.0)
    assert rig.plant.valve_bandwidth == pytest.approx(17.74 * 2.0 * math.pi, rel=1e-9)
    assert rig.friction[:5] == (640.8, 865.4, 2.031e-3, 0.8764, 7265.0)
    assert rig.friction.element_stiffness == (1.884e6, 1.969e5, 1.841e5)
    assert rig.friction.element_weight == (0.829, 0.089, 0.082)
    assert rig.effects == ()
    assert rig.sensors == {}


def test_an_effect_that_the_law_reckons_with_and_is_not_told_of_is_named(config):
    spec = load_spec(config / "experiments" / "measured_sine_fd2_preview.yaml")
    assert undeclared_effects(spec) == ()
    unaware = spec._replace(controller_rig=spec.controller_rig._replace(effects=()))
    assert [sentence.split(" and ")[0] for sentence in undeclared_effects(unaware)] == [
        "fasmc_predictive does not know the rig's command_delay",
        "fasmc_predictive does not know the rig's coupling_stiffness",
    ]
    assert undeclared_effects(unaware, "fasmc_output_feedback") == ()


def test_a_programme_that_nobody_paces_is_named(config):
    values = {"rig": str(config / "rig_paper.yaml"), "controller": "sic", "duration": 1.0}
    block = {"block": "ramp", "to": 1e3, "time": 1.0, "pacing": {"mode": "static", "tolerance": 10.0}}
    programmes = [{"name": "programme", "blocks": [paced]} for paced in (block, {**block, "pacing": {}})]
    said = [
        ignored_pacing(spec_from_mapping({**values, "reference": reference}, "spec", Path()))
        for reference in (*programmes, "sine")
    ]
    assert said[1:] == [(), ()]
    assert "leave out --in-process" in said[0][0]


AT_REST = {
    "rig": "rig_paper_measured.yaml",
    "duration": 1.5,
    "reference": {"name": "constant", "value": 0.0},
    "controller": "fasmc_output_feedback",
}
DELAY = {"name": "command_delay", "delay": 1e-3}


def test_a_law_assumes_by_default_the_delay_that_the_simulated_rig_has(config):
    def assumed(**more):
        spec = for_simulated_rig(spec_from_mapping({**AT_REST, **more}, "spec", config))
        return spec.controller.parameters.command_delay

    assert assumed() == 0.0
    assert assumed(effects=[DELAY]) == 1e-3
    assert assumed(controller={"name": "fasmc_output_feedback", "command_delay": 5e-4}) == 5e-4
    other = spec_from_mapping({**AT_REST, "controller": "fasmc"}, "spec", config)
    assert for_simulated_rig(other) is other


@pytest.mark.long
def test_a_filter_with_the_delay_of_the_rig_holds_the_force_at_rest(config):
    """With a delay that the rig does not have, the piston reached 1.8 m/s after 0.4 s."""
    recorded = run_in_process(for_simulated_rig(spec_from_mapping(AT_REST, "spec", config)))
    assert np.abs(recorded["velocity_m_s"]).max() < 0.1
    assert np.abs(recorded["force_n"][500:]).max() < 50.0
