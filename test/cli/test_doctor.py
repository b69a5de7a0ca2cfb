"""`ehls doctor` reports working and failing parts."""

import fcntl
import json
import sys
import uuid
from pathlib import Path

import pytest
from patience import PATIENCE

from ehls_ros.cli import checks
from ehls_ros.cli.main import main
from ehls_ros.nodes import shared_memory


def findings(capsys, *arguments):
    code = main(["doctor", "--json", *arguments])
    return code, {found["check"]: found for found in json.loads(capsys.readouterr().out.splitlines()[-1])}


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Give two processes ample time to discover each other on this machine."""
    monkeypatch.setattr(checks, "DISCOVERY_TIME", PATIENCE)


@pytest.fixture
def without_dds(monkeypatch):
    monkeypatch.setattr("ehls_ros.cli.verbs.doctor.CHECKS", tuple(c for c in checks.CHECKS if c is not checks.discovery))


def test_two_processes_find_each_other():
    pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy or its wheels")
    found = checks.discovery()
    assert found.level == "ok", found
    assert "us" in found.found


@pytest.mark.long
def test_a_process_that_does_not_exit_is_killed(monkeypatch, tmp_path, ros_domain_id):
    pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy or its wheels")
    deaf = tmp_path / "deaf.py"
    deaf.write_text(
        "import runpy, signal\nsignal.signal(signal.SIGTERM, lambda *_: None)\n"
        "import rclpy.signals, rclpy\nstart = rclpy.init\n"
        "rclpy.init = lambda: start(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)\n"
        "runpy.run_module('ehls_ros.nodes.round_trip', run_name='__main__')\n"
    )
    monkeypatch.setattr(checks, "ROUND_TRIP", (sys.executable, str(deaf)))
    monkeypatch.setattr(checks, "ENDING", 0.5)
    assert checks.discovery().level == "ok"
    first = 7400 + 250 * ros_domain_id
    assert not [file for port in range(first, first + 250) for file in shared_memory.SHARED_MEMORY.glob(f"*_port{port}*")]


@pytest.mark.usefixtures("without_dds")
def test_every_finding_that_is_not_ok_gives_advice(capsys):
    code, found = findings(capsys)
    assert code == 0
    assert {"Python", "packages", "shared memory", "processors", "clock", "permissions", "files"} <= set(found)
    assert all(entry["advice"] for entry in found.values() if entry["level"] != "ok")


@pytest.mark.usefixtures("without_dds")
@pytest.mark.parametrize(("name", "level", "ends_with"), [("rosbags", "problem", 1), ("plotly", "note", 0)])
def test_a_missing_package_is_a_problem_unless_one_can_do_without(name, level, ends_with, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    code, found = findings(capsys)
    assert code == ends_with
    assert found["packages"]["level"] == level
    assert name in found["packages"]["found"]


@pytest.mark.usefixtures("without_dds")
def test_leftovers_are_found_and_removed(capsys, monkeypatch, tmp_path: Path):
    monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
    dead, alive = tmp_path / f"fastrtps_{uuid.uuid4().hex}", tmp_path / f"fastrtps_{uuid.uuid4().hex}"
    dead.write_bytes(b"x" * 2**20)
    foreign = tmp_path / "somebody_elses"
    foreign.touch()
    with alive.open("wb"):
        _, found = findings(capsys)
        assert found["shared memory"]["level"] == "note"
        assert "1 files of killed processes, 1 MiB" in found["shared memory"]["found"]
        _, found = findings(capsys, "--clean")
        assert found["shared memory"]["level"] == "ok"
        assert not dead.exists()
        assert alive.exists()
    assert foreign.exists()


def test_lock_and_mutex_are_leftovers_only_with_their_port(monkeypatch, tmp_path: Path):
    monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
    port = [tmp_path / name for name in ("fastrtps_port7000", "fastrtps_port7000_el", "sem.fastrtps_port7000_mutex")]
    for file in port:
        file.touch()
    with port[0].open("rb"):
        assert shared_memory.leftovers() == []
    assert shared_memory.leftovers() == sorted(port)


def test_files_locked_by_an_invisible_process_are_not_leftovers(monkeypatch, tmp_path: Path):
    monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
    monkeypatch.setattr(shared_memory, "used_by", lambda process: set())
    segment = [tmp_path / name for name in ("fastrtps_00ff", "fastrtps_00ff_el")]
    for file in segment:
        file.touch()
    with segment[1].open("rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert shared_memory.leftovers() == []
    assert shared_memory.leftovers() == segment
