"""The whole loop in process, against the paper's figures."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.trajectory import SIGNALS

REFERENCES = {
    "constant": {"name": "constant", "value": 1e4},
    "sine": {"name": "sine", "amplitude": 1e4, "frequency": 0.5},
    "triangle": {"name": "triangle", "amplitude": 1e4, "frequency": 0.5},
    "irregular": {"name": "irregular", "amplitude": 1e4},
}
FD1 = {"name": "force", "signal": {"name": "sine", "amplitude": 2e3, "frequency": 0.25}}
FD2 = {"name": "force", "signal": {"name": "sine", "amplitude": 5e3, "frequency": 1.0}}


class Cell(NamedTuple):
    """A cell of Table 3, FASMC II: largest error in % of 10 kN, and the text's convergence time where it names one."""

    reference: str
    disturbance: dict[str, Any]
    percent: float
    convergence_s: float | None


CELLS = [
    Cell("constant", FD1, 0.049, 0.8),
    Cell("sine", FD1, 0.378, 1.8),
    Cell("triangle", FD1, 0.342, 1.8),
    Cell("irregular", FD1, 0.247, None),
    Cell("constant", FD2, 0.421, 1.3),
    Cell("sine", FD2, 0.913, 3.3),
    Cell("triangle", FD2, 0.798, 1.8),
    Cell("irregular", FD2, 0.616, None),
]


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: f"{cell.reference}-{'fd1' if cell.disturbance is FD1 else 'fd2'}")
def test_gms_compensation_is_as_good_as_table_3(make_spec, cell):
    spec = make_spec(reference=REFERENCES[cell.reference], disturbance=cell.disturbance)
    metrics = evaluate(run_in_process(spec))
    assert metrics.max_error_n <= cell.percent / 100.0 * 1e4
    assert metrics.convergence_s is not None
    assert metrics.convergence_s <= (cell.convergence_s or 3.3)
    assert metrics.missed_cycles == 0
    assert metrics.cycles == 10001


def test_error_stays_within_the_laws_own_bound(make_spec):
    run = run_in_process(make_spec(disturbance=FD2))
    late = run.time_s > 2.0
    assert np.all(np.abs(run["force_error_n"][late]) <= run["force_bound_n"][late])
    assert run["force_bound_n"][-1] == pytest.approx(78.1, abs=0.1)


def test_gms_compensation_beats_stribeck_on_a_held_force(make_spec):
    # The paper: 73.2 % less against the large disturbance.
    gms, stribeck = (
        evaluate(run_in_process(make_spec(disturbance=FD2, compensation=name))).max_error_n for name in ("gms", "stribeck")
    )
    assert gms < 0.5 * stribeck


@pytest.mark.parametrize(("disturbance", "percent"), [(FD1, 1.12), (FD2, 2.9)])
def test_sic_holds_a_force_less_well(make_spec, disturbance, percent):
    # Table 3 has 1.12 and 2.23 %.
    metrics = evaluate(run_in_process(make_spec(controller={"name": "sic"}, disturbance=disturbance)))
    assert 20.0 < metrics.max_error_n <= percent / 100.0 * 1e4


def test_two_runs_are_bitwise_equal(make_spec, rig_mapping):
    rig = {**rig_mapping, "sensors": {"velocity": {"noise_std": 1e-4}, "load_pressure": {"resolution": 1.5e3}}}
    spec = make_spec(rig=rig, disturbance=FD2, duration=2.0, seed=5)
    one, two = run_in_process(spec), run_in_process(spec)
    assert one.time_s.tobytes() == two.time_s.tobytes()
    assert set(one.signals) == set(two.signals) <= set(SIGNALS)
    for name in one.signals:
        assert one[name].tobytes() == two[name].tobytes(), name
    other = run_in_process(make_spec(rig=rig, disturbance=FD2, duration=2.0, seed=6))
    assert not np.array_equal(one["valve_command_m"], other["valve_command_m"])


@pytest.mark.parametrize("reference", REFERENCES)
def test_half_the_integration_step_changes_nothing(make_spec, reference):
    errors = [
        evaluate(run_in_process(make_spec(reference=REFERENCES[reference], disturbance=FD2, integration_step=step))).max_error_n
        for step in (1e-4, 5e-5)
    ]
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)


def test_progress_counts_up_to_the_end(make_spec):
    calls: list[tuple[int, int]] = []
    run_in_process(make_spec(duration=4.5), lambda done, cycles: calls.append((done, cycles)))
    assert calls == [(2000, 4501), (4000, 4501), (4501, 4501)]


def test_signals_of_a_run_fit_each_other(make_spec):
    run = run_in_process(make_spec(reference=REFERENCES["sine"], disturbance=FD2, duration=3.0))
    assert np.allclose(run["force_n"], 2.6e-3 * run["load_pressure_pa"])
    assert np.allclose(run["force_error_n"], run["force_n"] - run["force_reference_n"])
    assert np.allclose(run["disturbance_force_n"], 5e3 * np.sin(2.0 * np.pi * run.time_s), atol=1e-6)
    assert np.allclose(run["friction_elements_n"].sum(axis=1), run["friction_gms_n"], atol=1e-9)
    assert np.allclose(np.gradient(run["position_m"], run.time_s)[5:-5], run["velocity_m_s"][5:-5], atol=5e-3)
    # (4): the spool follows the command with 111.46 rad/s, held over a cycle.
    spool, command = run["spool_m"], run["valve_command_m"]
    kept = np.exp(-111.46370743e-3)
    assert np.allclose(spool[1:], kept * spool[:-1] + (1.0 - kept) * command[:-1], rtol=1e-6, atol=1e-10)
    # (3): the force balance over the run's accelerations, with the plant's friction estimated by the observer.
    force = run["force_n"] - 60.0 * run["velocity_m_s"] - 4e4 * run["position_m"] - 70.0 * 9.81
    rest = force - run["friction_gms_n"] - run["friction_viscous_n"] - run["disturbance_force_n"]
    acceleration = np.gradient(run["velocity_m_s"], run.time_s)
    assert np.sqrt(np.mean((70.0 * acceleration - rest)[500:-5] ** 2)) < 0.02 * np.sqrt(np.mean(rest[500:-5] ** 2)) + 10.0


NOISY = {
    "position": {"noise_std": 5e-6, "resolution": 5e-6},
    "velocity": {"noise_std": 1e-4},
    "load_pressure": {"noise_std": 1e3, "resolution": 1.5e3, "bias": 2e3},
    "spool_position": {"noise_std": 1e-6, "resolution": 1e-6, "bias": 1e-6},
    "force": {"noise_std": 4.0, "resolution": 4.0},
}


@pytest.mark.parametrize("reference", REFERENCES)
def test_imperfect_sensors_leave_the_error_bounded(make_spec, rig_mapping, reference):
    spec = make_spec(rig={**rig_mapping, "sensors": NOISY}, reference=REFERENCES[reference], disturbance=FD2)
    run = run_in_process(spec)
    true_error = 2.6e-3 * run["load_pressure_pa"] - run["force_reference_n"]
    assert np.max(np.abs(true_error[run.time_s > 5.0])) < 300.0
    assert np.max(run["saturated"]) == 0.0
    assert np.max(np.abs(run["delta_n"])) < 7e3


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.05, 0.25), (0.05, 1.0), (0.125, 0.25), (0.125, 0.5), (0.125, 1.0)])
def test_position_servo_moves_as_told_and_the_force_is_held(make_spec, amplitude, frequency):
    signal = {"name": "sine", "amplitude": amplitude, "frequency": frequency}
    run = run_in_process(make_spec(disturbance={"name": "position_servo", "signal": signal}))
    late = run.time_s > 2.0
    wanted = amplitude * np.sin(2.0 * np.pi * frequency * run.time_s)
    assert np.max(np.abs(run["disturbance_displacement_m"] - wanted)[late]) < 0.03 * amplitude
    # The loader is carried along, held back by its force over the stiffness between them.
    assert np.max(np.abs(run["position_m"] - wanted)[late]) < 0.012
    # 117 N was the largest error of the paper's experiment, at 1 Hz.
    assert np.max(np.abs(run["force_error_n"][late])) < 250.0
    assert evaluate(run).max_error_n <= {0.25: 50.0, 0.5: 80.0, 1.0: 230.0}[frequency]


def test_position_servo_feels_the_loader(make_spec):
    servo = {"name": "position_servo", "signal": {"name": "sine", "amplitude": 0.05, "frequency": 1.0}}
    runs = [
        run_in_process(make_spec(reference={"name": "constant", "value": value}, disturbance=servo, duration=2.0))
        for value in (0.0, 1e4)
    ]
    apart = runs[1]["disturbance_displacement_m"] - runs[0]["disturbance_displacement_m"]
    assert 1e-5 < np.max(np.abs(apart)) < 5e-3


@pytest.mark.parametrize("start", [0.005, -0.05])
def test_a_servo_that_starts_off_the_loaders_place_is_recovered_from(make_spec, start):
    # -0.05 m times 2e6 N/m is five times what the supply pressure can hold.
    signal = {"name": "constant", "value": start}
    run = run_in_process(make_spec(disturbance={"name": "position_servo", "signal": signal}, duration=5.0))
    assert np.max(np.abs(run["force_error_n"][run.time_s > 4.0])) < 78.1


def test_without_a_disturbance_the_error_vanishes(make_spec):
    run = run_in_process(make_spec(duration=5.0))
    assert np.max(np.abs(run["force_error_n"][run.time_s > 4.0])) < 1.0
    assert not np.any(run["disturbance_force_n"])
