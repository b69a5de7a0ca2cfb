"""The catalogue of experiments, and the discrimination of causes by the proposed ones."""

import itertools
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tiers import tiered

from ehls_ros.errors import BadInput
from ehls_ros.experiments import next_experiment as module
from ehls_ros.experiments import separation
from ehls_ros.experiments.catalogue import CATALOGUE, catalogue_spec, home_of, reach
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.next_experiment import MIN_SIGMA, next_experiment
from ehls_ros.experiments.spec import load_rig, load_spec, spec_from_mapping
from ehls_ros.physics.rig import EVERY_SENSED, SENSED, Rig, effects_from_list, rig_from_mapping, rig_to_mapping

WITHOUT_LOAD_CELL = ("position", "load_pressure", "spool_position")
BOTH_CHAMBERS = ("position", "pressure_a", "pressure_b", "spool_position")


@pytest.fixture(scope="module")
def rig(config) -> Rig:
    """The paper's rig with its sensors."""
    return load_rig(config / "rig_paper_measured.yaml")


def with_effect(rig: Rig, name: str, **values: float) -> Rig:
    return rig.with_effects(effects_from_list([{"name": name, **values}], "test"))


# Both causes of a pair give about the same force or flow in a first recording: at 0.1 m/s and 2 MPa.
CAUSES: dict[str, dict[str, float]] = {
    "constant_load": {"force": -400.0},
    "pressure_sensor_bias": {"bias": 1.54e5},
    "coulomb_shift": {"offset": 300.0},
    "pressure_dependent_friction": {"slope": 1.5e-4},
    "viscous_shift": {"added": 3e3},
    "internal_leakage_shift": {"added": 4.7e-12},
    "turbulent_leakage": {"coefficient": 6.6e-9},
}


def candidates(rig: Rig, *names: str) -> dict[str, Rig]:
    return {name: with_effect(rig, name, **CAUSES[name]) for name in names}


# --- the catalogue -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_experiment_runs_within_the_limits_and_follows(rig, name):
    spec = spec_from_mapping({**catalogue_spec(name, rig), "rig": rig_to_mapping(rig)}, "spec", Path())
    assert 5.0 <= spec.settings.duration <= 10.0
    run = run_in_process(spec)
    assert rig.limits.position[0] < np.min(run["position_m"]) <= np.max(run["position_m"]) < rig.limits.position[1]
    assert np.max(np.abs(run["force_n"])) < rig.limits.force
    assert not np.any(run["saturated"])
    late = run.time_s > 1.0
    if "force_reference_n" in run:
        wanted, followed = run["force_reference_n"][late], run["force_n"][late]
    else:
        wanted, followed = run["position_reference_m"][late], run["position_m"][late]
    assert np.std(followed - wanted) < 0.15 * np.std(wanted)


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_experiment_is_a_spec_file(rig, config, tmp_path, name):
    path = tmp_path / "next.yaml"
    mapping = {**catalogue_spec(name, rig), "rig": str(config / "rig_paper_measured.yaml")}
    path.write_text(yaml.safe_dump(mapping), encoding="utf-8")
    spec = load_spec(path)
    assert spec == spec_from_mapping({**mapping, "rig": rig_to_mapping(rig)}, "spec", Path())
    assert spec.settings.title.startswith("next experiment: ")


@pytest.mark.parametrize(
    "sections",
    [
        {"limits": {"force": 5e3, "position": [-0.05, 0.05]}},
        {"limits": {"position": [0.0, 0.6]}, "plant": {"spring_stiffness": 0.0}},
        {"plant": {"supply_pressure": 2.1e7, "piston_area": 8e-3}, "limits": {"force": 1.6e5, "load_pressure": 2.1e7}},
        {"friction": {"coulomb_force": 50.0, "static_force": 60.0}, "limits": {"velocity": 0.2}},
    ],
    ids=["small", "no spring", "large", "slow"],
)
def test_the_catalogue_suits_other_rigs(rig, sections):
    mapping = rig_to_mapping(rig)
    other = rig_from_mapping({**mapping, **{k: {**mapping[k], **v} for k, v in sections.items()}}, "rig")
    fit = []
    for name in CATALOGUE:
        experiment = module._Experiment(catalogue_spec(name, other), other)
        if not module._unfit(experiment.closed_loop(other), experiment, other):
            fit.append(name)
    # Without a spring a force moves the piston out of its stroke; experiments that follow a position remain.
    assert {"velocity_sweep", "presliding", "large_sine", "loaded_motion", "pressure_staircase"} <= set(fit), fit
    assert other.limits.position[0] < home_of(other) < other.limits.position[1]
    assert all(value >= 0.0 for value in reach(other)[1:])


def test_an_unknown_experiment_is_bad_input(rig):
    with pytest.raises(BadInput, match="velocity_sweep") as caught:
        catalogue_spec("velocity_swep", rig)
    assert "'velocity_swep'" in caught.value.what


# --- running along a record --------------------------------------------------------------------


def quiet(rig: Rig) -> Rig:
    return rig._replace(sensors={})


@pytest.mark.parametrize("name", ["force_steps", "pressure_staircase", "warm_velocity_sweep"])
def test_the_bench_is_the_loop(rig, name):
    mapping = catalogue_spec(name, rig)
    experiment = module._Experiment(mapping, quiet(rig))
    record = experiment.closed_loop(quiet(rig)).record
    run = run_in_process(spec_from_mapping({**mapping, "rig": rig_to_mapping(quiet(rig))}, "spec", Path()))
    names = ("position_m", "velocity_m_s", "load_pressure_pa", "spool_m", "force_n", "supply_pressure_pa", "oil_temperature_k")
    for column, signal in enumerate((*names, "valve_command_m")):
        assert np.allclose(record[:, column], run[signal], rtol=1e-9, atol=1e-12), signal


@pytest.mark.parametrize("name", ["force_chirp", "break_away"])
def test_a_model_along_its_own_record_is_right(rig, name):
    experiment = module._Experiment(catalogue_spec(name, rig), rig)
    other = with_effect(rig, "coulomb_shift", offset=300.0)
    record = experiment.closed_loop(other).record
    assert np.array_equal(experiment.along(other, record), record)
    assert np.max(np.abs(experiment.along(rig, record) - record)[:, SENSED.index("load_pressure")]) > 5e4


def test_an_error_of_the_force_balance_shows_in_the_pressure_and_one_of_the_flow_in_the_position(rig):
    experiment = module._Experiment(catalogue_spec("large_sine", rig), rig)
    record = experiment.closed_loop(rig).record
    late, fast = slice(4000, None), np.abs(record[4000:, SENSED.index("velocity")]) > 0.2
    position, pressure = SENSED.index("position"), SENSED.index("load_pressure")
    loaded = experiment.along(with_effect(rig, "constant_load", force=-400.0), record)[late] - record[late]
    # Less the loss of flow and velocity, and so of viscous friction, due to the higher pressure.
    assert np.mean(loaded[fast, pressure]) == pytest.approx(400.0 / 2.6e-3, rel=0.15)
    narrow = experiment.along(with_effect(rig, "valve_gain_shift", flow_gain=0.98), record)[late] - record[late]
    velocity = record[late, SENSED.index("velocity")]
    # 2 % of the velocity for as long as the model remembers.
    assert np.mean((narrow[:, position] / (-0.02 * velocity * separation.MEMORY))[fast]) == pytest.approx(1.0, abs=0.15)
    assert np.mean(np.abs(narrow[fast, pressure])) < 0.2 * 400.0 / 2.6e-3


# --- proposals ---------------------------------------------------------------------------------


# The physically right experiments for a pair: a proposal is one of these.
EXPECTED = {
    ("constant_load", "pressure_sensor_bias"): {"full_stroke", "large_sine"},
    ("coulomb_shift", "pressure_dependent_friction"): {"loaded_motion"},
    ("viscous_shift", "coulomb_shift"): {"velocity_sweep", "force_staircase", "fast_chirp"},
    ("internal_leakage_shift", "turbulent_leakage"): {"pressure_staircase"},
}


@pytest.fixture
def few(monkeypatch):
    """A catalogue of three, for tests that do not depend on its contents."""
    names = ("velocity_sweep", "pressure_staircase", "force_steps")
    monkeypatch.setattr(module, "CATALOGUE", {name: CATALOGUE[name] for name in names})


def better_explained(
    rig: Rig, rigs: dict[str, Rig], spec: dict[str, Any], true: str, seed: int, signals: tuple[str, ...] = WITHOUT_LOAD_CELL
) -> str:
    """Record an experiment with noise on a candidate's rig and return the candidate whose model is least wrong along it."""
    whole = spec_from_mapping({**spec, "rig": rig_to_mapping(rigs[true]), "seed": seed}, "spec", Path())
    run = run_in_process(whole._replace(controller_rig=rig))
    names = ["position_m", "velocity_m_s", "load_pressure_pa", "spool_m", "force_n", "supply_pressure_pa", "oil_temperature_k"]
    names += ["pressure_a_pa", "pressure_b_pa"] if rig.cylinder.law.CHAMBERS else []
    record = np.column_stack([*(run[name] for name in names), run["valve_command_m"]])
    experiment = module._Experiment(spec, rig)
    columns = [EVERY_SENSED.index(signal) for signal in signals]
    scale = separation.scale_of({true: record}, rigs, columns, {}, experiment.period)
    errors = {
        name: np.linalg.norm(
            separation.block_means(experiment.along(model, record) - record, columns, experiment.period, 1000) / scale
        )
        for name, model in rigs.items()
    }
    return min(errors, key=lambda name: errors[name])


@pytest.fixture(scope="module")
def proposed(rig):
    """The proposal for a pair recorded without a load cell, searched for once."""
    return cache(lambda *pair: next_experiment(candidates(rig, *pair), signals=WITHOUT_LOAD_CELL))


@pytest.mark.parametrize("pair", tiered(EXPECTED, ("coulomb_shift", "pressure_dependent_friction")), ids="-".join)
def test_the_proposal_separates_the_pair(rig, proposed, pair):
    rigs = candidates(rig, *pair)
    proposal = proposed(*pair)
    experiment = proposal.experiment
    assert proposal.reason == ""
    assert experiment.name in EXPECTED[pair]
    (separation,) = experiment.separation
    assert {separation.one, separation.other} == set(pair)
    assert separation.sigma > 5.0 * MIN_SIGMA
    for true, seed in itertools.product(pair, (1, 2)):
        assert better_explained(rig, rigs, experiment.spec, true, seed) == true


@pytest.mark.long
def test_the_best_is_not_what_any_experiment_does(proposed):
    proposal = proposed("internal_leakage_shift", "turbulent_leakage")
    judged = {entry.name: entry.sigma for entry in proposal.considered}
    assert set(judged) == set(CATALOGUE)
    assert [entry.sigma for entry in proposal.considered] == sorted(judged.values(), reverse=True)
    assert proposal.considered[0].name == proposal.experiment.name
    assert np.median(list(judged.values())) < 0.5 * judged[proposal.experiment.name]


@pytest.mark.long
def test_a_load_cell_tells_a_load_from_a_bias_at_once(rig, proposed):
    without = proposed("constant_load", "pressure_sensor_bias").experiment
    with_it = next_experiment(candidates(rig, "constant_load", "pressure_sensor_bias")).experiment
    assert with_it.separation[0].sigma > 2.0 * without.separation[0].sigma


@pytest.mark.long
def test_an_experiment_tells_on_which_side_a_single_rod_leaks(config):
    single = load_rig(config / "rig_single_rod.yaml")
    rigs = {side: with_effect(single, "external_leakage", **{side: 3e-13}) for side in ("first", "second")}
    experiment = next_experiment(rigs, signals=BOTH_CHAMBERS).experiment
    assert experiment.separation[0].sigma > 5.0 * MIN_SIGMA
    assert "pressure in" in experiment.why
    for true, seed in itertools.product(rigs, (1, 2)):
        assert better_explained(single, rigs, experiment.spec, true, seed, BOTH_CHAMBERS) == true


def test_pressures_of_chambers_are_recorded_on_a_single_rod_only(rig):
    with pytest.raises(BadInput, match=r"signal 'pressure_a' is unknown"):
        next_experiment(candidates(rig, "viscous_shift", "coulomb_shift"), signals=BOTH_CHAMBERS)


@pytest.mark.long
def test_of_three_the_worst_pair_decides(rig, monkeypatch):
    rigs = candidates(rig, "coulomb_shift", "pressure_dependent_friction", "viscous_shift")
    done: list[tuple[int, int]] = []
    runs: list[float] = []

    def counted(self, *arguments, run=module._Experiment._run):
        runs.append(self.spec.settings.duration)
        return run(self, *arguments)

    monkeypatch.setattr(module._Experiment, "_run", counted)
    proposal = next_experiment(rigs, signals=WITHOUT_LOAD_CELL, progress=lambda *count: done.append(count))
    # Each experiment takes three runs and six along their records; parameters are fitted to the most promising one alone.
    assert len(runs) < 20 * len(CATALOGUE)
    assert done == [(n + 1, len(CATALOGUE)) for n in range(len(CATALOGUE))]
    sigmas = [pair.sigma for pair in proposal.experiment.separation]
    assert len(sigmas) == 3
    assert sigmas == sorted(sigmas)
    assert sigmas[0] == max(entry.sigma for entry in proposal.considered if not entry.note)
    assert {proposal.experiment.separation[0].one, proposal.experiment.separation[0].other} <= set(rigs)


def test_the_sentence_names_signal_moment_and_motion(proposed):
    pair = "coulomb_shift", "pressure_dependent_friction"
    experiment = proposed(*pair).experiment
    for part in (
        "load pressure",
        " bar (",
        " sigma)",
        " s, where the piston moves at ",
        " mm/s under a driving force of ",
        " kN",
    ):
        assert part in experiment.why
    assert all(name in experiment.why for name in pair)
    assert "\n" not in experiment.why


@pytest.mark.long
def test_only_warm_oil_tells_friction_from_temperature(rig, monkeypatch):
    warm = with_effect(rig, "temperature_dependent_friction", coulomb_slope=15.0, reference_temperature=293.15)
    proposal = next_experiment({"temperature": warm, **candidates(rig, "coulomb_shift")}, parameter_std=0.02)
    assert proposal.experiment.name == "warm_velocity_sweep"
    others = [entry.sigma for entry in proposal.considered if entry.name != "warm_velocity_sweep"]
    assert max(others) < 1e-3
    # If the data so far do not constrain the parameters, either explains a single record with warm oil.
    monkeypatch.setattr(module, "CATALOGUE", {"warm_velocity_sweep": CATALOGUE["warm_velocity_sweep"]})
    loose = next_experiment({"temperature": warm, **candidates(rig, "coulomb_shift")}, parameter_std=10.0)
    assert loose.considered[0].sigma < proposal.considered[0].sigma / 2.0


@pytest.mark.usefixtures("few")
def test_what_its_own_parameters_explain_separates_nothing(rig):
    rigs = {"one": with_effect(rig, "coulomb_shift", offset=300.0), "other": with_effect(rig, "coulomb_shift", offset=330.0)}
    proposal = next_experiment(rigs, parameter_std=0.1)
    assert proposal.experiment is None
    assert "separates the candidates by" in proposal.reason
    assert proposal.considered[0].sigma < MIN_SIGMA
    assert next_experiment(rigs, parameter_std=1e-4).experiment is not None


@pytest.mark.usefixtures("few")
def test_candidates_that_are_the_same_are_told_so(rig):
    proposal = next_experiment({"one": rig, "other": rig})
    assert proposal.experiment is None
    assert proposal.reason == "the candidates do not differ in any experiment of the catalogue"
    assert all(entry.sigma == 0.0 for entry in proposal.considered)


def test_one_candidate_needs_no_experiment(rig):
    proposal = next_experiment({"one": rig})
    assert proposal.experiment is None
    assert "nothing to separate" in proposal.reason


@pytest.mark.usefixtures("few")
def test_noise_in_the_data_makes_the_separation_smaller(rig):
    rigs = candidates(rig, "viscous_shift", "coulomb_shift")
    clean = next_experiment(rigs, signals=["load_pressure"]).experiment
    noisy = next_experiment(rigs, signals=["load_pressure"], noise={"load_pressure": 2e5}).experiment
    assert noisy.separation[0].sigma < 0.5 * clean.separation[0].sigma
    blind = next_experiment(rigs, signals=["load_pressure"], noise={"load_pressure": 1e8})
    assert blind.experiment is None


@pytest.mark.usefixtures("few")
def test_a_short_limit_leaves_out_what_is_longer(rig):
    rigs = candidates(rig, "viscous_shift", "coulomb_shift")
    proposal = next_experiment(rigs, duration_limit=7.5)
    assert proposal.experiment.spec["duration"] <= 7.5
    assert any("more than 7.5 s" in entry.note for entry in proposal.considered)
    none = next_experiment(rigs, duration_limit=1.0)
    assert none.experiment is None
    assert none.reason.startswith("no experiment of the catalogue can be done on this rig: of velocity_sweep, it takes 7.1 s")


@pytest.mark.long
def test_an_experiment_that_a_candidates_loop_does_not_bear_is_left_out(rig, monkeypatch):
    tried = ("force_staircase", "force_steps", "force_chirp", "velocity_sweep")
    monkeypatch.setattr(module, "CATALOGUE", {name: CATALOGUE[name] for name in tried})
    rigs = {"delay": with_effect(rig, "command_delay", delay=0.003), **candidates(rig, "coulomb_shift")}
    proposal = next_experiment(rigs)
    left_out = {entry.name: entry.note for entry in proposal.considered if entry.sigma is None}
    # The law is unstable with a delay of 3 ms.
    assert set(left_out) == {"force_staircase", "force_steps", "force_chirp"}
    assert "with delay, its force reaches" in left_out["force_steps"]
    assert proposal.experiment.name == "velocity_sweep"


@pytest.mark.usefixtures("few")
def test_a_rig_that_nothing_can_be_done_on_is_told_so(rig):
    mapping = rig_to_mapping(rig)
    closed = rig_from_mapping({**mapping, "limits": {**mapping["limits"], "spool": 1e-9}}, "rig")
    proposal = next_experiment(candidates(closed, "viscous_shift", "coulomb_shift"))
    assert proposal.experiment is None
    assert proposal.reason.startswith("no experiment of the catalogue can be done on this rig: ")
    assert all(entry.note for entry in proposal.considered)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"signals": ["pressure"]}, "'pressure'"),
        ({"signals": []}, "signals is empty"),
        ({"noise": {"loud": 1.0}}, "'loud'"),
        ({"noise": {"force": -1.0}}, "noise of force is -1"),
        ({"noise": {"force": float("nan")}}, "noise of force is nan"),
        ({"duration_limit": 0.0}, "duration_limit is 0"),
        ({"duration_limit": float("nan")}, "duration_limit is nan"),
        ({"parameter_std": -0.1}, "parameter_std is -0.1"),
    ],
)
def test_wrong_arguments_are_bad_input(rig, arguments, what):
    with pytest.raises(BadInput) as caught:
        next_experiment({"one": rig, "other": rig}, **arguments)
    assert what in caught.value.what


def test_what_a_parameter_explains_is_taken_off_as_far_as_the_data_let_it_move():
    shape = np.array([[1.0], [2.0], [-1.0]])
    base = separation.Difference(3.0 * shape + np.array([[1.0], [0.0], [1.0]]), np.ones((3, 1)))
    stepped = [base.blocks + separation.STEP * shape]
    free, held = (separation.unexplained(base, stepped, std) for std in (1e6, 1e-6))
    # The rest is orthogonal to the parameter's own difference.
    assert np.sum(free.blocks * shape) == pytest.approx(0.0, abs=1e-6)
    assert free.sigma == pytest.approx(np.sqrt(2.0), rel=1e-6)
    assert held.sigma == pytest.approx(base.sigma, rel=1e-6)
    assert separation.unexplained(base, [], 0.1) is base


def test_the_start_is_left_out_until_friction_has_forgotten_it():
    record = np.zeros((4000, len(SENSED) + 1))
    record[:, SENSED.index("velocity")] = 1e-3
    assert separation.start_of(record, 1e-3, 1e-4) == round(separation.WORN_IN * 1e-4 / 1e-6) - 1
    assert separation.start_of(record, 1e-3, 1e-6) == round(separation.SETTLING / 1e-3)
    assert separation.start_of(np.zeros_like(record), 1e-3, 1e-6) == len(record)
