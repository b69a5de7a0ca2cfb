"""The exams' judge on hand-made results, and the draws of the cases."""

import io
import sys
import types

import numpy as np
import pytest
from rich.console import Console

from benchmarks.diagnosis import tables
from benchmarks.diagnosis.cases import Case, effect_of, healthy_of, recording_of, rig, rig_file
from benchmarks.diagnosis.exams import EXAMS, JITTER, numbers
from benchmarks.diagnosis.judge import below_power, closed_off, judge, peer_right
from benchmarks.diagnosis.running import diagnose_case
from truth_generator import LISTED, Day, FormErrors, Measurement, listed_of
from truth_generator.effects import STAGES


def cause(name, probability=0.99, equivalent_to=()):
    return {
        "name": name, "probability": probability, "equivalent_to": list(equivalent_to), "stage": "force_balance",
        "parameters": {}, "fixed": {}, "gain": 10.0, "sigmas": 5.0, "rivals": [],
    }  # fmt: skip


def row(hidden, causes, verdict="effect", exam="clean", kind=None, share=None, closed=0.9):
    return {
        "exam": exam, "seed": 1, "number": 0, "kind": kind or ("nothing", "singles", "pairs")[len(hidden)], "sources": "x",
        "experiment": "rich", "hidden": {name: {} for name in hidden}, "natural": {}, "near": {}, "share": share, "redrawn": 0,
        "visibility": {name: {"force_balance": 9.0} for name in hidden}, "appears_in": dict.fromkeys(hidden, "force_balance"),
        "ours": {
            "verdict": verdict, "causes": causes, "partial": [], "unknown_stage": "force_balance", "stages": {}, "wall_s": 1.0,
            "gain": {"closed_fraction": closed, "ci95": [closed - 0.1, closed + 0.1]}, "missing": [],
        },
    }  # fmt: skip


def test_a_cause_that_is_not_there_beside_the_true_one_is_wrong():
    j = judge(row(["mass_shift"], [cause("mass_shift"), cause("constant_load")]))
    assert j.first
    assert not j.right
    assert not j.lenient
    assert j.not_there == ("constant_load",)
    assert j.confident_wrong
    alone = judge(row(["mass_shift"], [cause("mass_shift")]))
    assert alone.right
    assert alone.exact
    assert alone.not_there == ()


def test_a_pair_with_a_third_cause_is_wrong_and_one_with_both_is_right():
    hidden = ["coulomb_shift", "mass_shift"]
    both = [cause("mass_shift"), cause("coulomb_shift")]
    assert judge(row(hidden, both)).right
    more = judge(row(hidden, [*both, cause("constant_load", 0.5)]))
    assert more.first
    assert not more.right
    assert more.not_there == ("constant_load",)
    assert not more.confident_wrong
    assert not judge(row(hidden, both[:1])).right


@pytest.mark.parametrize(
    ("named", "detectable", "rightly"),
    [(["mass_shift"], 5.0, True), (["mass_shift"], 1.0, False), (["constant_load"], 5.0, False), ([], 5.0, False)],
)
def test_a_missed_effect_counts_as_too_small_if_the_answer_says_so_and_names_nothing_wrong(named, detectable, rightly):
    answer = row(["mass_shift", "valve_null_bias"], [cause(name) for name in named])
    answer["natural"] = {"mass_shift": {"factor": 1.5}, "valve_null_bias": {"bias": 2e-6, "site": "ports"}}
    answer["ours"]["sensitivities"] = [("mass_shift", "factor", 0.1), ("valve_null_bias", "opening", detectable * 1e-6)]
    assert below_power(answer) is rightly


def test_an_effect_in_a_stage_that_is_not_judged_is_rightly_not_named():
    answer = row(["mass_shift"], [], verdict="insufficient")
    assert not below_power(answer)
    answer["ours"]["missing"] = ["force_balance: no baseline has its signals"]
    assert below_power(answer)
    answer["visibility"]["mass_shift"]["flow"] = 5.0
    assert not below_power(answer)


def test_not_to_judge_a_healthy_recording_is_no_alarm():
    verdicts = {verdict: judge(row([], [], verdict=verdict)) for verdict in ("consistent", "insufficient", "unknown")}
    assert {verdict: (j.right, j.lenient) for verdict, j in verdicts.items()} == {
        "consistent": (True, True), "insufficient": (False, True), "unknown": (False, False),
    }  # fmt: skip


def test_a_second_name_for_the_same_cause_is_one_too_many():
    twice = judge(row(["mass_shift"], [cause("mass_shift"), cause("flexible_mode", equivalent_to=["mass_shift"])]))
    assert twice.not_there == ("flexible_mode",)
    assert judge(row(["mass_shift"], [cause("flexible_mode", equivalent_to=["mass_shift"])])).right
    hidden = ["flexible_mode", "mass_shift"]
    assert judge(row(hidden, [cause("mass_shift", equivalent_to=["flexible_mode"]), cause("flexible_mode")])).right


def test_the_side_is_judged_beside_the_name():
    hidden = row(["edge_gain"], [cause("mass_shift"), cause("edge_gain") | {"side": "b"}])
    hidden["hidden"]["edge_gain"] = {"factor": 1.1, "edge": "bt", "side": "b"}
    assert judge(hidden).sides == (True,)
    hidden["ours"]["causes"] = [cause("edge_wear", equivalent_to=["edge_gain"]) | {"side": "a"}]
    assert judge(hidden).right
    assert judge(hidden).sides == (False,)
    hidden["ours"]["causes"] = [cause("mass_shift")]
    assert judge(hidden).sides == ()
    # The side of an end stop is a direction.
    stop = row(["end_stop"], [cause("end_stop")])
    stop["hidden"]["end_stop"] = {"position": -0.03, "stiffness": 1e5, "side": -1.0}
    assert judge(stop).sides == ()


def test_a_recording_with_swapped_sensors_is_to_be_refused_for_that_reason():
    refused = row(["swapped_pressure_sensors"], [])
    del refused["ours"]
    assert judge(refused | {"refused": "pressure_a_pa and pressure_b_pa are swapped"}).right
    assert judge(refused | {"refused": "pressure_a_pa: no reading"}).what == "error"
    assert not judge(refused | {"hidden": {"mass_shift": {}}, "refused": "the columns are swapped"}).right
    assert not judge(row(["swapped_pressure_sensors"], [cause("pressure_sensor_bias")])).right


def test_wrong_names_alone_are_wrong_but_nothing_beside_a_true_one():
    j = judge(row(["mass_shift"], [cause("constant_load")]))
    assert not j.right
    assert j.not_there == ()
    assert j.confident_wrong
    assert not judge(row(["mass_shift"], [cause("constant_load"), cause("mass_shift")])).first


@pytest.mark.parametrize("exam", EXAMS)
@pytest.mark.parametrize("verdict", ["unknown", "consistent", "insufficient"])
def test_no_name_is_never_right_when_something_is_hidden(exam, verdict):
    j = judge(row(["mass_shift"], [], verdict, exam))
    assert not j.right
    assert not j.lenient
    assert not j.first


@pytest.mark.parametrize("exam", EXAMS)
def test_a_partial_answer_counts_by_its_names(exam):
    assert judge(row(["mass_shift"], [cause("mass_shift")], "partial", exam)).right
    assert not judge(row([], [cause("mass_shift")], "partial", exam)).right
    assert judge(row([], [], "consistent", exam)).right


def test_the_closed_share_is_compared_with_the_true_one_where_the_name_is_right():
    right = row(["mass_shift"], [cause("mass_shift")], "partial", "partial", share=0.75, closed=0.8)
    assert closed_off(right) == pytest.approx(0.05)
    assert closed_off(row(["mass_shift"], [cause("constant_load")], "partial", "partial", share=0.75)) is None
    assert closed_off(row(["mass_shift"], [cause("mass_shift")])) is None


def test_peers_are_judged_by_the_same_rule():
    single = row(["mass_shift"], [])
    assert peer_right(single, ["flexible_mode|mass_shift"])
    assert not peer_right(single, ["mass_shift", "constant_load"])
    assert not peer_right(single, [])
    pair = row(["coulomb_shift", "mass_shift"], [])
    assert peer_right(pair, ["mass_shift", "coulomb_shift"])
    assert not peer_right(pair, ["mass_shift|coulomb_shift"])
    assert peer_right(row([], []), [])


@pytest.mark.parametrize("exam", EXAMS)
def test_every_exam_has_its_tables(exam):
    rows = [row(["mass_shift"], [cause("mass_shift"), cause("constant_load")], exam=exam, share=0.9)]
    rows += [row([], [], "consistent", exam)] if "nothing" in EXAMS[exam].kinds else []
    text = io.StringIO()
    tables.show(rows, Console(file=text, width=220))
    line = next(line for line in text.getvalue().splitlines() if "a true cause and one that is not there" in line)
    assert "100.0 % (1/1)" in line
    line = next(line for line in text.getvalue().splitlines() if "right cause first, no other" in line)
    assert "0.0 % (0/1)" in line


def test_the_skew_exam_has_every_experiment_with_and_without_disturbance_and_effect():
    cases = [EXAMS["skew"].make(3, number, 2.0) for number in range(1, 16, 2)]
    assert {(case.experiment, case.disturbed) for case in cases} == {
        (name, d) for name in ("rich", "random", "steps", "paper_sine") for d in (True, False)
    }
    for case in cases:
        assert not case.hidden
        assert case.measurement.jitter == JITTER
        assert set(case.measurement.skew) == set(recording_of(case).columns)
    assert EXAMS["skew"].kind_of(0) == "singles"


def test_a_case_hides_what_stands_out_of_the_form_errors_of_its_rig():
    case = EXAMS["partial"].make(7, 1, 6.0)
    (name,) = case.hidden
    assert max(case.visibility[name].values()) >= 2.0
    assert 0.0 < case.share < 1.0
    assert all(size > 0.001 for size in case.forms.sizes.values())
    assert recording_of(case).truth["forms"].keys() == case.forms.sizes.keys()


def test_a_baseline_case_is_diagnosed_against_its_healthy_recordings(monkeypatch):
    forms = FormErrors({"warm_valve": 0.05, "warm_rate": 3.0}, dict.fromkeys(STAGES, ()), dict.fromkeys(STAGES, 0.01))
    case = Case(
        1, 4, "singles", "rich", 9, 1.0, {"mass_shift": {"factor": 1.3}}, {}, 0, "baseline", forms=forms,
        measurement=Measurement(jitter=0.05), healthy=(("random", 5), ("rich", 6)), days=(Day(1.0), Day(1.1), Day(0.9)),
    )  # fmt: skip
    given = {}

    def diagnose_against(new, baselines, rig, name, *, seed, threads):
        given.update(new=new, baselines=baselines, rig=rig, name=name, seed=seed, threads=threads)
        return "diagnosis"

    stub = types.ModuleType("ehls_ros.experiments.baseline")
    monkeypatch.setattr(stub, "diagnose_against", diagnose_against, raising=False)
    monkeypatch.setitem(sys.modules, stub.__name__, stub)
    assert diagnose_case(case) == "diagnosis"
    assert (given["seed"], given["threads"], given["rig"]) == (4, 1, rig())
    assert len(given["new"]) == 1000
    assert np.array_equal(given["new"]["position_m"], recording_of(case).columns["position_m"])
    truths = [recording_of(case).truth, *(r.truth for r in healthy_of(case))]
    assert [list(truth["effects"]) for truth in truths] == [["mass_shift"], [], []]
    assert [truth["experiment"] for truth in truths] == ["rich", "random", "rich"]
    assert all(truth["forms"].keys() == set(STAGES) for truth in truths)
    assert [len(b) for b in given["baselines"]] == [1000, 1000]
    assert not np.array_equal(given["baselines"][0]["force_n"], given["baselines"][1]["force_n"])


@pytest.mark.parametrize("exam", ["single_rod clean", "single_rod partial", "single_rod baseline"])
def test_an_exam_on_the_single_rod_hides_its_effects(exam):
    case = EXAMS[exam].make(7, 0, 5.0)
    assert (case.rig, case.exam) == ("single_rod", exam)
    assert set(case.hidden) <= set(listed_of(rig_file("single_rod")))
    assert all(max(stages.values()) >= 1.3 for stages in case.visibility.values())
    for recording in (recording_of(case), *healthy_of(case)):
        assert {"pressure_a_pa", "pressure_b_pa"} <= set(recording.columns)


def test_in_turn_one_chamber_or_both_are_missing_and_no_fault_of_their_sensors_is_hidden(monkeypatch):
    given = []
    monkeypatch.setattr("benchmarks.diagnosis.running.diagnose", lambda new, *_, **__: given.append(set(new.signals)))
    for number in range(2):
        case = EXAMS["single_rod one_pressure"].make(7, number, 5.0)
        assert not {"pressure_sensor_bias", "pressure_sensor_gain", "swapped_pressure_sensors"} & set(case.hidden)
        diagnose_case(case)
    pressures = {"pressure_a_pa", "pressure_b_pa", "load_pressure_pa"}
    assert [columns & pressures for columns in given] == [{"pressure_a_pa"}, {"load_pressure_pa"}]


def test_half_of_the_baseline_cases_change_nothing_and_each_effect_is_equally_often_hidden():
    assert numbers("baseline", 3, "nothing") == [1, 3, 5]
    assert numbers("clean", 2, "pairs") == [2, 10]
    once = [effect_of(5, turn) for turn in range(len(LISTED))]
    assert sorted(once) == sorted(LISTED)
    assert [effect_of(6, turn) for turn in range(len(LISTED))] != once
