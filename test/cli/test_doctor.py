"""`ehls doctor` says what is there and what is not."""

import json
import sys
import uuid
from pathlib import Path

import pytest

from ehls_ros.cli import checks
from ehls_ros.cli.main import main
from ehls_ros.nodes import shared_memory


def findings(capsys, *arguments):
    code = main(["doctor", "--json", *arguments])
    return code, {found["check"]: found for found in json.loads(capsys.readouterr().out.splitlines()[-1])}


@pytest.fixture
def without_dds(monkeypatch):
    monkeypatch.setattr("ehls_ros.cli.verbs.doctor.CHECKS", tuple(c for c in checks.CHECKS if c is not checks.discovery))


def test_two_processes_find_each_other():
    pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy or its wheels")
    found = checks.discovery()
    assert found.level == "ok", found
    assert "us" in found.found


def test_a_process_that_does_not_end_is_ended(monkeypatch):
    pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy or its wheels")
    deaf = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
    monkeypatch.setattr(
        checks, "ECHO", checks.ECHO.replace("rclpy.spin(node)", f"{deaf}while True:\n    rclpy.spin_once(node)")
    )
    monkeypatch.setattr(checks, "ENDING", 0.5)
    assert checks.discovery().level == "ok"


@pytest.mark.usefixtures("without_dds")
def test_every_finding_that_is_not_fine_says_what_to_do(capsys):
    code, found = findings(capsys)
    assert code == 0
    assert {"Python", "packages", "shared memory", "processors", "clock", "permissions", "files"} <= set(found)
    assert all(entry["advice"] for entry in found.values() if entry["level"] != "ok")


@pytest.mark.usefixtures("without_dds")
def test_a_missing_package_is_a_problem(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    code, found = findings(capsys)
    assert code == 1
    assert "rosbags" in found["packages"]["found"]


@pytest.mark.usefixtures("without_dds")
def test_leftovers_are_found_and_cleaned_away(capsys, monkeypatch, tmp_path: Path):
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
