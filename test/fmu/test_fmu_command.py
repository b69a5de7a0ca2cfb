"""The command `ehls fmu`."""

import json
import shutil
import zipfile

import pytest
from fmpy import read_model_description

from ehls_ros.cli.main import main
from ehls_ros.experiments.files import configured


def test_folder_of_a_diagnosis_is_exported_with_it(tmp_path, capsys):
    folder = tmp_path / "diagnosis"
    folder.mkdir()
    shutil.copy(configured("rig_paper"), folder / "rig_extended.yaml")
    (folder / "diagnosis.json").write_text("{}")
    out = tmp_path / "my rig.fmu"
    words = ["fmu", str(folder), "--out", str(out), "--fmi", "2.0", "--system", "linux", "--json"]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert document["interfaces"] == ["Co-Simulation", "Model Exchange"]
    with zipfile.ZipFile(out) as archive:
        assert {"resources/rig.yaml", "resources/diagnosis.json", "binaries/linux64/my_rig.so"} <= set(archive.namelist())
    described = read_model_description(str(out))
    mass = next(variable for variable in described.modelVariables if variable.name == "plant.moving_mass")
    assert (mass.unit, mass.start, mass.min) == ("kg", "70.0", "0.0")
    assert main(words) == 2
    assert "the file is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["."], "there is no rig_extended.yaml"),
        (["rig_paper", "--period", "1"], "--period is 1.0"),
        (["rig_paper", "--integration-step", "0.005", "--period", "0.01"], "too fast for steps of 0.005 s"),
        (["rig_papers"], "there is no file"),
    ],
)
def test_bad_input_is_one_line(words, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["fmu", *words]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
