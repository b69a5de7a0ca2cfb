"""Skew, jitter and offsets of converters; the tables delivered by a rig's data acquisition."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from truth_generator import FINE, Measurement, Recording, draw_measurement, measured, record, variants
from truth_generator.measurement import OFFSETS

RIG = yaml.safe_load((Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml").read_text(encoding="utf-8"))
PERFECT = RIG | {"sensors": {name: {} for name in ("position", "load_pressure", "force")}}
RATE = 1000.0
RADIANS = 2.0 * math.pi * 7.0


@pytest.fixture(scope="module")
def sine():
    time = np.arange(8000) / FINE
    wave = np.sin(RADIANS * time)
    columns = {"position_m": wave, "load_pressure_pa": wave.copy(), "valve_command_m": np.floor(time * RATE + 1e-9)}
    return Recording(time, columns, {"noise": 0.0, "degraded": []})


@pytest.fixture(scope="module")
def moved():
    return record(RIG, {}, "rich", seed=1, duration=4, rate=FINE, noise=0.0)


def phase(time, a):
    """Return the delay of a sine [s]."""
    inside = slice(10, 1000)
    parts = np.stack([np.sin(RADIANS * time), np.cos(RADIANS * time)], axis=1)[inside]
    sine, cosine = np.linalg.lstsq(parts, a[inside], rcond=None)[0]
    return -math.atan2(cosine, sine) / RADIANS


@pytest.mark.parametrize("skew", [-1.0, -0.4, 0.0, 0.25, 1.0])
def test_a_skewed_channel_is_late_by_its_fraction_of_a_sample(skew, sine):
    r = measured(sine, PERFECT, 1, Measurement({"position_m": skew}))
    assert phase(r.time, r.columns["position_m"]) == pytest.approx(skew / RATE, abs=2e-6)
    assert phase(r.time, r.columns["load_pressure_pa"]) == pytest.approx(0.0, abs=2e-6)


@pytest.mark.parametrize(("skew", "late"), [(0.3, 0.7), (1.0, 0.0), (0.0, 0.0)])
def test_a_held_channel_has_the_value_of_its_own_last_instant(skew, late, sine):
    r = measured(sine, PERFECT, 1, Measurement({"position_m": skew}, held=("position_m",)))
    assert phase(r.time, r.columns["position_m"]) == pytest.approx(late / RATE, abs=2e-6)


@pytest.mark.parametrize(("skew", "step"), [(0.0, 0), (0.5, -1), (-0.5, 0)])
def test_a_command_stays_one_of_its_values(skew, step, sine):
    u = measured(sine, PERFECT, 1, Measurement({"valve_command_m": skew})).columns["valve_command_m"]
    assert np.array_equal(u[5:], np.arange(u.size)[5:] + step)


def test_jitter_moves_all_columns_of_a_row_together(sine):
    r = measured(sine, PERFECT, 1, Measurement(jitter=0.1))
    exact = np.sin(RADIANS * r.time)
    steep = np.abs(np.cos(RADIANS * r.time)) > 0.7
    off = (r.columns["position_m"] - exact)[steep] / (RADIANS * np.cos(RADIANS * r.time[steep]))
    assert np.std(off) == pytest.approx(0.1 / RATE, rel=0.1)
    assert np.array_equal(r.columns["position_m"], r.columns["load_pressure_pa"])
    assert np.array_equal(r.time, np.arange(2000) / RATE)


def test_a_perfectly_sampled_recording_is_the_recorder_s(moved):
    direct = record(PERFECT, {}, "rich", seed=1, duration=4, noise=0.0)
    r = measured(moved, PERFECT, 1, Measurement())
    assert r.columns["position_m"] == pytest.approx(direct.columns["position_m"], abs=1e-9)
    assert np.array_equal(r.time, direct.time)


def test_noise_resolution_and_offset_are_the_sensors(moved):
    how = Measurement(offset={"position_m": 4e-4})
    x = measured(moved, RIG, 1, how).columns["position_m"]
    true = moved.columns["position_m"][::4]
    assert x / 5e-6 == pytest.approx(np.round(x / 5e-6), abs=1e-6)
    assert np.mean(x - true) == pytest.approx(4e-4, abs=2e-7)
    assert np.std(x - true) == pytest.approx(math.hypot(2e-6, 5e-6 / math.sqrt(12.0)), rel=0.05)
    other = measured(moved, RIG, 2, how).columns["position_m"]
    assert not np.array_equal(x, other)


def test_drawn_measurements_stay_within_their_bounds(moved):
    drawn = [draw_measurement(np.random.default_rng(i), moved.columns, skew=1.0, jitter=0.1, offset=1.0) for i in range(50)]
    skews = np.array([list(how.skew.values()) for how in drawn])
    assert skews.min() >= 0.0
    assert skews.max() <= 1.0
    assert np.std(skews) > 0.2
    assert 0.4 < np.mean([len(how.held) / len(how.skew) for how in drawn]) < 0.6
    assert all(abs(how.offset[name]) <= OFFSETS[name] for how in drawn for name in how.offset)
    assert set(drawn[0].skew) == set(moved.columns)


def test_what_cannot_be_measured_is_refused(moved):
    with pytest.raises(ValueError, match="perfect sensors"):
        measured(record(RIG, {}, "rich", seed=1, duration=1), RIG, 1, Measurement())
    with pytest.raises(ValueError, match="no columns"):
        measured(moved, RIG, 1, Measurement({"speed": 0.5}))


def test_a_slow_table_has_its_own_time_stamps():
    r = record(RIG, {}, "rich", seed=1, duration=4)
    fast, slow = variants.two_rates(r, ["load_pressure_pa", "spool_m"], rate=100.0, first=0.003)
    assert set(fast.columns) == {"load_pressure_pa", "spool_m"}
    assert set(slow.columns) == set(r.columns) - set(fast.columns)
    assert fast.time.size == 4000
    assert np.allclose(np.diff(slow.time), 0.01)
    assert slow.time[0] == pytest.approx(0.003)
    assert np.array_equal(slow.columns["position_m"], r.columns["position_m"][3::10])
    assert np.array_equal(variants.slowed(r).columns["force_n"], r.columns["force_n"][::10])
    assert variants.slowed(r).truth["rate"] == 100.0
    with pytest.raises(ValueError, match="no multiple"):
        variants.slowed(r, 333.0)


def test_the_other_tables_have_what_a_rig_would_have():
    r = record(RIG, {}, "rich", seed=1, duration=4)
    assert set(r.columns) - set(variants.command_only(r).columns) == {"spool_m"}
    c = variants.chamber_pressures(r, np.random.default_rng(1)).columns
    assert "load_pressure_pa" not in c
    assert c["pressure_a_pa"] - c["pressure_b_pa"] == pytest.approx(r.columns["load_pressure_pa"], abs=1e-6)
    assert c["pressure_a_pa"] + c["pressure_b_pa"] == pytest.approx(r.columns["supply_pressure_pa"], abs=1e4)
    assert min(c["pressure_a_pa"].min(), c["pressure_b_pa"].min()) > 0.0
