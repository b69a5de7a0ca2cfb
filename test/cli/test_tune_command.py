"""`ehls tune` from the command line."""

import json

import pytest

from ehls_ros.cli.main import main
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.tuning import tune as tuning


@pytest.mark.long
def test_files_table_and_document(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tuning, "MAX_TRIALS", 1)
    monkeypatch.setattr(tuning, "SPEEDS", (0.5, 1.0))
    out = tmp_path / "out"
    more = ["--law", "fasmc", "--spec", "sine_fd2", "--uncertainty", "0", "--jobs", "1", "--out", str(out), "--json"]
    assert main(["tune", "rig_paper", *more]) == 0
    said = capsys.readouterr().out
    document = json.loads(said.splitlines()[-1])
    assert document == json.loads((out / "tuning.json").read_text(encoding="utf-8"))
    assert document["law"] == "fasmc"
    assert document["chosen"]["max_error_n"] <= document["default"]["max_error_n"]
    assert document["chosen"]["gain_margin_db"] > 0.0
    assert {file.name for file in out.iterdir()} == {"experiment.yaml", "fasmc.yaml", "report.html", "tuning.json"}
    assert "gain margin" in said


@pytest.mark.long
def test_a_rig_with_sensors_is_tuned_within_its_uncertainty(tmp_path, capsys):
    rig = tmp_path / "rig.yaml"
    late = "effects: [{name: command_delay, delay: 1.0e-3}]"
    rig.write_text(configured("rig_paper_measured").read_text(encoding="utf-8").replace("effects: []", late), encoding="utf-8")
    arguments = ["tune", str(rig), "--spec", "measured_sine_fd2", "--margins", "3", "20"]
    assert main([*arguments, "--out", str(tmp_path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out.splitlines()[-1])
    chosen, default = document["chosen"], document["default"]
    assert chosen["gain_margin_db"] >= 3.0
    assert chosen["phase_margin_deg"] >= 20.0
    assert default["gain_margin_db"] < 3.0
    assert document["causal_limit_n"] < chosen["max_error_n"] <= chosen["largest_of_all_runs_n"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--margins", "-1", "30"], "0 or more"),
        (["--uncertainty", "-1"], "uncertainty"),
        (["--law", "fasmc", "--spec", "no_such_spec"], "no_such_spec"),
        (["--spec", "friction_presliding"], "force"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, arguments, words):
    assert main(["tune", "rig_paper", "--out", str(tmp_path / "out"), *arguments]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert words in line
