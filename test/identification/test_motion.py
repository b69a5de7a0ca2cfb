"""A recording in blocks: derivatives of known curves, gaps, shifted clocks, and blocks of the right length."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.motion import BLOCK_LENGTHS, WINDOW, block_length, motions_of, prepare, slope_noise
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

SAMPLE, PERIOD = 1e-3, 0.01
TIME = np.arange(4000) * SAMPLE


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(Path(__file__).parents[2] / "config" / "rig_paper.yaml")


def recording(position=None, force=None, time=TIME) -> Trajectory:
    position = 0.01 * (time - 2.0) ** 3 - 0.02 * time if position is None else position
    return Trajectory(time, {"position_m": position, "force_n": 800.0 * np.sin(time) if force is None else force})


def test_a_cubic_has_its_own_derivatives(rig):
    made = prepare(recording(), rig, "cubic", PERIOD)
    inside = made.resolved
    t = made.time[inside]
    assert inside[WINDOW - 1 : 1 - WINDOW].all()
    np.testing.assert_allclose(made.velocity[inside], 0.03 * (t - 2.0) ** 2 - 0.02, atol=2e-6)
    np.testing.assert_allclose(made.acceleration[inside], 0.06 * (t - 2.0), atol=1e-4)
    np.testing.assert_allclose(made.position[inside], 0.01 * (t - 2.0) ** 3 - 0.02 * t, atol=2e-6)
    np.testing.assert_allclose(made.force[inside], 800.0 * np.sin(t), atol=0.05)


def test_the_recordings_clock_does_not_matter(rig):
    here = prepare(recording(), rig, "here", PERIOD)
    later = Trajectory(TIME + 1e4, recording().signals)
    moved = prepare(later, rig, "later", PERIOD)
    for name in ("time", "position", "velocity", "force"):
        np.testing.assert_allclose(getattr(moved, name), getattr(here, name), rtol=1e-6, atol=1e-9)


def test_an_offset_of_the_position_changes_nothing_else(rig):
    here, there = prepare(recording(), rig, "a", PERIOD), prepare(recording(recording()["position_m"] + 0.05), rig, "b", PERIOD)
    np.testing.assert_allclose(there.position, here.position + 0.05, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(there.velocity, here.velocity, atol=1e-9)
    np.testing.assert_array_equal(there.resolved, here.resolved)


def test_a_gap_begins_a_new_stretch_and_spoils_a_window_on_each_side(rig):
    kept = (TIME < 1.0) | (TIME >= 1.5)
    made = prepare(Trajectory(TIME[kept], {k: v[kept] for k, v in recording().signals.items()}), rig, "gap", PERIOD)
    assert np.flatnonzero(made.fresh).tolist() == [0, 150]
    spoilt = np.flatnonzero(~made.resolved[10:-10]) + 10
    assert spoilt.tolist() == list(range(100 - WINDOW + 1, 150 + WINDOW - 1))


def test_single_lost_samples_are_no_gap(rig):
    random = np.random.default_rng(0)
    kept = random.random(len(TIME)) > 0.1
    made = prepare(Trajectory(TIME[kept], {k: v[kept] for k, v in recording().signals.items()}), rig, "lossy", PERIOD)
    assert np.flatnonzero(made.fresh).tolist() == [0]
    t = made.time[made.resolved]
    np.testing.assert_allclose(made.velocity[made.resolved], 0.03 * (t - 2.0) ** 2 - 0.02, atol=1e-4)


def test_outliers_are_left_out_and_counted(rig):
    force = recording()["force_n"].copy()
    force[50::100] = 1e4
    spoilt, clean = prepare(recording(force=force), rig, "spoilt", PERIOD), prepare(recording(), rig, "clean", PERIOD)
    assert spoilt.outliers == pytest.approx(0.01, rel=0.05)
    np.testing.assert_allclose(spoilt.force, clean.force, atol=0.5)


def test_pressure_times_area_is_the_force(rig):
    signals = recording().signals
    pressure = {"position_m": signals["position_m"], "load_pressure_pa": signals["force_n"] / rig.plant.piston_area}
    made = prepare(Trajectory(TIME, pressure), rig, "pressure", PERIOD)
    np.testing.assert_allclose(made.force, prepare(recording(), rig, "force", PERIOD).force, rtol=1e-9, atol=1e-9)


def test_the_noises_are_those_of_the_sensors(rig):
    random = np.random.default_rng(1)
    position = recording()["position_m"] + 1e-5 * random.standard_normal(len(TIME))
    force = recording()["force_n"] + 3.0 * random.standard_normal(len(TIME))
    made, clean = prepare(recording(position, force), rig, "noisy", PERIOD), prepare(recording(), rig, "clean", PERIOD)
    assert made.force_noise == pytest.approx(3.0 / np.sqrt(10), rel=0.1)
    scatter = np.std((made.velocity - clean.velocity)[made.resolved])
    assert made.velocity_noise == pytest.approx(scatter, rel=0.2)
    assert made.velocity_noise == pytest.approx(slope_noise(1e-5 / np.sqrt(10), PERIOD), rel=0.1)


def test_scatter_is_what_a_block_averages_away(rig):
    random = np.random.default_rng(3)
    quiet = 800.0 * TIME  # a ramp
    noisy = quiet + 3.0 * random.standard_normal(len(TIME))
    shaken = noisy + np.where(TIME > 2.0, 60.0 * np.sin(2.0 * np.pi * 50.0 * TIME), 0.0)
    assert np.max(prepare(recording(force=quiet), rig, "quiet", PERIOD).scatter[5:-5]) < 0.5
    scatter = prepare(recording(force=shaken), rig, "shaken", PERIOD).scatter
    assert np.median(scatter[:190]) == pytest.approx(3.0, rel=0.15)
    assert np.median(scatter[210:]) > 5.0 * np.median(scatter[:190])


def test_strokes_and_turns(rig):
    made = prepare(recording(0.05 * np.cos(2.0 * np.pi * TIME)), rig, "cosine", PERIOD)
    assert len(made.turns) == 7
    np.testing.assert_allclose(made.time[made.turns], np.arange(0.5, 4.0, 0.5), atol=PERIOD)
    assert made.strokes[0] == 0
    assert made.strokes[-1] == 7
    assert not made.small
    assert prepare(recording(1e-3 * np.cos(2.0 * np.pi * TIME)), rig, "small", PERIOD).small


def test_a_motion_the_window_cannot_follow_is_not_resolved(rig):
    position = np.where(TIME < 2.0, 0.0, 0.05) + 0.01 * TIME
    made = prepare(recording(position), rig, "jump", PERIOD)
    assert not made.resolved[200]
    assert made.resolved[100]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"time": TIME[:10]}, "it is 0.009 s long with 10 samples"),
        ({"position": np.full(4000, np.nan)}, "'position_m' has no finite sample"),
        ({"position": np.zeros(4000)}, "position_m does not change"),
        ({"force": np.zeros(4000)}, "force_n does not change"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(rig, change, said):
    size = len(change.get("time", TIME))
    signals = {k: v[:size] for k, v in recording(change.get("position"), change.get("force")).signals.items()}
    with pytest.raises(BadInput) as refused:
        prepare(Trajectory(TIME[:size], signals), rig, "bad", PERIOD)
    assert said in str(refused.value)
    assert "bad" in str(refused.value)


def test_blocks_grow_until_the_velocity_is_clear_of_noise():
    random = np.random.default_rng(2)
    time = np.arange(60_000) * SAMPLE
    position = 0.2 * np.abs((time / 15.0) % 2.0 - 1.0)
    lengths = [
        block_length(recording(position + noise * random.standard_normal(len(time)), np.sin(time), time), 0.0)
        for noise in (1e-9, 1e-6, 1e-5, 1e-3)
    ]
    assert lengths == sorted(lengths)
    assert lengths[0] == BLOCK_LENGTHS[0]
    assert lengths[-1] == BLOCK_LENGTHS[-1]
    assert block_length(recording(position, np.sin(time), time), 0.05) >= 0.05


@pytest.mark.parametrize(("frequency", "length"), [(0.3, 0.02), (1.0, 0.005), (5.0, 0.005)])
def test_blocks_of_presliding_resolve_a_branch(frequency, length):
    time = np.arange(30_000) * SAMPLE
    small = 1e-3 * np.sin(2.0 * np.pi * frequency * time)
    assert block_length(recording(small, np.sin(time), time), 0.1) == length


def test_a_block_is_never_shorter_than_a_sample():
    time = np.arange(2000) * 0.2
    assert block_length(recording(0.1 * np.sin(0.1 * time), np.sin(time), time), 0.0) == pytest.approx(0.2)


def test_every_recording_becomes_a_motion_of_its_name(rig):
    first, second = motions_of({"one": recording(), "two": recording(0.05 * np.cos(TIME))}, rig)
    assert (first.name, second.name) == ("one", "two")
