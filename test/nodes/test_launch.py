"""The launch file starts the graph it describes; `launch_testing` checks it."""

import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")
pytest.importorskip("launch_testing", reason="needs launch_testing, which a ROS 2 installation brings")

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

HERE = Path(__file__).resolve().parent


@pytest.fixture(autouse=True)
def installed() -> None:
    """Skip if launch would not find this package."""
    try:
        get_package_prefix("ehls_ros")
    except PackageNotFoundError:
        pytest.skip("needs ehls_ros built by colcon and its install space sourced")


def run_launch_test(monkeypatch: pytest.MonkeyPatch) -> subprocess.CompletedProcess[str]:
    monkeypatch.setenv("PYTHONPATH", str(HERE.parent), prepend=":")
    command = [sys.executable, "-m", "launch_testing.launch_test", str(HERE / "launched_graph.py")]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def test_the_launched_graph_runs_as_its_arguments_say_and_ends_cleanly(monkeypatch):
    done = run_launch_test(monkeypatch)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
