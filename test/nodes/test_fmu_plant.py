"""An FMU as the plant of a graph."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from ehls_command import ehls, trajectory_of

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


def test_unusable_fmu_is_refused_before_any_node_starts(spec_file, tmp_path):
    done = ehls("experiment", spec_file(), "--plant-fmu", spec_file(), "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "File is not a zip file" in done.stderr
    assert done.stderr.count("\n") == 1
