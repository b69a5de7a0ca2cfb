"""What a user may get wrong ends with code 2 and one line that says what, where and what was expected."""

from pathlib import Path

import pytest
import yaml

from ehls_ros.cli.main import main

CONFIG = Path(__file__).resolve().parents[2] / "config"


@pytest.fixture
def spec(tmp_path):
    """Return a function that writes a spec with some keys changed and returns its path."""
    mapping = yaml.safe_load((CONFIG / "experiments" / "sine_fd2.yaml").read_text())
    mapping["rig"] = yaml.safe_load((CONFIG / "rig_paper.yaml").read_text())
    mapping["duration"] = 0.1

    def write(change):
        change(mapping)
        path = tmp_path / "spec.yaml"
        path.write_text(yaml.safe_dump(mapping))
        return path

    return write


def complaint(capsys, *arguments):
    assert main([str(argument) for argument in arguments]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    return line


CASES = {
    "missing rig key": (lambda m: m["rig"]["plant"].pop("piston_area"), ("plant", "piston_area", "missing")),
    "unknown effect": (lambda m: m["rig"].update(effects=[{"name": "gremlins"}]), ("gremlins", "valve_dead_zone")),
    "negative mass": (lambda m: m["rig"]["plant"].update(moving_mass=-70.0), ("moving_mass", "-70", "greater than 0")),
    "not a number": (lambda m: m["rig"]["plant"].update(bulk_modulus=float("nan")), ("bulk_modulus", "nan", "finite")),
    "unknown controller": (lambda m: m["controller"].update(name="magic"), ("magic", "fasmc")),
    "gain out of range": (lambda m: m["controller"].update(k=1e9), ("k is", "1000")),
    "unknown key": (lambda m: m.update(durration=3), ("durration", "duration")),
    "text for a number": (lambda m: m.update(duration="long"), ("duration", "long", "number")),
}


@pytest.mark.parametrize("case", CASES)
def test_wrong_spec(case, spec, tmp_path, capsys):
    change, words = CASES[case]
    line = complaint(capsys, "experiment", spec(change), "--in-process", "--out", tmp_path / "run")
    assert "spec.yaml" in line
    for word in words:
        assert word in line, line
    assert not (tmp_path / "run").exists()


def test_reference_file_with_nan(spec, tmp_path, capsys):
    (tmp_path / "load.csv").write_text("time_s,value\n0.0,1.0\n0.1,nan\n0.2,2.0\n")
    path = spec(lambda m: m.update(reference={"name": "load_spectrum", "file": "load.csv"}))
    line = complaint(capsys, "experiment", path, "--in-process", "--out", tmp_path / "run")
    assert "load.csv:3" in line
    assert "finite" in line


def test_bag_cut_in_half(spec, tmp_path, capsys):
    path = spec(lambda m: None)
    assert main(["experiment", str(path), "--in-process", "--out", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    [bag] = (tmp_path / "run" / "bag").glob("*.mcap")
    whole = bag.read_bytes()
    bag.write_bytes(whole[: len(whole) // 2])
    line = complaint(capsys, "report", tmp_path / "run")
    assert "bag" in line
    assert "expected" in line


def test_output_that_cannot_be_written(spec, tmp_path, capsys):
    path = spec(lambda m: None)
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where the folder should go")
    line = complaint(capsys, "experiment", path, "--in-process", "--out", blocked / "run")
    assert str(blocked) in line
    assert "writable folder" in line


def test_an_existing_run_is_not_replaced_unasked(spec, tmp_path, capsys):
    path, out = spec(lambda m: None), tmp_path / "run"
    assert main(["experiment", str(path), "--in-process", "--out", str(out)]) == 0
    capsys.readouterr()
    assert "--overwrite" in complaint(capsys, "experiment", path, "--in-process", "--out", out)
    assert main(["experiment", str(path), "--in-process", "--out", str(out), "--overwrite"]) == 0


def test_a_folder_of_other_things_is_never_replaced(spec, tmp_path, capsys):
    path, out = spec(lambda m: None), tmp_path / "thesis"
    out.mkdir()
    (out / "thesis.tex").write_text("years of work")
    line = complaint(capsys, "experiment", path, "--in-process", "--out", out, "--overwrite")
    assert "thesis.tex" in line
    assert (out / "thesis.tex").read_text() == "years of work"


def test_report_of_what_is_not_there(tmp_path, capsys):
    line = complaint(capsys, "report", tmp_path / "nothing")
    assert "nothing" in line
    assert "expected" in line
