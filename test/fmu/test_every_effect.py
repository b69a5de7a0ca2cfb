"""Every effect and friction model as an FMU, against the simulator."""

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from stepped_fmu import stepped

from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.fmu.archive import fmu
from ehls_ros.fmu.plant_model import plant_model
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import HOOKS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import SENSED, Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.physics.simulator import Simulator

PERIOD = 1e-3

TABLE = {"per_position": 5.0, "per_velocity": 1.0, "direction": 0.05, **{f"value_{k}": 1e-5 * k for k in range(16)}}

CHANGED = {
    "command_delay": {"delay": 2.3e-3},
    "valve_dead_zone": {"positive": 5e-5, "negative": 4e-5},
    "valve_gain_asymmetry": {"opening_positive": 0.1},
    "valve_hysteresis": {"width": 3e-5, "spread": 1e-5},
    "valve_null_bias": {"command": 2e-5},
    "valve_saturation": {"command_limit": 1.2e-3},
    "valve_second_order": {"natural_frequency": 400.0},
    "entrained_air": {"chambers": 0.01},
    "external_leakage": {"each": 1e-13},
    "supply_pressure_droop": {"resistance": 1e9, "time_constant": 0.02},
    "turbulent_leakage": {"coefficient": 1e-9, "transition": 1e5},
    "coulomb_asymmetry": {"offset": 30.0},
    "position_dependent_friction": {"slope": 100.0, "sine": 20.0},
    "pressure_dependent_friction": {"slope": 1e-5, "onset": 1e5},
    "temperature_dependent_friction": {"coulomb_slope": -2.0, "thinning_part": 500.0, "thinning_rate": 0.02},
    "stribeck_shift": {"tail_force": 50.0, "tail_velocity": 0.02},
    "viscous_asymmetry": {"asymmetry": 100.0},
    "end_stop": {"upper": 0.01, "lower": -0.01},
    "flexible_mode": {"mass": 0.3, "frequency": 40.0},
    "spring_hardening": {"cubic": 1e6},
    "constant_load": {"force": 200.0},
    "coupling_stiffness": {"stiffness": 1e5, "damping": 100.0},
    "periodic_disturbance": {"sine": 100.0, "frequency": 3.0},
    "empirical_force": {**TABLE, "memory": 0.05},
    "empirical_friction": TABLE,
    "empirical_position_reading": TABLE,
    "empirical_pressure_reading": {**TABLE, **{f"value_{k}": 1e3 * k for k in range(16)}},
    "empirical_force_reading": {**TABLE, "per_pressure": 1e-7, "power": 3.0, "exponent": 2.0},
    "empirical_leakage": {**TABLE, **{f"value_{k}": 1e-9 * k for k in range(16)}},
    "empirical_opening": TABLE,
    "empirical_spool": TABLE,
    "hinge_backlash": {},  # beside a flexible mode, no second joint
}


def stages() -> dict[str, list[dict[str, object]]]:
    """Effects with hooks by stage, as a rig file lists them."""
    found: dict[str, list[dict[str, object]]] = {}
    for name in EFFECTS.names():
        effect = EFFECTS.load(name)
        if any(hasattr(effect, hook) for hook in HOOKS):
            found.setdefault(effect.GROUP, []).append({"name": name, **CHANGED[name]})
    found["backlash"] = [{"name": "hinge_backlash", "gap": 1e-4}]
    return found


def assert_same_numbers(rig: Rig, path) -> None:
    """Compare an FMU with the simulator over reversals, with noise and a changing temperature."""
    model = plant_model(rig, "rig", PERIOD)
    path.write_bytes(fmu(model, "3.0", {}, "test", ["linux"]))
    assert validate_fmu(str(path)) == []
    simulator = Simulator(rig, PERIOD, warming=5.0)
    dice = np.random.default_rng(3).standard_normal((301, len(SENSED)))
    wanted, found = [simulator.measure(dice[0]).copy()], []

    def noise(cycle):
        return {f"noise.{signal}": value for signal, value in zip(SENSED, dice[cycle].tolist(), strict=True)}

    with stepped(path) as plant:
        plant.begin(**noise(0))
        found.append(plant.get(*SENSED))
        for cycle in range(300):
            t = cycle * PERIOD
            command, force, rate = 1.5e-3 * np.sin(30.0 * t), 3e3 * np.sin(9.0 * t), 2.7e4 * np.cos(9.0 * t)
            plant.set(
                valve_command=command,
                disturbance_force=force,
                disturbance_force_rate=rate,
                disturbance_displacement=1e-3 * np.sin(5.0 * t),
                disturbance_velocity=5e-3 * np.cos(5.0 * t),
                oil_temperature_supplied=simulator.inputs[5],
                oil_temperature_rate=5.0,
                **noise(cycle + 1),
            )
            simulator.advance(command, force, rate, 1e-3 * np.sin(5.0 * t), 5e-3 * np.cos(5.0 * t))
            plant.step()
            wanted.append(simulator.measure(dice[cycle + 1]).copy())
            found.append(plant.get(*SENSED))
    assert np.ptp(np.array(wanted)[:, 1]) > 0.01
    assert np.array_equal(np.array(found), np.array(wanted))


def paper_rig(effects, model="gms") -> Rig:
    rig = load_rig(configured("rig_paper"))
    content = rig_to_mapping(rig)
    content["friction"] |= {"model": model}
    content["effects"] = effects
    sensors = {"position": {"resolution": 1e-6}, "velocity": {"noise_std": 1e-3}, "load_pressure": {"bandwidth": 500.0}}
    content["sensors"] = {**sensors, "force": {"delay": 1.5e-3, "gain": 1.01}, "spool_position": {"bias": 1e-6}}
    return rig_from_mapping(content, "test")


@pytest.mark.long
@pytest.mark.parametrize("stage", stages())
def test_effects(stage, tmp_path):
    rig = paper_rig(stages()[stage])
    assert rig.sensors["velocity"] == Sensor(noise_std=1e-3)
    assert_same_numbers(rig, tmp_path / "rig.fmu")


@pytest.mark.long
@pytest.mark.parametrize("model", FRICTION_MODELS.names())
def test_friction_models(model, tmp_path):
    assert_same_numbers(paper_rig([], model), tmp_path / "rig.fmu")
