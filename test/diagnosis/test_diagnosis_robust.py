"""Spoilt data and wrong rig files: the right verdict or an inconclusive one, never a wrong name with confidence."""

import warnings

import numpy as np
import pytest
from test_hidden_effects import CONFIDENT, class_of, told

from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.errors import BadInput
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import degrade

DURATION = 8.0
HIDDEN = {"coulomb_shift": {"offset": 250.0}}
NAMES = {"coulomb_shift"}


def rng():
    return np.random.default_rng(7)


def assert_no_wrong_name(d, names):
    wrong = [c for c in d.causes if not class_of(c) & set(names) and c.probability > CONFIDENT]
    assert not wrong, told(d)


@pytest.fixture(scope="module")
def hidden(recorded):
    """Return a recording with more Coulomb friction than the rig file has."""
    return recorded(HIDDEN, "rich", seed=201, duration=DURATION)


SPOILT = {
    "lost samples": lambda r: degrade.drop_samples(r, rng(), 0.01),
    "outliers": lambda r: degrade.add_outliers(r, rng(), 0.001),
    "stretches of NaN": lambda r: degrade.blank(r, rng(), 2, 0.2),
    "uncertain time stamps": lambda r: degrade.jitter(r, rng(), 2e-5),
}


@pytest.mark.long
@pytest.mark.parametrize("how", SPOILT)
def test_spoilt_data_still_tell_the_cause(how, hidden, diagnosed):
    d = diagnosed(SPOILT[how](hidden))
    assert_no_wrong_name(d, NAMES)
    assert d.verdict == "effect", told(d)
    assert {"coulomb_shift"} & class_of(d.causes[0]), told(d)
    if d.causes[0].name == "coulomb_shift":
        assert d.causes[0].parameters["offset"].value == pytest.approx(250.0, rel=0.1), told(d)


@pytest.mark.long
def test_gaps_in_the_data_of_a_right_model_are_no_error_of_it(recorded, diagnosed):
    d = diagnosed(SPOILT["stretches of NaN"](recorded({}, "rich", seed=202, duration=DURATION)))
    assert d.verdict == "consistent", told(d)


@pytest.mark.long
@pytest.mark.parametrize("column", ["load_pressure_pa", "position_m"])
def test_a_signal_that_comes_late_is_a_sensors_delay(column, recorded, diagnosed):
    r = degrade.shift(recorded({}, "rich", seed=203, duration=DURATION), column, 5e-3)
    d = diagnosed(r)
    assert_no_wrong_name(d, {"sensor_delay", "pressure_sensor_lag"} if column == "load_pressure_pa" else {"sensor_delay"})
    assert d.verdict in {"effect", "unknown", "insufficient"}, told(d)


# With neither velocity nor load cell: test_a_slow_friction_loop_at_100_hz_is_judged_and_its_error_found.
LEFT_OUT = {
    "no spool": ("spool_m",),
    "no pressure": ("load_pressure_pa",),
    "no position": ("position_m",),
    "no command": ("valve_command_m",),
}


@pytest.mark.long
@pytest.mark.parametrize("how", LEFT_OUT)
def test_a_missing_signal_narrows_what_is_judged(how, hidden, diagnosed):
    d = diagnosed(degrade.without(hidden, *LEFT_OUT[how]))
    assert_no_wrong_name(d, NAMES)
    if how == "no position":
        # The spring force is unknown then, and the friction cannot be judged.
        assert d.verdict == "consistent", told(d)
        assert "position_m" in d.stages["force_balance"].why_not
        return
    assert d.verdict == "effect", told(d)
    assert {"coulomb_shift"} & class_of(d.causes[0]), told(d)
    assert d.stages["force_balance"].judged
    if how == "no command":
        assert not d.stages["valve"].judged
        assert "valve_command_m" in d.stages["valve"].why_not
    assert any(line.startswith(f"{stage}: ") for stage, s in d.stages.items() if not s.judged for line in d.missing) or all(
        s.judged for s in d.stages.values()
    )


@pytest.mark.long
def test_position_and_force_alone_tell_the_force_balance(hidden, diagnosed):
    d = diagnosed(degrade.without(hidden, *(set(hidden.columns) - {"position_m", "force_n", "disturbance_force_n"})))
    assert_no_wrong_name(d, NAMES)
    assert d.verdict == "effect", told(d)
    assert {stage for stage, s in d.stages.items() if s.judged} == {"force_balance"}


def test_one_signal_alone_tells_nothing(hidden, diagnosed):
    d = diagnosed(degrade.without(hidden, *(set(hidden.columns) - {"position_m"})))
    assert d.verdict == "insufficient", told(d)
    assert len(d.missing) == len(d.stages) == 4
    assert not any(s.judged for s in d.stages.values())


@pytest.mark.long
@pytest.mark.parametrize(("rate", "duration"), [(100.0, 20.0), (2000.0, 6.0)])
def test_other_rates_do_as_well(rate, duration, recorded, diagnosed):
    d = diagnosed(recorded(HIDDEN, "rich", seed=204, duration=duration, rate=rate))
    assert_no_wrong_name(d, NAMES)
    assert d.verdict in {"effect", "unknown"}, told(d)
    if d.verdict == "effect":
        assert {"coulomb_shift"} & class_of(d.causes[0]), told(d)


@pytest.mark.long
def test_a_right_model_is_consistent_at_a_low_rate(recorded, diagnosed):
    d = diagnosed(recorded({}, "rich", seed=205, duration=12.0, rate=200.0))
    assert d.verdict in {"consistent", "insufficient"}, told(d)
    # Command and piston move little within a sample: no stage is left out because of the rate.
    assert all(result.judged for result in d.stages.values()), told(d)


@pytest.mark.long
def test_three_wrong_parameters_of_the_rig_file_are_named(recorded, diagnosed, rig_file):
    wrong = degrade.wrong_rig(
        rig_file, {"plant.bulk_modulus": 1.3, "plant.spring_stiffness": 0.7, "friction.viscous_coefficient": 1.3}
    )
    d = diagnosed(recorded({}, "rich", seed=206, duration=DURATION), rig_from_mapping(wrong, "wrong"))
    named = [
        shift
        for shift in ("bulk_modulus_shift", "spring_rate_shift", "viscous_shift")
        if any(shift in class_of(c) for c in d.causes)
    ]
    assert len(named) >= 2, told(d)
    assert d.gain.closed_fraction >= 0.9, told(d)
    # The extended model corrects the errors of the rig file.
    plant, friction = d.extended.effective().plant, d.extended.effective().friction
    right = {
        "bulk_modulus_shift": (plant.bulk_modulus, rig_file["plant"]["bulk_modulus"]),
        "spring_rate_shift": (plant.spring_stiffness, rig_file["plant"]["spring_stiffness"]),
        "viscous_shift": (friction.viscous_coefficient, rig_file["friction"]["viscous_coefficient"]),
    }
    for cause in d.causes:
        if cause.name in right:
            found, true = right[cause.name]
            assert found == pytest.approx(true, rel=0.05), (cause.name, told(d))


def test_at_rest_the_data_tell_nothing(recorded, diagnosed):
    d = diagnosed(recorded({}, "rest", seed=207, duration=5.0))
    assert d.verdict == "insufficient", told(d)
    assert not d.causes
    assert d.missing


@pytest.mark.parametrize("names", [(), ("coulomb_shift",)], ids=["nothing", "friction"])
def test_three_seconds_do_no_harm(names, recorded, diagnosed):
    d = diagnosed(recorded({name: HIDDEN[name] for name in names}, "rich", seed=208, duration=3.0))
    assert_no_wrong_name(d, names)
    if not names:
        assert d.verdict in {"consistent", "insufficient"}, told(d)


def test_too_few_samples_are_refused(recorded, diagnosed):
    with pytest.raises(BadInput, match="samples"):
        diagnosed(recorded({}, "rich", seed=209, duration=0.1))


def test_signals_at_0_are_not_divided_by(rig_file):
    time = np.arange(0.0, 4.0, 1e-3)
    still = {name: np.zeros(len(time)) for name in ("position_m", "velocity_m_s", "load_pressure_pa", "force_n", "spool_m")}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = diagnose(Trajectory(time, still), rig_from_mapping(rig_file, "rig.yaml"))
    assert found.verdict == "insufficient"
    assert "valve: its signals are 0 throughout" not in found.missing  # without a command, there is no valve to judge
    assert "sensors: its signals are 0 throughout" in found.missing
