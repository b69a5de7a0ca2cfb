"""The monitor's benchmark: criteria for right and late, the interval of a rate, and the rigs that change within a run."""

import numpy as np
import pytest

from benchmarks.diagnosis.cases import rig_file
from benchmarks.monitor.judge import judge
from benchmarks.monitor.peers import Cusum, Ewma
from benchmarks.monitor.tables import incidents, rate
from truth_generator import record

ONSET = 90.0


def row(*alarms, effect="coulomb_shift", offline=("coulomb_shift",), bound=5.0):
    return {"onset": ONSET, "effect": effect, "offline": list(offline), "bound": bound, "alarms": list(alarms)}


def alarm(time, kind, names=(), wall_s=0.0):
    return {"time": time, "kind": kind, "names": list(names), "wall_s": wall_s}


def test_the_delay_runs_from_the_onset_and_beyond_what_an_offline_diagnosis_needs():
    j = judge(row(alarm(98.0, "noticed"), alarm(98.5, "named", ("viscous_shift", "coulomb_shift"), wall_s=2.0)))
    assert (j.right, j.noticed, j.named) == (True, 8.0, 8.5)
    assert (j.beyond, j.beyond_with_wall) == (3.5, 5.5)


def test_only_the_first_name_counts():
    j = judge(row(alarm(98.5, "named", ("viscous_shift",)), alarm(120.0, "named", ("coulomb_shift",))))
    assert not j.right
    assert j.beyond is None


def test_an_alarm_before_the_onset_is_no_success():
    j = judge(row(alarm(60.0, "named", ("coulomb_shift",))))
    assert (j.right, j.early, j.noticed) == (False, 1, None)


def test_what_no_offline_diagnosis_finds_does_not_count():
    assert not judge(row(offline=("viscous_shift",))).counts


def test_the_interval_of_a_rate_is_the_exact_one():
    # Garwood's interval of a count of 3: 0.6187 to 8.7673.
    assert rate(3, 2.0) == pytest.approx((1.5, 0.6187 / 2.0, 8.7673 / 2.0), rel=1e-4)
    assert rate(0, 1000.0) == pytest.approx((0.0, 0.0, 3.6889e-3), rel=1e-4)


def test_blocks_above_the_bound_on_end_are_one_alarm():
    assert incidents([7.0, 7.0, 1.0, 2.0, 7.0, 1.0], 6.0) == 2


@pytest.mark.parametrize("detector", [Cusum, Ewma])
def test_a_detector_alarms_on_a_shift_and_not_on_what_is_healthy(detector):
    noise = np.random.default_rng(1).standard_normal(200)
    assert not any(detector(12.0).alarms(value) for value in noise)
    shifted = detector(12.0)
    assert any(shifted.alarms(value) for value in 6.0 + noise)


def test_a_rig_that_changes_within_a_run_is_the_old_one_before_and_the_new_one_from_then_on():
    same = {"seed": 5, "duration": 2.0}
    sizes = {"viscous_shift": {"factor": 1.3}}
    healthy = record(rig_file(), {}, "rich", **same).columns
    changed = record(rig_file(), {}, "rich", growth=[(1.0, sizes)], **same).columns
    always = record(rig_file(), sizes, "rich", **same).columns
    at_once = record(rig_file(), {}, "rich", growth=[(0.0, sizes)], **same).columns
    for name, values in changed.items():
        assert np.array_equal(values[:1000], healthy[name][:1000])
        assert np.array_equal(at_once[name], always[name])
    assert np.max(np.abs(changed["load_pressure_pa"][1000:] - healthy["load_pressure_pa"][1000:])) > 1e4


def test_experiments_under_other_control_do_not_follow_in_one_run():
    with pytest.raises(ValueError, match="position control"):
        record(rig_file(), {}, "rich+slow_sweep", seed=1, duration=10.0)
