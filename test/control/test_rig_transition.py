"""A running controller changes to an accepted rig no further and no faster than adaptation may, or refuses it by name."""

import math
import re

import numpy as np
import pytest
from test_controller import PERIOD, Bench, make, measure

from ehls_ros.control.adaptation.reach import sizes
from ehls_ros.control.adaptation.transition import Transition, with_own_sensors
from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.controller import ADAPTATION_LIMITS, Controller
from ehls_ros.control.controllers.base import model_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.effects import command_delay
from ehls_ros.physics.friction import stribeck
from ehls_ros.physics.rig import UNKNOWN, EffectUse
from ehls_ros.schema import parse

MEASURED = np.array([0.01, 0.02, 1e6, 1e-4, 2600.0, 7e6, 313.0])
REFERENCE, FRICTION = np.array([5e3, 1e3, 0.0]), np.array([300.0, 145.0])


def known(rig, **plant):
    """Return the model of a rig with other coefficients of the plant."""
    return model_of(rig._replace(plant=rig.plant._replace(**plant)), PERIOD)


def scaled(model, part, name, factor):
    values = getattr(model, part)
    value = getattr(values, name)
    new = tuple(factor * each for each in value) if isinstance(value, tuple) else factor * value
    return model._replace(**{part: values._replace(**{name: new})})


def transition(original, wanted, present=None):
    return Transition(original, present or original, with_own_sensors(original, wanted), ADAPTATION_LIMITS)


def test_a_piston_area_of_ten_times_is_refused_by_name_and_changes_nothing(rig):
    law, other = make(rig, "sic"), make(rig, "sic")
    words = "piston_area goes from 0.0026 to 0.026; expected a change of at most 0.00078, 30 % in all"
    with pytest.raises(BadInput, match=re.escape(words)):
        law.accept(known(rig, piston_area=10.0 * rig.plant.piston_area))
    for _ in range(50):
        assert law.step(MEASURED, REFERENCE, FRICTION) == other.step(MEASURED, REFERENCE, FRICTION)
    assert law.model == other.model


SINGLE_ROD = load_rig(configured("rig_single_rod"))

COEFFICIENTS = (
    *(("plant", name) for name in ("piston_area", "moving_mass", "bulk_modulus", "valve_gain", "gravity")),
    *(("friction", name) for name in ("coulomb_force", "viscous_coefficient", "element_stiffness", "attraction_rate")),
    *(("cylinder", name) for name in ("area_a", "volume_b")),
    ("valve", "gain_pb"),
)


@pytest.mark.parametrize(("part", "name"), COEFFICIENTS)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_each_coefficient_moves_by_30_percent_at_most_and_by_20_percent_a_second(rig, part, name, side):
    original = model_of(SINGLE_ROD if part in ("cylinder", "valve") else rig, PERIOD)
    within, beyond = (scaled(original, part, name, 1.0 + side * change) for change in (0.3, 0.301))
    with pytest.raises(BadInput, match=f"{name}.* goes from"):
        transition(original, beyond)
    way = transition(original, within)
    assert way.duration == pytest.approx(1.5)
    seen = [original, *(way.after(PERIOD) for _ in range(1501))]
    values = np.array([np.ravel(getattr(getattr(model, part), name)) for model in seen])
    assert np.all(np.abs(np.diff(values, axis=0)) <= 0.2 * PERIOD * values[0] * (1.0 + 1e-9))
    assert way.complete
    assert seen[-1] == within
    assert seen[750] != within


def test_a_random_rig_within_reach_is_reached_exactly_and_what_both_rigs_have_in_common_holds_on_the_way(rig):
    random = np.random.default_rng(11)
    original = model_of(rig, PERIOD)
    weights = np.array(original.friction.element_weight)
    for _ in range(20):
        shift = 0.25 * min(weights) * random.uniform(-1.0, 1.0)
        other = tuple((weights + shift * np.array([1.0, -1.0, *[0.0] * (len(weights) - 2)])).tolist())
        plant = original.plant._make(value * random.uniform(0.75, 1.25) for value in original.plant)
        wanted = original._replace(plant=plant, friction=original.friction._replace(element_weight=other))
        way = transition(original, wanted)
        assert 0.0 < way.duration <= 1.25
        while not way.complete:
            model = way.after(0.1)
            assert sum(model.friction.element_weight) == pytest.approx(1.0, abs=1e-12)
            assert type(model.plant.moving_mass) is float
        assert model == wanted


def test_a_second_accepted_rig_counts_from_the_one_in_use_and_may_not_add_up(rig):
    law = make(rig, "sic")
    area = rig.plant.piston_area
    law.accept(known(rig, piston_area=1.3 * area))
    for _ in range(500):
        law.step(MEASURED, REFERENCE, FRICTION)
    assert law.model.plant.piston_area == pytest.approx(1.1 * area)
    with pytest.raises(BadInput, match="piston_area"):
        law.accept(known(rig, piston_area=1.35 * area))
    assert law.accept(known(rig, piston_area=area)) == pytest.approx(0.5)
    law.step(MEASURED, REFERENCE, FRICTION, 499)
    assert law.model.plant.piston_area == pytest.approx(1.0002 * area)
    law.step(MEASURED, REFERENCE, FRICTION, 2)
    assert law.model == model_of(rig, PERIOD)


@pytest.mark.parametrize(("delay", "accepted"), [(PERIOD, True), (1.5 * PERIOD, False)])
def test_a_rig_without_a_delay_may_get_one_of_a_cycle(rig, delay, accepted):
    slow = rig._replace(effects=(EffectUse("command_delay", parse(command_delay.Parameters, {"delay": delay}, "test")),))
    original, wanted = model_of(rig, PERIOD), model_of(slow, PERIOD)
    assert original.command_delay == 0.0
    if not accepted:
        with pytest.raises(BadInput, match=re.escape("command_delay goes from 0 to 0.0015")):
            transition(original, wanted)
    else:
        way = transition(original, wanted)
        assert way.after(way.duration) == wanted


def test_a_rig_of_another_kind_is_refused(rig):
    original = model_of(rig, PERIOD)
    friction = original.friction
    values = {name: getattr(friction, name) for name in stribeck.Parameters._fields if name in friction._fields}
    fewer = friction._replace(element_stiffness=friction.element_stiffness[:2], element_weight=friction.element_weight[:2])
    for wanted, words in (
        (original._replace(friction=stribeck.Parameters(**values)), "the friction model is stribeck; expected gms"),
        (model_of(SINGLE_ROD, PERIOD), "it has another kind of cylinder"),
        (original._replace(friction=fewer), "element_stiffness has 2 values"),
        (original._replace(spool_limit=2.0 * original.spool_limit), "spool is 0.02"),
        (known(rig, piston_area=UNKNOWN), "piston_area goes from 0.0026 to unknown"),
        (known(rig, leakage_coefficient=0.0), "leakage_coefficient goes from"),
    ):
        with pytest.raises(BadInput, match=words):
            transition(original, wanted)
    unknown = known(rig, moving_mass=UNKNOWN)
    assert transition(unknown, unknown).duration == 0.0
    with pytest.raises(BadInput, match="moving_mass goes from unknown to 70; expected no change"):
        transition(unknown, known(rig, moving_mass=70.0))


def test_beside_a_companion_that_corrects_the_model_no_rig_is_accepted(rig):
    class Correcting:
        corrects = True

        def prepare(self):
            pass

        def interrupt(self):
            pass

    law = make(rig, "sic")
    law.companions = CompanionChain({"any": Correcting()})
    with pytest.raises(BadInput, match="a companion corrects the model"):
        law.accept(model_of(rig, PERIOD))


def test_an_accepted_rig_makes_no_bump_and_nothing_of_the_change_is_left_after_it(rig):
    law = make(rig)
    bench = Bench(rig, law)
    commands = [bench.step()[2] for _ in range(2310)]
    before = np.max(np.abs(np.diff(commands[1500:])))
    wanted = known(rig, discharge_coefficient=1.1 * rig.plant.discharge_coefficient)
    assert law.accept(wanted) == pytest.approx(0.5)
    after = [commands[-1], *(bench.step()[2] for _ in range(1100))]
    assert np.max(np.abs(np.diff(after))) <= 1.1 * before
    assert law.model == wanted
    fresh = Controller("fasmc", law.parameters, wanted)
    fresh._memory = law._memory.copy()
    reading = measure(rig, bench.simulator)
    friction = bench.estimator.state.estimate
    assert law.step(reading, REFERENCE, friction) == pytest.approx(fresh.step(reading, REFERENCE, friction), abs=1e-11)
    assert math.isfinite(law.step(reading, REFERENCE, friction))


def test_a_coefficient_that_may_be_about_zero_moves_by_a_share_of_its_size(rig):
    own = model_of(rig, PERIOD)
    size = sizes(own, rig.limits)["leakage_coefficient"]
    leaky = known(rig, leakage_coefficient=rig.plant.leakage_coefficient + 0.2 * size)
    with pytest.raises(BadInput, match="leakage_coefficient goes from"):
        make(rig, "sic").accept(leaky)
    assert make(rig, "sic").accept(leaky, sizes(own, rig.limits)) == pytest.approx(0.2 / ADAPTATION_LIMITS.rate)
