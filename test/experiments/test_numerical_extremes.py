"""Numbers that are valid one by one and nonsense together: refused, cut short, or flagged; never passed off as sound."""

import copy
import json
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from tiers import tiered

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.run_failure import Implausible
from ehls_ros.physics.plausibility import LIMIT_UNITS, WARNING_FACTOR, within
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.topics import LOADER_STATE

REFUSED, ENDED, TOLD, SOUND = "refused", "ended", "told", "sound"
"""Outcomes of an extreme: no run; a run cut short with a reason; a run with warnings; a run within the rig's limits."""


class Extreme(NamedTuple):
    """One change of the base experiment: dotted path, value, expected outcome, and expected words."""

    path: str
    value: Any
    outcome: str
    said: tuple[str, ...] = ()


TRIED = (
    # a rig's numbers, too small, too large, or in another unit
    Extreme("rig.plant.supply_pressure", 7.0, REFUSED, ("supply_pressure is 7 Pa", "7 MPa is 7e+06 Pa")),
    Extreme("rig.plant.supply_pressure", 70.0, REFUSED, ("supply_pressure is 70 Pa", "70 bar is 7e+06 Pa")),
    Extreme("rig.plant.supply_pressure", 7e21, REFUSED, ("supply_pressure", "2e+08 Pa")),
    Extreme("rig.plant.oil_density", 0.84, REFUSED, ("oil_density", "0.84 g/cm^3 is 840 kg/m^3")),
    Extreme("rig.plant.oil_density", 8.4e-10, REFUSED, ("oil_density",)),
    Extreme("rig.plant.bulk_modulus", 690.0, REFUSED, ("bulk_modulus", "690 MPa is 6.9e+08 Pa")),
    Extreme("rig.plant.bulk_modulus", 6.9e23, REFUSED, ("bulk_modulus",)),
    Extreme("rig.plant.discharge_coefficient", 620.0, REFUSED, ("discharge_coefficient",)),
    Extreme("rig.plant.valve_area_gradient", 26.7, REFUSED, ("valve_area_gradient", "26.7 mm is 0.0267 m")),
    Extreme("rig.plant.valve_area_gradient", 2.67e-14, REFUSED, ("valve_area_gradient",)),
    Extreme("rig.plant.leakage_coefficient", 4.7e3, REFUSED, ("leakage_coefficient",)),
    Extreme("rig.plant.total_volume", 1.5, REFUSED, ("total_volume", "1.5 l is 0.0015 m^3")),
    Extreme("rig.plant.total_volume", 1.5e-15, REFUSED, ("total_volume",)),
    Extreme("rig.plant.moving_mass", 1e-3, REFUSED, ("moving_mass is 0.001 kg", "0.001 t is 1 kg")),
    Extreme("rig.plant.moving_mass", 0.15, REFUSED, ("rate of the damping", "0.15 kg", "integration_step of at most")),
    Extreme("rig.plant.moving_mass", 7e4, REFUSED, ("weight of plant.moving_mass", "the cylinder can hold")),
    Extreme("rig.plant.piston_area", 2600.0, REFUSED, ("piston_area", "2600 mm^2 is 0.0026 m^2")),
    Extreme("rig.plant.piston_area", 2.6e-15, REFUSED, ("piston_area",)),
    Extreme("rig.plant.spring_stiffness", 4e19, REFUSED, ("spring_stiffness",)),
    Extreme("rig.plant.spring_stiffness", 4e-8, SOUND),
    Extreme("rig.plant.viscous_damping", 60e15, REFUSED, ("viscous_damping",)),
    Extreme("rig.plant.valve_bandwidth", 1.1e17, REFUSED, ("valve_bandwidth",)),
    Extreme("rig.plant.valve_bandwidth", 0.5, TOLD, ("the force does not follow its reference",)),
    Extreme("rig.plant.valve_gain", 1e15, REFUSED, ("plant.valve_gain times limits.spool",)),
    Extreme("rig.plant.valve_gain", 1e-3, TOLD, ("the force does not follow its reference",)),
    Extreme("rig.friction.coulomb_force", 1e-12, REFUSED, ("rate of the slipping friction", "coulomb_force 1e-12 N")),
    Extreme("rig.friction.static_force", 8.7e5, REFUSED, ("friction.static_force", "the cylinder can overcome")),
    Extreme("rig.friction.stribeck_velocity", 2.031, REFUSED, ("stribeck_velocity", "2.031 mm/s is 0.002031 m/s")),
    Extreme("rig.friction.viscous_coefficient", 7.3e18, REFUSED, ("viscous_coefficient",)),
    Extreme("rig.friction.element_stiffness", [1e15, 1e15, 1e15], REFUSED, ("rate of the presliding friction", "1e+15")),
    Extreme("rig.friction.element_stiffness", [1884.0, 196.9, 184.1], REFUSED, ("break-away", "1 N/mm is 1e3 N/m")),
    Extreme("rig.friction.attraction_rate", 1.65e18, REFUSED, ("attraction_rate",)),
    Extreme("rig.limits.force", 18.2, REFUSED, ("limits.force", "1 kN is 1e3 N")),
    Extreme("rig.limits.load_pressure", 70.0, REFUSED, ("limits.load_pressure", "1 bar is 1e5 Pa")),
    Extreme("rig.limits.position", [-300.0, 300.0], REFUSED, ("stroke", "1 mm is 1e-3 m")),
    Extreme("rig.limits.spool", 10.0, REFUSED, ("spool", "10 mm is 0.01 m")),
    Extreme("rig.limits.velocity", 2e3, REFUSED, ("velocity", "2000 mm/s is 2 m/s")),
    # the controller's numbers at the ends of their ranges
    Extreme("controller.h", 1e4, TOLD, ("the force does not follow its reference", "leaves its limits: position")),
    Extreme("controller.b", 1e-3, TOLD, ("the force does not follow its reference",)),
    Extreme("controller.delta_f", 1e6, TOLD, ("the force does not follow its reference",)),
    Extreme("controller.xi", 1e-3, TOLD, ("the force does not follow its reference",)),
    # the experiment's
    Extreme("reference.amplitude", 1e6, REFUSED, ("the reference reaches", "plant.supply_pressure", "in N?")),
    Extreme("reference.amplitude", 1.9e4, TOLD, ("the rig leaves its limits",)),
)
FURTHER = (
    Extreme("reference.amplitude", 1e-12, TOLD, ("the force does not follow its reference",)),
    Extreme("reference.frequency", 1e3, REFUSED, ("a shorter control_period",)),
    Extreme("reference.frequency", 400.0, TOLD, ("the force does not follow its reference",)),
    Extreme("disturbance.signal.amplitude", 1e6, REFUSED, ("the disturbance reaches",)),
    Extreme("disturbance.signal.amplitude", 1e5, TOLD, ("the rig leaves its limits: position",)),
    Extreme("disturbance.signal.frequency", 1e3, REFUSED, ("a shorter control_period",)),
    Extreme("duration", 1e-12, REFUSED, ("duration is 1e-12", "control_period")),
    Extreme("reference.offset", 1e6, REFUSED, ("the reference reaches",)),
    Extreme("control_period", 0.1, TOLD, ("the force does not follow its reference",)),
    Extreme("integration_step", 1e-2, SOUND),
    Extreme("initial_position", 300.0, REFUSED, ("initial_position is 300 m", "limits.position")),
    Extreme("initial_position", -1e300, REFUSED, ("initial_position",)),
    Extreme("controller.phi1", 1e6, TOLD, ("the force does not follow its reference",)),
    Extreme("controller.phi3", 0.0, TOLD, ("the force does not follow its reference",)),
    Extreme("controller.k", 1e3, TOLD, ("the force does not follow its reference",)),
    Extreme("rig.sensors.force.gain", 1e-3, REFUSED, ("gain is 0.001", "SI units")),
    Extreme("rig.sensors.load_pressure.noise_std", 1e15, REFUSED, ("noise_std", "load_pressure")),
    Extreme("rig.sensors.position.bias", 1e3, REFUSED, ("bias is 1000", "position")),
    Extreme("rig.sensors.spool_position.resolution", 1e12, REFUSED, ("resolution", "spool_position")),
    Extreme("rig.sensors.load_pressure.bandwidth", 1e-12, TOLD, ("the force does not follow its reference",)),
    Extreme("rig.sensors.force.delay", 1.0, TOLD, ("the force does not follow its reference",)),
    Extreme("rig.sensors.velocity.bandwidth", 1e15, SOUND),
    # effects at the ends of their ranges
    Extreme("effects.constant_load.force", 1e6, ENDED, ("is impossible", "the rig's limit", "units")),
    Extreme("effects.end_stop.upper", -10.0, ENDED, ("is impossible", "integration_step")),
    Extreme("effects.viscous_asymmetry.asymmetry", -1e6, ENDED, ("is impossible",)),
    Extreme("effects.spring_hardening.cubic", -1e12, ENDED, ("is impossible",)),
    Extreme("effects.mass_shift.factor", 50.0, TOLD, ("the rig leaves its limits: position",)),
    Extreme("effects.command_delay.delay", 0.05, TOLD, ("the force does not follow its reference",)),
    Extreme("effects.valve_null_bias.opening", 0.01, TOLD, ("the force does not follow its reference",)),
    Extreme("effects.viscous_shift.added", 1e6, SOUND),
)
SERVO = (
    Extreme("disturbance.supply_pressure", 210.0, REFUSED, ("disturbance", "210 bar is 2.1e+07 Pa")),
    Extreme("disturbance.moving_mass", 1e-12, REFUSED, ("disturbance", "moving_mass")),
    Extreme("disturbance.signal.amplitude", 50.0, REFUSED, ("the disturbance reaches", "in m?")),
    Extreme("disturbance.stiffness", 1e8, SOUND),
)
EFFECTS = (
    "constant_load", "end_stop", "viscous_asymmetry", "spring_hardening", "mass_shift", "command_delay", "valve_null_bias",
    "viscous_shift",
)  # fmt: skip


def name_of(extreme: Extreme) -> str:
    return f"{extreme.path}={extreme.value}"


@pytest.fixture
def base(rig_mapping):
    """Ten kN at 1 Hz against a small disturbance, for the settling time of a law."""
    return {
        "rig": rig_mapping,
        "duration": 1.5,
        "control_period": 1e-3,
        "reference": {"name": "sine", "amplitude": 1e4, "frequency": 1.0},
        "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 2e3, "frequency": 0.5}},
        "controller": {"name": "fasmc"},
    }


@pytest.fixture
def with_effects(base):
    """The base experiment with every tested effect, at its neutral values: one kernel serves them all."""
    return {**base, "effects": {name: {"name": name} for name in EFFECTS}}


@pytest.fixture
def with_servo(base):
    """The base experiment against a position servo."""
    signal = {"name": "sine", "amplitude": 0.05, "frequency": 0.5}
    return {**base, "disturbance": {"name": "position_servo", "signal": signal}}


def changed(base: dict[str, Any], extreme: Extreme) -> dict[str, Any]:
    made = copy.deepcopy(base)
    *sections, key = extreme.path.split(".")
    at = made
    for section in sections:
        at = at.setdefault(section, {})
    at[key] = extreme.value
    if isinstance(made.get("effects"), dict):
        made["effects"] = list(made["effects"].values())
    return made


def becomes(make_spec: Any, sections: dict[str, Any]) -> tuple[str, str]:
    """Run an experiment; return its outcome and its messages."""
    try:
        run = run_in_process(make_spec(**sections))
    except BadInput as error:
        return REFUSED, str(error)
    except Implausible as error:
        return ENDED, str(error)
    metrics = evaluate(run)
    if metrics.warnings:
        return TOLD, "; ".join(metrics.warnings)
    limits = make_spec(**sections).rig.limits
    for name in LIMIT_UNITS:
        low, high = within(limits, name)
        away = np.abs(run[LOADER_STATE.signals[name]] - 0.5 * (low + high))
        assert np.all(away <= WARNING_FACTOR * 0.5 * (high - low)), name
    assert math.isfinite(metrics.max_error_n)
    return SOUND, ""


def test_the_base_is_sound(make_spec, base):
    assert becomes(make_spec, base) == (SOUND, "")


def test_43_extremes_were_tried_and_30_more():
    assert len(TRIED) == 43
    assert len(FURTHER) == 30


@pytest.mark.parametrize("extreme", [*TRIED, *FURTHER], ids=name_of)
def test_an_extreme_is_refused_or_told_or_gives_a_sound_run(make_spec, base, with_effects, extreme):
    sections = changed(with_effects if extreme.path.startswith("effects") else base, extreme)
    outcome, said = becomes(make_spec, sections)
    assert outcome == extreme.outcome, said
    assert "\n" not in said
    for words in extreme.said:
        assert words in said


@pytest.mark.parametrize("extreme", tiered(SERVO, *SERVO[:-1]), ids=name_of)
def test_a_servo_at_its_extremes_is_no_better(make_spec, with_servo, extreme):
    outcome, said = becomes(make_spec, changed(with_servo, extreme))
    assert outcome == extreme.outcome, said
    for words in extreme.said:
        assert words in said


SWEPT = [
    f"rig.{section}.{key}"
    for section, keys in {
        "plant": (
            "supply_pressure", "oil_density", "bulk_modulus", "discharge_coefficient", "valve_area_gradient",
            "leakage_coefficient", "total_volume", "moving_mass", "piston_area", "arm_length", "spring_stiffness",
            "viscous_damping", "valve_bandwidth", "valve_gain",
        ),
        "friction": (
            "coulomb_force", "static_force", "stribeck_velocity", "viscous_coefficient", "attraction_rate",
        ),
        "limits": ("spool", "force", "load_pressure", "velocity"),
    }.items()
    for key in keys
]  # fmt: skip


@pytest.mark.parametrize("path", SWEPT)
def test_no_factor_on_a_rigs_number_passes_off_nonsense_as_a_result(make_spec, base, path):
    _, section, key = path.split(".")
    value = base["rig"][section][key]
    for factor in (1e-15, 1e-12, 1e-6, 1e-3, 1e3, 1e6, 1e12, 1e15):
        # Outcomes neither refused nor flagged have been checked by `becomes`.
        outcome, said = becomes(make_spec, changed(base, Extreme(path, value * factor, "")))
        assert outcome in {REFUSED, ENDED, TOLD, SOUND}
        assert bool(said) == (outcome != SOUND)


@pytest.mark.parametrize("factor", [0.8, 1.2])
@pytest.mark.parametrize("path", SWEPT)
def test_a_fifth_more_or_less_is_run(make_spec, base, path, factor):
    _, section, key = path.split(".")
    sections = changed(base, Extreme(path, factor * base["rig"][section][key], ""))
    outcome, said = becomes(make_spec, {**sections, "duration": 0.1})
    assert outcome in {TOLD, SOUND}, said


def test_more_cycles_than_fit_into_memory_are_refused(make_spec, base):
    outcome, said = becomes(make_spec, {**base, "duration": 1e6, "control_period": 1e-6})
    assert outcome == REFUSED
    assert "1000000000001 cycles take" in said
    assert "a shorter duration or a longer control_period" in said


def test_a_run_that_ends_early_keeps_what_there_was(make_spec, with_effects):
    sections = changed(with_effects, Extreme("effects.viscous_asymmetry.asymmetry", -1e6, ""))
    with pytest.raises(Implausible) as caught:
        run_in_process(make_spec(**sections))
    run = caught.value.trajectory
    assert run is not None
    assert 1 < len(run) < 100
    assert np.all(np.isfinite(run["force_n"][:-1]))
    assert f"the run ended at {run.time_s[-1]:g} s of 1.5 s" in str(caught.value)


def experiment(tmp_path, sections):
    """Run the command on an experiment; return its exit code and the run folder."""
    path = tmp_path / "spec.yaml"
    path.write_text(yaml.safe_dump(json.loads(json.dumps(sections))), encoding="utf-8")
    return main(["experiment", str(path), "--in-process", "--out", str(tmp_path / "run")]), tmp_path / "run"


def test_the_command_fails_where_a_run_ends_early_and_keeps_bag_metrics_and_report(tmp_path, with_effects, capsys):
    code, folder = experiment(tmp_path, changed(with_effects, Extreme("effects.viscous_asymmetry.asymmetry", -1e6, "")))
    assert code == 1
    [line] = capsys.readouterr().err.strip().splitlines()[-1:]
    assert line.startswith("ehls experiment: the run ended at ")
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    [warning] = metrics["warnings"]
    assert warning in line
    assert len(read_bag(folder / "bag")) == metrics["cycles"] < 100
    assert "the run ended at" in (folder / "report.html").read_text(encoding="utf-8")


def test_the_command_refuses_a_rig_in_other_units(tmp_path, base, capsys):
    code, folder = experiment(tmp_path, changed(base, Extreme("rig.plant.piston_area", 2600.0, "")))
    assert code == 2
    assert "2600 mm^2 is 0.0026 m^2" in capsys.readouterr().err
    assert not folder.exists()


def test_the_command_tells_a_useless_result_and_the_swing_beside_the_band(tmp_path, base, capsys):
    code, folder = experiment(tmp_path, changed(base, Extreme("controller.xi", 1e-3, "")))
    said = capsys.readouterr().out
    assert code == 0
    assert "not converged" in said
    assert "100.0 N, 1 % of the largest reference" in said
    assert "warning: the force does not follow its reference" in said
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["convergence_s"] is None
    assert metrics["oscillation_n"] > metrics["convergence_band_n"] == pytest.approx(100.0)


def test_what_a_sensor_hides_ends_the_run_all_the_same(make_spec, base):
    # The position is not in the law: a reading stuck at zero would hide that the piston has long left the rig.
    sections = copy.deepcopy(base)
    sections["rig"]["sensors"] = {"position": {"bandwidth": 1e-12}, "velocity": {"bandwidth": 1e-12}}
    sections["rig"]["plant"].update(spring_stiffness=0.0)
    sections |= {"duration": 5.0, "disturbance": {"name": "force", "signal": {"name": "constant", "value": -1.5e4}}}
    outcome, said = becomes(make_spec, {**sections, "reference": {"name": "constant", "value": 1e4}})
    assert (outcome, "position" in said) == (ENDED, True), said
