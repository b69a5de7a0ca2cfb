"""Terms found in recordings of the truth generator with effects that are on no list."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from ehls_ros.diagnosis.carried_over import carried_over
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.empirical import Proposal, candidates_of, concentrated, waves_along
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
    assert abs(term.reading.power.exponent - 2.0) < 3.0 * term.reading.power.std < 1.5
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
def test_nothing_is_found_where_a_named_cause_explains_the_error():
    found = diagnosed(coulomb_shift={"offset": 200.0})
    assert (found.verdict, found.term) == ("effect", None)


def test_the_part_of_a_range_that_holds_a_remainder_is_found():
    means = np.random.default_rng(2).uniform(-0.1, 0.1, 4000)
    low, high = concentrated(means, np.exp(-(((means - 0.03) / 0.004) ** 2)), -0.1, 0.1)
    assert -0.1 < low < 0.026
    assert 0.034 < high < 0.06
    assert concentrated(means, np.sin(20.0 * means), -0.1, 0.1) is None


def test_the_period_that_predicts_a_remainder_is_found():
    values = 0.065 * np.sin(np.linspace(0.0, 40.0, 3000))
    target, even = np.sin(2.0 * np.pi * values / 8.1e-3 + 0.4), np.arange(3000) // 100 % 2 == 0
    waves, share = waves_along(lambda signal: signal, values).strongest(target, even)
    assert float(np.ptp(values)) / waves == pytest.approx(8.1e-3, rel=0.01)
    assert share > 0.9


def test_a_proposal_is_tried_with_few_and_with_many_knots():
    few, many = candidates_of(Proposal(0.5, "empirical_leakage", "pressure", -1e6, 2e6, (-1.5e6, 2.5e6)))
    assert (len(few.free), len(many.free)) == (8, 16)
    use = many.use(np.arange(16.0) * 1e-6)
    assert use.parameters.per_pressure * -1e6 + use.parameters.offset == pytest.approx(0.0, abs=1e-12)
    assert use.parameters.lowest == pytest.approx(-0.5 / 3.0)
    assert use.parameters.highest == pytest.approx(1.0 + 0.5 / 3.0)
