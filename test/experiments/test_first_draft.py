"""First drafts of rig files: which numbers are wrong, and when a file is fitted before a diagnosis."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.diagnosis.result import Fitted
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.first_draft import DRAFT, is_first_draft, wrong_numbers
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.rig_result import ChannelFit, RigIdentification

RIG = load_rig(Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml")
NAMES = (
    "plant.moving_mass",
    "plant.bulk_modulus",
    "plant.leakage_coefficient",
    "friction.coulomb_force",
    "plant.supply_pressure",
)


def identified(factor: float, std: float, count: int = len(NAMES), before: float = 0.1) -> RigIdentification:
    """Return an identification with some coefficients off by a factor, and a bias that no rig file has.

    The given rig's residual is ``before`` of a balance, the identified one's 0.002.
    """
    values = {**RIG.plant._asdict(), **RIG.friction._asdict()}
    estimates = {path: Estimate(factor * v, std * v, "1") for path in NAMES[:count] for v in [values[path.split(".")[1]]]}
    estimates["effects.valve_null_bias.command"] = Estimate(1e-5, 1e-8, "m")
    none, channels = np.empty((0, 0)), {"force": ChannelFit(before, 0.002, 0.001)}
    return RigIdentification(RIG, estimates, none, none, {}, {}, channels, (), (), 0.0)


@pytest.mark.parametrize(
    ("factor", "std", "before", "wrong"),
    [
        (1.3, 0.01, 0.1, True),
        (1.05, 0.001, 0.1, True),
        (1.3, 0.1, 0.1, False),
        (0.7, 0.01, 0.1, True),
        (1.3, 0.01, 0.002, False),
    ],
    ids=["far off", "near", "vague", "far below", "as good"],
)
def test_a_number_is_wrong_that_contradicts_a_certain_and_better_estimate(factor, std, before, wrong):
    found = wrong_numbers(RIG, identified(factor, std, before=before))
    assert {path for path in found if path in NAMES} == (set(NAMES) if wrong else set())
    values = {**RIG.plant._asdict(), **RIG.friction._asdict()}
    for path in set(NAMES) & set(found):
        assert found[path].given == values[path.split(".")[1]]
        assert found[path].fitted.value == pytest.approx(factor * found[path].given)


def test_few_numbers_far_off_are_causes_and_many_a_first_draft():
    assert not is_first_draft(wrong_numbers(RIG, identified(1.3, 0.01, DRAFT - 1)))
    assert not is_first_draft(wrong_numbers(RIG, identified(1.05, 0.001)))
    assert is_first_draft(wrong_numbers(RIG, identified(1.3, 0.01, DRAFT)))


def test_the_numbers_of_chambers_and_edges_count_and_overlaps_do_not():
    def off(*paths: str) -> dict[str, Fitted]:
        return {path: Fitted(1.0, Estimate(1.5, 0.01, "1"), None) for path in paths}

    counted = ("valve.gain_pb", "cylinder.tank_pressure", "cylinder.leakage_a", "plant.bulk_modulus")
    assert len(counted) == DRAFT
    assert is_first_draft(off(*counted))
    assert not is_first_draft(off(*counted[1:], "valve.overlap_pa", "valve.rounding_bt"))
