"""A wrong rig is refused in one line that names file, section, key, value and the expected value."""

import json

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.friction.gms import MAX_ELEMENTS
from ehls_ros.physics.rig import MAX_EFFECTS, EffectUse, check_known, rig_from_mapping, rig_to_mapping, unknown_keys


def refused(data):
    with pytest.raises(BadInput) as caught:
        rig_from_mapping(data, "rig.yaml")
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith("rig.yaml")
    return line


def test_the_paper_rig_survives_writing_and_reading(rig_data):
    rig = rig_from_mapping(rig_data, "rig.yaml")
    assert rig_from_mapping(json.loads(json.dumps(rig_to_mapping(rig))), "rig.yaml") == rig


@pytest.mark.parametrize(
    ("section", "key", "value", "said"),
    [
        ("plant", "moving_mass", -70.0, ["-70", "greater than 0", "kg"]),
        ("plant", "moving_mass", float("nan"), ["nan", "finite number", "kg"]),
        ("plant", "supply_pressure", float("inf"), ["inf", "finite number", "Pa"]),
        ("plant", "moving_mass", "heavy", ["'heavy'", "number"]),
        ("plant", "moving_mass", None, ["None", "number"]),
        ("plant", "gravity", 981.0, ["981", "20", "m/s^2"]),
        ("friction", "stribeck_exponent", 0.0, ["0.0", "greater than 0"]),
        ("friction", "element_weight", [0.5, 0.3, 0.3], ["1.1", "sum of 1"]),
        ("friction", "element_weight", [0.5, 0.5], ["3 element_stiffness", "2 element_weight", "same length"]),
        ("friction", "element_weight", [1.5, -0.25, -0.25], ["-0.25", "above 0"]),
        ("friction", "element_weight", [float("nan"), 0.5, 0.5], ["nan", "finite number"]),
        ("friction", "element_stiffness", [float("inf"), 1.0, 1.0], ["inf", "finite number"]),
        ("friction", "element_stiffness", 1e6, ["1000000.0", "N/m"]),
        ("friction", "static_force", 100.0, ["640.8", "at most static_force = 100"]),
        ("friction", "model", "sticky", ["'sticky'", "gms", "lugre", "stribeck"]),
        ("limits", "position", [0.3, -0.3], ["[0.3, -0.3]", "min < max"]),
        ("limits", "position", [0.3], ["[0.3]", "m"]),
        ("limits", "position", [float("nan"), 0.3], ["nan", "finite number"]),
    ],
)
def test_a_value_out_of_range(section, key, value, said, rig_data):
    rig_data[section][key] = value
    line = refused(rig_data)
    assert section in line
    assert key in line or key == "static_force"
    for part in said:
        assert part in line


def test_a_key_of_the_friction_that_is_missing(rig_data):
    del rig_data["friction"]["attraction_rate"]
    assert refused(rig_data).startswith("rig.yaml: friction: key 'attraction_rate' is missing; expected")


@pytest.mark.parametrize(
    ("section", "key", "said"),
    [
        ("plant", "bulk_modulus", "effective bulk modulus of the oil, beta_e [Pa], such as 1e+09"),
        ("limits", "position", "smallest and largest piston position [m], such as [-0.1, 0.1]"),
    ],
)
def test_what_a_rig_file_lacks_is_asked_for_where_it_is_needed(section, key, said, rig_data):
    del rig_data[section][key]
    rig = rig_from_mapping(rig_data, "rig.yaml")
    assert unknown_keys(rig) == (f"{section}.{key}",)
    assert rig_to_mapping(rig)[section] == rig_data[section]
    check_known(rig, "rig.yaml", ("plant.moving_mass",))
    for needed in ((), (f"{section}.{key}",)):
        with pytest.raises(BadInput) as caught:
            check_known(rig, "rig.yaml", needed)
        assert str(caught.value) == f"rig.yaml: {section}: key '{key}' is missing; expected a value for it ({said})"


def test_whole_sections_may_be_missing_of_a_rig_that_is_not_simulated(rig_data):
    rig = rig_from_mapping({"friction": rig_data["friction"]}, "rig.yaml")
    assert rig_to_mapping(rig)["plant"] == rig_to_mapping(rig)["limits"] == {}


@pytest.mark.parametrize(
    ("section", "typed", "meant"),
    [
        ("plant", "supply_presure", "supply_pressure"),
        ("friction", "colomb_force", "coulomb_force"),
        ("limits", "forces", "force"),
    ],
)
def test_a_key_spelt_wrongly_is_named_with_the_one_it_is_like(section, typed, meant, rig_data):
    rig_data[section][typed] = rig_data[section].pop(meant)
    line = refused(rig_data)
    assert f"key '{typed}' is unknown" in line
    assert line.endswith(f"did you mean '{meant}'?")


def test_a_key_that_is_unknown(rig_data):
    rig_data["plant"]["mass"] = 70.0
    line = refused(rig_data)
    assert "plant: key 'mass' is unknown" in line
    assert "moving_mass" in line


def test_a_section_that_is_missing_or_unknown(rig_data):
    friction = rig_data.pop("friction")
    assert "section 'friction' is missing" in refused(rig_data)
    rig_data.update(friction=friction, sensor={})
    assert refused(rig_data).endswith("did you mean 'sensors'?")


@pytest.mark.parametrize("data", [None, [], "rig", 3.0])
def test_something_that_is_no_rig(data):
    assert "plant" in refused(data)


@pytest.mark.parametrize(
    ("effects", "said"),
    [
        ([{"name": "valve_dead_band"}], ["effects[0]", "'valve_dead_band'", "valve_dead_zone"]),
        ([{"name": "valve_dead_zone"}, {"name": "valve_dead_zone", "overlap": 1e-5}], ["effects[1]", "'overlap'", "positive"]),
        ([{"name": "valve_dead_zone", "positive": -1e-5}], ["effects[0]", "positive", "-1e-05", "greater than or equal to 0"]),
        ([{"name": "valve_dead_zone", "positive": "wide"}], ["effects[0]", "positive", "'wide'", "number"]),
        ([{"positive": 1e-5}], ["effects[0]", "name"]),
        (["valve_dead_zone"], ["effects[0]", "'valve_dead_zone'", "name"]),
        ({"name": "valve_dead_zone"}, ["effects", "a list"]),
        ([{"name": ["valve_dead_zone"]}], ["effects[0]", "unknown"]),
        ([{"name": "valve_dead_zone"}] * (MAX_EFFECTS + 1), ["effects", f"{MAX_EFFECTS + 1} effects", "at most"]),
    ],
)
def test_effects_that_are_wrong(effects, said, rig_data):
    rig_data["effects"] = effects
    line = refused(rig_data)
    for part in said:
        assert part in line


@pytest.mark.parametrize("count", [MAX_ELEMENTS, MAX_ELEMENTS + 1])
def test_elements_are_as_many_as_are_compiled_in_a_reasonable_time(count, rig_data):
    rig_data["friction"].update(element_stiffness=[1e5] * count, element_weight=[1.0 / count] * count)
    if count == MAX_ELEMENTS:
        assert len(rig_from_mapping(rig_data, "rig.yaml").friction.element_stiffness) == count
    else:
        line = refused(rig_data)
        assert f"element_stiffness has {count} values" in line
        assert f"at most {MAX_ELEMENTS}" in line


@pytest.mark.parametrize(
    ("sensors", "said"),
    [
        ({"pressure": {}}, ["'pressure'", "load_pressure"]),
        ({"force": {"noise": 1.0}}, ["sensors: force", "'noise'", "noise_std"]),
        ({"force": {"delay": -1.0}}, ["sensors: force", "delay", "-1.0", "greater than or equal to 0"]),
        ({"force": {"gain": 0.0}}, ["sensors: force", "gain", "0.0", "greater than 0"]),
        ({"force": 4.0}, ["sensors: force", "4.0", "noise_std"]),
        ([], ["sensors", "[]"]),
    ],
)
def test_sensors_that_are_wrong(sensors, said, rig_data):
    rig_data["sensors"] = sensors
    line = refused(rig_data)
    for part in said:
        assert part in line


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ([1.0], ["standard_errors", "plant.bulk_modulus"]),
        ({"plant.bulk": 1.0}, ["plant.bulk", "one of its coefficients"]),
        ({"effects.command_delay.delay": 1e-5}, ["effects.command_delay.delay"]),
        ({"sensors.speed.noise_std": 1e-5}, ["sensors.speed.noise_std"]),
        ({"plant.bulk_modulus": -1.0}, ["plant.bulk_modulus", "-1.0", "0 or more"]),
    ],
)
def test_standard_errors_that_are_wrong(errors, said, rig_data):
    rig_data["standard_errors"] = errors
    line = refused(rig_data)
    for part in said:
        assert part in line


def test_standard_errors_are_kept(rig_data):
    errors = {"plant.bulk_modulus": 1e7, "sensors.force.noise_std": 0.1, "effects.command_delay.delay": 1e-6}
    rig_data |= {"standard_errors": errors, "effects": [{"name": "command_delay", "delay": 1e-3}]}
    written = json.loads(json.dumps(rig_to_mapping(rig_from_mapping(rig_data, "rig.yaml"))))
    assert rig_from_mapping(written, "rig.yaml").standard_errors == errors


# --- the friction section ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_the_word_model_is_all_that_has_to_change(model, rig_data):
    paper = rig_from_mapping(rig_data, "rig.yaml")
    rig_data["friction"]["model"] = model
    rig = rig_from_mapping(rig_data, "rig.yaml")
    assert rig.friction_model == model
    assert type(rig.friction) is FRICTION_MODELS.load(model).Parameters
    written = json.loads(json.dumps(rig_to_mapping(rig)))
    assert rig_from_mapping(written, "rig.yaml") == rig
    written["friction"]["model"] = paper.friction_model
    back = rig_from_mapping(written, "rig.yaml")
    assert back.friction == paper.friction
    assert set(rig_data["friction"]) <= set(written["friction"])


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_a_model_reads_its_own_keys_alone(model, rig_data):
    declared = FRICTION_MODELS.load(model).Parameters
    rig_data["friction"]["model"] = model
    rig = rig_from_mapping(rig_data, "rig.yaml")
    rig_data["friction"] = {"model": model, **rig.friction._asdict()}
    alone = rig_from_mapping(rig_data, "rig.yaml")
    assert alone.friction == rig.friction
    assert alone.other_friction == {}
    for key in declared._fields:
        less = {**rig_data, "friction": {k: v for k, v in rig_data["friction"].items() if k != key}}
        if key in declared._field_defaults:
            rig_from_mapping(less, "rig.yaml")
        else:
            assert f"key '{key}' is missing" in refused(less)


@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_a_key_that_no_friction_model_has(model, rig_data):
    rig_data["friction"] |= {"model": model, "stickiness": 1.0}
    line = refused(rig_data)
    assert "friction: key 'stickiness' is unknown" in line
    for other in FRICTION_MODELS.names():
        assert all(key in line for key in FRICTION_MODELS.load(other).Parameters._fields)


@pytest.mark.parametrize(
    ("model", "key", "value"), [("stribeck", "attraction_rate", -1.0), ("lugre", "element_weight", "even")]
)
def test_keys_of_other_models_are_checked_too(model, key, value, rig_data):
    rig_data["friction"] |= {"model": model, key: value}
    line = refused(rig_data)
    assert f"friction: {key} is {value!r}" in line


def test_an_own_stiffness_goes_before_that_of_other_models_elements(rig_data):
    rig_data["friction"] |= {"model": "lugre", "presliding_stiffness": 3e6}
    rig = rig_from_mapping(rig_data, "rig.yaml")
    assert rig.friction.presliding_stiffness == 3e6
    assert rig_to_mapping(rig)["friction"]["presliding_stiffness"] == 3e6
    del rig_data["friction"]["presliding_stiffness"]
    assert rig_from_mapping(rig_data, "rig.yaml").friction.presliding_stiffness == 1.884e6 + 1.969e5 + 1.841e5


# --- effects on friction ----------------------------------------------------------------------------------------------


def pairs(acting):
    """Yield each effect on friction coefficients with each model that has, or has none of, the coefficients it shifts."""
    for name in EFFECTS.names():
        shifts = set(getattr(EFFECTS.load(name), "SHIFTS", ()))
        for model in FRICTION_MODELS.names():
            fields = set(FRICTION_MODELS.load(model).Parameters._fields)
            if shifts and bool(shifts & fields) == acting:
                yield name, model


@pytest.mark.parametrize(("effect", "model"), list(pairs(acting=True)))
def test_an_effect_shifts_the_coefficients_that_a_model_has(effect, model, rig_data):
    rig_data["friction"]["model"] = model
    rig = rig_from_mapping(rig_data, "rig.yaml")
    member = EFFECTS.load(effect)
    assert member.forms(rig)
    assert rig.with_effects((EffectUse(effect, member.Parameters()),)).effective().friction == rig.friction
    for form in member.forms(rig):
        for key in form.free:
            changed = EffectUse(effect, member.Parameters(**{**form.fixed, key: 1.5}))
            assert rig.with_effects((changed,)).effective().friction != rig.friction


@pytest.mark.parametrize(("effect", "model"), list(pairs(acting=False)))
def test_an_effect_without_anything_to_act_on_is_refused(effect, model, rig_data):
    rig_data["friction"]["model"] = model
    assert EFFECTS.load(effect).forms(rig_from_mapping(rig_data, "rig.yaml")) == ()
    rig_data["effects"] = [{"name": effect}]
    line = refused(rig_data)
    assert line.startswith("rig.yaml: effects")
    assert repr(effect) in line
    assert repr(model) in line
    able = [other for name, other in pairs(acting=True) if name == effect]
    assert all(other in line for other in able)


def test_some_effect_finds_nothing_to_act_on_in_some_model():
    """Otherwise the test above is run for no pair."""
    assert list(pairs(acting=False))
