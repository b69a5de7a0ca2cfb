"""Terms found in recordings of the truth generator with effects that are on no list."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from plain_evidence import MASS, assessed, evidence_of

from ehls_ros.arrays import in_python
from ehls_ros.diagnosis import empirical
from ehls_ros.diagnosis.carried_over import carried_over
from ehls_ros.diagnosis.dependence import play_of
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.empirical import asked_about, candidate_of, formula_of
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.hypotheses import extended
from ehls_ros.diagnosis.loss import closed
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.diagnosis.term_formula import Formula
from ehls_ros.diagnosis.term_proposals import (
    FRICTION,
    Proposal,
    concentrated,
    hats,
    lag_of,
    proposals,
    supported,
    waves_along,
)
from ehls_ros.physics.effects._table import looked_up
from ehls_ros.physics.plant import X
from ehls_ros.physics.rig import rig_from_mapping, rig_to_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import record

RIG_FILE = yaml.safe_load((Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml").read_text(encoding="utf-8"))
RIG = rig_from_mapping(RIG_FILE, "rig_paper_measured.yaml")


def recorded(experiment, seed=11, **hidden):
    made = record(RIG_FILE, hidden, experiment, seed=seed, duration=20.0)
    return Trajectory(made.time, dict(made.columns))


def diagnosed(**hidden):
    return diagnose(recorded("rich", **hidden), RIG)


@pytest.mark.long
def test_a_drag_that_grows_with_the_square_of_the_speed_is_found_as_such():
    found = diagnosed(quadratic_drag={"coefficient": 2e4})
    term = found.term
    assert (found.verdict, found.unknown_stage, found.causes) == ("unknown", "force_balance", ())
    assert (term.effect, term.argument, term.period) == ("empirical_force", "velocity_m_s", None)
    assert term.closed > 0.95
    assert term.reading.power.symmetry == "odd"
    assert term.reading.power.exponent == pytest.approx(2.0, abs=0.05)
    assert {shape.name for shape in term.formula} <= {"level", "power"}
    fast = np.abs(term.at) > 0.1
    assert term.values[fast] - np.mean(term.values) == pytest.approx(-2e4 * term.at[fast] * np.abs(term.at[fast]), rel=0.25)
    assert found.gain.closed_fraction > 0.9
    assert [use.name for use in found.extended.effects] == ["empirical_force"]
    assert rig_from_mapping(rig_to_mapping(found.extended), "extended").effects == found.extended.effects
    other = carried_over(found, recorded("random", seed=12, quadratic_drag={"coefficient": 2e4}), "other")
    assert set(other) == {"force"}
    assert other["force"].closed > 0.9
    assert carried_over(found, recorded("random", seed=13), "a healthy one")["force"].closed < -0.9


@pytest.mark.long
def test_a_force_that_repeats_along_the_stroke_has_its_period():
    cogging = {"force": 400.0, "length": 7.3e-3, "speed": 1e-2, "phase": 1.0}
    term = diagnosed(ratchet_cogging=cogging).term
    assert (term.effect, term.argument) == ("empirical_force", "position_m")
    assert term.period.value == pytest.approx(7.3e-3, rel=1e-3)
    assert term.direction > 0.0
    assert term.closed > 0.8


@pytest.mark.long
def test_what_depends_on_the_changes_of_a_signal_has_its_time_constant():
    term = diagnosed(swelling_hose={"compliance": 5e-12, "time_constant": 0.5}).term
    assert (term.effect, term.argument) == ("empirical_leakage", "load_pressure_pa")
    assert term.lag.value == pytest.approx(0.5, rel=0.05)
    assert term.closed > 0.95


@pytest.mark.long
def test_a_term_is_not_lost_to_named_causes_that_imitate_it_together():
    found = diagnosed(creeping_spring={"stiffness": 4800.0, "time_constant": 1.3})
    assert (found.verdict, found.causes, found.term.effect) == ("unknown", (), "empirical_force")
    assert found.term.lag.value == pytest.approx(1.3, rel=0.05)


@pytest.mark.long
def test_an_error_of_a_sensor_is_found_as_one_of_that_sensor():
    found = diagnosed(pressure_sensor_bow={"deviation": 1.2e5})
    term = found.term
    assert (found.unknown_stage, term.effect, term.argument) == ("sensors", "empirical_pressure_reading", "load_pressure_pa")
    assert term.reading.power.exponent == pytest.approx(2.0, abs=0.1)
    assert set(found.gain.channels) > {"cell"}
    assert found.gain.closed_fraction > 0.95


@pytest.mark.long
def test_a_hum_of_a_thousand_periods_is_a_sine_of_its_amplitude():
    term = diagnosed(mains_hum={"amplitude": 3e-5, "frequency": 50.0, "phase": 4.7}).term
    assert (term.effect, term.argument, [shape.name for shape in term.formula]) == ("empirical_spool", "time_s", ["wave"])
    assert term.period.value == pytest.approx(0.02, rel=1e-5)
    assert term.reading.amplitude == pytest.approx(3e-5, rel=0.05)


@pytest.mark.long
def test_a_spool_of_limited_speed_is_found():
    found = diagnosed(spool_slew_limit={"rate": 8e-4})
    assert (found.term.effect, found.term.argument, found.term.error) == ("empirical_spool", "spool_m", True)
    assert found.gain.closed_fraction > 0.99


@pytest.mark.long
def test_a_friction_that_follows_the_temperature_is_no_other_than_a_drift_where_that_followed_the_time():
    (cause,) = diagnosed(temperature_dependent_friction={"coefficient": 0.0276, "warming": -20.0, "time_constant": 31.0}).causes
    assert cause.name == "temperature_dependent_friction"
    assert "empirical_force" in cause.equivalent_to


@pytest.mark.long
def test_nothing_is_found_where_a_named_cause_explains_the_error():
    found = diagnosed(coulomb_shift={"offset": 200.0})
    assert (found.verdict, found.term) == ("effect", None)


def test_the_part_of_a_range_that_holds_a_remainder_is_found():
    means = np.random.default_rng(2).uniform(-0.1, 0.1, 4000)
    low, high = concentrated(means, np.exp(-(((means - 0.03) / 0.004) ** 2)), -0.1, 0.1)
    assert -0.1 < low < 0.026
    assert 0.034 < high < 0.06
    assert concentrated(means, np.sin(20.0 * means), -0.1, 0.1) is None


def test_friction_that_is_higher_at_one_place_is_proposed_over_the_position():
    patch = {"force": 1000.0, "position": -0.01, "width": 0.01}
    record = prepare(recorded("rich", stick_patch=patch), RIG, "patch")
    evidence = gather(record, RIG, setup(record, RIG), 0)
    (asked,) = asked_about(evidence, "force_balance")
    best = proposals(asked, evidence.base.values["force"])[0]
    assert (best.effect, best.argument, best.periodic) == (FRICTION, "position", False)
    assert best.share > 0.5


def test_a_hysteresis_of_the_pressure_sensor_is_known_from_the_load_cell():
    record = prepare(recorded("rich", pressure_sensor_hysteresis={"half_width": 5e4}), RIG, "hysteresis")
    evidence = gather(record, RIG, setup(record, RIG), 0)
    (asked,) = (asked for asked in asked_about(evidence, "sensors") if asked.channel == "cell")
    best = max(proposals(asked, evidence.base.values["cell"]), key=lambda p: p.share)
    assert (best.effect, best.argument) == ("empirical_pressure_reading", "pressure")
    assert best.play > 0.0
    term = candidate_of(best._replace(low=-5e4, high=5e4, play=1e5))
    values = np.array([1.0, *np.linspace(5e4, -5e4, best.knots)])
    after = evidence.residuals(evidence.comparison(), extended(RIG, (term,), values))
    for channel in ("cell", "volume", "force"):
        assert closed(evidence.base.values[channel], after.values[channel], evidence.noise[channel]) > 0.95


def test_the_period_that_predicts_a_remainder_is_found():
    values = 0.065 * np.sin(np.linspace(0.0, 40.0, 3000))
    target, even = np.sin(2.0 * np.pi * values / 8.1e-3 + 0.4), np.arange(3000) // 100 % 2 == 0
    waves, share = waves_along(lambda signal: signal, values, even).strongest(target)
    assert float(np.ptp(values)) / waves == pytest.approx(8.1e-3, rel=0.01)
    assert share > 0.9


def test_a_whole_fraction_of_a_period_is_preferred():
    values = 0.065 * np.sin(np.linspace(0.0, 40.0, 3000))
    angle = 2.0 * np.pi * values / 8.1e-3 + 0.4
    target, even = np.sin(angle) + 0.1 * np.random.default_rng(1).standard_normal(3000), np.arange(3000) // 100 % 2 == 0
    waves, _ = waves_along(lambda signal: signal, values, even).strongest(target)
    assert float(np.ptp(values)) / waves == pytest.approx(8.1e-3, rel=0.01)


def test_a_proposal_is_a_table_over_its_range():
    many = candidate_of(Proposal(0.5, "empirical_leakage", "pressure", -1e6, 2e6, (-1.5e6, 2.5e6), 16))
    assert len(many.free) == 16
    use = many.use(np.arange(16.0) * 1e-6)
    assert use.parameters.per_pressure * -1e6 + use.parameters.offset == pytest.approx(0.0, abs=1e-12)
    assert use.parameters.lowest == pytest.approx(-0.5 / 3.0)
    assert use.parameters.highest == pytest.approx(1.0 + 0.5 / 3.0)


def test_a_proposal_of_two_signals_with_a_memory_has_them_in_its_parameters():
    proposal = Proposal(0.5, "empirical_spool", "displacement", -1e-4, 1e-4, (-1e-4, 1e-4), factor="error", factor_reach=2e-5)
    p = candidate_of(proposal).use(np.zeros(8)).parameters
    assert p.per_spool == -p.per_error == pytest.approx(1.0 / 2e-4)
    assert p.times_error == pytest.approx(1.0 / 2e-5)
    lagged = candidate_of(Proposal(0.5, "empirical_leakage", "pressure", -1e6, 1e6, (-1e6, 1e6), lag=0.2))
    assert lagged.free[0] == "memory"
    assert lagged.starts[0, 0] == pytest.approx(0.2)


def test_a_formula_goes_on_beyond_the_data_and_a_table_does_not():
    proposal = Proposal(0.5, "empirical_force", "velocity", -0.1, 0.3, (-0.1, 0.3), 8)
    formula = formula_of(proposal, Formula({"power": 1.0}))
    table = candidate_of(proposal)
    p, q = (c.use(c.starts[0]).parameters for c in (formula, table))
    assert [(end - p.offset) / p.per_velocity for end in (p.lowest, p.highest)] == pytest.approx([-0.3, 0.5])
    assert [(end - q.offset) / q.per_velocity for end in (q.lowest, q.highest)] == pytest.approx([-0.1, 0.3])


@pytest.mark.parametrize("periodic", [False, True])
def test_a_remainder_is_predicted_by_the_same_table_that_the_effect_has(periodic):
    low = 0.0 if periodic else -0.01
    proposal = Proposal(0.5, "empirical_force", "position", low, 0.03, (-0.05, 0.07), 8, periodic=periodic)
    values = np.random.default_rng(4).standard_normal(8)
    candidate = candidate_of(proposal)
    p = candidate.use(np.concatenate([candidate.starts[0][: len(candidate.free) - 8], values])).parameters
    at = np.linspace(-0.05, 0.07, 50)
    states = np.zeros((len(at), 8))
    states[:, X] = at
    of_effect = [in_python(looked_up)(0.0, 0.0, y, np.zeros(8), np.zeros(1), p) for y in states]
    assert values @ np.stack(list(hats(proposal, at, 8))) == pytest.approx(of_effect)


def test_a_lag_and_a_play_begin_at_zero():
    step = np.ones(4000)
    assert lag_of(step, 0.5, 1e-3)[500] == pytest.approx(1.0 - np.exp(-1.0), rel=1e-6)
    wave = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.0, 50)])
    assert wave - play_of(wave, 0.4) == pytest.approx(
        np.clip(np.concatenate([wave[:50], wave[50:] - 0.6 - 0.2 + 0.0]), -0.2, 0.2)
    )


def test_a_table_has_data_at_each_of_its_values():
    even = np.linspace(0.0, 1.0, 1000)
    assert [supported(even, 0.0, 1.0, knots) for knots in (4, 16)] == [4, 16]
    pressures = np.concatenate([level + 0.1 * (even - 0.5) for level in (1.0, 3.0, 5.0, 7.0)])
    assert supported(pressures, 0.95, 7.05, 16) == 4
    assert supported(np.concatenate([even, 9.0 + even]), 0.0, 10.0, 16) == 2


@pytest.mark.parametrize(("other", "equal"), [(500.0, True), (300.0, False)], ids=["as much", "less in one"])
def test_hypotheses_are_equally_good_only_if_they_explain_each_channel_equally(other, equal):
    # All of what is explained of one channel is less than a fiftieth of the other's.
    def with_term(force):
        gain = {"force": np.full(12, force / 12.0), "cell": np.full(12, 1e5 / 12.0)}
        return assessed((MASS,), {"force": np.zeros(12), "cell": np.zeros(12)}, [1.0], gain)

    evidence = evidence_of({"force": np.zeros(12), "cell": np.zeros(12)})
    found = empirical._equally_good(evidence, [with_term(500.0), with_term(other)], assessed((), {}, gain={}))
    assert found == ([0, 1] if equal else [0])
