"""Prediction of a recording from its command, over windows started from the measured past."""

import numpy as np
import pytest

from ehls_ros.diagnosis.prediction import UNCHANGED, nrmse, predict
from ehls_ros.errors import BadInput
from ehls_ros.physics.simulator import Simulator
from ehls_ros.trajectory import Trajectory

SECONDS, PERIOD = 8.0, 1e-3


@pytest.fixture(scope="module")
def recording(rig):
    """A rig without noise that follows a slow command of two sines."""
    simulator = Simulator(rig.quiet(), PERIOD)
    time = PERIOD * np.arange(round(SECONDS / PERIOD))
    command = 4e-5 * np.sin(2.0 * np.pi * 0.7 * time) + 2e-5 * np.sin(2.0 * np.pi * 1.9 * time)
    rows = []
    for u in command:
        simulator.measure(np.zeros(7))
        rows.append(simulator.truth.copy())
        simulator.advance(u, 0.0, 0.0, 0.0, 0.0)
    truth = np.array(rows)
    signals = ("position_m", "velocity_m_s", "load_pressure_pa", "spool_m", "force_n")
    return Trajectory(time, {"valve_command_m": command, **{name: truth[:, i] for i, name in enumerate(signals)}})


def of(recording, *signals):
    return Trajectory(recording.time_s, {name: recording[name] for name in ("valve_command_m", *signals)})


def with_flow(rig, factor):
    return rig._replace(plant=rig.plant._replace(discharge_coefficient=factor * rig.plant.discharge_coefficient))


@pytest.mark.long
def test_the_right_rig_predicts_and_a_wrong_one_does_not(recording, rig):
    wrong = with_flow(rig, 1.2)
    found = predict(of(recording, "position_m", "force_n", "spool_m"), {"right": rig, "wrong": wrong}, [2.0, 0.5])
    assert [windows.length for windows in found.windows] == [0.5, 2.0]
    for windows in found.windows:
        errors = {model: nrmse(each) for model, each in windows.errors["force_n"].items()}
        assert errors["right"] < 0.03
        assert errors["wrong"] > 3.0 * errors["right"]
        assert errors[UNCHANGED] > errors["wrong"]
        assert {"position_m", "spool_m"} < windows.errors.keys()


def test_windows_overlap_and_lie_within_the_time_asked_for_and_without_gaps(recording, rig):
    time = recording.time_s + np.where(recording.time_s < 4.0, 0.0, 30.0)
    gapped = Trajectory(time, of(recording, "position_m", "force_n", "spool_m").signals)
    [windows] = predict(gapped, {"rig": rig}, [1.0], begin=1.0, end=36.0).windows
    assert np.all(windows.starts >= 1.0)
    assert np.all((windows.starts < 3.0) | (windows.starts > 34.0))
    assert np.all(windows.starts + 1.0 < 36.001)
    assert np.diff(windows.starts)[0] == pytest.approx(0.25)
    assert np.any(windows.starts > 34.0)


def test_without_pressure_and_spool_the_load_cell_and_the_command_stand_for_them(recording, rig):
    [windows] = predict(of(recording, "position_m", "force_n"), {"rig": rig}, [1.0]).windows
    assert nrmse(windows.errors["force_n"]["rig"]) < 0.03


def test_a_piston_that_leaves_the_stroke_has_no_error(recording, rig):
    short = rig._replace(limits=rig.limits._replace(position=(-2e-3, 2e-3)))
    [windows] = predict(of(recording, "position_m", "force_n", "spool_m"), {"short": short}, [1.0]).windows
    assert nrmse(windows.errors["force_n"]["short"]) is None


@pytest.mark.parametrize(
    ("signals", "lengths", "words"),
    [(("force_n",), [1.0], "position_m"), (("position_m",), [1.0], "force_n"), (("position_m", "force_n"), [9.0], "9 s")],
)
def test_missing_signals_and_too_long_windows_are_refused(recording, rig, signals, lengths, words):
    with pytest.raises(BadInput, match=words):
        predict(of(recording, *signals), {"rig": rig}, lengths, "axis.csv")
