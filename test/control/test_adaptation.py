"""Online identification of errors in the rig file, its limits, and the model passed to the controller."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from ehls_ros.control.adaptation.correction import SCALED
from ehls_ros.control.companions import adaptation
from ehls_ros.control.companions.base import PLACE, Past, Setting
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import ROW, STATUS_SIZE, Model, model_of
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.loop import ClosedLoop
from ehls_ros.experiments.spec import Spec, load_spec, spec_from_mapping
from ehls_ros.physics.sensors import SPOOL

PERIOD = 1e-3
CONFIG = Path(__file__).parents[2] / "config" / "experiments"


class Run(NamedTuple):
    """A recorded run of a rig against a position servo: readings of real sensors, and commands."""

    spec: Spec
    measured: np.ndarray
    command: np.ndarray


@pytest.fixture(scope="module")
def run() -> Run:
    spec = load_spec(CONFIG / "measured_sine_fd2.yaml")
    loop = ClosedLoop(spec)
    blocks = [(b.record[:, :7].copy(), b.record[:, loop.columns.command].copy()) for b in loop.blocks()]
    return Run(spec, np.concatenate([m for m, _ in blocks]), np.concatenate([c for _, c in blocks]))


@pytest.fixture(scope="module")
def single_rod() -> Run:
    """Run of a single rod with hoses, overlaps and a droop of the supply, by a law that knows its coupling."""
    servo = {"moving_mass": 100.0, "position_gain": 10.0}
    motion = {"name": "sine", "amplitude": 0.02, "frequency": 1.0}
    content = {
        "title": "single rod against a servo",
        "rig": str(configured("rig_single_rod")),
        "duration": 8.0,
        "control_period": PERIOD,
        "known_effects": ["coupling_stiffness"],
        "reference": {"name": "sine", "amplitude": 6000.0, "frequency": 0.5},
        "disturbance": {"name": "position_servo", "stiffness": 2e6, "damping": 2e3, **servo, "signal": motion},
        "controller": "fasmc_predictive",
    }
    spec = spec_from_mapping(content, "it", Path())
    loop = ClosedLoop(spec)
    blocks = [(b.record[:, loop.columns.measured].copy(), b.record[:, loop.columns.command].copy()) for b in loop.blocks()]
    return Run(spec, np.concatenate([m for m, _ in blocks]), np.concatenate([c for _, c in blocks]))


def companion(spec: Spec, model: Model, **values: float) -> adaptation.Adaptation:
    law, rig = CONTROLLERS.load(spec.controller.name), spec.controller_rig
    setting = Setting(law, spec.controller.parameters, model, "position", cylinder=rig.cylinder.model, valve=rig.valve.model)
    return adaptation.build(adaptation.Parameters(**values), setting)


def fed(one: adaptation.Adaptation, model: Model, measured: np.ndarray, command: np.ndarray, first: int = 0) -> list[Model]:
    """Return the model after each stretch."""
    models, start = [], 0
    while start < len(command):
        n = one.room(first + start, np.full((len(command) - start, PLACE), np.nan))
        rows = slice(start, start + n)
        nothing = np.zeros((len(command[rows]), max(ROW, STATUS_SIZE)))
        past = Past(
            first + start, nothing[:, :ROW], nothing[:, :3], nothing[:, :PLACE], measured[rows], command[rows], nothing[:, :11]
        )
        model = one.done(past, model)
        models.append(model)
        start += n
    return models


def known(spec: Spec, **plant: float) -> Model:
    """Return a controller's model with scaled plant coefficients; it includes the delay of 1 ms and the coupling."""
    model = model_of(spec.controller_rig, PERIOD)
    values = {name: getattr(model.plant, name) * factor for name, factor in plant.items()}
    return model._replace(
        plant=model.plant._replace(**values), command_delay=1e-3, coupling_stiffness=2e6, coupling_damping=2e3
    )


def value(one: adaptation.Adaptation, name: str) -> float:
    return float(one.report()[name])


def test_a_right_rig_file_stays_as_it_is(run: Run) -> None:
    model = known(run.spec)
    one = companion(run.spec, model)
    assert all(later is model for later in fed(one, model, run.measured, run.command))
    told = one.report()
    assert told["discharge_coefficient_told"] == "the rig file's discharge coefficient agrees with this run (± 0.1 %)"


@pytest.mark.parametrize(
    ("name", "within"),
    [("discharge_coefficient", 0.004), ("piston_area", 0.002), ("valve_gain", 0.004), ("valve_bandwidth", 0.02)],
)
@pytest.mark.parametrize("off", [0.8, 1.2])
def test_a_wrong_coefficient_is_found(run: Run, name: str, within: float, off: float) -> None:
    model = known(run.spec, **{name: off})
    one = companion(run.spec, model)
    last = fed(one, model, run.measured, run.command)[-1]
    truth = getattr(run.spec.rig.plant, name)
    assert getattr(last.plant, name) == pytest.approx(truth, rel=within)
    others = {"discharge_coefficient", "piston_area", "valve_gain"} - {name}
    assert all(getattr(last.plant, other) == getattr(run.spec.rig.plant, other) for other in others)


def test_the_user_is_told_what_the_rig_file_has_wrong(run: Run) -> None:
    model = known(run.spec, discharge_coefficient=0.91)
    one = companion(run.spec, model)
    fed(one, model, run.measured, run.command)
    assert one.report()["discharge_coefficient_told"] == "the rig file's discharge coefficient seems 9 % low (± 0.1 %)"


def test_who_asks_for_the_report_changes_nothing(run: Run) -> None:
    """A node publishes its diagnostics at times set by the clock."""
    model = known(run.spec, discharge_coefficient=0.91, valve_bandwidth=0.9)
    asked, unasked = companion(run.spec, model), companion(run.spec, model)
    last = model
    for first in range(0, 4000, 410):
        rows = slice(first, first + 410)
        last = fed(asked, last, run.measured[rows], run.command[rows], first)[-1]
        asked.report()
    assert last is not model
    assert last == fed(unasked, model, run.measured[:4100], run.command[:4100])[-1]


def test_a_wrong_bulk_modulus_is_found_within_its_error(run: Run) -> None:
    model = known(run.spec, bulk_modulus=1.25)
    one = companion(run.spec, model)
    last = fed(one, model, run.measured, run.command)[-1]
    assert last.plant.bulk_modulus == pytest.approx(run.spec.rig.plant.bulk_modulus, rel=0.04)


@pytest.mark.parametrize("signals", [9, 7], ids=["both pressures", "load cell alone"])
def test_the_right_file_of_a_single_rod_stays_as_it_is(single_rod: Run, signals: int) -> None:
    model = known(single_rod.spec)._replace(command_delay=0.0)
    one = companion(single_rod.spec, model)
    measured = single_rod.measured[:, :signals]
    assert all(later is model for later in fed(one, model, measured, single_rod.command))
    assert one.report()["discharge_coefficient_told"] == "the rig file's discharge coefficient agrees with this run (± 0.1 %)"


@pytest.mark.parametrize(
    ("name", "within"),
    [("discharge_coefficient", 0.004), ("valve_gain", 0.004), ("valve_bandwidth", 0.02), ("bulk_modulus", 0.09)],
)
@pytest.mark.parametrize("off", [0.8, 1.2])
def test_a_wrong_coefficient_of_a_single_rod_is_found(single_rod: Run, name: str, within: float, off: float) -> None:
    # Hoses yield as well, and the modulus is that of hose and oil.
    model = known(single_rod.spec, **{name: off})._replace(command_delay=0.0)
    last = fed(companion(single_rod.spec, model), model, single_rod.measured, single_rod.command)[-1]
    assert getattr(last.plant, name) == pytest.approx(getattr(single_rod.spec.rig.plant, name), rel=within)


def test_wrong_areas_of_a_single_rod_are_found_by_the_load_cell(single_rod: Run) -> None:
    model = known(single_rod.spec, piston_area=0.85)._replace(command_delay=0.0)
    chambers = model.cylinder
    model = model._replace(cylinder=chambers._replace(area_a=0.85 * chambers.area_a, area_b=0.85 * chambers.area_b))
    last = fed(companion(single_rod.spec, model), model, single_rod.measured, single_rod.command)[-1]
    assert last.plant.piston_area == pytest.approx(single_rod.spec.rig.plant.piston_area, rel=0.002)
    assert (last.cylinder.area_a, last.cylinder.area_b) == pytest.approx((chambers.area_a, chambers.area_b), rel=0.002)


@pytest.mark.parametrize("believed", [0.8e-3, 1.2e-3])
def test_a_wrong_delay_is_found_between_whole_cycles(run: Run, believed: float) -> None:
    model = known(run.spec)._replace(command_delay=believed)
    one = companion(run.spec, model)
    last = fed(one, model, run.measured, run.command)[-1]
    assert last.command_delay == pytest.approx(1e-3, abs=0.04e-3)


@pytest.mark.parametrize("off", [0.8, 1.2])
def test_a_wrong_friction_level_is_found_roughly_beside_a_servo_with_friction(run: Run, off: float) -> None:
    model = known(run.spec)
    friction: Any = model.friction
    wrong = model._replace(
        friction=friction._replace(coulomb_force=off * friction.coulomb_force, static_force=off * friction.static_force)
    )
    one = companion(run.spec, wrong)
    last = fed(one, wrong, run.measured, run.command)[-1]
    assert last.friction.coulomb_force == pytest.approx(friction.coulomb_force, rel=0.1)


def test_the_friction_level_found_does_not_depend_on_the_rig_files() -> None:
    spec = load_spec(CONFIG / "constant_fd1.yaml")
    loop = ClosedLoop(spec)
    blocks = [(b.record[:, :7].copy(), b.record[:, loop.columns.command].copy()) for b in loop.blocks()]
    measured, command = (np.concatenate(each) for each in zip(*blocks, strict=True))
    truth: Any = spec.rig.friction
    for off in (0.8, 1.2):
        model = model_of(spec.controller_rig, PERIOD)
        model = model._replace(friction=truth._replace(**{name: off * getattr(truth, name) for name in SCALED}))
        law = CONTROLLERS.load(spec.controller.name)
        one = adaptation.build(adaptation.Parameters(), Setting(law, spec.controller.parameters, model, actuator="force"))
        last = fed(one, model, measured, command)[-1]
        assert last.friction.coulomb_force == pytest.approx(truth.coulomb_force, rel=2e-3)


def test_without_a_spool_sensor_the_product_of_gain_and_discharge_coefficient_is_found_and_named_so(run: Run) -> None:
    measured = run.measured.copy()
    measured[:, SPOOL] = np.nan
    model = known(run.spec, valve_gain=0.9)
    one = companion(run.spec, model)
    last = fed(one, model, measured, run.command)[-1]
    assert last.plant.valve_gain == model.plant.valve_gain
    assert last.plant.discharge_coefficient == pytest.approx(model.plant.discharge_coefficient / 0.9, rel=0.01)
    told = one.report()
    assert str(told["discharge_coefficient_told"]).startswith(
        "the rig file's discharge coefficient times valve gain seems 10 % low"
    )
    assert told["valve_gain_told"] == "valve gain: not identified; the rig file's value is used"


def test_at_rest_nothing_moves_and_nothing_is_claimed(run: Run) -> None:
    model = known(run.spec, discharge_coefficient=0.8, piston_area=1.2)
    one = companion(run.spec, model)
    rng = np.random.default_rng(1)
    noise = np.array([2.5e-6, 1e-4, 1.1e3, 1.1e-6, 2.3, 0.0, 0.0])
    measured = rng.standard_normal((4000, 7)) * noise + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 7e6, 313.0])
    assert all(later is model for later in fed(one, model, measured, np.zeros(4000)))
    told = [text for key, text in one.report().items() if key.endswith("_told")]
    assert all("not identified" in str(text) for text in told)


def test_nothing_changes_before_the_wait_is_over_and_later_at_most_at_the_rate(run: Run) -> None:
    model = known(run.spec, discharge_coefficient=0.8)
    one = companion(run.spec, model, wait=1.0, rate=0.2)
    models = fed(one, model, run.measured, run.command)
    values = np.array([later.plant.discharge_coefficient for later in models]) / model.plant.discharge_coefficient
    assert np.all(values[: round(0.98 / PERIOD / adaptation.STRIDE)] == 1.0)
    assert np.abs(np.diff(values)).max() <= 0.2 * PERIOD * adaptation.STRIDE * 1.000001


def test_no_coefficient_goes_beyond_its_reach(run: Run) -> None:
    model = known(run.spec, discharge_coefficient=0.5)
    one = companion(run.spec, model)
    last = fed(one, model, run.measured, run.command)[-1]
    assert last.plant.discharge_coefficient == pytest.approx(1.3 * model.plant.discharge_coefficient)
    assert "the controller is given a change of 30 % at most" in str(one.report()["discharge_coefficient_told"])
    [said] = [sentence for sentence in one.at_bounds() if "discharge coefficient" in sentence]
    assert "30 % at most: correct the rig file" in said
    right = known(run.spec, discharge_coefficient=0.9)
    near = companion(run.spec, right)
    fed(near, right, run.measured, run.command)
    assert not any("discharge coefficient" in sentence for sentence in near.at_bounds())


def test_cycle_by_cycle_gives_the_same_as_many_at_once(run: Run) -> None:
    model = known(run.spec, discharge_coefficient=0.9)
    together, single = companion(run.spec, model), companion(run.spec, model)
    last = fed(together, model, run.measured[:3000], run.command[:3000])[-1]
    alone = model
    for cycle in range(3000):
        rows = slice(cycle, cycle + 1)
        nothing = np.zeros((1, 11))
        past = Past(cycle, nothing[:, :6], nothing[:, :3], nothing[:, :2], run.measured[rows], run.command[rows], nothing)
        alone = single.done(past, alone)
    assert alone.plant == last.plant
    assert alone.friction == last.friction


def test_readings_lost_for_a_while_leave_the_estimates_right(run: Run) -> None:
    measured = run.measured.copy()
    measured[2000:2300] = np.nan
    model = known(run.spec, discharge_coefficient=0.9)
    one = companion(run.spec, model)
    fed(one, model, measured[:4000], run.command[:4000])
    one.interrupt()
    last = fed(one, model, measured[5000:], run.command[5000:], first=5000)[-1]
    assert last.plant.discharge_coefficient == pytest.approx(run.spec.rig.plant.discharge_coefficient, rel=0.005)
