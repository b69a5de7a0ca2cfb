"""FMUs of the paper's rig, exported once."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.fmu.archive import fmu
from ehls_ros.fmu.plant_model import plant_model

# The extra "fmu" is not installed.
collect_ignore_glob = [] if find_spec("fmpy") and find_spec("ziglang") else ["test_*.py"]


@pytest.fixture(scope="session")
def model():
    return plant_model(load_rig(configured("rig_paper")), "rig")


@pytest.fixture(scope="session", params=["2.0", "3.0"])
def exported(request, model, tmp_path_factory) -> Path:
    """FMU of one version for Linux."""
    path = tmp_path_factory.mktemp("fmu") / f"rig_{request.param[0]}.fmu"
    path.write_bytes(fmu(model, request.param, {"rig.yaml": b"{}"}, "test", ["linux"]))
    return path
