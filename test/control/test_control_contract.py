"""Contract of every file of the control side's families; new files are found and tested automatically."""

import inspect
import math
from typing import Any

import numpy as np
import pytest

from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.companions.base import PLACE, Past, Setting, Upcoming
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import ROW as FOLLOWED
from ehls_ros.control.controllers.base import STATUS_SIZE, Model, model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import ROW
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.references import REFERENCES
from ehls_ros.control.references.base import SampledReference
from ehls_ros.errors import BadInput
from ehls_ros.families import Family
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import SENSED
from ehls_ros.schema import declarations, parse

FAMILIES = {
    "controller": CONTROLLERS,
    "companion": COMPANIONS,
    "reference": REFERENCES,
    "disturbance": DISTURBANCES,
    "observer": OBSERVERS,
}
MEMBERS = [pytest.param(family, name, id=f"{kind}-{name}") for kind, family in FAMILIES.items() for name in family.names()]
DECLARED = [
    pytest.param(name, declared, id=f"{kind}-{name}-{declared.name}")
    for kind, family in FAMILIES.items()
    for name in family.names()
    for declared in declarations(family.load(name).Parameters)
]


@pytest.mark.parametrize(("family", "name"), MEMBERS)
def test_a_file_says_what_it_is(family: Family[Any], name: str):
    member = family.load(name)
    assert len(inspect.getdoc(member) or "") > 5
    own = [value for value in vars(member).values() if getattr(value, "__module__", None) == member.__name__]
    for value in own:
        function = getattr(value, "py_func", value)
        if (inspect.isclass(function) or inspect.isfunction(function)) and not function.__name__.startswith("_"):
            assert inspect.getdoc(function), f"{member.__name__}.{function.__name__}"


@pytest.mark.parametrize(("name", "declared"), DECLARED)
def test_a_parameter_is_declared_with_unit_range_and_help(name, declared):
    assert len(declared.description) > 3
    if declared.kind not in {int, float}:
        return
    assert declared.unit
    assert declared.minimum is not None, "no minimum"
    assert declared.maximum is not None, "no maximum"
    assert declared.default is not None
    assert declared.minimum <= declared.default <= declared.maximum
    assert isinstance(declared.default, declared.kind)


@pytest.mark.parametrize("kind", FAMILIES)
def test_parameters_survive_a_round_trip(kind):
    for name in FAMILIES[kind].names():
        parameters = FAMILIES[kind].load(name).Parameters
        needed = {"points": [(0.0, 1.0), (1.0, 2.0)], "blocks": [{"block": "dwell", "time": 1.0}]}
        values = {key: value for key, value in needed.items() if key in parameters._fields}
        p = parse(parameters, values, name)
        assert parse(parameters, p._asdict(), name) == p


@pytest.mark.parametrize("kind", FAMILIES)
@pytest.mark.parametrize("name", ["", "base", "no_such_one", "__init__", "../../os", 3, None, 1.5, True, ["sine"], {"a": 1}])
def test_an_unknown_name_is_bad_input_that_lists_the_known(kind, name):
    with pytest.raises(BadInput) as caught:
        FAMILIES[kind].load(name, "spec.yaml: section")
    assert repr(name) in caught.value.what
    assert caught.value.where == "spec.yaml: section"
    assert all(known in caught.value.expected for known in FAMILIES[kind].names())


@pytest.mark.parametrize("name", CONTROLLERS.names())
def test_a_controller_has_its_parts(name):
    member = CONTROLLERS.load(name)
    assert isinstance(member.FRICTION, bool)
    assert member.FOLLOWS in {"force", "position"}
    assert set(member.NEEDS) < set(SENSED)
    memory = member.memory(member.Parameters())
    assert memory.dtype == np.float64
    assert np.all(np.isfinite(memory))
    assert memory is not member.memory(member.Parameters())
    assert list(inspect.signature(member.step.py_func).parameters) == ["m", "r", "f", "p", "model", "memory", "status"]


@pytest.mark.parametrize("name", COMPANIONS.names())
def test_a_companion_has_its_parts(rig, name):
    member = COMPANIONS.load(name)
    assert isinstance(member.ACTUATOR, bool)
    law = CONTROLLERS.load("fasmc_predictive")
    model = model_of(rig, 1e-3)
    companion = member.build(member.Parameters(), Setting(law, law.Parameters(), model, "force"))
    place, rows, actuator = np.full((5, PLACE), np.nan), np.full((5, FOLLOWED), np.nan), np.full((5, 3), np.nan)
    rows[:, :3] = 0.0
    assert 1 <= companion.room(0, place) <= 5
    companion.ahead(Upcoming(0, rows[:1], place[:1], actuator[:1]))
    assert np.isfinite(rows[:, :3]).all()
    nothing = np.zeros((1, 3)), place[:1], np.zeros((1, len(SENSED))), np.zeros(1), np.zeros((1, STATUS_SIZE))
    assert isinstance(companion.done(Past(0, rows[:1], *nothing), model), Model)
    companion.interrupt()
    assert all(isinstance(value, float | str) for value in companion.report().values())
    kept = companion.kept()
    assert not kept.parts
    companion.recall(kept)


@pytest.mark.parametrize("name", OBSERVERS.names())
def test_an_observer_has_its_parts(rig, name):
    member = OBSERVERS.load(name)
    state = member.state(rig.friction_law, rig.friction)
    assert state.estimate.size == 2 + 2 * state.forces.size
    assert not np.any(state.estimate)
    assert list(inspect.signature(member.updater(rig.friction_law).py_func).parameters) == [
        "velocity",
        "period",
        "friction",
        "p",
        "state",
    ]


@pytest.mark.parametrize("name", DISTURBANCES.names())
def test_a_disturbance_has_its_parts(rig, name):
    member = DISTURBANCES.load(name)
    assert isinstance(member.REACTS, bool)
    p = member.Parameters()
    for use in member.loader_effects(p):
        assert use.name in EFFECTS.names()
        parse(EFFECTS.load(use.name).Parameters, use.parameters._asdict(), name)
    sine = REFERENCES.load("sine")
    signal = SampledReference(sine, sine.Parameters(amplitude=0.01, frequency=1.0), 1e-3)
    rows = member.build(p, signal, rig, 1e-3).rows(0, 21)
    assert rows.shape == (21, ROW)
    assert np.all(np.isfinite(rows))
    assert hasattr(member, "servo") == member.REACTS
    if member.REACTS:
        servo = member.servo(p, rig, 0.01)
        assert servo.start == 0.01
        assert servo.rig.friction_model == rig.friction_model
        assert not servo.rig.effects


@pytest.mark.parametrize("name", DISTURBANCES.names())
@pytest.mark.parametrize("first", [0, 1, SampledReference.BLOCK - 3])
def test_rows_on_end_are_bit_for_bit_those_one_by_one(rig, name, first):
    member, chirp = DISTURBANCES.load(name), REFERENCES.load("chirp")

    def source() -> Any:
        signal = SampledReference(chirp, chirp.Parameters(amplitude=5e3, offset=100.0), 1e-3)
        return member.build(member.Parameters(), signal, rig, 1e-3)

    one_by_one = source()
    rows = source().rows(first, 1100)
    assert rows.shape == (1100, ROW)
    assert np.max(np.ptp(rows, axis=0)) > 1e3
    assert rows.tobytes() == np.concatenate([one_by_one.rows(k, 1) for k in range(first, first + 1100)]).tobytes()


def test_a_force_is_its_signal(rig):
    member, sine = DISTURBANCES.load("force"), REFERENCES.load("sine")
    signal = SampledReference(sine, sine.Parameters(amplitude=5e3, frequency=1.0), 1e-3)
    rows = member.build(member.Parameters(), signal, rig, 1e-3).rows(0, 251)
    assert rows[0, 0] == 0.0
    assert rows[250, 0] == pytest.approx(5e3)
    assert rows[250, 1] == pytest.approx(0.0, abs=1e-8)
    assert rows[125, 1] == pytest.approx(5e3 * 2.0 * math.pi * math.cos(math.pi / 4.0))
    assert not np.any(rows[:, 2:])
