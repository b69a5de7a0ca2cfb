"""Changes since a baseline: rigs with wrong files, or that no model describes, against their own past."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.diagnosis import stages
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.excitation import mass_observable
from ehls_ros.diagnosis.healthy_variation import NOT_LEARNT, OUTSIDE, describe, learn_healthy_variation
from ehls_ros.diagnosis.record import prepare
from ehls_ros.errors import BadInput
from ehls_ros.experiments.baseline import diagnose_against
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EffectUse, rig_from_mapping
from ehls_ros.trajectory import Preparation, Trajectory
from truth_generator import FormErrors, record

ROOT = Path(__file__).parents[2]
COLUMNS = ("position_m", "load_pressure_pa", "disturbance_force_n")
SECONDS = 8.0


@pytest.fixture(scope="module")
def wrong_rig(rig_file):
    """The rig file 30 % off in three coefficients."""
    data = copy.deepcopy(rig_file)
    data["friction"]["coulomb_force"] *= 1.3
    data["friction"]["static_force"] *= 1.3
    data["friction"]["viscous_coefficient"] *= 0.7
    data["plant"]["moving_mass"] *= 1.3
    return rig_from_mapping(data, "wrong.yaml")


@pytest.fixture(scope="module")
def run(recorded):
    """Record the true rig: hidden effects, experiment, seed."""

    def run(effects, experiment, seed, seconds=SECONDS):
        made = recorded(effects, experiment, seed=seed, duration=seconds, columns=COLUMNS)
        return Trajectory(made.time, made.columns)

    return run


@pytest.fixture(scope="module")
def healthy(run):
    return run({}, "rich", 1)


def against(new, baselines, rig):
    return diagnose_against(new, baselines, rig, "new", threads=1)


@pytest.mark.long
def test_a_wrong_rig_file_is_no_change(run, healthy, wrong_rig, rig):
    found = against(run({}, "rich", 2), [healthy], wrong_rig)
    assert (found.verdict, found.causes) == ("consistent", ())
    fitted = found.baseline.coefficients["coulomb_force"]
    assert fitted.given == wrong_rig.friction.coulomb_force
    assert fitted.fitted.value == pytest.approx(rig.friction.coulomb_force, rel=0.02)
    assert found.rig.plant.moving_mass == pytest.approx(rig.plant.moving_mass, rel=0.02)


@pytest.mark.long
def test_what_changed_is_named_with_its_size(run, wrong_rig):
    # In 8 s, some recordings have a single sharp turn, whose noise moves the size by 7 %.
    seconds = 2.0 * SECONDS
    found = against(run({"coulomb_shift": {"offset": -200.0}}, "rich", 3, seconds), [run({}, "rich", 1, seconds)], wrong_rig)
    assert (found.verdict, found.causes[0].name) == ("effect", "coulomb_shift")
    offset = found.causes[0].parameters["offset"]
    assert offset.value == pytest.approx(-200.0, abs=6.0)
    assert abs(offset.value + 200.0) < 4.0 * offset.std
    assert [use.name for use in found.extended.effects] == ["coulomb_shift"]


def evidence(made, rig):
    record = prepare(Trajectory(made.time, made.columns), rig, "test")
    return gather(record, rig, stages.setup(record, rig), 0)


def test_a_stage_that_the_baselines_do_not_cover_says_so(recorded, rig):
    variation = learn_healthy_variation(
        [describe(evidence(recorded({}, "random", seed=1, duration=SECONDS, columns=COLUMNS), rig))]
    )
    judged = variation.judged(
        evidence(recorded({}, "paper_sine", seed=2, duration=SECONDS, columns=(*COLUMNS, "spool_m")), rig)
    )
    assert judged.channels == ()
    assert dict(judged.setup.why_not) == {"force_balance": OUTSIDE, "flow": NOT_LEARNT}


def test_a_load_cells_hysteresis_is_expected_where_motion_and_force_turn_apart(recorded, rig):
    """Without a disturbance, the force turns with the motion: a hysteresis then looks like an error over the velocity."""
    cell = FormErrors({"cell_play_width": 200.0, "cell_play_mean": 0.98, "cell_play": -0.3})
    columns = (*COLUMNS, "force_n")
    known = evidence(recorded({}, "random", seed=3, duration=30.0, columns=columns, forms=cell, disturbed=False), rig)
    variation = learn_healthy_variation([describe(known)])
    new = evidence(recorded({}, "rich", seed=4, duration=SECONDS, columns=columns, forms=cell), rig)
    expected = variation.expected(describe(new))["cell"]
    residual = new.base.values["cell"] * new.floor["cell"] / variation.channels["cell"].terms.size
    near = np.isfinite(expected.variance)
    assert np.std((residual - expected.mean)[near]) < 0.4 * np.std(residual[near])


@pytest.mark.parametrize(
    ("hidden", "use", "neutral"),
    [
        ({"internal_leakage_shift": {"factor": 1.9}}, ("internal_leakage_shift", "added", 0.9 * 4.7e-12), 0.0),
        ({"bulk_modulus_shift": {"factor": 0.5}}, ("bulk_modulus_shift", "factor", 0.5), 1.0),
    ],
    ids=["leakage", "bulk modulus"],
)
def test_allowances_take_no_share_of_a_change(recorded, rig, hidden, use, neutral):
    """All coefficients larger by one factor change a residual by itself: allowed freely, that halves any change."""

    columns = (*COLUMNS, "spool_m")
    variation = learn_healthy_variation(
        [describe(evidence(recorded({}, "rich", seed=1, duration=SECONDS, columns=columns), rig))]
    )
    judged = variation.judged(evidence(recorded(hidden, "rich", seed=3, duration=SECONDS, columns=columns), rig))
    name, parameter, true = use
    sizes = np.linspace(0.5, 1.5, 11)
    losses = []
    for size in sizes:
        values = EFFECTS.load(name).Parameters(**{parameter: neutral + size * (true - neutral)})
        changed = rig.with_effects((EffectUse(name, values),))
        losses.append(np.sum(judged.residuals(judged.comparison(), changed).values["volume"] ** 2))
    assert sizes[np.argmin(losses)] == pytest.approx(1.0, abs=0.11)


def test_a_pump_set_lower_is_named_with_its_size(rig_file, rig):
    """Coefficients may vary by 0.3 % between recordings: 17 standard deviations of that are no healthy variation."""
    columns = (*COLUMNS, "spool_m", "supply_pressure_pa")
    lower = copy.deepcopy(rig_file)
    lower["plant"]["supply_pressure"] *= 0.95
    healthy = [record(rig_file, {}, "rich", seed=seed, duration=SECONDS, columns=columns) for seed in (1, 2)]
    variation = learn_healthy_variation([describe(evidence(made, rig)) for made in healthy])
    new = record(lower, {}, "rich", seed=3, duration=SECONDS, columns=columns)
    found = diagnose(Trajectory(new.time, new.columns), rig, "new", threads=1, standard=variation)
    assert [cause.name for cause in found.causes] == ["supply_pressure_shift"]
    told = found.causes[0].parameters["factor"]
    assert told.value == pytest.approx(0.95, abs=1e-3)
    assert 1e-3 < told.std < 1e-2


def imperfect(trajectory, rig):
    """Return a recording of a rig with a force along the stroke and a drag that match no listed effect."""
    x = trajectory["position_m"]
    v = np.gradient(x, trajectory.time_s)
    v = np.convolve(v, np.ones(15) / 15.0, mode="same")
    more = 120.0 * np.sin(60.0 * x) + 2.0e4 * v**3
    pressure = trajectory["load_pressure_pa"] + more / rig.plant.piston_area
    return replace(trajectory, signals={**trajectory.signals, "load_pressure_pa": pressure})


@pytest.mark.long
def test_an_imperfect_rig_agrees_with_its_own_past(run, healthy, rig):
    found = against(imperfect(run({}, "rich", 4), rig), [imperfect(healthy, rig)], rig)
    assert found.verdict == "consistent"
    channel = found.baseline.channels["force"]
    # No coefficients of the model reproduce this rig.
    assert channel.fitted > 3.0 * channel.noise_floor
    assert channel.left < 0.5 * channel.fitted


@pytest.mark.long
def test_operating_points_never_seen_are_said_and_raise_no_alarm(run, rig):
    slow = imperfect(run({}, "slow_sweep", 5), rig)
    found = against(imperfect(run({}, "random", 5), rig), [slow], rig)
    assert found.verdict in ("consistent", "insufficient")
    beyond = {item.signal: item.beyond for item in found.baseline.coverage}
    assert beyond["velocity_m_s"] > 0.1
    assert any("outside the baseline's range" in remark and "velocity_m_s" in remark for remark in found.remarks)


@pytest.mark.long
def test_a_level_within_the_spread_of_two_baselines_is_no_change(run, rig):
    levels = [run({"coulomb_shift": {"offset": offset}}, "rich", seed) for offset, seed in ((-60.0, 7), (60.0, 8))]
    new = run({"coulomb_shift": {"offset": 40.0}}, "rich", 9)
    assert against(new, levels, rig).verdict == "consistent"
    one = against(new, levels[:1], rig)
    assert (one.verdict, one.causes[0].name) == ("effect", "coulomb_shift")
    assert one.causes[0].parameters["offset"].value == pytest.approx(100.0, abs=15.0)


def test_no_baseline_is_refused(healthy, rig):
    with pytest.raises(BadInput, match="no baseline"):
        against(healthy, [], rig)


def test_a_baseline_that_shows_nothing_is_refused(healthy, rig):
    blind = Trajectory(healthy.time_s, {"position_m": healthy["position_m"]})
    with pytest.raises(BadInput, match="baseline 1"):
        against(healthy, [blind], rig)


@pytest.fixture(scope="module")
def seal_rig():
    return load_rig(ROOT / "examples" / "seals" / "rig.yaml")


def seal(rig, level, seed, pressure=3e5, drift=0.0):
    """Return slow strokes to and fro at a held pressure: friction of some level, and the load cell's response to it."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 0.01)
    x = 0.016 * np.sin(2.0 * np.pi * t / 5.0)
    v = np.gradient(x, t)
    side = np.zeros(len(t))
    for i, step in enumerate(np.diff(x)):
        # Dahl's model: the seal yields by 0.2 mm before it slides.
        side[i + 1] = side[i] + (1.0 - side[i] * np.sign(step)) * step / 2e-4
    friction = level * (1.0 + drift * (t / t[-1] - 0.5)) * np.clip(side, -1.0, 1.0) + 20.0 * v
    p = pressure - 5e3 * side + 30.0 * rng.standard_normal(len(t))
    # The area differs slightly from the rig file's.
    load = 1.03 * rig.plant.piston_area * p - friction + 0.05 * rng.standard_normal(len(t))
    signals = {"position_m": x + 2e-6 * rng.standard_normal(len(t)), "load_pressure_pa": p, "disturbance_force_n": load}
    return Trajectory(t, signals, preparation=Preparation(measured=("disturbance_force_n",)))


@pytest.mark.long
def test_a_piston_pushed_slowly_does_not_show_its_mass(seal_rig, healthy, rig):
    def shown(recording, of):
        record = prepare(recording, of, "recording")
        return mass_observable(gather(record, of, stages.setup(record, of), seed=0))

    assert not shown(seal(seal_rig, 5.0, 1), seal_rig)
    assert shown(healthy, rig)


@pytest.mark.long
def test_friction_shows_in_a_load_cell_although_it_answers_to_it(seal_rig):
    found = against(seal(seal_rig, 6.5, 2), [seal(seal_rig, 5.0, 1)], seal_rig)
    assert found.names_causes
    assert "coulomb_shift" in {found.causes[0].name, *found.causes[0].equivalent_to}


@pytest.mark.long
def test_a_seal_that_drifts_may_have_drifted_on(seal_rig):
    drifted, steady = ([seal(seal_rig, 5.0, 1, drift=drift)] for drift in (0.15, 0.0))
    new = seal(seal_rig, 5.75, 2)
    assert against(new, drifted, seal_rig).verdict in ("consistent", "insufficient")
    assert against(new, steady, seal_rig).causes
