"""Commissioning of an emulated rig whose file and wiring may be wrong."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.emulated import EmulatedDevice
from ehls_ros.errors import BadInput
from ehls_ros.experiments.commissioning import conduct, measuring
from ehls_ros.experiments.commissioning import first_run as first_run_module
from ehls_ros.experiments.commissioning.conduct import STEPS, commission
from ehls_ros.experiments.commissioning.first_run import first_run, law_tuned
from ehls_ros.experiments.commissioning.measuring import at_rest, coupling, motion, nudge
from ehls_ros.experiments.commissioning.session import Session, Stopped
from ehls_ros.experiments.commissioning.step import Contradiction, Known, after
from ehls_ros.experiments.files import config_folder, configured
from ehls_ros.experiments.spec import load_rig, spec_from_mapping
from ehls_ros.hardware.bridge_file import bridge_from_mapping
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import effects_from_list, rig_to_mapping
from ehls_ros.recording.yaml_text import read_yaml

RIG = load_rig(configured("rig_paper_measured"))
BRIDGE = read_yaml(config_folder() / "bridge_udp.yaml", "bridge")
SINGLE_ROD = load_rig(configured("rig_single_rod"))
OIL = {"scale": 2.5e6, "range": [-10.0, 10.0]}
OF_SINGLE_ROD = {
    **BRIDGE,
    "channels": {
        **{signal: channel for signal, channel in BRIDGE["channels"].items() if signal != "load_pressure"},
        "supply_pressure": {"channel": 4, **OIL},
        "pressure_a": {"channel": 6, **OIL},
        "pressure_b": {"channel": 7, **OIL},
    },
}
"""Bridge file of a rig with both pressures of its chambers in place of the load pressure."""

HELD = {"name": "position_servo", "signal": {"name": "constant", "value": 0.0}}
STILL = {"name": "constant", "value": 0.0}


def device(disturbance=None, seed=3, rig=RIG, wiring=BRIDGE):
    content = {"rig": rig_to_mapping(rig), "reference": STILL, "controller": "fasmc", "disturbance": disturbance, "seed": seed}
    true = bridge_from_mapping(wiring, "true wiring").calibration
    return EmulatedDevice(spec_from_mapping(content, "emulated", config_folder()), true)


def session(given=None, rig=RIG, disturbance=None):
    """Return a session with an emulated rig; ``given`` is the bridge file, which may be wrong."""
    wired = bridge_from_mapping(given or BRIDGE, "bridge file").calibration
    return Session(device(disturbance), wired, rig, 1e-3, lockstep=True)


def session_of_single_rod(given=OF_SINGLE_ROD, known=SINGLE_ROD, disturbance=None):
    """Return a session with an emulated single rod; ``given`` is the bridge file, ``known`` the rig of the file."""
    wired = bridge_from_mapping(given, "bridge file").calibration
    return Session(device(disturbance, rig=SINGLE_ROD, wiring=OF_SINGLE_ROD), wired, known, 1e-3, lockstep=True)


def rewired(signal, factor, given=BRIDGE):
    channels = {**given["channels"]}
    channels[signal] = {**channels[signal], "scale": factor * float(channels[signal]["scale"])}
    return {**given, "channels": channels}


def silent(done, total, doing=""):
    """Show no progress."""


def test_the_noise_of_each_sensor_is_found_at_rest():
    outcome = at_rest(session(), Known(RIG._replace(sensors={})), silent)
    found = {finding.path.split(".")[1]: finding.found for finding in outcome.findings}
    for signal in ("load_pressure", "force"):
        assert abs(found[signal].value - RIG.sensors[signal].reading_std) < 4.0 * found[signal].std + 0.1 * found[signal].value
    assert outcome.rig.sensors["force"].noise_std == found["force"].value
    assert np.ptp(outcome.recordings["at_rest"]["valve_command_m"]) == 0.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (rewired("position", -1.0), "channels.position.scale with the other sign"),
        (rewired("load_pressure", -1.0), "channels.load_pressure.scale with the other sign"),
        (rewired("force", -1.0), "channels.force.scale or channels.load_pressure.scale with the other sign"),
        (rewired("force", 1e-3), "in the unit of the channel"),
        ({**BRIDGE, "command": {**BRIDGE["command"], "scale": -2e-3}}, "command.scale with the other sign"),
        ({**BRIDGE, "command": {**BRIDGE["command"], "scale": 1e3}}, "a running pump"),
    ],
)
def test_a_reversed_sign_or_a_piston_at_rest_ends_with_the_remedy(given, words):
    with pytest.raises(Contradiction, match=words):
        nudge(session(given), Known(RIG), silent)


def test_right_signs_move_the_piston_a_little():
    recording = nudge(session(), Known(RIG), silent).recordings["nudge"]
    assert 1e-4 < np.ptp(recording["position_m"]) < 0.1 * (RIG.limits.position[1] - RIG.limits.position[0])
    assert np.max(np.abs(recording["valve_command_m"])) <= 0.3 * RIG.limits.spool


def test_a_sensor_that_rounds_more_than_its_converter_is_known_once_it_moves():
    step, converter = 2e-5, 6.1e-6
    coarse = RIG._replace(sensors={**RIG.sensors, "position": Sensor(resolution=step)})
    wired = bridge_from_mapping(BRIDGE, "bridge file").calibration
    one = Session(device(rig=coarse), wired, RIG, 1e-3, lockstep=True)
    known = Known(RIG._replace(sensors={}))
    for measure in (at_rest, nudge):
        known = after(known, measure(one, known, silent))
    assert one.resolution("position") < converter
    assert known.rig.sensors["position"].reading_std == pytest.approx(step / math.sqrt(12.0), rel=0.3)


@pytest.mark.parametrize(("factor", "unit"), [(1e-5, "bar"), (1e-6, "MPa")])
def test_a_supply_pressure_in_another_unit_is_named(factor, unit):
    with pytest.raises(Contradiction, match=unit):
        at_rest(session(rewired("supply_pressure", factor)), Known(RIG), silent)


@pytest.mark.parametrize("gain", [10.0, 30.0])
def test_the_coupling_to_an_actuator_that_yields_where_it_holds_is_found(gain):
    outcome = coupling(session(disturbance={**HELD, "position_gain": gain}), Known(RIG), silent)
    [finding] = outcome.findings
    assert abs(finding.found.value - 2e6) < 2.0 * finding.found.std
    [told] = [use for use in outcome.rig.effects if use.name == "coupling_stiffness"]
    assert told.parameters.stiffness == finding.found.value


def test_a_heavy_mass_on_hardly_damped_oil_moves_within_the_gate(monkeypatch):
    heavy = RIG.with_plant(moving_mass=450.0, leakage_coefficient=1e-12)
    heavy = heavy.with_friction(viscous_coefficient=0.0, coulomb_force=200.0, static_force=250.0)
    found = SimpleNamespace(rig=heavy, estimates={}, remarks=(), not_identifiable={})
    monkeypatch.setattr(measuring, "identify_whole_rig", lambda *_, **__: found)
    wired = bridge_from_mapping(BRIDGE, "bridge file").calibration
    one = Session(device(rig=heavy), wired, heavy, 1e-3, lockstep=True)
    moved = motion(one, Known(heavy), silent).recordings["motion"]
    assert np.ptp(moved["position_m"]) > 0.05 * 0.6


def test_without_a_connected_rod_there_is_no_coupling():
    with pytest.raises(Contradiction, match="rod connected"):
        coupling(session(), Known(RIG), silent)


def test_the_gate_ends_a_step_at_null_and_what_was_recorded_is_kept():
    one = session()
    with pytest.raises(Stopped, match="gate") as stopped:
        one.record(lambda m, cycle: 5e-3 if cycle < 2000 else math.nan, 3.0)
    assert len(stopped.value.recording) > 100
    quiet = one.record(None, 0.1)
    assert np.ptp(quiet["valve_command_m"]) == 0.0


def test_a_stop_is_obeyed_at_once():
    wired = bridge_from_mapping(BRIDGE, "bridge file").calibration
    asked = iter([False] * 50 + [True] * 5000)
    with pytest.raises(Stopped, match="request"):
        Session(device(), wired, RIG, 1e-3, lockstep=True, stopped=lambda: next(asked)).record(None, 1.0)


def test_the_steps_are_logged_skipped_and_resumed(tmp_path, monkeypatch):
    monkeypatch.setattr(conduct, "STEPS", [step for step in STEPS if step.name in {"at_rest", "nudge"}])
    asked = []

    def release(step):
        asked.append(step.name)
        return step.name == "at_rest"

    def carried_out():
        one = session()
        return list(commission(lambda known: one, RIG, tmp_path, release, lambda step: silent))

    first = carried_out()
    assert [done.outcome is None for done in first] == [False, True]
    assert asked == ["at_rest", "nudge"]
    log = json.loads((tmp_path / "commission.json").read_text(encoding="utf-8"))
    assert log["at_rest"]["findings"]
    assert log["nudge"] == {"done": False}
    assert (tmp_path / "at_rest.csv").exists()
    found = {finding["name"]: finding["value"] for finding in log["at_rest"]["findings"]}
    assert load_rig(tmp_path / "rig.yaml").sensors["force"].noise_std == pytest.approx(found["sensors.force.noise_std"])
    assert carried_out() == []
    (tmp_path / "commission.json").write_text('{"another": 1}', encoding="utf-8")
    with pytest.raises(BadInput, match="another folder"):
        carried_out()


def connected():
    """Return what is known once the coupling is."""
    told = [{"name": "coupling_stiffness", "stiffness": 2e6, "damping": 2e3}]
    delay = [{"name": "command_delay", "delay": 1e-3}]
    return Known(RIG._replace(effects=effects_from_list([*delay, *told], "test")))


@pytest.mark.long
def test_the_first_run_begins_small_and_the_force_follows():
    outcome = first_run(session(disturbance=HELD), connected(), silent)
    reached = list[float]()
    for recording in outcome.recordings.values():
        half = slice(len(recording) // 2, None)
        angle, force = 2.0 * np.pi * 0.5 * recording.time_s[half], recording["force_n"][half]
        columns = np.stack((np.sin(angle), np.cos(angle), np.ones(len(angle))), axis=1)
        (sine, cosine, _), *_ = np.linalg.lstsq(columns, force, rcond=None)
        reached.append(math.hypot(sine, cosine))
    largest = min(RIG.limits.force, RIG.plant.supply_pressure * RIG.plant.piston_area)
    assert reached == pytest.approx([0.05 * largest, 0.15 * largest, 0.4 * largest], rel=0.02)


def test_a_law_that_is_lost_in_simulation_does_not_get_the_valve(monkeypatch):
    monkeypatch.setattr(first_run_module, "tune", lambda *_, **__: SimpleNamespace(lost=True))
    with pytest.raises(Contradiction, match=r"no numbers of fasmc_predictive hold the force .* `ehls tune`"):
        law_tuned(session(), connected(), silent)


def test_a_first_run_without_a_wired_force_names_the_channels():
    channels = {signal: channel for signal, channel in BRIDGE["channels"].items() if signal != "force"}
    with pytest.raises(Contradiction, match=r"channels for the readings of fasmc_predictive: .*force"):
        first_run(session({**BRIDGE, "channels": channels}), connected(), silent)


def test_no_larger_amplitude_follows_where_the_force_does_not():
    wired = bridge_from_mapping(BRIDGE, "bridge file").calibration
    without_pump = device(HELD, rig=RIG.with_plant(supply_pressure=2e5))
    with pytest.raises(Stopped, match=r"gate closed the valve|no larger amplitude"):
        first_run(Session(without_pump, wired, RIG, 1e-3, lockstep=True), connected(), silent)


@pytest.mark.long
def test_a_wrong_rig_file_is_corrected_by_one_motion():
    wrong = RIG.with_plant(moving_mass=80.0, bulk_modulus=8e8, discharge_coefficient=0.5).with_friction(coulomb_force=550.0)
    found = {finding.path: finding.found for finding in motion(session(rig=wrong), Known(wrong), silent).findings}
    for path, true in (
        ("plant.moving_mass", 70.0), ("plant.bulk_modulus", 6.9e8), ("plant.discharge_coefficient", 0.62),
        ("friction.coulomb_force", 640.8), ("effects.command_delay.delay", 1e-3),
    ):  # fmt: skip
        assert found[path].value == pytest.approx(true, rel=0.02, abs=4.0 * found[path].std), path


def test_the_load_pressure_of_a_single_rod_is_known_from_its_chambers():
    outcome = at_rest(session_of_single_rod(), Known(SINGLE_ROD), silent)
    recording, p = outcome.recordings["at_rest"], SINGLE_ROD.cylinder.parameters
    force = p.area_a * recording["pressure_a_pa"] - p.area_b * recording["pressure_b_pa"]
    np.testing.assert_allclose(recording["load_pressure_pa"] * 0.5 * (p.area_a + p.area_b), force, rtol=1e-12)
    noise = outcome.rig.sensors
    both = math.hypot(p.area_a * noise["pressure_a"].noise_std, p.area_b * noise["pressure_b"].noise_std)
    assert noise["load_pressure"].noise_std == pytest.approx(both / SINGLE_ROD.plant.piston_area, rel=0.1)
    assert "moves the piston" in nudge(session_of_single_rod(), Known(SINGLE_ROD), silent).sentences[0]


def test_a_reversed_pressure_of_a_single_rod_ends_with_the_remedy():
    given = rewired("pressure_b", -1.0, OF_SINGLE_ROD)
    with pytest.raises(Contradiction, match=r"channels\.pressure_a\.scale or channels\.pressure_b\.scale"):
        nudge(session_of_single_rod(given), Known(SINGLE_ROD), silent)


@pytest.mark.long
def test_a_single_rod_is_commissioned_to_its_first_run():
    wrong = SINGLE_ROD.with_plant(moving_mass=145.0, bulk_modulus=9e8, leakage_coefficient=3e-12)
    known = Known(wrong.with_friction(coulomb_force=430.0))
    for step, held in ((at_rest, None), (motion, None), (coupling, HELD)):
        outcome = step(session_of_single_rod(known=known.rig, disturbance=held), known, silent)
        known = after(known, outcome)
        found = {finding.path: finding.found for finding in outcome.findings}
        if step is motion:
            for path, true in (
                ("plant.moving_mass", 120.0), ("plant.bulk_modulus", 1.1e9), ("plant.leakage_coefficient", 2e-12),
                ("friction.coulomb_force", 520.0), ("valve.gain_pb", 0.51),
            ):  # fmt: skip
                assert found[path].value == pytest.approx(true, rel=0.02, abs=4.0 * found[path].std), path
    runs = first_run(session_of_single_rod(known=known.rig, disturbance=HELD), known, silent)
    assert len(runs.recordings) == 3
