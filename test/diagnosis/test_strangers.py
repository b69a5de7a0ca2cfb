"""The exam of strangers: its judge on hand-made answers, and the independence and accuracy of its generator."""

import ast
import inspect

import numpy as np
import pytest

from benchmarks.strangers import generator
from benchmarks.strangers.judge import judge, reading, unchanged


def row(kind, size, **modes):
    return {"kind": kind, "size": size, "number": 0, "sources": "x", "signals": ["spool_m"], **modes}


def identified(**values):
    names = {"leakage": "plant.leakage_coefficient", "mass": "plant.moving_mass", "null": "effects.valve_null_bias.command"}
    estimates = {names[name]: estimate for name, estimate in values.items()}
    return {"estimates": estimates, "absent": {}, "not_identifiable": {}}


def named(name, parameter, value, std, equivalent_to=()):
    cause = {"name": name, "probability": 0.9, "equivalent_to": list(equivalent_to), "parameters": {parameter: [value, std]}}
    return {"verdict": "effect", "unknown_stage": None, "causes": [cause], "power": {name: [parameter, 1e-12]}}


NOTHING = {"verdict": "consistent", "unknown_stage": None, "causes": [], "power": {"internal_leakage_shift": ["added", 2e-12]}}


def test_the_size_told_by_two_identifications_is_their_difference_with_both_errors():
    before, after = identified(leakage=[1e-12, 3e-14], mass=[100.0, 1.0]), identified(leakage=[3e-12, 4e-14], mass=[101.0, 1.0])
    answers = row("leakage", 2.05e-12, identify={"before": before, "after": after})
    j = judge(answers, "identify")
    assert j.verdict == "right"
    assert j.size.value == pytest.approx(2e-12)
    assert j.size.std == pytest.approx(5e-14)
    assert j.size.sigmas == pytest.approx(1.0)
    [(path, sigmas)] = unchanged(answers)
    assert path == "plant.moving_mass"
    assert sigmas == pytest.approx(0.01 / (1.01 * np.hypot(1 / 100, 1 / 101)))


def test_a_difference_of_another_coefficient_is_wrong_and_one_of_a_healthy_rig_a_false_alarm():
    before, after = identified(leakage=[1e-12, 3e-14], mass=[100.0, 1.0]), identified(leakage=[1e-12, 4e-14], mass=[120.0, 1.0])
    assert judge(row("leakage", 2e-12, identify={"before": before, "after": after}), "identify").verdict == "wrong"
    assert judge(row("", 0.0, identify={"before": before, "after": after}), "identify").verdict == "false alarm"
    assert judge(row("", 0.0, identify={"before": before, "after": before}), "identify").verdict == "quiet"


def test_an_equivalent_name_is_right_but_tells_no_size():
    other = named("external_leakage", "first", 2e-12, 1e-13, equivalent_to=["internal_leakage_shift"])
    j = judge(row("leakage", 2e-12, baseline=other), "baseline")
    assert j.verdict == "right"
    assert j.size is None
    wrong = named("external_leakage", "first", 2e-12, 1e-13)
    assert judge(row("leakage", 2e-12, baseline=wrong), "baseline").verdict == "wrong"


def test_a_factor_is_judged_by_its_distance_from_one():
    j = judge(row("bulk_modulus", -0.2, alone=named("bulk_modulus_shift", "factor", 0.79, 0.005)), "alone")
    assert j.verdict == "right"
    assert j.size.error == pytest.approx(0.05)
    assert j.size.sigmas == pytest.approx(2.0)


def test_a_change_that_is_missed_is_excused_below_the_size_that_would_have_been_seen():
    assert judge(row("leakage", 1e-12, baseline=NOTHING), "baseline")[:2] == ("missed", False)
    assert judge(row("leakage", 3e-12, baseline=NOTHING), "baseline")[:2] == ("missed", True)
    assert judge(row("", 0.0, baseline=NOTHING), "baseline").verdict == "quiet"


def test_the_monitors_reading_is_the_change_since_the_rig_as_identified():
    monitor = {"readings": {"moving_mass": [110.0, 1.1, ""]}, "changes": []}
    answers = row("mass", 0.1, identify={"before": identified(mass=[100.0, 1.0])}, monitor=monitor)
    assert reading(answers).value == pytest.approx(0.1)
    assert judge(answers, "monitor").verdict == "missed"
    untold = {"readings": {"moving_mass": [110.0, None, "not excited by the programme"]}, "changes": []}
    assert reading(answers | {"monitor": untold}) is None


def test_the_generator_imports_nothing_of_the_package_nor_of_its_truth_generator():
    tree = ast.parse(inspect.getsource(generator))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported == {"math", "numba", "numpy", "numpy.typing", "typing", "collections.abc"}


def test_a_quarter_of_the_strangers_is_healthy_and_all_changes_take_turns():
    kinds = [generator.kind_of(7, number) for number in range(44)]
    assert kinds.count("") == 11
    assert sorted(kind for kind in kinds if kind) == sorted(3 * generator.KINDS)


@pytest.mark.long
def test_half_the_step_changes_a_recording_by_less_than_its_noise():
    stranger = generator.draw(36, 1)
    assert generator.LAWS[stranger.rig.law] == "LuGre"
    coarse, fine = (generator.simulate(stranger, stranger.rig, 0, 10.0, step) for step in (generator.STEP, generator.STEP / 2))
    noise = np.maximum(stranger.sensors.noise, stranger.sensors.resolution)
    recorded = noise > 0.0
    apart = np.sqrt(np.mean((coarse.readings - fine.readings) ** 2, axis=0))
    assert np.all(apart[recorded] < 0.1 * noise[recorded])
