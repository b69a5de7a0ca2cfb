"""First drafts of rig files: which numbers are wrong, and when a file is fitted before a diagnosis."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.estimate import Estimate
from ehls_ros.experiments.first_draft import DRAFT, is_first_draft, wrong_numbers
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.rig_result import RigIdentification

RIG = load_rig(Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml")
NAMES = (
    "plant.moving_mass",
    "plant.bulk_modulus",
    "plant.leakage_coefficient",
    "friction.coulomb_force",
    "plant.supply_pressure",
)


def identified(factor: float, std: float, count: int = len(NAMES)) -> RigIdentification:
    """Return an identification with some coefficients off by a factor, and a bias that no rig file has."""
    values = {**RIG.plant._asdict(), **RIG.friction._asdict()}
    estimates = {path: Estimate(factor * v, std * v, "1") for path in NAMES[:count] for v in [values[path.split(".")[1]]]}
    estimates["effects.valve_null_bias.command"] = Estimate(1e-5, 1e-8, "m")
    none = np.empty((0, 0))
    return RigIdentification(RIG, estimates, none, none, {}, {}, {}, (), (), 0.0)


@pytest.mark.parametrize(
    ("factor", "std", "wrong"),
    [(1.3, 0.01, True), (1.05, 0.001, False), (1.3, 0.1, False), (0.7, 0.01, True)],
    ids=["far off", "near enough", "vague", "far below"],
)
def test_a_number_is_wrong_that_is_far_from_a_certain_estimate(factor, std, wrong):
    found = wrong_numbers(RIG, identified(factor, std))
    assert list(found) == ([path.split(".")[1] for path in NAMES] if wrong else [])
    for name, item in found.items():
        assert item.fitted.value == pytest.approx(factor * item.given)
        assert item.given == {**RIG.plant._asdict(), **RIG.friction._asdict()}[name]


def test_few_wrong_numbers_are_causes_and_many_a_first_draft():
    assert not is_first_draft(wrong_numbers(RIG, identified(1.3, 0.01, DRAFT - 1)))
    assert is_first_draft(wrong_numbers(RIG, identified(1.3, 0.01, DRAFT)))
