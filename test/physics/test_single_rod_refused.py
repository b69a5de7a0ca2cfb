"""What knows one pressure only refuses a single rod at once, with the remedy."""

from pathlib import Path

import pytest
import yaml
from reference_single_rod import SingleRodConstants

from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.next_experiment import next_experiment
from ehls_ros.physics.rig import rig_from_mapping


@pytest.fixture
def rig():
    paper = yaml.safe_load(Path(configured("rig_paper")).read_text(encoding="utf-8"))
    return rig_from_mapping(SingleRodConstants().mapping(paper, "gms"), "rig")


def test_a_single_rod_is_refused(rig):
    with pytest.raises(BadInput, match=r"the rig's cylinder is two_chamber; expected model: double_rod"):
        next_experiment({"a": rig, "b": rig})
