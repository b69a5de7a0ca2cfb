"""Rigs that no model describes: form errors of the requested size, in their stage, that no coefficient describes."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.signal import butter, lfilter, sosfiltfilt

from truth_generator import EXPERIMENTS, Day, FormErrors, draw_day, draw_forms, kernel, record
from truth_generator.calibration import Scale, largest_terms
from truth_generator.effects import STAGES
from truth_generator.forms import KINDS, LARGEST, SMALLEST, draw_shapes
from truth_generator.residuals import model_residuals
from truth_generator.visibility import background, prominence

RIG = yaml.safe_load((Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml").read_text(encoding="utf-8"))
PLANT, FRICTION = RIG["plant"], RIG["friction"]
FINE = 4000.0


def rms(a):
    return float(np.sqrt(np.mean(a * a)))


RUN = {"seed": 20, "duration": 12.0, "noise": 0.0}


@pytest.fixture(scope="module")
def own():
    return draw_forms(np.random.default_rng(11), RIG, "rich", seed=20, duration=12.0)


@pytest.fixture(scope="module")
def scale():
    return Scale(RIG, "rich", 20, 12.0)


def balances(r):
    """Return the imbalance and the largest term of the equations for the kernel's states, without filtering."""
    x, v, p_load, spool = (r.states[:, i] for i in (kernel.X, kernel.V, kernel.PL, kernel.XV))
    area, dt = PLANT["piston_area"], 1.0 / FINE
    force = area * p_load - PLANT["moving_mass"] * (np.gradient(v, dt) + PLANT["gravity"]) - PLANT["spring_stiffness"] * x
    force -= (PLANT["viscous_damping"] + FRICTION["viscous_coefficient"]) * v + r.states[:, kernel.N_BASE :].sum(axis=1)
    force -= r.columns["disturbance_force_n"]
    flow = PLANT["discharge_coefficient"] * PLANT["valve_area_gradient"] * spool
    flow *= np.sqrt((PLANT["supply_pressure"] - np.sign(spool) * p_load) / PLANT["oil_density"])
    oil = flow - area * v - PLANT["leakage_coefficient"] * p_load
    oil -= PLANT["total_volume"] / (4.0 * PLANT["bulk_modulus"]) * np.gradient(p_load, dt)
    # Between the control's ticks the command is constant, so this is the exact response.
    decay = np.exp(-PLANT["valve_bandwidth"] * dt)
    followed = lfilter([0.0, 1.0 - decay], [1.0, -decay], r.columns["valve_command_m"])
    return {
        "force_balance": [(force, max(rms(area * p_load), rms(r.columns["disturbance_force_n"])))],
        "flow": [(oil, max(rms(flow), rms(area * v)))],
        "valve": [(spool - followed, rms(spool))],
        "sensors": [(r.columns["force_n"] - area * p_load, rms(area * p_load)), (r.columns["velocity_m_s"] - v, rms(v))],
    }


def test_form_errors_have_the_size_asked_in_every_stage(own):
    r = record(RIG, {}, "rich", rate=FINE, forms=own, internals=True, **RUN)
    low = butter(3, 25.0, fs=FINE, output="sos")
    for stage, rows in balances(r).items():
        slow = stage in ("force_balance", "flow")
        found = np.sqrt(sum((rms(sosfiltfilt(low, a) if slow else a) / term) ** 2 for a, term in rows))
        assert found == pytest.approx(own.sizes[stage], rel=0.1), stage
        assert 0.9 * SMALLEST < found < 1.1 * LARGEST, stage


def test_two_draws_are_two_rigs_and_a_seed_is_one(scale):
    first, again, other = (draw_shapes(np.random.default_rng(seed), scale.signals) for seed in (11, 11, 12))
    assert first == again
    for stage in STAGES:
        assert first.sizes[stage] != other.sizes[stage]
        assert len(set(first.kinds[stage])) == 2
    a, b = (record(RIG, {}, "rich", seed=1, duration=5, noise=0, forms=forms).columns for forms in (first, other))
    assert rms(a["position_m"] - b["position_m"]) > 1e-5


def test_form_errors_of_no_size_and_an_average_day_change_nothing(own):
    plain = record(RIG, {}, "rich", seed=1, duration=5).columns
    none = own.scaled({kind: 0.0 for kinds in own.kinds.values() for kind in kinds})
    for forms in (FormErrors(), none):
        same = record(RIG, {}, "rich", seed=1, duration=5, forms=forms, day=Day()).columns
        assert all(np.array_equal(same[name], plain[name]) for name in plain)
    with_them = record(RIG, {}, "rich", seed=1, duration=5, forms=own).columns
    assert not np.array_equal(with_them["spool_m"], plain["spool_m"])


def test_every_kind_shows_in_its_own_stage(scale):
    for name, kind in KINDS.items():
        shape = kind.shape(np.random.default_rng([3, *name.encode()]), scale.signals)
        rows = scale.rows(FormErrors({kind.amplitude: kind.first, **shape}))
        own = rows[kind.stage][kind.row]
        others = [size for stage in STAGES for row, size in enumerate(rows[stage]) if (stage, row) != (kind.stage, kind.row)]
        assert own > 1e-4, name
        # The residuals themselves are no more accurate than this on another motion.
        assert max(others) < 0.1 * own + 3e-4, name


def bases(r):
    """Return the changes due to the coefficients of the rig file, by kind of form error."""
    c, dt = r.columns, 1e-3
    v = np.gradient(c["position_m"], dt)
    opening = c["spool_m"] * np.sqrt(PLANT["supply_pressure"] - np.sign(c["spool_m"]) * c["load_pressure_pa"])
    return {
        "friction_over_speed": [np.tanh(v / 2e-3), v],
        "friction_memory": [np.gradient(v, dt)],
        "flow_over_opening": [opening],
        "soft_mount": [np.gradient(c["load_pressure_pa"], dt)],
        "spool_over_command": [np.maximum(c["spool_m"], 0.0), np.minimum(c["spool_m"], 0.0)],
        "spool_pace": [np.gradient(c["spool_m"], dt)],
        "cell_bow": [c["force_n"]],
        "cell_hysteresis": [c["force_n"]],
        "cell_sees_speed": [c["force_n"]],
        "speed_sensor_sees_pressure": [v],
    }


def test_the_rig_files_coefficients_describe_none_of_it(scale):
    plain = record(RIG, {}, "rich", **RUN)
    low = butter(3, 25.0, fs=1000.0, output="sos")
    for name, terms in bases(plain).items():
        kind = KINDS[name]
        shape = kind.shape(np.random.default_rng([4, *name.encode()]), scale.signals)
        forms = FormErrors({kind.amplitude: kind.first, **shape})
        r = record(RIG, {}, "rich", forms=forms, **RUN)
        left = model_residuals(RIG, r)[kind.stage][kind.row] - scale.without[kind.stage][kind.row]
        columns = [sosfiltfilt(low, a)[100:-100] if kind.stage != "valve" else a[100:-100] for a in terms]
        matrix = np.stack(columns, axis=1)
        rest = left - matrix @ np.linalg.lstsq(matrix, left, rcond=None)[0]
        assert rms(rest) > 0.9 * rms(left), name


def test_a_share_is_the_part_of_the_power_that_is_due_to_the_effect():
    without = background(RIG, "rich", seed=1, duration=5)
    t = np.arange(without.left["flow"][0].size) * 1e-3
    floor = without.floor["flow"][0]

    def with_flow(added):
        return {s: [a + added if (s, i) == ("flow", 0) else a for i, a in enumerate(rows)] for s, rows in without.left.items()}

    form, effect = 20.0 * floor * np.sin(10.0 * t), 60.0 * floor * np.cos(10.0 * t)
    healthy, changed = with_flow(form), with_flow(form + effect)
    rest = [(1.0, {s: [a - b for a, b in zip(healthy[s], without.left[s], strict=True)] for s in STAGES})]
    found = prominence(without, rest, healthy, changed)
    assert found.share == pytest.approx(0.9, abs=0.02)
    assert found.visibility["flow"] == pytest.approx(3.0, rel=0.03)
    assert found.visibility["valve"] == 0.0


def test_days_differ_by_as_much_as_said_and_the_temperature_is_recorded():
    days = [draw_day(np.random.default_rng(seed), 0.03) for seed in range(400)]
    assert np.std([day.level for day in days]) == pytest.approx(0.03, rel=0.15)
    assert np.std([day.viscous for day in days]) == pytest.approx(0.03, rel=0.15)
    assert np.corrcoef([day.viscous for day in days], [day.warmer for day in days])[0, 1] < -0.99
    same, warm = (record(RIG, {}, "rich", seed=1, duration=5, noise=0, day=day).columns for day in (None, Day(1.0, 0.95, 5.0)))
    assert warm["oil_temperature_k"] - same["oil_temperature_k"] == pytest.approx(5.0, abs=1e-9)
    assert rms(warm["spool_m"] - same["spool_m"]) > 0.0


def test_the_largest_terms_are_those_of_the_recording():
    r = record(RIG, {}, "rich", seed=1, duration=5, noise=0)
    terms = largest_terms(RIG, r)
    assert terms["sensors"] == pytest.approx([rms(r.columns["force_n"]), rms(r.columns["velocity_m_s"])], rel=1e-3)
    assert terms["valve"] == pytest.approx([rms(r.columns["spool_m"])])


def test_without_a_disturbance_the_motion_is_the_same_but_takes_another_force():
    with_it, without = (record(RIG, {}, "rich", seed=1, duration=20, noise=0, disturbed=d).columns for d in (True, False))
    assert rms(with_it["disturbance_force_n"]) > 500.0
    assert not without["disturbance_force_n"].any()
    assert rms(with_it["velocity_m_s"] - without["velocity_m_s"]) < 0.3 * rms(with_it["velocity_m_s"])
    assert rms(with_it["force_n"] - without["force_n"]) > 500.0


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_rig_of_its_own_stays_within_its_limits(experiment, own):
    day = draw_day(np.random.default_rng(1), 0.05)
    states = record(RIG, {}, experiment, seed=2, duration=4.0, forms=own, day=day, internals=True).states
    assert np.isfinite(states).all()
    assert np.abs(states[:, kernel.X]).max() < 0.3
    assert np.abs(states[:, kernel.PL]).max() < 7.0e6
