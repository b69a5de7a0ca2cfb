"""`ehls predict` from the command line."""

import json

import numpy as np
import pytest

from ehls_ros.cli.main import main
from ehls_ros.cli.verbs import predict as verb
from ehls_ros.diagnosis.prediction import Prediction, Windows


@pytest.fixture
def table(tmp_path):
    """A short table with the names of the data contract."""
    path = tmp_path / "axis.csv"
    path.write_text("time_s,valve_command_m,position_m,force_n\n0,0,0,0\n0.001,0,0,0\n")
    return str(path)


def test_models_beside_each_other_and_the_document(table, tmp_path, capsys, monkeypatch):
    errors = {"force_n": {"rig_paper.yaml": np.array([0.1, 0.2]), "value kept": np.array([0.5, np.nan])}}
    given = {}

    def predicted(trajectory, rigs, lengths, name, begin, end, progress):
        given.update(rigs=list(rigs), lengths=lengths, name=name, span=(begin, end))
        progress(1, 1)
        return Prediction((Windows(0.5, np.array([1.0, 1.5]), errors),), ("a remark",))

    monkeypatch.setattr(verb, "predict", predicted)
    out = tmp_path / "out"
    more = ["--windows", "0.5", "--from", "1", "--out", str(out), "--json"]
    assert main(["predict", table, "--rig", "rig_paper", "rig_paper_measured", *more]) == 0
    said = capsys.readouterr().out
    assert given == {
        "rigs": ["rig_paper.yaml", "rig_paper_measured.yaml"], "lengths": [0.5], "name": "axis.csv", "span": (1.0, np.inf),
    }  # fmt: skip
    document = json.loads(said.splitlines()[-1])
    assert document == json.loads((out / "prediction.json").read_text(encoding="utf-8"))
    [windows] = document["windows"]
    assert windows["nrmse"]["force_n"] == {"rig_paper.yaml": pytest.approx(np.sqrt(0.025)), "value kept": None}
    assert windows["each"]["force_n"]["value kept"] == [0.5, None]
    assert "15.8" in said
    assert "20.0 at 1.5 s" in said
    assert "a remark" in said


@pytest.mark.parametrize(
    ("arguments", "words"), [(["--windows", "0"], "lengths above 0"), (["--rig", "no_such_rig"], "no_such_rig")]
)
def test_bad_input_is_one_line(table, tmp_path, capsys, arguments, words):
    assert main(["predict", table, "--rig", "rig_paper", "--out", str(tmp_path / "out"), *arguments]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert words in line
