import json
import math

import numpy as np
import pytest

from ehls_ros.experiments.metrics import evaluate
from ehls_ros.trajectory import Trajectory, steady_error


def judged(error, reference=1e4, command=None, time=None):
    error = np.asarray(error, dtype=float)
    time = np.arange(len(error)) * 1e-3 if time is None else time
    wanted = np.broadcast_to(np.asarray(reference, dtype=float), error.shape).copy()
    signals = {
        "force_n": wanted + error,
        "force_reference_n": wanted,
        "valve_command_m": np.zeros(len(error)) if command is None else command,
    }
    return evaluate(Trajectory(time, signals))


def test_errors_are_those_of_the_last_half():
    error = np.concatenate([np.full(500, 999.0), [30.0, -40.0] * 250, [0.0]])
    metrics = judged(error)
    assert metrics.max_error_n == pytest.approx(40.0)
    assert metrics.rms_error_n == pytest.approx(math.sqrt(500 * 0.5 * (900.0 + 1600.0) / 501), rel=1e-9)
    assert metrics.cycles == 1001
    assert metrics.duration_s == pytest.approx(1.0)


@pytest.mark.parametrize("start", [0.0, 17.25])
def test_convergence_is_when_the_band_is_left_for_the_last_time(start):
    # The band is 1 % of 10 kN; the last error beyond it stands at cycle 320.
    error = np.where(np.arange(1001) <= 320, 150.0, 99.0)
    error[100:200] = 0.0
    metrics = judged(error, time=start + np.arange(1001) * 1e-3)
    assert metrics.convergence_s == pytest.approx(0.321)


def test_a_controller_with_a_large_steady_error_converges_to_it():
    t = np.arange(4001) * 1e-3
    metrics = judged(np.where(t < 0.3, 2e3, 500.0 * np.sign(np.sin(20.0 * t))))
    assert metrics.max_error_n == pytest.approx(500.0)
    assert metrics.convergence_s == pytest.approx(0.3)


def test_no_error_at_all_converges_at_once():
    metrics = judged(np.zeros(101))
    assert metrics[:3] == (0.0, 0.0, 0.0)


def test_an_error_that_still_grows_never_converges():
    assert judged(np.linspace(0.0, 5e3, 1001)).convergence_s is None


def test_an_error_that_leaves_the_band_at_the_very_end_never_converges():
    error = np.zeros(1001)
    error[-1] = 2e3
    assert judged(error).convergence_s is None


def test_a_reference_of_zero_has_no_band_of_its_own():
    metrics = judged(np.where(np.arange(1001) < 300, 5.0, 1.0), reference=0.0)
    assert metrics.convergence_s == pytest.approx(0.3)


def test_cycles_without_a_sample_are_left_out_and_counted():
    error = np.full(1001, 20.0)
    error[[3, 600, 1000]] = np.nan
    command = np.zeros(1001)
    command[[3, 600]] = np.nan
    metrics = judged(error, command=command)
    assert metrics.max_error_n == pytest.approx(20.0)
    assert metrics.rms_error_n == pytest.approx(20.0)
    assert metrics.missed_cycles == 2
    assert metrics.convergence_s == 0.0


def test_a_gap_after_the_last_error_does_not_hide_it():
    error = np.where(np.arange(1001) <= 320, 150.0, 0.0)
    error[321:330] = np.nan
    assert judged(error).convergence_s == pytest.approx(0.321, abs=0.01)


@pytest.mark.parametrize("command", [None, np.full(101, np.nan)])
def test_nothing_but_gaps_gives_no_figures(command):
    metrics = judged(np.full(101, np.nan), command=command)
    assert math.isnan(metrics.max_error_n)
    assert math.isnan(metrics.rms_error_n)
    assert metrics.convergence_s is None
    assert metrics.cycles == 101


@pytest.mark.parametrize("names", [[], ["force_n"], ["force_reference_n"], ["position_m", "position_reference_m", "force_n"]])
def test_a_run_that_followed_no_force_has_no_force_error(names):
    run = Trajectory(np.arange(101) * 1e-3, {name: np.zeros(101) for name in names})
    metrics = evaluate(run)
    assert math.isnan(metrics.max_error_n)
    assert metrics.cycles == 101
    plain = metrics.as_json()
    assert [plain[name] for name in ("max_error_n", "rms_error_n", "convergence_s")] == [None] * 3
    assert "NaN" not in json.dumps(plain)


def test_the_steady_error_is_that_of_the_last_half_where_both_are_known():
    time = 3.0 + np.arange(11) * 0.1
    position, reference = np.zeros(11), np.full(11, 1e-3)
    position[7], reference[9], position[10] = np.nan, np.inf, 5e-3
    run = Trajectory(time, {"position_m": position, "position_reference_m": reference})
    # samples 5 to 10 but for 7 and 9
    assert steady_error(run, "position_m", "position_reference_m") == pytest.approx([1e-3, 1e-3, 1e-3, 4e-3])
    assert steady_error(run, "force_n", "position_reference_m").size == 0
    assert steady_error(run, "position_m", "force_reference_n").size == 0
    assert steady_error(Trajectory(np.empty(0), {}), "position_m", "position_reference_m").size == 0


def test_json_has_the_contracts_keys():
    assert list(judged(np.zeros(11)).as_json()) == [
        "max_error_n",
        "rms_error_n",
        "convergence_s",
        "cycles",
        "missed_cycles",
        "duration_s",
        "cycles_per_second_asked",
        "cycles_per_second_reached",
        "in_real_time",
        "wall_s",
        "bag",
        "report",
    ]
