"""The whole loop in process, against the paper's figures."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from ehls_ros.control.controllers.base import model_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import ClosedLoop, run_in_process, run_in_stretches, simulator_of
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.trajectory import SIGNALS, Trajectory

REFERENCES = {
    "constant": {"name": "constant", "value": 1e4},
    "sine": {"name": "sine", "amplitude": 1e4, "frequency": 0.5},
    "triangle": {"name": "triangle", "amplitude": 1e4, "frequency": 0.5},
    "irregular": {"name": "irregular", "amplitude": 1e4},
}
FD1 = {"name": "force", "signal": {"name": "sine", "amplitude": 2e3, "frequency": 0.25}}
FD2 = {"name": "force", "signal": {"name": "sine", "amplitude": 5e3, "frequency": 1.0}}


class Cell(NamedTuple):
    """A cell of Table 3, FASMC II: largest error in % of 10 kN, and the text's convergence time if given."""

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


def cell_name(cell: Cell) -> str:
    """Return the test id of a cell."""
    return f"{cell.reference}-{'fd1' if cell.disturbance is FD1 else 'fd2'}"


@pytest.mark.parametrize("cell", CELLS, ids=cell_name)
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


@pytest.mark.parametrize("cell", CELLS, ids=cell_name)
def test_gms_compensation_beats_stribeck(make_spec, cell):
    def largest_error(compensation: Any) -> float:
        spec = make_spec(reference=REFERENCES[cell.reference], disturbance=cell.disturbance, compensation=compensation)
        return evaluate(run_in_process(spec)).max_error_n

    gms = largest_error("gms")
    assert gms < 0.9 * largest_error({"name": "stribeck", "smoothing": 0.2})
    # The paper has 57 to 75 % less; smoothed over 10 mm/s its curve has about the paper's errors.
    assert gms < 0.3 * largest_error({"name": "stribeck", "smoothing": 0.01})


@pytest.mark.parametrize(("disturbance", "percent"), [(FD1, 1.12), (FD2, 2.23)])
def test_sic_holds_a_force_as_well_as_table_3_and_less_well_than_the_law(make_spec, disturbance, percent):
    law, sic = (
        evaluate(run_in_process(make_spec(controller=name, disturbance=disturbance))).max_error_n for name in ("fasmc", "sic")
    )
    assert 2.0 * law < sic <= percent / 100.0 * 1e4


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


def test_error_of_the_sampled_law_is_of_order_one(make_spec):
    errors = [
        evaluate(run_in_process(make_spec(reference="sine", disturbance=FD2, duration=4.0, control_period=period))).max_error_n
        for period in (1e-3, 5e-4, 2.5e-4, 1.25e-4)
    ]
    assert errors[-1] < 6.0
    assert np.array(errors[:-1]) / errors[1:] == pytest.approx([2.0, 2.0, 2.0], rel=0.1)


def off(rig_mapping: dict[str, Any], key: str, factor: float) -> dict[str, Any]:
    """Return the paper's rig with one coefficient of its plant off."""
    return {**rig_mapping, "plant": {**rig_mapping["plant"], key: factor * rig_mapping["plant"][key]}}


@pytest.mark.parametrize("reference", ["constant", "sine"])
@pytest.mark.parametrize("factor", [0.8, 1.2])
@pytest.mark.parametrize("key", ["discharge_coefficient", "piston_area"])
def test_a_rig_that_is_20_percent_off_is_held_by_the_corrected_pressure_rate(make_spec, rig_mapping, key, factor, reference):
    def run(**tuning: float) -> Trajectory:
        rigs = {"rig": off(rig_mapping, key, factor), "controller_rig": rig_mapping}
        controller = {"name": "fasmc", **tuning}
        return run_in_process(make_spec(**rigs, controller=controller, reference=REFERENCES[reference], disturbance=FD2))

    held = run(rate_correction=1.0)
    late = held.time_s > 2.0
    # 1.5 % of the largest reference; 35.5 N where the model is right.
    assert np.max(np.abs(held["force_error_n"][late])) < 150.0
    assert np.max(held["saturated"]) == 0.0
    assert np.max(np.abs(held["delta_n"])) < 1e4
    # Without correction the model misses the rate by far more than the k/2 = 6 MPa/s that the surface has against it.
    lost = run(rate_correction=0.0)
    assert np.max(np.abs(lost["force_error_n"][late])) > 2e3


@pytest.mark.parametrize("reference", ["constant", "sine"])
@pytest.mark.parametrize("factor", [0.6, 1.7])
def test_a_valve_gain_between_0_6_and_1_7_of_the_models_leaves_the_error_below_100_n(make_spec, rig_mapping, factor, reference):
    rigs = {"rig": off(rig_mapping, "valve_gain", factor), "controller_rig": rig_mapping}
    run = run_in_process(make_spec(**rigs, reference=REFERENCES[reference], disturbance=FD2))
    assert np.max(np.abs(run["force_error_n"][run.time_s > 2.0])) < 100.0
    assert np.max(run["saturated"]) == 0.0


@pytest.mark.parametrize(
    ("signal", "bias"),
    [("load_pressure", 2e5), ("spool_position", 5e-5), ("velocity", 0.01), ("supply_pressure", 7e5), ("supply_pressure", -7e5)],
)
def test_the_force_is_the_load_cells_whatever_bias_the_other_readings_have(make_spec, rig_mapping, signal, bias):
    rig = {**rig_mapping, "sensors": {signal: {"bias": bias}}}

    def largest_error(part: float) -> float:
        law = {"name": "fasmc", "rate_correction": part}
        run = run_in_process(make_spec(rig=rig, controller=law, disturbance=FD2, duration=5.0))
        return float(np.max(np.abs(run["force_error_n"][run.time_s > 2.0])))

    assert largest_error(1.0) < 150.0
    assert largest_error(0.0) > 500.0


def test_the_controller_has_its_own_rig_and_the_plant_the_other(make_spec, rig_mapping):
    believed = off(off(rig_mapping, "piston_area", 1.1), "supply_pressure", 1.2)
    believed["limits"] = {**rig_mapping["limits"], "spool": 2e-3}
    believed["friction"] = {**rig_mapping["friction"], "viscous_coefficient": 8000.0}
    spec = make_spec(controller_rig=believed, disturbance=FD2, duration=1.0)
    assert ClosedLoop(spec)._control.model == model_of(spec.controller_rig, 1e-3)
    assert model_of(spec.controller_rig, 1e-3).plant.piston_area == pytest.approx(2.86e-3)
    assert simulator_of(spec).rig == simulator_of(make_spec()).rig
    run = run_in_process(spec)
    # The plant's area and supply in the readings; the controller's area, friction and spool limit in their evaluation.
    assert np.allclose(run["force_n"], 2.6e-3 * run["load_pressure_pa"])
    assert np.all(run["supply_pressure_pa"] == 7e6)
    assert np.allclose(run["e3_pa"], run["force_error_n"] / 2.86e-3)
    assert np.allclose(run["friction_viscous_n"], 8000.0 * run["velocity_m_s"])
    assert np.max(np.abs(run["valve_command_m"])) <= 2e-3


def test_a_controllers_rig_that_says_the_same_changes_nothing(make_spec, rig_mapping):
    plain = run_in_process(make_spec(disturbance=FD2, duration=1.0))
    # The arm's length is in no equation of (1)-(4).
    told = run_in_process(make_spec(controller_rig=off(rig_mapping, "arm_length", 2.0), disturbance=FD2, duration=1.0))
    for name in plain.signals:
        assert plain[name].tobytes() == told[name].tobytes(), name
    assert told.metadata["spec"]["controller_rig"]["plant"]["arm_length"] == 1.0
    assert told.metadata["rig"]["plant"]["arm_length"] == 0.5


def test_parameters_of_the_compensation_reach_the_observer(make_spec):
    run = run_in_process(make_spec(disturbance=FD2, duration=1.0, compensation={"name": "stribeck", "smoothing": 0.05}))
    speed = run["velocity_m_s"]
    level = 640.8 + 224.6 * np.exp(-(np.abs(speed / 2.031e-3) ** 0.8764))
    assert np.allclose(run["friction_gms_n"], level * np.tanh(speed / 0.05), rtol=1e-12, atol=1e-12)


@pytest.mark.long
def test_oil_warms_through_the_run_and_d_learns_what_thinner_oil_takes_from_friction(make_spec):
    thinner = [{"name": "temperature_dependent_friction", "viscous_slope": -100.0}]
    spec = make_spec(reference="sine", duration=8.0, oil_temperature=303.15, oil_warming=2.5, effects=thinner)
    run = run_in_process(spec)
    assert np.allclose(run["oil_temperature_k"], 303.15 + 2.5 * run.time_s, rtol=1e-12)
    # The controller does not include it: -100 N s/m for each kelvin above 313.15 K, so +1000 N s/m at first.
    missed = -100.0 * (run["oil_temperature_k"] - 313.15) * run["velocity_m_s"]
    estimate = run["friction_gms_n"], run["friction_viscous_n"]
    learnt = run["delta_n"] + (run["alpha"] - 1.0) * estimate[0] + (run["beta"] - 1.0) * estimate[1]
    assert np.max(np.abs(missed)) > 400.0
    assert np.sqrt(np.mean((learnt - missed)[500:] ** 2)) < 20.0


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


@pytest.mark.parametrize(
    "sensor", [{"bias": 2e-3}, {"resolution": 5e-6}, {"noise_std": 5e-6}], ids=lambda sensor: next(iter(sensor))
)
def test_position_servo_feels_the_loader_and_not_its_sensor(make_spec, rig_mapping, sensor):
    """SIC does not use the position, so that no other signal distinguishes the runs."""
    servo = {"name": "position_servo", "signal": {"name": "sine", "amplitude": 0.05, "frequency": 1.0}}
    changes = {"disturbance": servo, "controller": {"name": "sic"}, "duration": 1.0}
    runs = [
        run_in_process(make_spec(rig={**rig_mapping, "sensors": {**rig_mapping["sensors"], "position": reading}}, **changes))
        for reading in ({}, sensor)
    ]
    perfect, imperfect = (run["disturbance_displacement_m"] for run in runs)
    assert np.max(np.abs(runs[1]["position_m"] - runs[0]["position_m"])) > 1e-6
    assert np.array_equal(perfect, imperfect)


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


def test_a_rig_that_becomes_another_one_within_a_run_goes_on_from_its_state(make_spec):
    spec = make_spec(reference=REFERENCES["sine"], duration=6.0)
    leaking = spec.rig._replace(plant=spec.rig.plant._replace(leakage_coefficient=20.0 * spec.rig.plant.leakage_coefficient))

    def pressure(later: Any) -> Any:
        return np.concatenate([part["load_pressure_pa"].copy() for part in run_in_stretches(spec, later)])

    healthy, changed, same = pressure(()), pressure([(3.0, leaking)]), pressure([(3.0, spec.rig)])
    assert np.array_equal(same, healthy)
    # Stretches are 2 s long: the first that begins at 3 s or later begins at 4 s.
    assert np.array_equal(changed[:4001], healthy[:4001])
    moved = np.abs(changed - healthy)
    assert moved[4001] < 1e3
    assert np.max(moved[4001:]) > 1e3


def test_a_rig_cannot_become_one_with_other_effects(make_spec):
    spec = make_spec(duration=1.0)
    other = make_spec(duration=1.0, effects=[{"name": "constant_load", "force": 1.0}])
    with pytest.raises(BadInput, match="effects"):
        ClosedLoop(spec).become(other.rig)
