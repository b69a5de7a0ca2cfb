"""Wrong input ends with code 2 and one line that names the error, its location and the expected value."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from full_disk import no_file_larger_than
from patience import PATIENCE

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_spec

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
    "yes for a number": (
        lambda m: m["rig"]["plant"].update(moving_mass=True),
        ("moving_mass is True", "number", "yes, on, no"),
    ),
    "a number in quotes": (lambda m: m["rig"]["plant"].update(moving_mass="70"), ("moving_mass is '70'", "without quotes")),
    "a number for a text": (lambda m: m.update(title=7), ("title is 7", "string in quotes")),
    "yes in a list": (lambda m: m["rig"]["friction"].update(element_weight=[True]), ("element_weight", "True", "number")),
    "yes for a name": (lambda m: m["controller"].update(name=True), ("controller True is unknown", "fasmc")),
    "a fraction of a seed": (lambda m: m.update(seed=1.5), ("seed is 1.5", "integer")),
    "a companion that cannot work": (
        lambda m: m.update(companions=[{"name": "disturbance_preview"}]),
        ("spec.yaml: disturbance_preview beside fasmc", "does not use what is foreseen", "PREVIEW"),
    ),
    "learning that need not converge": (
        lambda m: m.update(companions=[{"name": "learning", "period": 4.0, "gain": 2.0}]),
        ("spec.yaml: learning beside fasmc", "gain 2", "gain 0"),
    ),
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


def test_a_companions_file_is_read_by_who_runs_the_controller_only(spec, tmp_path, capsys):
    learnt = tmp_path / "learnt.npz"
    learnt.write_text("nothing")
    path = spec(lambda m: m.update(companions=[{"name": "learning", "period": 4.0, "file": str(learnt)}]))
    assert load_spec(path).companions[0].parameters.file == str(learnt)
    for how in ((), ("--in-process",)):
        line = complaint(capsys, "experiment", path, *how, "--out", tmp_path / "run")
        assert f"experiment: {learnt}: the learnt file cannot be " in line
        assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("written", ["0.1", "1e-1", "1.0E-1", ".1", "1_0e-2"])
def test_numbers_however_they_are_written(spec, written):
    path = spec(lambda m: m.update(duration="here", seed=3.0))
    path.write_text(path.read_text().replace("here", written))
    if "_" in written:
        with pytest.raises(BadInput, match="duration is '1_0e-2'; expected a valid number"):
            load_spec(path)
    else:
        assert load_spec(path).settings.duration == 0.1
        assert load_spec(path).settings.seed == 3


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


def limited(*arguments, largest_file):
    """Return exit code and errors of a process whose files are limited in size, as on a full disk."""
    command = [sys.executable, "-m", "ehls_ros.cli.main", *map(str, arguments)]
    # The child inherits the limit, and so do the processes it starts.
    with no_file_larger_than(largest_file):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    _, complaint = process.communicate(timeout=PATIENCE)
    return process.returncode, complaint.strip().splitlines()


def test_a_disk_that_is_full(spec, tmp_path):
    path = spec(lambda m: m.update(duration=2.0))
    code, lines = limited("experiment", path, "--in-process", "--out", tmp_path / "run", largest_file=300_000)
    assert (code, len(lines)) == (1, 1), lines
    assert f"the run in {tmp_path / 'run'} cannot go on (File too large; the bag is incomplete after" in lines[0]
    assert "free some space" in lines[0]


@pytest.mark.long
def test_a_disk_that_is_full_while_the_graph_records(spec, tmp_path):
    path = spec(lambda m: m.update(duration=20.0))
    code, lines = limited("experiment", path, "--out", tmp_path / "run", largest_file=1_100_000)
    assert code == 1
    assert "recorder_node: not recording: [Errno 27] File too large; the bag is incomplete after" in lines[-1]
    assert "recovered" not in lines[-1]
    assert "killed" not in lines[-1]


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


def test_a_wrong_file_is_named_before_slow_libraries_load():
    slow = {"pandas", "plotly", "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.stats", "scipy.linalg"}
    code = f"import sys; from ehls_ros.cli.main import parser; parser(); print({slow} & sys.modules.keys())"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "set()"
