"""The truth generator: independent, neutral where required, visible where required, within its limits."""

import ast
import csv
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from tiers import tiered

import truth_generator
from truth_generator import EFFECTS, EXPERIMENTS, LISTED, OTHER_FORMS, OUTSIDE, degrade, draw_effect, draw_other_form, record
from truth_generator.recording import COLUMNS, SERVO_COLUMNS
from truth_generator.visibility import against, background, raw_difference

ROOT = Path(__file__).parents[2]
RIG = yaml.safe_load((ROOT / "config" / "rig_paper_measured.yaml").read_text(encoding="utf-8"))
DESIGN = {
    "valve": """valve_dead_zone valve_null_bias valve_gain_asymmetry valve_gain_shift valve_saturation valve_bandwidth_shift
        valve_second_order valve_hysteresis command_delay""",
    "flow": """supply_pressure_droop bulk_modulus_shift entrained_air internal_leakage_shift turbulent_leakage
        external_leakage""",
    "force_balance": """coulomb_shift coulomb_asymmetry viscous_shift viscous_asymmetry stribeck_shift
        presliding_stiffness_shift pressure_dependent_friction position_dependent_friction temperature_dependent_friction
        mass_shift spring_rate_shift spring_hardening hinge_backlash end_stop flexible_mode periodic_disturbance constant_load
        coupling_stiffness""",
    "sensors": """pressure_sensor_bias pressure_sensor_gain pressure_sensor_lag position_sensor_bias position_sensor_gain
        sensor_delay""",
}


def rng_for(name, seed=0):
    return np.random.default_rng([seed, *name.encode()])


def test_nothing_in_the_truth_imports_the_package():
    sources = sorted(Path(truth_generator.__file__).parent.rglob("*.py"))
    assert len(sources) >= 7
    for path in sources:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += (
                [node.value]
                if isinstance(node, ast.Constant) and isinstance(node.value, str) and "import" in node.value
                else []
            )
            assert not [name for name in names if name.split(".")[0] == "ehls_ros"], path
            called = getattr(node, "func", None)
            assert getattr(called, "id", getattr(called, "attr", "")) not in {"__import__", "import_module"}, path


def test_every_effect_of_the_design_is_there_and_the_others_are_enough():
    for stage, names in DESIGN.items():
        assert {name for name, effect in LISTED.items() if effect.stage == stage} == set(names.split())
        assert sum(effect.stage == stage for effect in OUTSIDE.values()) >= 4
    assert not set(LISTED) & set(OUTSIDE)
    assert {name for effect in OUTSIDE.values() for name in effect.near} <= set(LISTED)


@pytest.mark.parametrize("name", tiered(EFFECTS, *list(EFFECTS)[::4]))
def test_a_neutral_size_changes_nothing(name):
    plain = record(RIG, {}, "rich", seed=5, duration=1.0)
    neutral = record(RIG, {name: {}}, "rich", seed=5, duration=1.0)
    assert all(np.array_equal(neutral.columns[column], plain.columns[column]) for column in COLUMNS)


@pytest.fixture(scope="module")
def rich_background():
    return background(RIG, "rich", seed=2, duration=30)


@pytest.mark.parametrize("name", tiered(EFFECTS, *list(EFFECTS)[::4]))
def test_drawn_sizes_stand_out_of_the_noise(name, rich_background):
    sizes = draw_effect(name, rng_for(name), RIG)
    assert all(value == value for value in sizes.values())  # noqa: PLR0124
    r = record(RIG, {name: sizes}, "rich", seed=2, duration=30, noise=0)
    assert raw_difference(r, rich_background.recording)[0] > 1.5
    seen = against(rich_background, RIG, r)
    assert max(seen.values()) > (1.5 if name in OUTSIDE else 0.3), seen


FORMS = [(name, form) for name, of in OTHER_FORMS.items() for form in of]


@pytest.mark.parametrize(("name", "form"), tiered(FORMS, *FORMS[::4], unpack=True))
def test_an_effect_by_another_formula_shows_where_the_usual_one_does(name, form, rich_background):
    sizes = draw_other_form(name, form, rng_for(name), RIG)
    r = record(RIG, {name: sizes}, "rich", seed=2, duration=30, noise=0)
    seen = against(rich_background, RIG, r)
    assert seen[r.truth["appears_in"][name]] == max(seen.values()) > 0.3
    assert name not in r.truth["natural"]


@pytest.mark.parametrize("experiment", tiered(EXPERIMENTS, "rich"))
def test_the_actuator_stays_within_its_limits_whatever_is_hidden(experiment):
    for seed, name in enumerate(EFFECTS):
        hidden = {name: draw_effect(name, rng_for(name, seed), RIG)}
        r = record(RIG, hidden, experiment, seed=seed, duration=4.0, internals=True)
        assert np.isfinite(r.states).all(), hidden
        assert np.abs(r.states[:, 0]).max() < 0.3, hidden
        assert np.abs(r.states[:, 2]).max() < 7.0e6, hidden


def test_the_rich_experiment_is_rich():
    for seed in range(3):
        c = record(RIG, {}, "rich", seed=seed, noise=0).columns
        speed, spool = np.abs(c["velocity_m_s"]), np.abs(c["spool_m"])
        assert 0.12 < speed.max() < 0.3
        assert np.mean((speed > 2e-4) & (speed < 2e-3)) > 0.02
        assert np.sum(np.diff(np.sign(c["velocity_m_s"])) != 0) > 40
        assert min(c["load_pressure_pa"].max(), -c["load_pressure_pa"].min()) > 1e6
        assert spool.max() > 2e-4
        assert np.mean(spool < 1e-5) > 0.02
        assert np.ptp(c["disturbance_force_n"]) > 3e3


def test_at_rest_nothing_moves():
    c = record(RIG, {}, "rest", seed=1, duration=20, noise=1).columns
    assert np.ptp(c["position_m"]) < 5e-5
    assert np.abs(c["load_pressure_pa"]).max() < 4e4


def test_the_same_seed_gives_the_same_recording_and_the_noise_is_as_said():
    a, b = (record(RIG, {}, "random", seed=7, duration=5) for _ in range(2))
    other = record(RIG, {}, "random", seed=8, duration=5)
    assert all(np.array_equal(a.columns[name], b.columns[name]) for name in COLUMNS)
    assert not np.array_equal(a.columns["position_m"], other.columns["position_m"])
    assert np.allclose(a.columns["position_m"] / 5e-6, np.round(a.columns["position_m"] / 5e-6), atol=1e-6)
    assert np.std(a.columns["supply_pressure_pa"]) == pytest.approx(math.hypot(1e3, 1.2e3 / math.sqrt(12)), rel=0.05)
    twice = record(RIG, {}, "random", seed=7, duration=5, noise=2.0)
    spread = np.std(
        twice.columns["oil_temperature_k"] - record(RIG, {}, "random", seed=7, duration=5, noise=0).columns["oil_temperature_k"]
    )
    assert spread == pytest.approx(0.1, rel=0.05)


def test_the_controller_sees_what_is_recorded():
    plain = record(RIG, {}, "rich", seed=4, duration=10, noise=0).columns
    biased = record(RIG, {"pressure_sensor_bias": {"bias": 2e5}}, "rich", seed=4, duration=10, noise=0).columns
    wrong = biased["load_pressure_pa"] - biased["force_n"] / RIG["plant"]["piston_area"]
    assert wrong == pytest.approx(2e5, abs=1e-3)
    assert np.abs(biased["valve_command_m"] - plain["valve_command_m"]).max() > 1e-6


@pytest.mark.parametrize("rate", [2000.0, 500.0, 400.0, 333.0])
def test_another_rate_samples_the_same_motion(rate):
    fine = record(RIG, {}, "rich", seed=4, duration=5, noise=0)
    r = record(RIG, {}, "rich", seed=4, duration=5, noise=0, rate=rate)
    assert r.time.size == pytest.approx(5 * rate, abs=1)
    common = r.time <= fine.time[-1]
    between = np.interp(r.time, fine.time, fine.columns["position_m"]) - r.columns["position_m"]
    assert np.abs(between[common]).max() < 2e-6


def test_delays_delay():
    plain = record(RIG, {}, "rich", seed=4, duration=8, noise=0, rate=1000).columns
    late = record(RIG, {"sensor_delay": {"delay": 4e-3, "signals": "all"}}, "rich", seed=4, duration=8, noise=0, internals=True)
    assert np.abs(late.columns["position_m"][4:] - late.states[:-4, 0]).max() < 1e-12
    assert np.abs(late.columns["position_m"][:4] - late.states[0, 0]).max() < 1e-12
    valve = RIG["plant"]["valve_bandwidth"]
    for delay in (3e-3, 2.4e-3):
        c = record(RIG, {"command_delay": {"delay": delay}}, "rich", seed=4, duration=8, noise=0).columns
        u, spool = c["valve_command_m"], np.zeros(c["spool_m"].size)
        whole, part = int(delay / 1e-3 + 1e-9), delay % 1e-3 if delay % 1e-3 < 0.99e-3 else 0.0
        for j in range(spool.size - 1):
            early, now = (u[j - whole - 1] if j > whole else 0.0), (u[j - whole] if j >= whole else 0.0)
            spool[j + 1] = early + (spool[j] - early) * math.exp(-valve * part)
            spool[j + 1] = now + (spool[j + 1] - now) * math.exp(-valve * (1e-3 - part))
        assert np.abs(spool - c["spool_m"]).max() < 1e-10
    assert np.abs(plain["spool_m"]).max() > 1e-5


def test_the_servo_is_recorded_where_it_moves_the_beam():
    r = record(RIG, {"coupling_stiffness": {"stiffness": 2e4}}, "rich", seed=4, duration=5, noise=0)
    assert list(r.columns) == [*COLUMNS, *SERVO_COLUMNS]
    x, v = (r.columns[name] for name in SERVO_COLUMNS)
    assert np.ptp(x) > 5e-3
    assert np.gradient(x, 1e-3)[1:-1] == pytest.approx(v[1:-1], abs=1e-6)
    assert list(record(RIG, {}, "rich", seed=4, duration=1).columns) == list(COLUMNS)
    assert set(SERVO_COLUMNS) <= set(record(RIG, {}, "servo", seed=4, duration=1).columns)


def test_a_held_disturbance_is_held():
    run, held = (record(RIG, {}, "rich", seed=4, duration=5, noise=0, rate=4000, hold=hold) for hold in (False, True))
    assert np.all(np.diff(held.columns["disturbance_force_n"].reshape(-1, 4), axis=1) == 0)
    assert np.abs(np.diff(run.columns["disturbance_force_n"].reshape(-1, 4), 2, axis=1)).max() < 1e-9


def test_the_truth_says_what_was_hidden():
    hidden = {name: draw_effect(name, rng_for(name), RIG) for name in ("mass_shift", "valve_null_bias", "detent")}
    r = record(RIG, hidden, "random", seed=1, duration=1)
    assert r.truth["natural"]["mass_shift"]["offset"] == pytest.approx(70 * (hidden["mass_shift"]["factor"] - 1))
    assert r.truth["stages"] == {"mass_shift": "force_balance", "valve_null_bias": "valve", "detent": "force_balance"}
    assert r.truth["outside"] == ["detent"]
    assert draw_effect("valve_null_bias", rng_for("x"), RIG, site="ports")["site"] == "ports"


def test_what_does_not_exist_is_refused():
    with pytest.raises(KeyError, match="gremlins"):
        record(RIG, {"gremlins": {}}, "rich", seed=1, duration=1)
    with pytest.raises(KeyError, match="gremlin"):
        record(RIG, {"end_stop": {"form": "gremlin"}}, "rich", seed=1, duration=1)
    with pytest.raises(ValueError, match="no columns"):
        record(RIG, {}, "rich", seed=1, duration=1, columns=["speed"])
    with pytest.raises(ValueError, match="stribeck"):
        record(RIG | {"friction": RIG["friction"] | {"model": "stribeck"}}, {}, "rich", seed=1, duration=1)
    with pytest.raises(ValueError, match="has no"):
        draw_effect("mass_shift", rng_for("x"), RIG, site="ports")
    with pytest.raises(ValueError, match="second body"):
        record(RIG, {"hinge_backlash": {}, "flexible_mode": {}}, "rich", seed=1, duration=1)
    with pytest.raises(ValueError, match="no size"):
        record(RIG, {"mass_shift": {"faktor": 2.0}}, "rich", seed=1, duration=1)


def test_a_csv_file_holds_what_was_recorded(tmp_path):
    r = degrade.blank(
        record(RIG, {}, "rich", seed=1, duration=1.5, columns=["position_m", "force_n"]), np.random.default_rng(1)
    )
    r.write_csv(tmp_path / "data.csv")
    with (tmp_path / "data.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "position_m", "force_n"]
    read = np.array([float(row["force_n"] or "nan") for row in rows])
    assert np.allclose(read, r.columns["force_n"], equal_nan=True)
    assert np.isnan(read).any()


def test_degradations_do_what_they_say_and_leave_the_original_alone():
    r = record(RIG, {}, "rich", seed=1, duration=5)
    before = {name: a.copy() for name, a in r.columns.items()}
    rng = np.random.default_rng(3)
    fewer = degrade.drop_samples(r, rng)
    assert 0.98 < fewer.time.size / r.time.size < 1.0
    spoilt = degrade.add_outliers(r, rng)
    assert 0 < np.sum(spoilt.columns["force_n"] != before["force_n"]) < 20
    assert np.isnan(degrade.blank(r, rng).columns["spool_m"]).sum() >= 300
    late = degrade.shift(r, "position_m", 5e-3)
    assert np.allclose(late.columns["position_m"][5:], before["position_m"][:-5], atol=1e-9)
    assert np.all(np.diff(degrade.jitter(r, rng).time) >= 0)
    assert "force_n" not in degrade.without(late, "force_n").columns
    assert len(degrade.without(late, "force_n").truth["degraded"]) == 2
    assert all(np.array_equal(r.columns[name], a) for name, a in before.items())
    factors = degrade.draw_wrong(rng, RIG, spread=0.2, count=4)
    wrong = degrade.wrong_rig(RIG, factors | {"friction.element_stiffness": 2.0})
    assert wrong["friction"]["element_stiffness"] == [2 * k for k in RIG["friction"]["element_stiffness"]]
    assert len(factors) == 4
    assert wrong != RIG
    record(wrong, {}, "rich", seed=1, duration=1)
