"""The flight recorder keeps the last trips, each as a bag that a diagnosis can read."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from full_disk import no_file_larger_than

from ehls_ros.cli.main import parser
from ehls_ros.experiments.monitoring import flight_recorder
from ehls_ros.experiments.monitoring.flight_recorder import MARK, Flight, FlightRecorder, write
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.trajectory import Trajectory

RIG = load_rig(Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml")
TIME = np.arange(500) * 1e-3
SIGNALS = {
    "position_m": np.sin(TIME),
    "load_pressure_pa": 1e6 * np.cos(TIME),
    "valve_command_m": np.where(TIME < 0.1, np.nan, TIME),
}


class Ended:
    def poll(self) -> int:
        return 0


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Return the commands of the processes that would have been started."""
    commands: list[list[str]] = []
    monkeypatch.setattr(flight_recorder.subprocess, "Popen", lambda command, **_: commands.append(command) or Ended())
    return commands


def flight(second: int) -> Flight:
    return Flight(Trajectory(TIME, SIGNALS), "emergency stop", (1_700_000_000 + second) * 10**9)


def test_a_flight_becomes_a_bag_and_the_arguments_of_its_diagnosis(tmp_path: Path, begun: list[list[str]]):
    folder = FlightRecorder(tmp_path, 3, 100.0).begin(flight(0), RIG, 1e-3, [tmp_path / "old"], Trajectory(TIME, SIGNALS))
    assert folder.name == "20231114-221320"
    assert begun[0][2:] == ["ehls_ros.experiments.monitoring.flight_recorder", str(folder)]
    arguments = parser().parse_args(write(folder))
    found = read_bag(arguments.data[0])
    assert np.allclose(found.time_s, TIME)
    for name, values in SIGNALS.items():
        assert np.array_equal(found[name], values, equal_nan=True)
    assert found.metadata["trip"] == {"cause": "emergency stop", "stamp_ns": 1_700_000_000 * 10**9}
    assert load_rig(arguments.rig) == RIG
    assert arguments.baseline == [tmp_path / "old", folder / "baseline"]
    assert len(read_bag(arguments.baseline[1])) == len(TIME)


def test_number_and_size_are_bounded(tmp_path: Path, begun: list[list[str]]):
    recorder = FlightRecorder(tmp_path, 3, 100.0)
    names = [recorder.begin(flight(second // 2), RIG, 1e-3).name for second in range(5)]
    assert len(set(names)) == 5
    assert {path.name for path in tmp_path.iterdir()} == set(names[-3:])
    size = sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file()) / 3
    small = FlightRecorder(tmp_path, 9, 2.5 * size / 1e6)
    small.begin(flight(9), RIG, 1e-3)
    assert len(list(tmp_path.iterdir())) == 3
    assert len(begun) == 6


def test_only_flights_are_removed_and_of_them_only_what_the_recorder_wrote(tmp_path: Path, begun: list[list[str]]):
    recorder = FlightRecorder(tmp_path, 1, 100.0)
    first = recorder.begin(flight(0), RIG, 1e-3)
    (first / "notes.txt").write_text("mine", encoding="utf-8")
    foreign = tmp_path / "20200101-000000"
    foreign.mkdir()
    (foreign / "measured.csv").write_text("mine", encoding="utf-8")
    elsewhere = tmp_path.parent / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / "20200101-000001").symlink_to(elsewhere)
    (tmp_path / "20200101-000002").symlink_to("nowhere")
    second = recorder.begin(flight(1), RIG, 1e-3)
    assert [path.name for path in first.iterdir()] == ["notes.txt"]
    assert (foreign / "measured.csv").read_text(encoding="utf-8") == "mine"
    names = {"20200101-000000", "20200101-000001", "20200101-000002", first.name, second.name}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_a_flight_that_cannot_be_written_leaves_nothing(tmp_path: Path, begun: list[list[str]]):
    with no_file_larger_than(4096), pytest.raises(NotWritten, match=r"samples\.npz: cannot be written"):
        FlightRecorder(tmp_path, 3, 100.0).begin(flight(0), RIG, 1e-3)
    assert not list(tmp_path.iterdir())


def test_the_process_says_what_is_wrong_with_a_flight(tmp_path: Path):
    (tmp_path / MARK).write_text("{}", encoding="utf-8")
    command = ["-m", "ehls_ros.experiments.monitoring.flight_recorder", str(tmp_path)]
    done = subprocess.run([flight_recorder.sys.executable, *command], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith(f"{tmp_path / MARK}: the flight cannot be used (it is something else")
