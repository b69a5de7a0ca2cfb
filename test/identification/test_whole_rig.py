"""A whole rig identified from recordings of the truth generator, nothing hidden, from a guess off by a factor of two."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
import yaml
from tiers import tiered

from ehls_ros.errors import BadInput
from ehls_ros.identification.rig_coefficients import COULOMB, DELAY, HYSTERESIS, SECOND_ORDER, Sizes, coefficients, read
from ehls_ros.identification.rig_result import rig_to_json
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import record

RIG_FILE = Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml"
FACTORS = {
    "supply_pressure": 0.5,
    "bulk_modulus": 2.0,
    "discharge_coefficient": 2.0,
    "leakage_coefficient": 0.5,
    "moving_mass": 2.0,
    "spring_stiffness": 0.5,
    "valve_bandwidth": 2.0,
    "valve_gain": 0.5,
}


@pytest.fixture(scope="module")
def rig_file() -> dict[str, Any]:
    return yaml.safe_load(RIG_FILE.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def truth(rig_file) -> Rig:
    return rig_from_mapping(rig_file, RIG_FILE.name)


@pytest.fixture(scope="module")
def guess(truth) -> Rig:
    """Return a rig with every identifiable coefficient of plant and valve at twice or half the truth."""
    return truth._replace(plant=truth.plant._replace(**{name: getattr(truth.plant, name) * by for name, by in FACTORS.items()}))


def recording(rig_file, experiment, seed, duration=15.0, hidden=None, without=()) -> Trajectory:
    made = record(rig_file, hidden or {}, experiment, seed=seed, duration=duration)
    return Trajectory(made.time, {name: values for name, values in made.columns.items() if name not in without})


@pytest.fixture(scope="module")
def rich(rig_file) -> Trajectory:
    return recording(rig_file, "rich", 3)


@pytest.fixture(scope="module")
def found(rich, guess):
    return identify_rig({"rich": rich}, guess)


@pytest.mark.parametrize("name", FACTORS)
def test_a_guess_off_by_two_returns_to_the_truth(found, truth, name):
    estimate, true = found.estimates[f"plant.{name}"], getattr(truth.plant, name)
    assert abs(estimate.value - true) < 3.0 * estimate.std
    assert estimate.value == pytest.approx(true, rel=0.02)
    assert getattr(found.rig.plant, name) == estimate.value


def test_nothing_is_put_into_the_rig_that_it_does_not_have(found):
    assert not found.rig.effects
    assert found.rig.sensors["velocity"].gain == 1.0
    assert "effects.constant_load.force" in found.absent


def test_what_is_left_is_noise(found):
    for channel in found.channels.values():
        assert channel.after < 1.5 * channel.noise
    assert found.channels["force"].before > 10.0 * found.channels["force"].after


def test_what_only_a_product_tells_is_kept_and_said(found, guess):
    assert "plant.discharge_coefficient" in found.not_identifiable["plant.valve_area_gradient"]
    assert "plant.bulk_modulus" in found.not_identifiable["plant.total_volume"]
    assert found.rig.plant.total_volume == guess.plant.total_volume


def test_the_rig_and_the_result_can_be_written_and_read(found):
    assert rig_from_mapping(rig_to_mapping(found.rig), "rig") == found.rig
    result = json.loads(json.dumps(rig_to_json(found), allow_nan=False))
    assert list(result["parameters"]) == list(found.estimates)
    matrix = np.array(result["correlations"]["matrix"])
    assert np.allclose(np.diag(matrix), 1.0)
    assert np.all(np.abs(matrix) <= 1.0 + 1e-9)


@pytest.mark.long
def test_biases_and_a_delay_are_found(rig_file, guess, truth):
    hidden = {"command_delay": {"delay": 4e-3}, "constant_load": {"force": 300.0}}
    out = identify_rig({"rich": recording(rig_file, "rich", 5, hidden=hidden)}, guess)
    delay = out.estimates["effects.command_delay.delay"]
    assert abs(delay.value - 4e-3) < 3.0 * delay.std < 4e-4
    assert abs(out.estimates["effects.constant_load.force"].value) == pytest.approx(300.0, rel=0.05)
    assert out.estimates["plant.valve_bandwidth"].value == pytest.approx(truth.plant.valve_bandwidth, rel=0.02)


@pytest.mark.long
def test_a_valve_with_inertia_hysteresis_and_delay_is_found(guess):
    """Its spool is the exact response to a held command: delayed, then lost at reversals, then of second order."""
    delay, width, frequency, damping, fine = 1.2e-3, 6e-6, 420.0, 0.75, 5
    rng, period = np.random.default_rng(4), 1e-3
    time = period * np.arange(12_000)
    sines = [1e-4 * np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.0)) for f in (0.7, 3.1, 11.0, 37.0)]
    command = np.sum(sines, axis=0) + 2e-4 * np.repeat(rng.uniform(-1.0, 1.0, 40), 300)
    late = np.repeat(command, fine)
    late = np.concatenate([np.zeros(round(delay / period * fine)), late])[: len(late)]
    played, at = np.empty_like(late), 0.0
    for k, value in enumerate(late):
        at = min(max(at, value - 0.5 * width), value + 0.5 * width)
        played[k] = at
    system = scipy.signal.cont2discrete(([frequency**2], [1.0, 2.0 * damping * frequency, frequency**2]), period / fine)
    spool = scipy.signal.lfilter(system[0].ravel(), system[1], played)[::fine]
    noisy = spool + 2e-7 * rng.standard_normal(len(spool))
    out = identify_rig({"valve": Trajectory(time, {"valve_command_m": command, "spool_m": noisy})}, guess)
    truth = dict(zip((DELAY, HYSTERESIS[0], *SECOND_ORDER), (delay, width, frequency, damping), strict=True))
    for path, true in truth.items():
        assert abs(out.estimates[path].value - true) < 3.0 * out.estimates[path].std
        assert out.estimates[path].value == pytest.approx(true, rel=0.02)
    assert SECOND_ORDER[0] in out.not_identifiable["plant.valve_bandwidth"]


def test_a_delay_is_found_although_one_recording_hardly_moves_the_spool(guess):
    """A hysteresis has a least width while it is fitted, which is large against the small spool displacement."""
    delay, bandwidth, step, period = 1e-3, 363.0, 4e-8, 1e-3
    time = period * np.arange(10_000)
    rich = 2e-4 * np.sin(2.0 * np.pi * 3.0 * time) + 1e-5 * np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 2500), 4)
    slow = 2e-6 * np.exp(0.3 * time) * np.sin(2.0 * np.pi * 0.5 * time)
    recordings = {}
    for name, command in (("rich", rich), ("slow", slow)):
        decay = math.exp(-bandwidth * period)
        spool = scipy.signal.lfilter([0.0, 0.0, 1.0 - decay], [1.0, -decay], command)
        recordings[name] = Trajectory(time, {"valve_command_m": command, "spool_m": step * np.round(spool / step)})
    out = identify_rig(recordings, guess)
    assert out.estimates[DELAY].value == pytest.approx(delay, rel=0.01)
    assert out.estimates["plant.valve_bandwidth"].value == pytest.approx(bandwidth, rel=0.01)


@pytest.mark.long
def test_a_load_cell_that_reads_too_much_is_found(rich, guess):
    louder = Trajectory(rich.time_s, {**rich.signals, "force_n": 1.05 * rich["force_n"] + 50.0})
    out = identify_rig({"rich": louder}, guess)
    assert out.estimates["sensors.force.gain"].value == pytest.approx(1.05, rel=1e-3)
    assert out.estimates["sensors.force.bias"].value == pytest.approx(50.0, abs=2.0)
    assert out.rig.sensors["force"].gain == out.estimates["sensors.force.gain"].value


def test_a_coefficient_that_is_not_excited_is_named_and_left_alone(rig_file, guess):
    out = identify_rig({"rest": recording(rig_file, "rest", 2, duration=8.0)}, guess)
    assert "plant.moving_mass" in out.not_identifiable
    assert "plant.moving_mass" not in out.estimates
    assert out.rig.plant.moving_mass == guess.plant.moving_mass


@pytest.mark.parametrize("missing", tiered(["velocity_m_s", "load_pressure_pa", "spool_m"], "load_pressure_pa"))
def test_a_signal_may_be_missing(rich, guess, truth, missing):
    without = {name: values for name, values in rich.signals.items() if name not in (missing, "supply_pressure_pa")}
    out = identify_rig({"rich": Trajectory(rich.time_s, without)}, guess)
    for name in ("moving_mass", "spring_stiffness", "bulk_modulus"):
        assert read(out.rig, f"plant.{name}") == pytest.approx(getattr(truth.plant, name), rel=0.03)
    if missing == "spool_m":
        assert "product" in out.not_identifiable["plant.valve_gain"]
        product = out.rig.plant.valve_gain * out.rig.plant.discharge_coefficient
        assert product == pytest.approx(truth.plant.valve_gain * truth.plant.discharge_coefficient, rel=0.02)


def test_a_noisy_position_does_not_make_the_mass_smaller(rig_file, truth):
    sine = recording(rig_file, "paper_sine", 3, without=("velocity_m_s",))
    noise = 2e-5 * np.random.default_rng(1).standard_normal(len(sine))
    out = identify_rig({"sine": Trajectory(sine.time_s, {**sine.signals, "position_m": sine["position_m"] + noise})}, truth)
    mass = out.estimates["plant.moving_mass"]
    assert abs(mass.value - truth.plant.moving_mass) < 2.0 * mass.std
    # Least squares are 0.45 % too low.
    assert mass.value == pytest.approx(truth.plant.moving_mass, rel=0.003)


@pytest.mark.long
def test_two_recordings_tell_more_than_one(rig_file, guess, truth, found, rich):
    out = identify_rig({"rich": rich, "random": recording(rig_file, "random", 4)}, guess)
    assert out.recordings == ("rich", "random")
    assert out.rig.plant.moving_mass == pytest.approx(truth.plant.moving_mass, rel=0.02)
    assert out.estimates["plant.supply_pressure"].std < 1.2 * found.estimates["plant.supply_pressure"].std


@pytest.mark.long
def test_a_spoilt_recording_is_left_out_and_named(rich, guess):
    holes = np.where(np.arange(len(rich)) % 3 == 0, math.nan, rich["position_m"])
    spoilt = Trajectory(rich.time_s, {**rich.signals, "position_m": holes})
    with pytest.raises(BadInput, match="position_m"):
        identify_rig({"spoilt": spoilt}, guess)
    out = identify_rig({"spoilt": spoilt, "rich": rich}, guess)
    assert out.recordings == ("rich",)
    assert any("spoilt" in remark and "position_m" in remark for remark in out.remarks)


def test_a_stuck_recording_changes_nothing(rich, guess):
    stuck = {name: np.full(len(rich), values[0]) for name, values in rich.signals.items()}
    out = identify_rig({"stuck": Trajectory(rich.time_s, stuck)}, guess)
    assert out.rig.plant == guess.plant
    assert out.rig.friction == guess.friction
    assert {f"plant.{name}" for name in FACTORS} <= set(out.not_identifiable)


@pytest.mark.long
def test_slow_data_tell_what_needs_no_fast_sampling(rich, guess, truth):
    slow = Trajectory(rich.time_s[::10], {name: values[::10] for name, values in rich.signals.items()})
    out = identify_rig({"slow": slow}, guess)
    json.dumps(rig_to_json(out), allow_nan=False)
    assert out.rig.plant.supply_pressure == pytest.approx(truth.plant.supply_pressure, rel=0.02)
    assert out.rig.plant.moving_mass == pytest.approx(truth.plant.moving_mass, rel=0.02)
    # The spool has settled between two samples.
    assert out.rig.plant.valve_bandwidth == guess.plant.valve_bandwidth
    assert "plant.valve_bandwidth" in out.not_identifiable


def test_the_friction_of_a_rig_far_larger_than_its_recorded_force_may_be_next_to_nothing(truth):
    """Its data sheet's guess, a share of the largest force, may exceed the friction by more than a search usually spans."""
    large = truth._replace(friction=truth.friction._replace(coulomb_force=1e3, static_force=1.3e3))
    [friction] = [c for c in coefficients(large, Sizes(1e-4, 500.0, 0.02)) if c.path == COULOMB]
    assert math.exp(friction.low) == pytest.approx(1e-4 * 500.0)


def test_without_a_recording_there_is_nothing_to_identify(guess):
    with pytest.raises(BadInput, match="no recording"):
        identify_rig({}, guess)
