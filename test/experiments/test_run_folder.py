import json
import re
from pathlib import Path

import pytest
import yaml

from ehls_ros.errors import BadInput
from ehls_ros.experiments import run_folder as module
from ehls_ros.experiments.metrics import Metrics
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import load_spec, spec_from_mapping

METRICS = Metrics(1.0, 0.5, None, 3, 0, 0.002)


def filled(path: Path) -> Path:
    """Return a folder of a run with all possible contents."""
    (path / "bag").mkdir(parents=True)
    (path / "bag" / "bag_0.mcap").write_bytes(b"data")
    (path / "logs").mkdir()
    for name in ("spec.yaml", "metrics.json", "report.html"):
        (path / name).write_text("old", encoding="utf-8")
    return path


def test_a_new_folder_is_made_with_its_parents(tmp_path):
    folder = RunFolder.create(tmp_path / "a" / "b", "name", overwrite=False)
    assert folder.path.is_dir()
    assert folder.bag.parent == folder.report.parent == folder.logs.parent == folder.path
    assert not folder.bag.exists()  # the bag's writer must create it


def test_without_a_path_the_run_gets_one_below_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = RunFolder.create(None, "sine_fd2", overwrite=False)
    assert re.fullmatch(r"runs/sine_fd2-\d{8}-\d{6}", str(folder.path))


def test_a_run_is_not_replaced_unasked(tmp_path):
    path = filled(tmp_path / "run")
    with pytest.raises(BadInput, match=r"run: the folder already holds a run; expected .*--overwrite"):
        RunFolder.create(path, "name", overwrite=False)
    assert (path / "bag" / "bag_0.mcap").read_bytes() == b"data"
    assert (path / "metrics.json").read_text(encoding="utf-8") == "old"


def test_a_run_is_replaced_whole_when_asked(tmp_path):
    path = filled(tmp_path / "run")
    RunFolder.create(path, "name", overwrite=True)
    assert sorted(entry.name for entry in path.iterdir()) == ["spec.yaml"]
    assert (path / "spec.yaml").read_text(encoding="utf-8") == ""


@pytest.mark.parametrize("stranger", ["thesis.tex", ".git", "bag_old", "results.csv"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_strangers_files_are_never_touched(tmp_path, stranger, overwrite):
    path = filled(tmp_path / "run")
    (path / stranger).write_text("mine", encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        RunFolder.create(path, "name", overwrite=overwrite)
    assert f"'{stranger}'" in caught.value.what
    assert (path / stranger).read_text(encoding="utf-8") == "mine"
    assert (path / "bag" / "bag_0.mcap").exists()


def test_an_empty_folder_is_taken(tmp_path):
    assert RunFolder.create(tmp_path, "name", overwrite=False).path == tmp_path


def test_a_link_in_place_of_the_bag_is_removed_without_what_it_points_to(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "precious.mcap").write_bytes(b"data")
    run = tmp_path / "run"
    run.mkdir()
    (run / "bag").symlink_to(elsewhere)
    RunFolder.create(run, "name", overwrite=True)
    assert (elsewhere / "precious.mcap").read_bytes() == b"data"
    assert not (run / "bag").exists()


# The tests may run as root, whom no permission stops: a file blocks the way instead.
@pytest.mark.parametrize("below", ["file", "file/run", "file/deeper/run"])
def test_a_file_in_the_way_is_bad_input(tmp_path, below):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    with pytest.raises(BadInput, match="the run folder cannot be written") as caught:
        RunFolder.create(tmp_path / below, "name", overwrite=True)
    assert caught.value.where == str(tmp_path / below)
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"


def test_a_place_where_nobody_may_write_is_bad_input():
    with pytest.raises(BadInput, match="the run folder cannot be written"):
        RunFolder.create(Path("/proc/ehls_run"), "name", overwrite=False)


def test_a_folder_that_exists_but_takes_no_file_is_bad_input():
    # An existing folder of the kernel: nothing can be made in it, not even by root.
    with pytest.raises(BadInput):
        RunFolder.create(Path("/proc/self/fdinfo"), "name", overwrite=False)


def test_spec_and_metrics_can_be_read_back(tmp_path, config):
    spec = load_spec(config / "experiments" / "servo_sine.yaml")
    folder = RunFolder.create(tmp_path / "run", "name", overwrite=False)
    folder.write_spec(spec)
    folder.write_metrics(METRICS)
    written = yaml.safe_load(folder.spec.read_text(encoding="utf-8"))
    assert spec_from_mapping(written, "spec", tmp_path) == spec
    assert load_spec(folder.spec) == spec
    assert json.loads((folder.path / "metrics.json").read_text(encoding="utf-8"))["max_error_n"] == 1.0
    assert {entry.name for entry in folder.path.iterdir()} <= set(module.CONTENT)
