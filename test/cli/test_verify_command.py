import json

import numpy as np
import pytest

from ehls_ros.cli.main import main


@pytest.fixture
def table(tmp_path):
    """A bench's table: 1 % too much force, in kN."""
    time = np.arange(0.0, 8.0, 4e-3)
    wave = np.sin(2.0 * np.pi * time)
    path = tmp_path / "bench.csv"
    np.savetxt(path, np.column_stack([time, 10.1 * wave, 10.0 * wave]), delimiter=",", header="t,F,set", comments="")
    (tmp_path / "columns.yaml").write_text(
        "time_s: {name: t}\nforce_n: {name: F, unit: kN}\nforce_reference_n: {name: set, unit: kN}\n"
    )
    return path


def test_it_writes_both_results_and_ends_with_the_document(table, tmp_path, capsys):
    out = tmp_path / "out"
    columns, rig = str(tmp_path / "columns.yaml"), "rig_paper_measured"
    arguments = ["verify", str(table), "--columns", columns, "--rig", rig, "--cell-uncertainty", "0.5", "--out", str(out)]
    assert main([*arguments, "--json"]) == 0
    said = capsys.readouterr().out
    document = json.loads(said.splitlines()[-1])
    assert document == json.loads((out / "verification.json").read_text(encoding="utf-8"))
    assert sorted(file.name for file in out.iterdir()) == ["report.html", "verification.json"]
    [block] = document["blocks"]
    assert block["amplitude"]["error_percent"] == pytest.approx(1.0)
    assert block["amplitude"]["type_b_resolution_n"] == pytest.approx(4.0 / np.sqrt(12.0))
    assert "certifies nothing" in said


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--inertia-mass", "12"], ("position_m", "acceleration")),
        (["--inertia-mass", "-1"], ("-1", "0 or more")),
        (["--settling", "-1"], ("settling", "0 or more")),
    ],
)
def test_bad_input_is_one_line(table, tmp_path, capsys, more, words):
    out = tmp_path / "out"
    assert main(["verify", str(table), "--columns", str(tmp_path / "columns.yaml"), "--out", str(out), *more]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert all(word in line for word in words)
    assert not out.exists()
