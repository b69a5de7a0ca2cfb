"""Blocks of a recording: what they say of a rig whose coefficients are not those of its model, and of one where they are."""

import numpy as np
import pytest

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.monitoring.blocks import scores, telling
from ehls_ros.diagnosis.monitoring.directions import directions
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, readings, tracked
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.trajectory import Trajectory

SECONDS = 20.0
WANTED = {(c.effect, c.parameter) for c in COEFFICIENTS.values()}


def compared(rig, recording, begin=0.0, end=SECONDS) -> Evidence:
    part = slice(*np.searchsorted(recording.time, [begin, end]))
    time = recording.time[part] - recording.time[part][0]
    trajectory = Trajectory(time, {name: values[part] for name, values in recording.columns.items()})
    prepared = prepare(trajectory, rig, "test")
    return gather(prepared, rig, setup(prepared, rig), 0, rules.MONITOR_REALISATIONS)


@pytest.fixture(scope="module")
def leaking(recorded):
    return recorded({"internal_leakage_shift": {"factor": 1.3}}, "rich", seed=5, duration=SECONDS)


def fitted(rig, recording):
    evidence = telling(compared(rig, recording))
    found = directions(evidence, WANTED)
    numbers = tracked(found)
    block = scores(evidence, found, tuple(numbers.values()))
    rows = list(numbers.values())
    return {r.name: r for r in readings(found, numbers, rig, block.score[rows], block.normal, np.full(len(rows), 1.5))}


def test_the_coefficient_that_differs_is_read_with_its_interval_and_the_others_stay(rig, leaking):
    told = fitted(rig, leaking)
    leakage = told.pop("leakage_coefficient")
    assert leakage.told
    assert abs(leakage.value - 1.3 * rig.plant.leakage_coefficient) < 4.0 * leakage.deviation
    assert leakage.deviation < 0.02 * rig.plant.leakage_coefficient
    for name, reading in told.items():
        given = COEFFICIENTS[name].given(rig)
        assert not reading.told or abs(reading.value - given) < 4.5 * reading.deviation, name
    assert told["bulk_modulus"].told
    assert told["coulomb_force"].told


def test_a_programme_that_holds_the_piston_still_tells_no_mass(rig, recorded):
    told = fitted(rig, recorded({}, "rest", seed=6, duration=SECONDS))
    assert not told["moving_mass"].told
    assert told["moving_mass"].value == rig.plant.moving_mass
    assert told["moving_mass"].why_not


def test_the_scores_of_blocks_add_up_to_that_of_the_whole(rig, leaking):
    """But for the windows across their borders, and the lead of each."""
    whole = compared(rig, leaking)
    found = directions(whole, WANTED)
    number = next(n for n, d in enumerate(found) if d.name == "internal_leakage_shift")
    parts = [scores(compared(rig, leaking, b, b + 5.0), found) for b in np.arange(0.0, SECONDS, 5.0)]
    together = sum(p.score[number] for p in parts) / sum(p.information[number] for p in parts)
    alone = scores(whole, found)
    assert together == pytest.approx(alone.score[number] / alone.information[number], rel=0.05)
