"""Tuning of a law: margins of the loop, the task, the uncertainty and the search."""

import math

import numpy as np
import pytest

from ehls_ros.control.controllers import fasmc_output_feedback
from ehls_ros.control.disturbances.position_servo import Parameters, steady_gain
from ehls_ros.control.margins import LoopMargins, pressure_loop_margins
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments.catalogue import largest_force
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig, spec_from_mapping, swinging_actuator
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.experiments.tuning import tune as tuning
from ehls_ros.experiments.tuning.files import document, experiment_text, parameters_text
from ehls_ros.experiments.tuning.loop_margins import UNSTABLE, changed, margins_of, slipping
from ehls_ros.experiments.tuning.task import held, task_of, usual
from ehls_ros.experiments.tuning.tune import Limit, Trial, Wanted, _remarks, tune
from ehls_ros.experiments.tuning.uncertainty import LIMIT, uncertain
from ehls_ros.physics.rig import effects_from_list, rig_to_mapping
from ehls_ros.recording.yaml_text import parse_yaml

RIG = load_rig(configured("rig_paper"))
SINGLE_ROD = load_rig(configured("rig_single_rod"))
COUPLING = effects_from_list([{"name": "coupling_stiffness", "stiffness": 3e6, "damping": 1e3}], "test")
DELAY = effects_from_list([{"name": "command_delay", "delay": 2e-3}], "test")
WIDE = LoopMargins(12.0, math.inf, 60.0, 0.01)
SHORT = {
    "title": "short",
    "duration": 1.0,
    "reference": {"name": "sine", "amplitude": 1e4, "frequency": 1.0},
    "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 5e3, "frequency": 2.0}},
}


def test_the_margins_of_a_pi_loop_are_those_of_its_transfer_function():
    # So heavy that it does not move: the loop is that of the oil alone.
    rig = RIG.with_plant(moving_mass=1e6, leakage_coefficient=0.0, gravity=0.0, spring_stiffness=0.0)
    still = {"name": "constant", "value": 0.0}
    content = {"rig": rig_to_mapping(rig), "reference": {"name": "constant", "value": 1e3}}
    content |= {"disturbance": {"name": "force", "signal": still}, "controller": {"name": "sic", "compensation": 0.0}}
    spec = spec_from_mapping(content, "test", configured("rig_paper").parent)
    numbers = spec.controller.parameters
    found, expected = (
        margins_of(spec),
        pressure_loop_margins(numbers.proportional, numbers.integral, rig.plant.valve_bandwidth, 1e-3),
    )
    assert found.gain_db == pytest.approx(expected.gain_db, abs=0.3)
    assert found.phase_deg == pytest.approx(expected.phase_deg, abs=2.0)


@pytest.mark.parametrize(("beyond", "stable"), [(0.85, True), (1.15, False)])
def test_the_gain_margin_is_the_gain_at_which_the_loop_becomes_unstable(beyond, stable):
    spec = task_of(RIG, "fasmc", SHORT).spec
    gain = 10.0 ** (beyond * margins_of(spec).gain_db / 20.0)
    smooth = changed(spec, slipping)
    other = smooth._replace(rig=smooth.rig.with_plant(valve_gain=gain))
    added = np.zeros(other.cycles)
    added[500] = 1e-6 * RIG.limits.spool
    moved = np.abs(stepped_run(other, added).command - stepped_run(other).command) / added[500]
    assert (moved[-100:].max() < 0.1) == stable


def test_a_loop_that_has_lost_the_force_has_no_margins():
    stronger = {"name": "force", "signal": {"name": "constant", "value": 6e4}}
    assert margins_of(task_of(RIG, "fasmc", {**SHORT, "disturbance": stronger}).spec) == UNSTABLE


def test_the_coupling_of_the_rig_file_acts_once():
    task = task_of(RIG.with_effects(COUPLING), "fasmc_predictive")
    [acting] = [use for use in task.spec.loader_rig().effects if use.name == "coupling_stiffness"]
    [known] = [use for use in task.spec.controller_rig.effects if use.name == "coupling_stiffness"]
    assert acting.parameters == pytest.approx(tuple(COUPLING[0].parameters))
    assert known.parameters == COUPLING[0].parameters
    assert task.remarks == ()


def test_an_untold_coupling_is_said_and_a_delay_is_known_to_the_law():
    task = task_of(RIG.with_effects(DELAY), "fasmc_output_feedback")
    assert "coupling_stiffness" in task.remarks[0]
    assert task.spec.controller.parameters.command_delay == pytest.approx(2e-3)
    assert [use.parameters.delay for use in task.spec.rig.effects] == [2e-3]


def test_a_law_takes_delay_and_coupling_from_the_rig():
    told = tuned_for(fasmc_output_feedback.Parameters, RIG.with_effects(COUPLING + DELAY))
    untold = tuned_for(fasmc_output_feedback.Parameters, RIG)
    assert (told.command_delay, told.coupling_stiffness, told.coupling_damping) == pytest.approx((2e-3, 3e6, 1e3))
    assert (untold.command_delay, untold.coupling_stiffness) == pytest.approx((1e-3, 2e6))


def test_a_law_that_follows_a_position_is_refused():
    with pytest.raises(BadInput, match="position"):
        task_of(RIG, "pid", SHORT)


def test_rigs_within_the_uncertainty():
    told = RIG.with_effects(COUPLING)._replace(standard_errors={"plant.moving_mass": 0.2 * RIG.plant.moving_mass})
    spec = task_of(told, "fasmc_predictive").spec
    drawn = uncertain([spec] * 3, 1)
    for other in drawn:
        assert other.controller_rig == spec.controller_rig
        assert abs(other.rig.plant.moving_mass / RIG.plant.moving_mass - 1.0) <= 0.2 * LIMIT
        assert other.rig.plant.bulk_modulus != RIG.plant.bulk_modulus
        assert other.disturbance.parameters.stiffness != 3e6
    assert len({other.rig.plant.moving_mass for other in drawn}) == 3
    [exact] = uncertain([spec], 1, 0.0)
    assert exact.rig == spec.rig


def test_a_small_force_against_a_held_actuator_belongs_to_the_task():
    spec = task_of(RIG.with_effects(COUPLING), "fasmc_predictive").spec
    still = held(spec)
    assert still.reference.parameters.amplitude == pytest.approx(0.05 * largest_force(RIG))
    assert (still.disturbance.signal.name, still.disturbance.signal.parameters.value) == ("constant", 0.0)
    assert still.loader_rig() == spec.loader_rig()
    assert held(task_of(RIG, "fasmc", SHORT).spec) is None


def test_the_actuator_under_test_of_a_heavy_rig_does_not_swing_by_itself():
    heavy = RIG.with_plant(moving_mass=30.0 * RIG.plant.moving_mass, leakage_coefficient=1e-13, spring_stiffness=0.0)
    rig = heavy.with_friction(viscous_coefficient=500.0)._replace(effects=COUPLING)
    gain, plant = steady_gain(rig), rig.plant
    assert gain < 0.1 * Parameters().position_gain
    # The servo alone, with a stiff valve: its characteristic polynomial is that of Merritt (1967), 6.5.
    leaking = 4.0 * plant.bulk_modulus * plant.leakage_coefficient / plant.total_volume
    rubbing = 500.0 / plant.moving_mass
    stiff = 4.0 * plant.bulk_modulus * plant.piston_area**2 / plant.total_volume / plant.moving_mass
    for factor, swings in ((1.0, False), (3.0, True)):
        roots = np.roots([1.0, leaking + rubbing, leaking * rubbing + stiff, factor * gain * stiff])
        assert bool(np.any(roots.real > 0.0)) == swings
    assert steady_gain(RIG) == Parameters().position_gain
    servo = {"name": "position_servo", "moving_mass": plant.moving_mass, "signal": {"name": "constant", "value": 0.0}}
    content = {"rig": rig_to_mapping(rig), "reference": {"name": "constant", "value": 0.0}, "controller": "fasmc"}
    for factor, words in ((1.0, ""), (3.0, "actuator under test swings on its oil by itself")):
        made = {**content, "disturbance": {**servo, "position_gain": factor * gain}}
        assert words in " ".join(swinging_actuator(spec_from_mapping(made, "test", configured("rig_paper").parent)))
        assert bool(swinging_actuator(spec_from_mapping(made, "test", configured("rig_paper").parent))) == bool(words)
    assert usual(rig)["disturbance"]["position_gain"] == pytest.approx(gain, rel=1e-2)


def test_a_single_rod_is_asked_for_half_of_its_pull():
    p, supply = SINGLE_ROD.cylinder.parameters, SINGLE_ROD.plant.supply_pressure
    pull = p.area_b * supply - p.area_a * p.tank_pressure
    assert pull < p.area_a * supply - p.area_b * p.tank_pressure
    assert usual(SINGLE_ROD)["reference"]["amplitude"] == pytest.approx(0.5 * pull, rel=1e-2)


@pytest.mark.long
@pytest.mark.parametrize("law", ["fasmc", "fasmc_predictive"])
def test_the_defaults_hold_the_force_of_a_single_rod_against_a_moving_actuator(law):
    rig = SINGLE_ROD.with_effects(COUPLING)
    assert stepped_run(task_of(rig, law).spec).largest() < 0.01 * usual(rig)["reference"]["amplitude"]


@pytest.mark.parametrize(("error", "gain_db", "phase", "factor"), [
    (0.05, 6.0, 30.0, 1.0), (0.1, 6.0, 30.0, 2.0), (0.0, 2.5, 30.0, 1.4), (0.0, 6.0, 14.3, 1.4), (0.1, 2.5, 14.3, 2.8),
])  # fmt: skip
def test_lacking_margins_and_an_unsteady_force_count_as_a_larger_error(error, gain_db, phase, factor):
    trial = Trial({}, 1.0, 1.0, 1.0, error, LoopMargins(gain_db, math.inf, phase, 0.0))
    assert math.exp(trial.score(Wanted(6.0, 30.0))) == pytest.approx(factor, rel=0.02)
    assert trial.lacking(Wanted(0.0, 0.0)) == pytest.approx(math.log(max(error / 0.05, 1.0)))


def test_six_decibels_and_thirty_degrees_are_nearly_the_same_distance():
    gain, phase = tuning.distances(6.0, 30.0)
    assert gain == pytest.approx(phase, rel=0.04)
    assert tuning.distances(math.inf, math.inf) == pytest.approx((1.0, 2.0))


def test_without_an_experiment_the_drawn_rigs_have_other_frequencies():
    task = task_of(RIG, "fasmc", period=5e-4)
    assert len(task.others) == tuning.RIGS
    frequencies = {other.reference.parameters.frequency for other in (task.spec, *task.others)}
    assert len(frequencies) == 1 + tuning.RIGS
    speeds = [
        signal.amplitude * signal.frequency
        for signal in (each.disturbance.signal.parameters for each in (task.spec, *task.others))
    ]
    assert max(speeds) <= 1.01 * speeds[0]
    assert all(other.settings == task.spec.settings for other in task.others)
    assert task_of(RIG, "fasmc", SHORT).others == ()


@pytest.mark.parametrize(("errors", "held", "worse"), [
    ((11.0, 12.0), 0.0, True), ((9.0, 30.0), 0.0, False), ((6.0, 7.0), 0.1, True), ((9.0, 9.0, 60.0), 0.0, True),
])  # fmt: skip
def test_a_set_is_given_up_when_each_run_or_their_sum_is_worse(errors, held, worse):
    best = Trial({}, 10.0, 10.0, 10.0, 0.0, WIDE, (10.0, 10.0, 10.0, 10.0))
    found = Trial({}, 0.0, sum(errors) / 4.0, 0.0, held, WIDE, errors)
    assert tuning._worse(found, best, Wanted()) == worse


@pytest.mark.parametrize(("error", "worse"), [(12.0, False), (13.0, True)])
def test_a_set_with_the_margins_asked_for_is_not_given_up_for_up_to_a_quarter_more_error(error, worse):
    lacking = LoopMargins(5.9, math.inf, 28.0, 0.01)
    best = Trial({}, 10.0, 10.0, 10.0, 0.0, lacking, (10.0,) * 4)
    found = Trial({}, 0.0, error, error, 0.0, WIDE, (error,) * 4)
    assert tuning._worse(found, best, Wanted()) == worse
    assert tuning._worse(found._replace(margins=lacking), best, Wanted())


@pytest.fixture(scope="module")
def tuned():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "MAX_TRIALS", 5)
        patch.setattr(tuning, "SPEEDS", (0.5, 1.0))
        return tune(task_of(RIG, "fasmc", SHORT), wanted=Wanted(3.0, 20.0), uncertainty=0.0, jobs=1)


@pytest.mark.parametrize(("error", "taken"), [(11.5, True), (11.8, False)])
def test_margins_asked_for_are_kept_where_they_cost_up_to_a_quarter_more_error(error, taken):
    search = object.__new__(tuning._Search)
    search._wanted = Wanted()
    lacking = Trial({}, 9.0, 9.0, 9.0, 0.0, LoopMargins(5.9, math.inf, 28.0, 0.01))
    whole = Trial({}, error, error, error, 0.0, WIDE)
    search.trials = [lacking, whole]
    assert search.choice() is lacking
    # The margins that the first lacks count as an error of 3 %.
    assert search.choice(tuning.AFFORDED) is (whole if taken else lacking)


def test_the_search_finds_less_error_with_the_margins_asked_for(tuned):
    assert tuned.chosen.error < 0.9 * tuned.default.error
    assert tuned.holds
    assert tuned.chosen.gain_db >= 3.0
    # Without noise, all runs on the rig of the file are equal.
    assert stepped_run(tuned.spec).largest() == pytest.approx(tuned.chosen.error)
    assert {limit.removed for limit in tuned.limits} >= {"friction", "sampling", "motion of the actuator under test"}
    assert len(tuned.curve) == 2


def test_the_files_give_the_numbers_found(tuned):
    numbers = tuned.chosen.numbers
    spec = spec_from_mapping(
        parse_yaml(experiment_text(tuned), "experiment", "spec"), "experiment", configured("rig_paper").parent
    )
    assert {name: getattr(spec.controller.parameters, name) for name in numbers} == pytest.approx(numbers)
    [(node, content)] = parse_yaml(parameters_text(tuned), "parameters", "parameters").items()
    assert node.endswith("fasmc_node")
    assert content["ros__parameters"] == pytest.approx(numbers, rel=1e-5)
    assert document(tuned)["chosen"]["max_error_n"] == tuned.chosen.error


def test_far_from_the_causal_limit_the_costliest_limitation_is_named(tuned):
    far = tuned._replace(causal_limit=0.1 * tuned.chosen.error, limits=(Limit("friction", 0.2 * tuned.chosen.error),))
    [said] = [remark for remark in _remarks(far, ()) if "causal limit" in remark]
    assert "10.0 times" in said
    assert "without friction" in said
    assert not any("causal limit" in remark for remark in _remarks(far._replace(causal_limit=tuned.chosen.error), ()))


@pytest.mark.long
def test_a_lost_force_is_a_result_with_advice(monkeypatch):
    monkeypatch.setattr(tuning, "MAX_TRIALS", 1)
    monkeypatch.setattr(tuning, "SPEEDS", (1.0,))
    stronger = {"name": "force", "signal": {"name": "constant", "value": 6e4}}
    found = tune(task_of(RIG, "fasmc", {**SHORT, "disturbance": stronger}), uncertainty=0.0, jobs=1)
    assert found.lost
    assert not found.holds
    assert "smaller reference" in found.remarks[0]
