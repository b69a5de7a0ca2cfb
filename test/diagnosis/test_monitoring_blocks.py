"""Blocks of a recording: estimates for a rig whose coefficients deviate from its model, and for one whose do not."""

import numpy as np
import pytest

from ehls_ros.diagnosis import rules, stages
from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.hypotheses import grown
from ehls_ros.diagnosis.monitoring.blocks import FRICTION, informative, scores
from ehls_ros.diagnosis.monitoring.directions import directions
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, MOVED, NOT_SEPARATE, WANTED, IdentifiedRig, readings, tracked
from ehls_ros.diagnosis.record import prepare
from ehls_ros.physics.rig import effects_from_list
from ehls_ros.trajectory import Trajectory

SECONDS = 20.0


def compared(rig, recording, begin=0.0, end=SECONDS) -> Evidence:
    part = slice(*np.searchsorted(recording.time, [begin, end]))
    time = recording.time[part] - recording.time[part][0]
    trajectory = Trajectory(time, {name: values[part] for name, values in recording.columns.items()})
    prepared = prepare(trajectory, rig, "test")
    return gather(prepared, rig, stages.setup(prepared, rig), 0, rules.MONITOR_REALISATIONS)


@pytest.fixture(scope="module")
def leaking(recorded):
    return recorded({"internal_leakage_shift": {"factor": 1.08}}, "rich", seed=5, duration=SECONDS)


def fitted(rig, recording):
    evidence = informative(compared(rig, recording))
    found = directions(evidence, WANTED)
    numbers = tracked(found)
    [block] = scores(evidence, found, tuple(numbers.values()), [0.0])
    scatter = np.full(len(numbers), 1.5)
    return {r.name: r for r in readings(found, numbers, IdentifiedRig(rig), [block], scatter)}


def test_the_coefficient_that_differs_is_read_with_its_interval_and_the_others_stay(rig, leaking):
    identified = fitted(rig, leaking)
    leakage = identified.pop("leakage_coefficient")
    assert leakage.identified
    assert abs(leakage.value - 1.08 * rig.plant.leakage_coefficient) < 4.0 * leakage.deviation
    assert leakage.deviation < 0.02 * rig.plant.leakage_coefficient
    for name, reading in identified.items():
        given = COEFFICIENTS[name].given(rig)
        assert not reading.identified or abs(reading.value - given) < 4.5 * reading.deviation, name
    assert identified["bulk_modulus"].identified
    assert identified["coulomb_force"].identified


def test_a_sensors_gain_is_read_only_once_its_effect_is_named(rig, leaking):
    assert fitted(rig, leaking)["pressure_sensor_gain"].why_not == NOT_SEPARATE
    named = rig.with_effects(effects_from_list([{"name": "pressure_sensor_gain", "gain": 1.0001}], "test"))
    gain = fitted(named, leaking)["pressure_sensor_gain"]
    assert gain.identified
    assert abs(gain.value - 1.0) < 4.5 * gain.deviation


def test_a_programme_that_holds_the_piston_still_tells_no_mass(rig, recorded):
    identified = fitted(rig, recorded({}, "rest", seed=6, duration=SECONDS))
    assert not identified["moving_mass"].identified
    assert identified["moving_mass"].value == rig.plant.moving_mass
    assert identified["moving_mass"].why_not


def test_blocks_together_say_what_the_whole_does(rig, leaking):
    whole = compared(rig, leaking)
    found = directions(whole, WANTED)
    number = next(n for n, d in enumerate(found) if d.name == "internal_leakage_shift")
    parts = scores(whole, found, (), [0.0, 5.0, 10.0, 15.0])
    [alone] = scores(whole, found, (), [0.0])
    together = sum(p.score[number] for p in parts) / sum(p.information[number] for p in parts)
    assert together == pytest.approx(alone.score[number] / alone.information[number], rel=0.02)


def test_what_leads_to_the_first_block_is_in_none(rig, leaking):
    whole = compared(rig, leaking)
    found = directions(whole, WANTED)[:3]
    later, [last] = scores(whole, found, (), [10.0, 15.0]), scores(whole, found, (), [15.0])
    assert later[1].score == pytest.approx(last.score)


def test_while_the_piston_is_held_the_force_balance_is_not_judged(rig, recorded):
    """The force that holds a stuck piston depends on micrometres that no sensor resolves."""
    assert FRICTION not in compared(rig, recorded({}, "rest", seed=6, duration=SECONDS)).channels


def test_a_coefficient_far_from_the_model_is_not_read_from_its_linearisation(rig, leaking):
    draft = rig.with_plant(bulk_modulus=1.5 * rig.plant.bulk_modulus)
    reading = fitted(draft, leaking)["bulk_modulus"]
    assert not reading.identified
    assert reading.why_not == MOVED
    assert reading.value == draft.plant.bulk_modulus


def test_a_departure_starts_from_the_present_state_of_an_effect(rig):
    present, more = effects_from_list(
        [{"name": "valve_null_bias", "command": -6e-6, "opening": 1e-6}, {"name": "valve_null_bias", "command": 2e-6}], "test"
    )
    [found] = grown(rig.with_effects((present,)), more).effects
    assert found.parameters == pytest.approx((-4e-6, 1e-6))
