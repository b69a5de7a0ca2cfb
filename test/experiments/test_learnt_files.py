"""Learnt files: refused before a run if wrong, kept or reported at its end."""

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.spoilt_memory import SIZE, changed_archive, learn, learning_company, learning_spec
from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.experiments import learnt_files
from ehls_ros.experiments.loop import ClosedLoop
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.state_files.access import NotWritten

LAW = "fasmc"


@pytest.fixture(scope="module")
def learnt(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the file learnt in some load cycles."""
    folder = tmp_path_factory.mktemp("learnt")
    spec = learning_spec(folder, "waveform", LAW)
    company = learning_company(spec)
    learn(company)
    learnt_files.keep(company, spec)
    return (folder / "learnt.npz").read_bytes()


def recalled(spec: Spec) -> Any:
    company = learning_company(spec)
    learnt_files.recall(company, spec)
    return company


def test_what_was_learnt_is_there_the_next_day(learnt: bytes, tmp_path: Path):
    spec = learning_spec(tmp_path, "waveform", LAW)
    assert not recalled(spec).members["learning"].kept().parts
    (tmp_path / "learnt.npz").write_bytes(learnt)
    [(block, arrays)] = recalled(spec).members["learning"].kept().parts.items()
    assert block == 0
    # The error of 60 N is corrected from the first load cycle on.
    assert np.abs(np.fft.irfft(arrays["reference.spectrum"], SIZE)).max() == pytest.approx(60.0, rel=0.1)


def heavier(spec: Spec) -> Spec:
    rig = spec.rig._replace(plant=spec.rig.plant._replace(moving_mass=80.0))
    return spec._replace(rig=rig, controller_rig=rig)


def slower(spec: Spec) -> Spec:
    return spec._replace(settings=spec.settings._replace(control_period=2e-3))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (heavier, "is of another rig: plant.moving_mass is 70.0, not 80.0"),
        (slower, "is of a control_period of 0.001 s, not 0.002 s"),
        (lambda spec: spec._replace(controller=spec.controller._replace(name="sic")), "with controller fasmc, not sic"),
    ],
)
def test_what_was_learnt_with_something_else_is_refused_and_named(learnt: bytes, tmp_path: Path, change, said):
    (tmp_path / "learnt.npz").write_bytes(learnt)
    with pytest.raises(BadInput) as refused:
        recalled(change(learning_spec(tmp_path, "waveform", LAW)))
    assert said in str(refused.value)
    assert (tmp_path / "learnt.npz").read_bytes() == learnt
    with pytest.raises(BadInput, match="with method waveform, not harmonics"):
        recalled(learning_spec(tmp_path, "harmonics", LAW))


def times_a_thousand(document: Any, arrays: Any) -> None:
    arrays["0.reference.spectrum"] = 1e3 * arrays["0.reference.spectrum"]


def nan(document: Any, arrays: Any) -> None:
    arrays["0.reference.spectrum"][1] = np.nan


def of_no_block(document: Any, arrays: Any) -> None:
    arrays["7.period"] = arrays["0.period"]


def without(document: Any, arrays: Any) -> None:
    del arrays["0.reference.noise"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (times_a_thousand, "the reference would be corrected by"),
        (nan, "'reference.spectrum' has a value that is not a number"),
        (of_no_block, "the array '7.period' is of no part"),
        (without, "the array 'reference.noise' is missing"),
    ],
)
def test_what_no_run_can_have_learnt_is_refused(learnt: bytes, tmp_path: Path, change, said):
    (tmp_path / "learnt.npz").write_bytes(changed_archive(learnt, change))
    with pytest.raises(BadInput) as refused:
        recalled(learning_spec(tmp_path, "waveform", LAW))
    assert said in str(refused.value)


def test_a_link_stays_a_link_and_a_foreign_file_as_it_is(learnt: bytes, tmp_path: Path):
    (tmp_path / "store").mkdir()
    (tmp_path / "learnt.npz").symlink_to(tmp_path / "store" / "learnt.npz")
    spec = learning_spec(tmp_path, "waveform", LAW)
    company = recalled(spec)
    learn(company)
    learnt_files.keep(company, spec)
    assert (tmp_path / "learnt.npz").is_symlink()
    assert (tmp_path / "store" / "learnt.npz").is_file()
    # A file that was put there during the run.
    (tmp_path / "store" / "learnt.npz").write_bytes(b"mine")
    with pytest.raises(NotWritten, match=r"learnt arrays are lost: .*learnt\.npz: is not replaced"):
        learnt_files.keep(company, spec)
    assert (tmp_path / "store" / "learnt.npz").read_bytes() == b"mine"


@pytest.fixture
def spec_file(tmp_path: Path) -> Path:
    """Return an experiment of 3 s that learns a repeating force."""
    rig = Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"
    data = {
        "rig": str(rig),
        "duration": 3.0,
        "reference": {"name": "sine", "amplitude": 4e3, "frequency": 2.5},
        "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 4e3, "frequency": 2.5}},
        "controller": {"name": LAW},
        "companions": [{"name": "learning", "period": 0.4, "file": str(tmp_path / "kept" / "learnt.npz")}],
    }
    path = tmp_path / "spec.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_a_run_whose_learnt_file_cannot_be_written_is_kept(spec_file: Path, tmp_path: Path, monkeypatch, capsys):
    written = ClosedLoop.keep_learnt

    def without_folder(loop: ClosedLoop) -> None:
        shutil.rmtree(tmp_path / "kept")
        written(loop)

    monkeypatch.setattr(ClosedLoop, "keep_learnt", without_folder)
    assert main(["experiment", str(spec_file), "--in-process", "--out", str(tmp_path / "run")]) == 1
    told = capsys.readouterr()
    reason = f"learnt arrays are lost: {tmp_path / 'kept' / 'learnt.npz'}: cannot be written (No such file or directory)"
    assert told.err.count("\n") == 1
    assert reason in told.err
    assert f"warning: {reason}" in told.out
    assert {"bag", "metrics.json", "report.html"} <= {path.name for path in (tmp_path / "run").iterdir()}
    assert reason in (tmp_path / "run" / "metrics.json").read_text(encoding="utf-8")


def test_a_file_that_is_of_no_use_is_refused_before_anything_is_written(spec_file: Path, tmp_path: Path, capsys):
    (tmp_path / "kept").mkdir()
    path = tmp_path / "kept" / "learnt.npz"
    for make, said in ((lambda: os.mkfifo(path), "it is a pipe"), (lambda: path.write_bytes(b""), "it is empty")):
        make()
        assert main(["experiment", str(spec_file), "--in-process", "--out", str(tmp_path / "run")]) == 2
        told = capsys.readouterr().err
        assert said in told
        assert told.count("\n") == 1
        assert not (tmp_path / "run").exists()
        path.unlink()
    assert not list((tmp_path / "kept").iterdir())
