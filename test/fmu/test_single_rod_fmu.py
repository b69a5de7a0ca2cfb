"""FMUs of a single rod and of a law that knows it: their closed loop against our own."""

import copy

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from stepped_fmu import stepped

from ehls_ros.experiments.files import configured
from ehls_ros.experiments.fmu_plant import run_on_fmu
from ehls_ros.experiments.loop import run_in_process, sampled
from ehls_ros.experiments.spec import load_spec, spec_from_mapping, spec_to_mapping
from ehls_ros.fmu.archive import fmu
from ehls_ros.fmu.control_model import law_model
from ehls_ros.fmu.plant_model import plant_model

PERIOD = 1e-3


def single_rod():
    """Return an experiment of the paper with areas of 3.5 and 1.7 cm^2 times ten, hoses of different size and worn edges."""
    data = copy.deepcopy(spec_to_mapping(load_spec(configured("sine_fd2", "experiments"))))
    plant = data["rig"]["plant"]
    for key in ("piston_area", "total_volume"):
        del plant[key]
    data["rig"]["cylinder"] = {
        "model": "two_chamber", "area_a": 3.5e-3, "area_b": 1.7e-3, "volume_a": 1.4e-3, "volume_b": 0.8e-3, "leakage_b": 1e-12,
    }  # fmt: skip
    data["controller_rig"] = data["rig"]
    data["duration"] = 0.3
    return spec_from_mapping(data, "single rod", configured("rig_paper").parent)


@pytest.mark.long
def test_exported_single_rod_is_the_simulator_in_an_experiment(tmp_path):
    spec = single_rod()
    (tmp_path / "plant.fmu").write_bytes(fmu(plant_model(spec.rig, "plant", PERIOD), "3.0", {}, "test", ["linux"]))
    found, failure = run_on_fmu(spec, tmp_path / "plant.fmu", None, lambda done, total: None)
    assert failure is None
    for name, values in run_in_process(spec).signals.items():
        assert np.array_equal(found.signals[name], values), name


@pytest.mark.long
def test_loop_of_two_fmus_is_the_simulated_one_to_the_bit(tmp_path):
    spec = single_rod()
    rig, use, watching = spec.rig, spec.controller, spec.compensation
    models = {
        "plant": plant_model(rig, "plant", PERIOD),
        "law": law_model(rig, "law", PERIOD, use.name, use.parameters, watching.name, watching.parameters),
    }
    for name, model in models.items():
        (tmp_path / f"{name}.fmu").write_bytes(fmu(model, "3.0", {}, "test", ["linux"]))
        assert validate_fmu(str(tmp_path / f"{name}.fmu")) == []
    wanted, signals = run_in_process(spec), rig.sensed
    assert signals[-2:] == ("pressure_a", "pressure_b")
    reference = sampled(spec.reference, PERIOD).rows(0, spec.cycles)
    columns = ("valve_command_m", "force_n", "pressure_a_pa", "pressure_b_pa")
    found = np.empty((spec.cycles, len(columns)))
    with stepped(tmp_path / "law.fmu") as law, stepped(tmp_path / "plant.fmu") as plant:
        law.begin()
        plant.begin()
        for cycle in range(spec.cycles):
            readings = dict(zip(signals, plant.get(*signals), strict=True))
            given = dict(zip(("reference", "reference_rate", "reference_acceleration"), reference[cycle], strict=True))
            law.set(**readings, **given)
            law.step()
            command = law.get("valve_command")[0]
            found[cycle] = command, readings["force"], readings["pressure_a"], readings["pressure_b"]
            force, rate = (wanted.signals[name][cycle] for name in ("disturbance_force_n", "disturbance_force_rate_n_s"))
            plant.set(valve_command=command, disturbance_force=force, disturbance_force_rate=rate)
            plant.step()
    assert np.array_equal(found, np.column_stack([wanted.signals[name] for name in columns]))
    assert np.ptp(found[:, 1]) > 1e3
