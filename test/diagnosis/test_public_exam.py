"""The public exam of truth_generator: its cases, the form of its answers, and the points they get."""

import ast
import json
from pathlib import Path

import jsonschema
import pytest
from docs_snippets import ROOT

from ehls_ros.experiments.spec import load_rig
from ehls_ros.recording.load import load
from truth_generator import exam
from truth_generator.scoring import SCHEMA, checked, matched, points, score, wilson

DEAD_ZONE = {"kind": "singles", "hidden": {"valve_dead_zone": {}}, "stage": "flow", "near": []}
PAIR = {"kind": "pairs", "hidden": {"mass_shift": {}, "coulomb_shift": {}}, "stage": "force_balance", "near": []}
NOTHING = {"kind": "nothing", "hidden": {}, "stage": None, "near": []}
DRAG = {"kind": "outside", "hidden": {"quadratic_drag": {}}, "stage": "force_balance", "near": ["viscous_shift"]}


def effect(*names, probability=None):
    causes = [{"names": [name] if isinstance(name, str) else name} for name in names]
    return {
        "verdict": "effect",
        "causes": causes if probability is None else [{**c, "probability": probability} for c in causes],
    }


# Truth, answer, whether it is right, whether it is confidently wrong.
JUDGED = [
    (NOTHING, {"verdict": "consistent"}, True, False),
    (NOTHING, effect("mass_shift"), False, True),
    (NOTHING, effect("mass_shift", probability=0.6), False, False),
    (DEAD_ZONE, effect("valve_dead_zone"), True, False),
    (DEAD_ZONE, effect(["valve_null_bias", "valve_dead_zone"]), True, False),
    (DEAD_ZONE, effect("valve_dead_zone", "mass_shift"), False, True),
    (DEAD_ZONE, {"verdict": "unknown", "stage": "flow"}, False, False),
    (DEAD_ZONE, {"verdict": "consistent"}, False, False),
    (DEAD_ZONE, None, False, False),
    (PAIR, effect("coulomb_shift", "mass_shift"), True, False),
    (PAIR, effect("coulomb_shift"), False, False),
    (PAIR, effect("coulomb_shift", "viscous_shift", probability=0.95), False, True),
    (DRAG, {"verdict": "unknown", "stage": "force_balance"}, True, False),
    (DRAG, {"verdict": "unknown", "stage": "valve"}, False, False),
    (DRAG, effect("viscous_shift"), False, False),
    (DRAG, effect("mass_shift"), False, True),
]


@pytest.mark.parametrize(("truth", "answer", "right", "confident"), JUDGED)
def test_an_answer_gets_its_points(truth, answer, right, confident):
    got = points(answer, truth)
    assert (got.right, got.confident_wrong) == (right, confident)


def test_the_score_counts_by_kind_and_a_missing_answer_is_wrong():
    truth = {"a": NOTHING, "b": DEAD_ZONE, "c": DRAG, "d": DRAG}
    lines = {line.kind: line for line in score({"a": {"verdict": "consistent"}, "c": effect("mass_shift")}, truth)}
    assert [(lines[k].right, lines[k].cases) for k in ("nothing", "singles", "outside", "pairs")] == [
        (1, 1),
        (0, 1),
        (0, 2),
        (0, 0),
    ]
    assert (lines["all"].right, lines["all"].cases, lines["all"].confident_wrong) == (1, 4, 1)


def test_as_many_causes_as_possible_match():
    assert matched(["a", "b"], [{"a", "b"}, {"b"}], ["b", "a"]) == {0, 1}
    assert matched(["c"], [{"c"}], ["a"]) == set()


def test_the_interval_is_wilsons():
    # Wilson 1927: 8 of 10.
    assert wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=2e-4)


def test_the_schema_describes_the_answers_that_are_accepted():
    given = {"entrant": "ours", "exam": "1-7", "answers": {"case_0000": effect("mass_shift", probability=0.5)}}
    given["answers"]["case_0001"] = {"verdict": "unknown", "stage": "valve", "seconds": 3.5}
    jsonschema.validate(given, SCHEMA)
    assert checked(given) is given


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({"verdict": "perhaps"}, "verdict"),
        ({"verdict": "unknown", "stage": "pump"}, "stage is 'pump'"),
        (effect("quadratic_drag"), "listed effects"),
        (effect("mass_shift", probability=1.5), "probability is 1.5"),
        ({"verdict": "consistent", "why": ""}, "why is not part"),
    ],
)
def test_an_answer_of_another_form_is_refused_by_schema_and_scorer(answer, said):
    given = {"entrant": "ours", "exam": "1-7", "answers": {"case_0000": answer}}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(given, SCHEMA)
    with pytest.raises(ValueError, match=said):
        checked(given)


def test_an_exam_is_made_answered_and_scored(tmp_path, capsys):
    folder = tmp_path / "exam"
    assert exam.main(["make", str(folder), "--seed", "5", "--cases", "3", "--duration", "4"]) == 0
    places = sorted(path for path in folder.iterdir() if path.is_dir())
    assert [place.name for place in places] == ["case_0000", "case_0001", "case_0002"]
    recording = load(places[0] / "recording.csv")
    assert len(recording) == 4000
    assert "valve_command_m" in recording.signals
    load_rig(places[0] / "rig.yaml")
    about = json.loads((folder / "exam.json").read_text(encoding="utf-8"))
    assert not {"hidden", "truth"} & set(about)
    truth = exam.truth_of(folder)
    assert [entry["kind"] for entry in truth.values()] == ["singles", "outside", "pairs"]
    right = {name: effect(*entry["hidden"]) for name, entry in truth.items() if entry["kind"] != "outside"}
    path = tmp_path / "answers.json"
    path.write_text(json.dumps({"entrant": "an oracle", "exam": about["exam"], "answers": right}), encoding="utf-8")
    assert exam.main(["score", str(folder), str(path), "--json"]) == 0
    lines = {line["kind"]: line for line in json.loads(capsys.readouterr().out.splitlines()[-1])["score"]}
    assert (lines["all"]["right"], lines["all"]["cases"]) == (2, 3)
    assert exam.main(["make", str(folder), "--seed", "6", "--cases", "3"]) == 2
    path.write_text(json.dumps({"entrant": "late", "exam": "1-6", "answers": {}}), encoding="utf-8")
    assert exam.main(["score", str(folder), str(path)]) == 2
    assert "1-5 is expected" in capsys.readouterr().err


def test_the_generator_shares_no_code_with_the_package():
    for path in (ROOT / "truth_generator").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.split(".")[0] in ("ehls_ros", "benchmarks")], Path(path).name
