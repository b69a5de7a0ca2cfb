"""Files of the package can be named from any folder; an existing path takes precedence."""

from pathlib import Path

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder, configured
from ehls_ros.experiments.spec import load_spec


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("name", "folder", "found"),
    [
        ("sine_fd2", "experiments", "experiments/sine_fd2.yaml"),
        ("k_and_h", "campaigns", "campaigns/k_and_h.yaml"),
        ("rig_paper", "", "rig_paper.yaml"),
    ],
)
def test_a_name_stands_for_the_file_that_comes_with_the_package(name: str, folder: str, found: str) -> None:
    assert configured(name, folder) == config_folder() / found


def test_a_file_of_that_name_comes_first(tmp_path: Path) -> None:
    (tmp_path / "sine_fd2").touch()
    assert configured("sine_fd2", "experiments") == Path("sine_fd2")


@pytest.mark.parametrize("path", ["mine/sine_fd2", "sine_fd2.yaml"])
def test_a_path_is_no_name(path: str) -> None:
    assert configured(path, "experiments") == Path(path)


def test_a_wrong_name_is_told_the_names_and_the_one_spelt_like_it() -> None:
    with pytest.raises(BadInput, match=r"a file's path, or one of .*sine_fd1, sine_fd2, .*did you mean 'sine_fd2'"):
        configured("sin_fd2", "experiments")
    with pytest.raises(BadInput, match=r"or one of rig_paper, rig_paper_measured, rig_single_rod$"):
        configured("bridge_udp", "")


def test_an_experiment_of_ones_own_names_a_rig_of_the_package(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    text = (config_folder() / "experiments" / "sine_fd2.yaml").read_text(encoding="utf-8")
    own.write_text(text.replace("../rig_paper.yaml", "rig_paper"), encoding="utf-8")
    assert "rig: rig_paper\n" in own.read_text(encoding="utf-8")
    assert load_spec(own).rig == load_spec(config_folder() / "experiments" / "sine_fd2.yaml").rig
