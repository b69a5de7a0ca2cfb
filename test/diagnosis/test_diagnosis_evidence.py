"""The evidence: the loss, the noise floor, the blocks, and the reuse of another model's results."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain_evidence import evidence_of

from ehls_ros.diagnosis import rules, stages
from ehls_ros.diagnosis.evidence import MAX_RESIDUAL, Residuals, gather, part_of, sections, whitened
from ehls_ros.diagnosis.loss import inflation, loss, power, weights
from ehls_ros.diagnosis.noise import deviations, with_noise
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.trajectory import Trajectory

PERIOD = 1e-3

# ---------------------------------------------------------------------------------------------------------------- loss


@pytest.mark.parametrize(("e", "expected"), [(0.0, 0.0), (2.0, 2.0), (-3.0, 4.5), (4.0, 7.5), (-10.0, 25.5), (1e6, 3e6 - 4.5)])
def test_the_loss_is_quadratic_up_to_three_and_linear_beyond(e, expected):
    assert loss(np.array([e]))[0] == expected


def test_weights_give_the_losss_gradient():
    e = np.linspace(-20.0, 20.0, 4001)
    np.testing.assert_allclose(np.gradient(loss(e), e), weights(e) * e, atol=0.02)


def test_inflation_is_the_clipped_mean_square_and_at_least_one():
    assert inflation(np.full(4, 0.5)) == 1.0
    assert inflation(np.full(4, 2.0)) == 4.0
    assert inflation(np.array([1.0, 1e6])) == 5.0


# --------------------------------------------------------------------------------------------------------- noise floor


def two_force_sensors(rig, force_noise, pressure_noise, seconds=20.0):
    """Return a recording of load cell and load pressure alone, both reading a slow sine."""
    rng = np.random.default_rng(3)
    t = PERIOD * np.arange(round(seconds / PERIOD))
    pressure = 1e6 * np.sin(2.0 * t)
    return t, {
        "load_pressure_pa": pressure + pressure_noise * rng.standard_normal(len(t)),
        "force_n": rig.plant.piston_area * pressure + force_noise * rng.standard_normal(len(t)),
    }


@pytest.mark.parametrize(("force_noise", "pressure_noise"), [(50.0, 1e3), (5.0, 1e4)])
def test_the_noise_floor_is_that_of_two_averaged_sensors(rig, force_noise, pressure_noise):
    area = rig.plant.piston_area
    t, signals = two_force_sensors(rig, force_noise, pressure_noise)
    record = prepare(Trajectory(t, signals), rig, "it")
    # The propagated noise is that reported by the record.
    record = record._replace(noise={"load_pressure_pa": pressure_noise, "force_n": force_noise})
    evidence = gather(record, rig, stages.setup(record, rig), 0)
    assert evidence.channels == ("cell",)
    gain = np.linalg.norm(evidence.setup.average.weights)
    noise = gain * math.hypot(force_noise, area * pressure_noise)
    expected = math.hypot(noise, rules.TOLERANCE * evidence.sizes["cell"])
    assert np.sqrt(np.mean(evidence.floor["cell"] ** 2)) == pytest.approx(expected, rel=0.03)
    assert np.sqrt(power(evidence.noise["cell"])) == pytest.approx(noise / expected, rel=0.05)


def test_commanded_signals_carry_no_noise(rig):
    t, signals = two_force_sensors(rig, 5.0, 1e3, seconds=1.0)
    record = prepare(Trajectory(t, signals | {"valve_command_m": 1e-4 * np.sin(t)}), rig, "it")
    noisy = with_noise(record, deviations(record), np.random.default_rng(0))
    np.testing.assert_array_equal(noisy.signals["valve_command_m"], record.signals["valve_command_m"])
    added = noisy.signals["force_n"] - record.signals["force_n"]
    assert np.std(added) == pytest.approx(record.noise["force_n"], rel=0.1)


def test_a_diverged_model_has_large_finite_residuals():
    raw = {"force": np.array([1.0, np.nan, np.inf, -np.inf, -1e9, 7.0])}
    mask = {"force": np.array([True, True, True, True, True, False])}
    e = whitened(raw, mask, {"force": np.full(5, 0.5)})["force"]
    far = MAX_RESIDUAL
    np.testing.assert_array_equal(e, [2.0, far, far, -far, -far])


# -------------------------------------------------------------------------------------------- a recording of the truth


@pytest.fixture(scope="module")
def noisy(rig, recorded):
    r = recorded({}, "rich", seed=11, duration=20.0)
    return prepare(Trajectory(r.time, r.columns), rig, "noisy")


@pytest.fixture(scope="module")
def evidence(noisy, rig):
    return gather(noisy, rig, stages.setup(noisy, rig), 0)


def test_residuals_of_a_right_model_are_as_large_as_their_noise(evidence):
    assert set(evidence.channels) == set(CHANNELS) - {"volume_a", "volume_b"}
    for channel, e in evidence.base.values.items():
        # The floor also holds a tolerance, so both are compared with the noise alone.
        assert 0.8 < np.sqrt(power(e) / power(evidence.noise[channel])) < 1.2, channel
        assert 0.5 < np.sqrt(power(e)) < 1.2, channel


def test_every_window_lies_in_a_block(evidence):
    assert evidence.blocks == 8
    for channel, e in evidence.base.values.items():
        assert len(e) == len(evidence.block[channel]) == len(evidence.times[channel]) == len(evidence.floor[channel])
        assert set(evidence.block[channel]) == set(range(evidence.blocks)), channel
        begins = [evidence.times[channel][evidence.block[channel] == b][0] for b in range(evidence.blocks)]
        assert begins[0] < rules.BLOCK
        # The force balance is judged from when friction no longer depends on its force at the beginning.
        whole = begins[1:] if channel == "force" else begins
        np.testing.assert_allclose(np.diff(whole), rules.BLOCK, atol=0.35)


@pytest.mark.parametrize("begin", [3.2, 5.0, 6.1])
def test_friction_does_not_count_until_its_unknown_force_at_the_beginning_is_forgotten(noisy, rig, begin):
    # At these times the friction falls from its break-away force, which the motion does not show.
    cut = noisy.parts([(round(begin / noisy.period), len(noisy.time))])
    judged = gather(cut, rig, stages.setup(cut, rig), 0)
    assert judged.times["force"][0] < begin + 0.2 * (20.0 - begin)
    assert power(judged.base.values["force"][:40]) < 1.5


def test_windows_with_a_gap_do_not_count(noisy, rig, evidence):
    bad = {name: good.copy() for name, good in noisy.good.items()}
    bad["load_pressure_pa"][9000:9200] = False
    gapped = gather(noisy._replace(good=bad), rig, stages.setup(noisy, rig), 0)
    for channel in ("force", "volume"):
        inside = np.abs(gapped.times[channel] - 9.1) < 0.1
        assert not inside.any(), channel
        assert np.any(np.abs(evidence.times[channel] - 9.1) < 0.1), channel
    assert len(gapped.times["spool"]) == len(evidence.times["spool"])


# --------------------------------------------------------------------------------------------------- models in evidence


class Model:
    """Stand-in for a comparison: the raw residuals of one model, and the dependencies of each channel."""

    def __init__(self, raw, depends):
        self.raw, self.depends, self.asked = raw, depends, []

    def relevant(self, rig):
        return self.depends

    def residuals(self, rig, channels):
        self.asked += channels
        return {c: self.raw[c] for c in channels}


def test_a_model_leaves_in_part_of_the_windows_what_it_leaves_there_in_all(evidence, rig):
    kept = {c: np.arange(len(e)) % 3 > 0 for c, e in evidence.base.values.items()}
    kept["supply"][:] = False
    part = part_of(evidence, kept)
    assert part.channels == tuple(c for c in evidence.channels if c != "supply")
    heavier = rig._replace(plant=rig.plant._replace(moving_mass=80.0, valve_gain=1.1))
    all_of, some = (e.residuals(e.comparison(), heavier).values for e in (evidence, part))
    for c in part.channels:
        np.testing.assert_array_equal(some[c], all_of[c][kept[c]])
        np.testing.assert_array_equal(part.times[c], evidence.times[c][kept[c]])


def test_only_channels_that_depend_on_something_else_are_computed():
    base = {"force": np.zeros(24), "volume": np.ones(24)}
    evidence = replace(evidence_of(base), base=Residuals(base, {"force": "a", "volume": "b"}))
    model = Model({"force": np.full(24, 5.0), "volume": np.full(24, 6.0)}, {"force": "a", "volume": "changed"})
    found = evidence.residuals(model, None)
    assert model.asked == ["volume"]
    np.testing.assert_array_equal(found.values["force"], 0.0)
    np.testing.assert_array_equal(found.values["volume"], 6.0)
    assert found.depends == model.depends
    again = evidence.residuals(model, None, found)
    assert model.asked == ["volume"]
    np.testing.assert_array_equal(again.values["volume"], 6.0)


def test_averaging_noise_saves_its_loss_and_passing_it_on_saves_nothing():
    noise = np.random.default_rng(1).standard_normal(4000)
    evidence = evidence_of({"force": np.zeros(4000)}, {"force": noise})
    own = Residuals({"force": np.zeros(4000)})
    averages, passes = Model({"force": 1e-3 * noise}, {}), Model({"force": noise}, {})
    saved = evidence.averaged_noise(averages, None, own, ("force",))["force"]
    assert saved == pytest.approx(float(np.sum(loss(noise))), rel=0.01)
    assert evidence.averaged_noise(passes, None, own, ("force",))["force"] == 0.0


@pytest.mark.parametrize(("remains", "factor"), [(0.1, 1.0), (0.6, 1.44), (0.7, 1.96), (3.0, rules.MAX_NOISE_SCALE)])
def test_where_the_noise_is_larger_than_estimated_more_of_it_is_averaged(remains, factor):
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, 4000)
    evidence = evidence_of({"force": np.zeros(4000)}, {"force": noise})
    # The model passes on half of the added noise.
    model = Model({"force": (remains + 0.5) * noise}, {})
    saved = evidence.averaged_noise(model, None, Residuals({"force": remains * noise}), ("force",))["force"]
    assert saved == pytest.approx(factor * 0.75 * float(np.sum(loss(noise))), rel=1e-9)


def test_joined_channels_are_found_again_in_their_sections():
    evidence = evidence_of({"force": np.arange(5.0), "cell": np.arange(3.0), "volume": np.arange(4.0)})
    channels = ("cell", "force")
    joined = evidence.base.joined(channels)
    for channel, rows in sections(evidence.block, channels).items():
        np.testing.assert_array_equal(joined[rows], evidence.base.values[channel])
    assert evidence.base.joined(()).size == 0


@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_noise_that_grows_with_the_rate_is_jitter(jitter, rig):
    rng = np.random.default_rng(4)
    k = np.arange(20000.0)
    moments = k + jitter * rng.standard_normal(len(k))
    signals = {
        "position_m": 0.05 * np.sin(2e-3 * moments) + 2e-6 * rng.standard_normal(len(k)),
        "supply_pressure_pa": 7e6 + 1e3 * rng.standard_normal(len(k)),
    }
    found = deviations(prepare(Trajectory(PERIOD * k, signals), rig, "it"))
    speed = 1e-4 * np.abs(np.cos(2e-3 * k))
    for part in (speed < 3e-5, speed > 9e-5):
        said, true = (np.sqrt(np.mean(x[part] ** 2)) for x in (found["position_m"], np.hypot(2e-6, jitter * speed)))
        assert said == pytest.approx(true, rel=0.15)
    np.testing.assert_allclose(found["supply_pressure_pa"], 1e3, rtol=0.05)
