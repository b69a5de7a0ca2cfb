"""The pages of examples/ with data: their commands are valid, and reproduce the stated results."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.cli.main import main, parser

ROOT = Path(__file__).parents[2]


def commands(page):
    """Return the arguments of each command on a page of the examples."""
    lines = (ROOT / "examples" / page / "README.md").read_text().splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("    .venv/bin/ehls ")]


@pytest.mark.parametrize("page", ["rotary", "seals"])
def test_every_command_is_valid_and_its_files_are_there(page):
    assert commands(page)
    for words in commands(page):
        options = parser().parse_args(words)
        for path in (*options.data, *options.baseline, options.rig, options.columns):
            assert (ROOT / path).is_file()


def test_the_commands_of_the_fatigue_rig_are_valid_and_lead_to_its_rig_file(tmp_path):
    page = ROOT / "examples" / "faster"
    for words in commands("faster"):
        options = parser().parse_args(words)
        given = [
            *np.atleast_1d(getattr(options, "data", [])),
            getattr(options, "columns", None),
            getattr(options, "answers", None),
        ]
        assert all((ROOT / path).is_file() for path in given if path is not None)
    assert main(["new-rig", "--from", str(page / "answers.yaml"), "--out", str(tmp_path / "rig.yaml")]) == 0
    committed = (page / "rig.yaml").read_text(encoding="utf-8").splitlines()
    assert (tmp_path / "rig.yaml").read_text(encoding="utf-8").splitlines() == committed[1:]  # below the line for editors


@pytest.mark.long
def test_the_identified_fatigue_rig_predicts_the_force_of_the_rest(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    [identify] = [words for words in commands("faster") if words[0] == "identify"]
    identify[identify.index("--out") + 1] = str(tmp_path)
    assert main(identify) == 0
    [predict] = [words for words in commands("faster") if words[0] == "predict"]
    at = predict.index("--rig")
    predict[at + 1 : at + 3] = [str(tmp_path / "rig_identified.yaml")]
    predict[predict.index("--out") + 1] = str(tmp_path)
    capsys.readouterr()
    assert main([*predict, "--json"]) == 0
    windows = json.loads(capsys.readouterr().out.splitlines()[-1])["windows"]
    errors = [length["nrmse"]["force_n"]["rig_identified.yaml"] for length in windows]
    assert errors == [pytest.approx(0.070, abs=0.005), pytest.approx(0.126, abs=0.01)]


@pytest.mark.long
@pytest.mark.parametrize(("page", "number", "verdict"), [("rotary", 0, "unchanged"), ("seals", 0, "unchanged")])
def test_what_the_page_says_comes_out(page, number, verdict, tmp_path, monkeypatch, capsys):
    words = commands(page)[number]
    words[words.index("--out") + 1] = str(tmp_path)
    monkeypatch.chdir(ROOT)
    assert main([*words, "--threads", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["verdict"] == verdict
