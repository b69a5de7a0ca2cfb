"""Friction identified from noisy recordings with known friction, and from unsuitable recordings."""

import json
from pathlib import Path

import numpy as np
import pytest
from identification.recordings import PAPER_VELOCITIES, PERIOD, recorded, small_sine, sweep

from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.identify import identify
from ehls_ros.identification.result import to_json
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.trajectory import Trajectory

CONFIG = Path(__file__).parents[2] / "config"

PAPER_ERRORS = {
    "coulomb_force": 3.45,
    "static_force": 2.26,
    "stribeck_velocity": 1.89,
    "stribeck_exponent": 3.62,
    "viscous_coefficient": 1.37,
}
"""Errors of the static fit reported in the paper [%]."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIG / "rig_paper.yaml")


@pytest.fixture(scope="module")
def guess(rig) -> Rig:
    """Return a rig file with only a rough guess of the friction."""
    rough = rig.friction._replace(
        coulomb_force=500.0,
        static_force=600.0,
        stribeck_velocity=5e-3,
        stribeck_exponent=1.0,
        viscous_coefficient=5e3,
        element_stiffness=(1e6,),
        element_weight=(1.0,),
        attraction_rate=500.0,
    )
    return rig._replace(friction=rough)


@pytest.fixture(scope="module")
def recordings(rig) -> dict[str, Trajectory]:
    return {"sweep": recorded(sweep(), rig, 1), "sine": recorded(small_sine(), rig, 2)}


@pytest.fixture(scope="module")
def found(recordings, guess):
    return identify(recordings, guess)


@pytest.mark.parametrize("name", PAPER_ERRORS)
def test_static_coefficients_are_closer_than_the_papers(found, rig, name):
    true = getattr(rig.friction, name)
    assert 100.0 * abs(found.estimates[name].value / true - 1.0) < PAPER_ERRORS[name]
    assert abs(found.estimates[name].value - true) < 5.0 * found.estimates[name].std


def test_the_papers_three_elements_are_one(found, rig):
    assert len(found.rig.friction.element_stiffness) == 1
    assert any("1 friction element explains the loop" in remark for remark in found.remarks)
    assert found.estimates["element_stiffness_1"].value == pytest.approx(sum(rig.friction.element_stiffness), rel=0.01)
    assert found.estimates["attraction_rate"].value == pytest.approx(1650.0, rel=0.1)


def test_standard_errors_known_to_be_too_small_are_said(found, rig):
    truth = {"coulomb_force": rig.friction.coulomb_force, "element_stiffness_1": sum(rig.friction.element_stiffness)}
    truth["attraction_rate"] = rig.friction.attraction_rate
    assert set(found.understated) == set(truth)
    [said] = [remark for remark in found.remarks if "exceed their standard errors" in remark]
    for name, value in truth.items():
        estimate, factor = found.estimates[name], found.understated[name]
        assert f"{name} {factor:g} times" in said
        assert abs(estimate.value - value) < 3.0 * factor * estimate.std


def test_viscous_damping_is_said_to_be_part_of_a_sum(found):
    assert "viscous_damping" in found.not_identifiable
    assert "viscous_damping" not in found.estimates
    assert found.rig.plant.viscous_damping == 60.0


def test_spring_and_gravity_are_found(found):
    assert found.estimates["spring_stiffness"].value == pytest.approx(4e4, rel=1e-4)
    assert found.rig.plant.gravity * found.rig.plant.moving_mass == pytest.approx(70.0 * 9.81, rel=1e-3)


def test_the_rig_can_be_used_as_it_is(found):
    assert rig_from_mapping(rig_to_mapping(found.rig), "rig") == found.rig


@pytest.mark.long
def test_separate_elements_are_told_apart(rig, guess):
    true = rig.friction._replace(element_stiffness=(3e6, 1e6, 3e5), element_weight=(0.35, 0.35, 0.3))
    other = rig._replace(friction=true)
    out = identify({"sweep": recorded(sweep(), other, 3), "sine": recorded(small_sine(), other, 4)}, guess)
    assert len(out.rig.friction.element_stiffness) == 3
    for i in range(3):
        assert out.estimates[f"element_stiffness_{i + 1}"].value == pytest.approx(true.element_stiffness[i], rel=0.05)
        assert out.estimates[f"element_weight_{i + 1}"].value == pytest.approx(true.element_weight[i], rel=0.05)
    assert out.estimates["attraction_rate"].value == pytest.approx(1650.0, rel=0.1)
    assert [node.way for node in out.nodes] == sorted(node.way for node in out.nodes)


def test_without_slow_strokes_the_stribeck_curve_is_not_given_as_numbers(rig, guess):
    out = identify({"sweep": recorded(sweep(PAPER_VELOCITIES[10:]), rig, 5)}, guess)
    assert {"stribeck_velocity", "stribeck_exponent"} <= set(out.not_identifiable)
    assert not {"stribeck_velocity", "stribeck_exponent"} & set(out.estimates)
    assert out.estimates["coulomb_force"].value == pytest.approx(640.8, rel=0.01)


def test_without_presliding_the_elements_stay_the_rig_files(recordings, guess):
    out = identify({"sweep": recordings["sweep"]}, guess)
    assert out.rig.friction.element_stiffness == guess.friction.element_stiffness
    assert {"element_stiffness", "element_weight", "attraction_rate"} <= set(out.not_identifiable)
    assert out.estimates["static_force"].value == pytest.approx(865.4, rel=0.02)


def test_presliding_with_too_few_turns_does_not_count(recordings, rig, guess):
    out = identify({"short": recorded(small_sine(duration=4.0), rig, 4), "sweep": recordings["sweep"]}, guess)
    assert out.branch is None
    assert {"element_stiffness", "element_weight", "attraction_rate"} <= set(out.not_identifiable)
    assert json.loads(json.dumps(to_json(out)))["noise_n"]["short"] is None
    assert to_json(out)["noise_n"]["sweep"] > 0.0


def test_one_speed_does_not_count_beside_presliding(recordings, rig, guess):
    out = identify({"one": recorded(sweep([0.1]), rig, 3), "sine": recordings["sine"]}, guess)
    assert out.static is None
    assert np.isnan(out.fit.residuals[0]).all()
    assert out.estimates["element_stiffness_1"].value == pytest.approx(sum(rig.friction.element_stiffness), rel=0.05)


def test_elements_of_a_model_without_them_are_refused(recordings, rig):
    data = rig_to_mapping(rig)
    data["friction"]["model"] = "lugre"
    with pytest.raises(BadInput, match="2 friction elements are asked for, friction model 'lugre' has none"):
        identify(recordings, rig_from_mapping(data, "rig"), elements=2)


def test_strokes_that_end_before_friction_settles_do_not_count(recordings, guess, monkeypatch):
    monkeypatch.setattr("ehls_ros.identification.elements.STEADY_LAGS", 60.0)
    out = identify(recordings, guess)
    assert "Nothing slides steadily for long enough: of the Stribeck curve only its level is fitted." in out.remarks
    assert {"stribeck_velocity", "stribeck_exponent"} <= set(out.not_identifiable)
    assert np.isnan(out.fit.residuals[0]).all()


def changed(trajectory: Trajectory, **signals: np.ndarray) -> Trajectory:
    return Trajectory(trajectory.time_s, {**trajectory.signals, **signals})


@pytest.mark.parametrize("part", [0.01, 0.1])
def test_outliers_are_left_out(recordings, guess, part):
    random = np.random.default_rng(0)
    spoilt = {}
    for name, recording in recordings.items():
        force, position = recording["force_n"].copy(), recording["position_m"].copy()
        hit = random.random(len(force)) < part
        force[hit] += random.choice([-1.0, 1.0], hit.sum()) * random.uniform(1e3, 5e4, hit.sum())
        position[random.random(len(position)) < part / 10.0] = 0.7
        spoilt[name] = changed(recording, force_n=force, position_m=position)
    out = identify(spoilt, guess)
    for name, percent in PAPER_ERRORS.items():
        true = {"coulomb_force": 640.8, "static_force": 865.4, "stribeck_velocity": 2.031e-3, "stribeck_exponent": 0.8764}
        assert 100.0 * abs(out.estimates[name].value / true.get(name, 7265.0) - 1.0) < percent
    assert any("outliers" in remark for remark in out.remarks)


def test_gaps_are_passed_over(recordings, guess):
    random = np.random.default_rng(1)
    kept = {}
    for name, recording in recordings.items():
        there = random.random(len(recording)) > 0.02
        for start in random.integers(0, len(recording) - 400, 5):
            there[start : start + 400] = False
        kept[name] = Trajectory(recording.time_s[there], {k: v[there] for k, v in recording.signals.items()})
    out = identify(kept, guess)
    assert out.estimates["coulomb_force"].value == pytest.approx(640.8, rel=0.01)
    assert out.estimates["static_force"].value == pytest.approx(865.4, rel=0.0226)


def refusal(recordings: dict[str, Trajectory], rig: Rig) -> str:
    with pytest.raises(BadInput) as caught:
        identify(recordings, rig)
    return str(caught.value)


def test_one_direction_is_refused(recordings, guess):
    velocity = np.maximum(sweep(PAPER_VELOCITIES[12:]), 0.0)
    message = refusal(
        {"forth": recorded(velocity, guess, 6)}, guess._replace(limits=guess.limits._replace(position=(-25.0, 25.0)))
    )
    assert "position_m slides forwards only" in message
    assert "forth" in message


@pytest.mark.parametrize(
    ("signal", "factor", "said"),
    [
        ("position_m", 1e3, "position_m"),
        ("force_n", 1e3, "force"),
        ("force_n", 1e-3, "force_n"),
        ("position_m", 1e-3, "position_m"),
    ],
)
def test_a_unit_off_by_1000_is_refused(recordings, guess, signal, factor, said):
    recording = recordings["sweep"]
    message = refusal({"sweep": changed(recording, **{signal: factor * recording[signal]})}, guess)
    assert said in message
    assert "sweep" in message


@pytest.mark.parametrize("signal", ["position_m", "force_n"])
def test_a_stuck_sensor_is_refused(recordings, guess, signal):
    recording = recordings["sweep"]
    values = recording[signal].copy()
    values[20_000:60_000] = values[20_000]
    message = refusal({"sweep": changed(recording, **{signal: values})}, guess)
    assert f"{signal} is stuck from 20" in message


@pytest.mark.parametrize("signal", ["position_m", "force_n"])
def test_a_missing_signal_is_named(recordings, guess, signal):
    recording = recordings["sweep"]
    rest = {name: values for name, values in recording.signals.items() if name != signal}
    assert f"'{signal}' is missing" in refusal({"sweep": Trajectory(recording.time_s, rest)}, guess)


def test_pressure_stands_in_for_force(recordings, guess, found):
    area = guess.plant.piston_area
    pressures = {
        name: Trajectory(r.time_s, {"position_m": r["position_m"], "load_pressure_pa": r["force_n"] / area})
        for name, r in recordings.items()
    }
    out = identify(pressures, guess)
    assert out.estimates["coulomb_force"].value == pytest.approx(found.estimates["coulomb_force"].value, rel=1e-6)


def test_too_short_a_recording_is_refused(rig):
    short = recorded(np.full(20, 0.01), rig)
    assert "long" in refusal({"short": short}, rig)


def test_nothing_is_refused(rig):
    assert "no recording" in refusal({}, rig)


def test_another_sampling_period_does(recordings, guess):
    every = {name: Trajectory(r.time_s[::5], {k: v[::5] for k, v in r.signals.items()}) for name, r in recordings.items()}
    assert every["sweep"].time_s[1] == pytest.approx(5.0 * PERIOD)
    out = identify(every, guess)
    assert out.estimates["coulomb_force"].value == pytest.approx(640.8, rel=0.01)
    assert out.estimates["viscous_coefficient"].value == pytest.approx(7265.0, rel=0.0137)
