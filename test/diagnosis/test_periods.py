"""Periods along the stroke from which fits start."""

import pytest

from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.periods import period_left
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.physics.effects.base import Period
from ehls_ros.trajectory import Trajectory


@pytest.fixture
def gathered(rig, recorded):
    def gather_from(hidden):
        r = recorded(hidden, "rich", seed=21, duration=12.0)
        record = prepare(Trajectory(r.time, r.columns), rig, "made")
        return gather(record, rig, setup(record, rig), 0)

    return gather_from


def test_the_period_of_a_force_that_turns_with_the_motion_is_found(gathered):
    evidence = gathered({"ratchet_cogging": {"force": 300.0, "length": 6.1e-3, "speed": 1e-2, "phase": 0.7}})
    assert period_left(evidence, Period("position_m", turning=True)) == pytest.approx(6.1e-3, rel=0.01)
    assert period_left(evidence, Period("oil_temperature_k")) is None
    assert period_left(evidence, Period("disturbance_displacement_m")) is None


def test_noise_has_no_period(gathered):
    assert period_left(gathered({}), Period("position_m", turning=True)) is None
