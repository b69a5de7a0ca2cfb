import json
import math

import numpy as np
import pytest

from ehls_ros.experiments.json_document import json_document
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
    # The band is 1 % of 10 kN; the last error beyond it is at cycle 320.
    error = np.where(np.arange(1001) <= 320, 150.0, 99.0)
    error[100:200] = 0.0
    metrics = judged(error, time=start + np.arange(1001) * 1e-3)
    assert metrics.convergence_s == pytest.approx(0.321)


@pytest.mark.parametrize("swing", [101.0, 505.0, 9.8e5])
def test_an_error_that_keeps_swinging_beyond_the_band_never_converges(swing):
    t = np.arange(8001) * 1e-3
    metrics = judged(np.where(t < 2.0, 2e3, 0.0) + swing * np.sign(np.sin(20.0 * t + 0.1)))
    assert metrics.convergence_s is None
    assert metrics.oscillation_n == pytest.approx(swing)
    assert metrics.convergence_band_n == pytest.approx(100.0)


@pytest.mark.parametrize("frequency", [0.0, 7.0])
def test_an_error_that_decays_converges_once_its_last_peak_is_inside_the_band(frequency):
    t = np.arange(8001) * 1e-3
    error = 5e3 * np.exp(-2.0 * t) * np.cos(2.0 * np.pi * frequency * t)
    enters = 0.5 * math.log(5e3 / 100.0)
    between_peaks = 0.5 / frequency if frequency else 2e-3
    assert enters - between_peaks < judged(error).convergence_s <= enters + 1e-3


def test_a_steady_oscillation_inside_the_band_has_converged_beyond_it_not():
    t = np.arange(8001) * 1e-3
    assert judged(99.0 * np.sin(20.0 * t)).convergence_s == 0.0
    assert judged(101.0 * np.sin(20.0 * t)).convergence_s is None


def test_a_burst_in_the_second_half_undoes_convergence_one_in_the_first_half_delays_it():
    t = np.arange(8001) * 1e-3
    burst = np.where(t < 0.2, 300.0, 0.0)
    assert judged(burst).convergence_s == pytest.approx(0.2)
    assert judged(np.roll(burst, 3000)).convergence_s == pytest.approx(3.2)
    assert judged(np.roll(burst, 6000)).convergence_s is None


def test_an_error_that_leaves_the_band_now_and_then_never_converges():
    # Each second a blow of 10 ms; the last one is long over when the run ends.
    t = np.arange(10001)
    metrics = judged(np.where((t % 1000 < 10) & (t < 9500), 190.0, 20.0))
    assert metrics.convergence_s is None
    assert metrics.oscillation_n == pytest.approx(85.0)


def test_the_band_does_not_grow_with_the_error():
    bands = {judged(np.full(101, error), reference=1e6).convergence_band_n for error in (0.0, 1e4, 9.8e5)}
    assert bands == {1e4}
    assert judged(np.full(101, 9.8e5), reference=1e6).convergence_s is None


def test_no_error_at_all_converges_at_once():
    metrics = judged(np.zeros(101))
    assert metrics[:3] == (0.0, 0.0, 0.0)


def test_an_error_that_still_grows_never_converges():
    assert judged(np.linspace(0.0, 5e3, 1001)).convergence_s is None


def test_an_error_that_grows_inside_the_band_has_converged():
    assert judged(np.linspace(0.0, 99.0, 1001)).convergence_s == 0.0


def test_an_error_that_leaves_the_band_at_the_very_end_never_converges():
    error = np.zeros(1001)
    error[-1] = 2e3
    assert judged(error).convergence_s is None


def test_a_reference_of_zero_has_no_band_to_converge_to():
    metrics = judged(np.where(np.arange(1001) < 300, 5.0, 1.0), reference=0.0)
    assert metrics.convergence_band_n == 0.0
    assert metrics.convergence_s is None
    assert metrics.max_error_n == 1.0


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
    plain = json_document(metrics)
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
    assert list(json_document(judged(np.zeros(11)))) == [
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
        "convergence_band_n",
        "oscillation_n",
        "causal_limit_n",
        "warnings",
    ]


LIMITS = {"spool": 0.01, "force": 1.82e4, "load_pressure": 7e6, "position": [-0.1, 0.3], "velocity": 2.0}


def told(limits=LIMITS, **signals):
    """Return the warnings of a run whose signals are constant, except for one late cycle."""
    count = len(next(iter(signals.values())))
    return evaluate(Trajectory(np.arange(count) * 1e-3, signals, {"rig": {"limits": limits}})).warnings


def blip(value, usual=0.0):
    values = np.full(101, usual)
    values[80] = value
    return values


@pytest.mark.parametrize(
    ("signal", "value", "words"),
    [
        ("force_n", -19.2e3, "force -1.92e+04 N, where the rig's limit is -18200 N"),
        ("load_pressure_pa", 7.4e6, "load pressure 7.4e+06 Pa, where the rig's limit is 7e+06 Pa"),
        ("velocity_m_s", 2.11, "velocity 2.11 m/s, where the rig's limit is 2 m/s"),
        ("position_m", 0.315, "position 0.315 m, where the rig's limit is 0.3 m"),
        ("position_m", -0.115, "position -0.115 m, where the rig's limit is -0.1 m"),
    ],
)
def test_a_limit_that_is_left_is_told_with_when(signal, value, words):
    [warning] = told(**{signal: blip(value)})
    assert words in warning
    assert "(at 0.08 s)" in warning


@pytest.mark.parametrize(
    ("signal", "value"), [("force_n", 19.0e3), ("position_m", 0.304), ("velocity_m_s", np.nan), ("oil_temperature_k", 1e9)]
)
def test_a_little_beyond_a_limit_and_a_gap_are_not_told(signal, value):
    assert told(**{signal: blip(value)}) == ()


@pytest.mark.parametrize("limits", [None, {}, {"force": "much"}, {**LIMITS, "velocity": -1.0}])
def test_a_recording_that_does_not_know_its_rig_has_no_limits(limits):
    assert told(limits, force_n=blip(1e9)) == ()


def test_an_error_of_a_fifth_of_the_reference_is_told():
    assert told(force_n=np.full(101, 8.1e3), force_reference_n=np.full(101, 1e4)) == ()
    [warning] = told(force_n=np.full(101, 7.9e3), force_reference_n=np.full(101, 1e4))
    assert (
        warning == "the force does not follow its reference: the error of the last half reaches 2100 N, the reference 10000 N"
    )
    [warning] = told(position_m=np.full(101, 0.02), position_reference_m=np.full(101, 0.03))
    assert "the position does not follow its reference" in warning


def test_a_valve_at_its_limit_all_the_time_is_told():
    assert told(saturated=(np.arange(101) < 70).astype(float)) == ()
    [warning] = told(saturated=(np.arange(101) > 20).astype(float))
    assert "at its limit for 100 % of the last half" in warning


@pytest.mark.parametrize("period", [1e-3, 2.5e-4])
def test_the_pace_is_asked_by_the_period_wherever_the_stamps_were_set_to_the_clock(period):
    time = np.arange(4001) * period
    # Simulated time took 5 s of wall time; twice its stamps were set to the clock.
    time[1500:] += 1.0
    time[3000:] += 1.0
    signals = {"valve_command_m": np.zeros(len(time))}
    metrics = evaluate(Trajectory(time, signals, {"timing": "realtime", "wall_s": 5.0}))
    assert metrics.cycles_per_second_asked == pytest.approx(1.0 / period)
    assert metrics.cycles_per_second_reached == pytest.approx(800.0)
    assert not metrics.in_real_time
