from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ehls_ros.experiments.spec import Spec, load_rig, spec_from_mapping
from ehls_ros.physics.rig import rig_to_mapping

CONFIG = Path(__file__).parents[2] / "config"


@pytest.fixture(scope="session")
def config() -> Path:
    """The folder of the rig file and the experiments."""
    return CONFIG


@pytest.fixture
def rig_mapping() -> dict[str, Any]:
    """Mapping of the paper's rig, as in a rig file."""
    return rig_to_mapping(load_rig(CONFIG / "rig_paper.yaml"))


@pytest.fixture
def make_spec(rig_mapping: dict[str, Any]) -> Callable[..., Spec]:
    """Return a maker of specs: sections by keyword, by default FASMC II on the paper's rig."""

    def make(**sections: Any) -> Spec:
        plain = {"rig": rig_mapping, "reference": {"name": "constant"}, "controller": {"name": "fasmc"}}
        return spec_from_mapping({**plain, **sections}, "spec.yaml", CONFIG)

    return make
