"""The recording: resampling, repair, omissions and refusals."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from ehls_ros.diagnosis.record import MAX_RECORDING, STRETCHES, prepare
from ehls_ros.errors import BadInput
from ehls_ros.trajectory import Trajectory

PERIOD = 1e-3


def plain(n=4000, period=PERIOD, seed=0):
    """Return a plausible recording of sines, with noise."""
    rng = np.random.default_rng(seed)
    t = period * np.arange(n)
    return t, {
        "position_m": 0.02 * np.sin(3.0 * t) + 2e-6 * rng.standard_normal(n),
        "load_pressure_pa": 1e6 * np.cos(3.0 * t) + 1e3 * rng.standard_normal(n),
        "valve_command_m": 1e-4 * np.sign(np.sin(5.0 * t)),
    }


def test_a_clean_recording_is_taken_as_it_is(rig):
    t, signals = plain()
    r = prepare(Trajectory(t, signals), rig, "it")
    np.testing.assert_array_equal(r.signals["valve_command_m"], signals["valve_command_m"])
    assert all(np.mean(good) > 0.99 for good in r.good.values())
    assert r.period == pytest.approx(PERIOD)
    assert list(np.flatnonzero(r.fresh)) == [0]
    assert r.noise["position_m"] == pytest.approx(2e-6, rel=0.1)
    assert r.noise["load_pressure_pa"] == pytest.approx(1e3, rel=0.1)
    assert "spool_m" not in r
    np.testing.assert_array_equal(r.values("spool_m"), 0.0)


def test_quantisation_counts_as_noise(rig):
    t, signals = plain(8000)
    for step in (5e-6, 1e-4):
        coarse = signals | {"position_m": np.round(signals["position_m"] / step) * step}
        found = prepare(Trajectory(t, coarse), rig, "it").noise["position_m"]
        assert found == pytest.approx(math.hypot(2e-6, step / math.sqrt(12.0)), rel=0.35)


def test_uneven_time_comes_onto_even_time(rig):
    t, signals = plain()
    at = t + 2e-4 * np.sin(np.arange(len(t)))
    signals["position_m"] = 0.02 * np.sin(3.0 * at)
    r = prepare(Trajectory(at, signals), rig, "it")
    np.testing.assert_allclose(np.diff(r.time), r.period, rtol=1e-9)
    np.testing.assert_allclose(r.signals["position_m"], 0.02 * np.sin(3.0 * r.time), atol=1e-7)
    assert any("uneven" in remark for remark in r.remarks)


def test_lost_samples_are_filled_in_and_longer_gaps_marked(rig):
    t, signals = plain()
    keep = np.random.default_rng(1).random(len(t)) > 0.01
    keep[1000:1100] = False
    keep[0] = keep[-1] = True
    r = prepare(Trajectory(t[keep], {n: a[keep] for n, a in signals.items()}), rig, "it")
    assert len(r.time) == len(t)
    np.testing.assert_allclose(r.signals["position_m"][keep], signals["position_m"][keep], atol=1e-7)
    assert not r.good["position_m"][1010:1090].any()
    assert np.mean(r.good["position_m"]) > 0.97
    assert any("missing" in remark for remark in r.remarks)
    # A held command keeps its value, without a transition between its two values.
    assert set(np.unique(r.signals["valve_command_m"])) <= {-1e-4, 0.0, 1e-4}


def test_nan_and_outliers_are_left_out(rig):
    t, signals = plain()
    signals["load_pressure_pa"][500:530] = np.nan
    signals["position_m"][[700, 1500, 2500]] += 0.01
    r = prepare(Trajectory(t, signals), rig, "it")
    assert all(np.isfinite(a).all() for a in r.signals.values())
    assert not r.good["load_pressure_pa"][503:527].any()
    np.testing.assert_allclose(r.signals["position_m"], 0.02 * np.sin(3.0 * t), atol=2e-5)


def test_a_short_oscillation_is_no_outlier(rig):
    t, signals = plain()
    spool = 1e-7 * np.random.default_rng(3).standard_normal(len(t))
    ringing = slice(2000, 2060)
    # As fast as a valve reverses: every sample is far from its neighbours' median.
    spool[ringing] += 8e-4 * np.sin(2.0 * np.pi * 60.0 * (t[ringing] - t[2000]))
    spool[[800, 2030]] += (4e-4, 5e-3)
    r = prepare(Trajectory(t, signals | {"spool_m": spool}), rig, "it")
    out = np.flatnonzero(np.abs(r.signals["spool_m"] - spool) > 1e-6)
    # A wrong sample among fast ones may take a neighbour with it.
    assert {800, 2030} <= set(out) <= {800, *range(2025, 2036)}
    assert len(out) <= 4


@pytest.mark.parametrize("late", [-1, 1])
def test_a_sample_repeated_or_skipped_in_fast_motion_is_left_out(late, rig):
    t, signals = plain()
    position = 0.2 * np.sin(3.0 * t) + 2e-6 * np.random.default_rng(5).standard_normal(len(t))
    taken = np.array([400, 1950, 1954, 1957, 3100])
    read = position.copy()
    read[taken] = position[taken + late]
    r = prepare(Trajectory(t, signals | {"position_m": read}), rig, "it")
    # There it moves by 0.2 to 0.6 mm a sample.
    np.testing.assert_allclose(r.signals["position_m"], position, atol=1.2e-5)


def test_corners_are_no_outliers(rig):
    t, signals = plain()
    position = 0.2 * np.abs(np.mod(t, 1.0) - 0.5) + 2e-6 * np.random.default_rng(6).standard_normal(len(t))
    r = prepare(Trajectory(t, signals | {"position_m": position}), rig, "it")
    np.testing.assert_allclose(r.signals["position_m"], position, atol=1e-9)


def test_lone_spikes_of_a_command_go_and_its_steps_stay(rig):
    t, signals = plain()
    command = np.repeat(1e-4 * np.random.default_rng(2).integers(-3, 4, 40), 100).astype(float)
    spiked = command.copy()
    spiked[[150, 950, 2550]] += 5e-3
    r = prepare(Trajectory(t, signals | {"valve_command_m": spiked}), rig, "it")
    np.testing.assert_array_equal(r.signals["valve_command_m"], command)


def test_a_lone_command_that_the_spool_answers_was_sent(rig):
    t, signals = plain()
    command = 1e-6 * np.sin(20.0 * t)
    command[[900, 1900, 2900]] = 1e-3
    # The last two were not sent: the spool stands still, or was read wrongly together with the command.
    sent = np.where(np.isin(np.arange(len(t)), [1900, 2900]), 0.0, command)
    keeps = math.exp(-rig.plant.valve_bandwidth * PERIOD)
    spool = lfilter([0.0, rig.plant.valve_gain * (1.0 - keeps)], [1.0, -keeps], sent)
    spool += 5e-7 * np.random.default_rng(4).standard_normal(len(t))
    spool[2900] += 1e-3
    r = prepare(Trajectory(t, signals | {"valve_command_m": command, "spool_m": spool}), rig, "it")
    left = r.signals["valve_command_m"]
    np.testing.assert_array_equal(np.flatnonzero(left > 1e-4), [900])


def test_a_signal_without_a_finite_sample_is_left_out(rig):
    t, signals = plain()
    r = prepare(Trajectory(t, signals | {"spool_m": np.full(len(t), np.nan)}), rig, "it")
    assert "spool_m" not in r
    assert any("spool_m" in remark for remark in r.remarks)


@pytest.mark.parametrize(
    ("name", "factor"),
    [("position_m", 1e3), ("load_pressure_pa", 1e3), ("force_n", 1e3), ("velocity_m_s", 1e3), ("supply_pressure_pa", 1e3)],
)
def test_a_wrong_unit_is_refused(rig, recorded, name, factor):
    c = recorded({}, "rich", seed=1, duration=3.0).columns
    t = PERIOD * np.arange(len(c[name]))
    prepare(Trajectory(t, c), rig, "it")
    with pytest.raises(BadInput, match=name):
        prepare(Trajectory(t, c | {name: factor * c[name]}), rig, "it")


@pytest.mark.parametrize("spoil", ["backwards", "twice", "nan", "short", "mostly nan"])
def test_what_cannot_be_read_is_refused(rig, spoil):
    t, signals = plain(1000)
    if spoil == "backwards":
        t = t[::-1].copy()
    elif spoil == "twice":
        t[500] = t[499]
    elif spoil == "nan":
        t[500] = np.nan
    elif spoil == "short":
        t, signals = t[:50], {n: a[:50] for n, a in signals.items()}
    else:
        signals["position_m"][:400] = np.nan
    with pytest.raises(BadInput, match="it"):
        prepare(Trajectory(t, signals), rig, "it")


def test_of_a_long_recording_stretches_are_taken(rig):
    t, signals = plain(40_000, period=0.01)
    r = prepare(Trajectory(t, signals), rig, "it")
    assert len(r.time) * r.period == pytest.approx(MAX_RECORDING, rel=0.02)
    assert np.sum(r.fresh) == STRETCHES
    assert r.duration == pytest.approx(400.0, rel=0.01)
    begins = np.flatnonzero(r.fresh)
    assert np.all(np.diff(r.time) > 0.0)
    assert np.all(np.diff(r.time)[begins[1:] - 1] > 0.1)
    good = r.good["position_m"]
    assert np.mean(good) > 0.99
    np.testing.assert_allclose(r.signals["position_m"][good], 0.02 * np.sin(3.0 * r.time)[good], atol=1e-4)
