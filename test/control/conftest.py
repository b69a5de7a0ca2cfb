from pathlib import Path
from typing import Any

import pytest

from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.rig import Rig, rig_to_mapping

RIG_FILE = Path(__file__).parents[2] / "config" / "rig_paper.yaml"


@pytest.fixture(scope="session")
def rig() -> Rig:
    """The paper's rig."""
    return load_rig(RIG_FILE)


@pytest.fixture
def rig_mapping(rig: Rig) -> dict[str, Any]:
    """Mapping of the paper's rig, as in a rig file."""
    return rig_to_mapping(rig)
