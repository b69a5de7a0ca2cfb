"""FMUs as plants: units, refusals, and libraries that crash, hang or return no numbers."""

import os
import random
import re
import signal
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from misbehaving_fmu import CRASH, ERROR, EXIT, HANG, MAP, NOT_A_NUMBER, write

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.fmu_plant import run_on_fmu
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.fmu import foreign_plant
from ehls_ros.fmu.foreign_plant import ForeignPlant
from ehls_ros.fmu.plant_map import PlantMap, map_from_mapping
from ehls_ros.physics.rig import SENSED

PERIOD = 1e-3


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    return write(tmp_path_factory.mktemp("other"))


@pytest.fixture(scope="module")
def rig():
    return load_rig(configured("rig_paper"))


@pytest.fixture
def plant_of(other, rig):
    made = []

    def build(data=MAP, path=other):
        made.append(ForeignPlant(path, map_from_mapping(data, "map"), rig, PERIOD))
        return made[-1]

    yield build
    for plant in made:
        plant.close()


def test_exported_rig_is_the_simulator_in_an_experiment(exported):
    spec = load_spec(configured("sine_fd2", "experiments"))
    spec = spec._replace(settings=spec.settings._replace(duration=0.2))
    found, failure = run_on_fmu(spec, exported, None, lambda done, total: None)
    wanted = run_in_process(spec)
    assert failure is None
    assert found.signals.keys() == wanted.signals.keys()
    for name, values in wanted.signals.items():
        assert np.array_equal(found.signals[name], values), name


def test_units_signs_and_derived_readings(plant_of, rig):
    plant = plant_of()
    for _ in range(10):
        plant.advance(2e-3, -1500.0, 0.0, 0.0, 0.0)
    reading = dict(zip(SENSED, plant.measure(np.zeros(len(SENSED))), strict=True))
    assert reading["velocity"] == pytest.approx(0.2)
    assert reading["position"] == pytest.approx(10 * PERIOD * 0.2)
    assert reading["spool_position"] == pytest.approx(2e-3)
    assert reading["load_pressure"] == pytest.approx(7.5e5)  # 5 bar per kN, against the direction of the FMU
    assert reading["force"] == pytest.approx(7.5e5 * rig.plant.piston_area)
    assert reading["supply_pressure"] == rig.plant.supply_pressure
    assert plant.trouble() == ""


@pytest.fixture
def single_rod_of(other):
    made = []

    def build(parameters=None, **outputs):
        motion = {name: MAP["outputs"][name] for name in ("position", "velocity", "spool_position")}
        data = {**MAP, "outputs": {**motion, **outputs}, "parameters": parameters or {}}
        made.append(ForeignPlant(other, map_from_mapping(data, "map"), load_rig(configured("rig_single_rod")), PERIOD))
        return made[-1]

    yield build
    for plant in made:
        plant.close()


def test_force_of_a_single_rod_follows_from_its_pressures(single_rod_of):
    plant = single_rod_of(pressure_a="pA", pressure_b="pB")
    for _ in range(10):
        plant.advance(2e-3, -1500.0, 0.0, 0.0, 0.0)
    reading = dict(zip(plant.rig.sensed, plant.truth, strict=True))
    p = plant.rig.cylinder.parameters
    assert reading["pressure_a"] != reading["pressure_b"]
    assert reading["force"] == pytest.approx(p.area_a * reading["pressure_a"] - p.area_b * reading["pressure_b"])
    assert reading["load_pressure"] == pytest.approx(reading["force"] / plant.rig.plant.piston_area)
    assert plant.trouble() == ""


def test_readings_that_a_single_rod_lacks_are_not_said_to_be_lost(single_rod_of):
    plant = single_rod_of({"misdeed": NOT_A_NUMBER}, load_pressure=MAP["outputs"]["load_pressure"])
    for _ in range(80):
        plant.advance(1e-3, 0.0, 0.0, 0.0, 0.0)
    assert "position" in plant.trouble()
    assert "pressure_a" not in plant.trouble()


def test_a_single_rod_needs_no_pressures_beside_a_load_pressure(single_rod_of):
    plant = single_rod_of(load_pressure=MAP["outputs"]["load_pressure"])
    plant.advance(2e-3, -1500.0, 0.0, 0.0, 0.0)
    assert np.array_equal(np.isnan(plant.truth), [name in ("pressure_a", "pressure_b") for name in plant.rig.sensed])
    assert plant.trouble() == ""


@pytest.mark.parametrize(
    ("misdeed", "reason"),
    [
        (CRASH, "ended by signal SIGSEGV"),
        (HANG, "did not answer in time"),
        (NOT_A_NUMBER, "returned NaN or infinity for position"),
        (ERROR, "the oil is gone|fmi2Error|failed"),
        (EXIT, "ended with code 3"),
    ],
)
def test_misbehaving_library_takes_down_only_its_process(plant_of, monkeypatch, misdeed, reason):
    monkeypatch.setattr(foreign_plant, "ANSWER", 0.5)
    plant = plant_of({**MAP, "parameters": {"misdeed": misdeed}})
    for _ in range(80):
        plant.advance(1e-3, 0.0, 0.0, 0.0, 0.0)
    assert np.isnan(plant.measure(np.zeros(len(SENSED)))).all()
    assert plant.trouble().count("\n") == 0
    assert re.search(reason, plant.trouble()), plant.trouble()


def test_killed_process_is_reported(plant_of):
    plant = plant_of()
    os.kill(plant._process._process.pid, signal.SIGKILL)
    plant.advance(0.0, 0.0, 0.0, 0.0, 0.0)
    assert "SIGKILL" in plant.trouble()


@pytest.mark.parametrize(
    ("data", "line"),
    [
        ({}, "no variable valve_command; expected a map with the entry inputs: valve_command"),
        ({**MAP, "inputs": {**MAP["inputs"], "valve_command": "spol"}}, "no variable 'spol'; .*did you mean 'spool'"),
        ({**MAP, "inputs": {**MAP["inputs"], "valve_command": "spool"}}, "spool is of causality output"),
        ({**MAP, "outputs": {**MAP["outputs"], "position": "pA"}}, "pA is in bar; expected a unit of the same quantity as m"),
        (
            {**MAP, "outputs": {**MAP["outputs"], "position": {"variable": "cylinder.x", "unit": "cm"}}},
            "cylinder.x is in mm, not cm",
        ),
        (
            {**MAP, "outputs": {**MAP["outputs"], "position": {"variable": "cylinder.x", "factor": 0}}},
            "factor is 0",
        ),
        ({**MAP, "parameters": {"u": 1.0}}, "u is of causality input"),
        (
            {**MAP, "outputs": {**MAP["outputs"], "pressure_a": "pA"}},
            "cylinder has no pressure_a; expected cylinder: {model: two",
        ),
        ({"outputs": {"speed": "v"}}, "signal 'speed' is unknown"),
        ({"wires": {}}, "'wires' is no section"),
        ({"parameters": {"misdeed": "a lot"}}, "misdeed is 'a lot'"),
    ],
)
def test_unsuitable_maps_are_refused(plant_of, data, line):
    with pytest.raises(BadInput, match=line):
        plant_of(data)


def test_damaged_archives_are_refused_in_one_line(exported, rig, tmp_path):
    """A few of the thousand of benchmarks/fmu_attacks.py."""
    content, dice = exported.read_bytes(), random.Random(1)
    for number in range(6):
        damaged = bytearray(content)
        if number % 2:
            del damaged[dice.randrange(len(damaged)) :]
        else:
            for _ in range(200):
                damaged[dice.randrange(len(damaged))] = dice.randrange(256)
        path = tmp_path / f"{number}.fmu"
        path.write_bytes(damaged)
        # Bytes of the resources may be wrong unnoticed.
        with suppress(BadInput, WorkFailed):
            ForeignPlant(path, PlantMap(), rig, PERIOD).close()


def test_other_version_is_refused(other, rig, tmp_path):
    path = tmp_path / "old.fmu"
    with zipfile.ZipFile(other) as source, zipfile.ZipFile(path, "w") as archive:
        text = source.read("modelDescription.xml").decode().replace('fmiVersion="2.0"', 'fmiVersion="1.0"')
        archive.writestr("modelDescription.xml", text)
    with pytest.raises(BadInput, match=r"expected an FMU for Co-Simulation, of FMI 2\.0 or 3\.0"):
        ForeignPlant(path, PlantMap(), rig, PERIOD)
