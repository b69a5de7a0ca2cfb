"""An FMU as the plant of a graph."""

import contextlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
import yaml
from ehls_command import ehls, trajectory_of
from patience import PATIENCE

pytest.importorskip("fmpy", reason="the extra fmu is not installed")
pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from ehls_ros.cli.main import main
from ehls_ros.recording.bag_reader import read_bag


@pytest.fixture(scope="module")
def rig_fmu(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "rig.fmu"
    assert main(["fmu", "rig_paper", "--out", str(path), "--system", "linux"]) == 0
    return path


def test_exported_rig_in_the_graph_is_the_simulated_rig(rig_fmu, spec_file, tmp_path):
    spec = spec_file(duration=0.3)
    found = trajectory_of(ehls("experiment", spec, "--plant-fmu", rig_fmu, "--out", tmp_path / "fmu", "--json"))
    assert main(["experiment", str(spec), "--out", str(tmp_path / "own"), "--in-process"]) == 0
    wanted = read_bag(tmp_path / "own" / "bag")
    for name in ("force_n", "valve_command_m", "position_m", "friction_gms_n"):
        assert np.array_equal(found[name], wanted[name]), name


@pytest.mark.long
def test_lost_fmu_ends_the_run_with_its_reason(rig_fmu, spec_file, tmp_path):
    variables = tmp_path / "map.yaml"
    variables.write_text(yaml.safe_dump({"parameters": {"plant.moving_mass": 1e-30}}))
    words = ("--plant-fmu", rig_fmu, "--plant-map", variables, "--out", tmp_path / "run")
    done = ehls("experiment", spec_file(duration=0.3), *words)
    assert done.returncode == 1
    assert "the FMU's process ended" in done.stderr
    assert "unsuitable parameters or inputs" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "run" / "bag").exists()


def fmu_of_node(command):
    """Return the process of the FMU that the plant's node runs, once there is one."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        for process in psutil.Process(command.pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                if "plant_process" in " ".join(process.cmdline()) and process.ppid() != command.pid:
                    return process
        assert command.poll() is None, command.communicate()
        time.sleep(0.02)
    raise AssertionError("no FMU runs")


@pytest.mark.long
@pytest.mark.parametrize(
    ("sent", "said"), [(signal.SIGKILL, "ended by signal SIGKILL"), (signal.SIGSTOP, "did not answer in time and was ended")]
)
def test_killed_or_hanging_fmu_ends_the_run_with_its_reason(sent, said, rig_fmu, spec_file, tmp_path):
    words = ["experiment", spec_file(duration=600.0), "--plant-fmu", rig_fmu, "--timing", "realtime", "--out", tmp_path / "run"]
    command = subprocess.Popen(
        [sys.executable, "-m", "ehls_ros.cli.main", *map(str, words)],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        found = fmu_of_node(command)
        found.send_signal(sent)
        _, errors = command.communicate(timeout=PATIENCE)
    finally:
        command.kill()
    assert command.returncode == 1
    assert f"{rig_fmu}: the FMU" in errors
    assert said in errors
    assert "Traceback" not in errors
    assert not found.is_running()


def test_unusable_fmu_is_refused_before_any_node_starts(spec_file, tmp_path):
    done = ehls("experiment", spec_file(), "--plant-fmu", spec_file(), "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "File is not a zip file" in done.stderr
    assert done.stderr.count("\n") == 1
