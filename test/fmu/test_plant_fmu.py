"""FMUs of the plant: numbers of the simulator, states, refusals, dependencies."""

import re
import zipfile

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from stepped_fmu import stepped

from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.fmu.archive import SYSTEMS, fmu, identifier
from ehls_ros.fmu.library import shared_library
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator

PERIOD = 1e-3


def inputs(cycle):
    """Command, force and its rate, with reversals."""
    t = cycle * PERIOD
    return 1.5e-3 * np.sin(40.0 * t), 2e3 * np.sin(9.0 * t), 1.8e4 * np.cos(9.0 * t)


def drive(rig, first, last):
    rows = []
    for cycle in range(first, last):
        command, force, rate = inputs(cycle)
        rig.set(valve_command=command, disturbance_force=force, disturbance_force_rate=rate)
        rig.step()
        rows.append(rig.get(*SENSED, "state.friction_force[1]"))
    return np.array(rows)


def test_validation_has_no_remarks(exported):
    assert validate_fmu(str(exported)) == []


def test_numbers_are_the_simulators_to_the_bit(exported):
    simulator = Simulator(load_rig(configured("rig_paper")), position=0.02)
    wanted = []
    for cycle in range(600):
        command, force, rate = inputs(cycle)
        simulator.advance(command, force, rate, 0.0, 0.0)
        wanted.append([*simulator.measure(np.zeros(len(SENSED))), simulator.y[4]])
    with stepped(exported) as rig:
        found = drive(rig.begin(initial_position=0.02), 0, 600)
    assert np.array_equal(found, np.array(wanted))
    assert np.ptp(found[:, 1]) > 0.1  # it moved


def test_several_periods_in_one_step(exported):
    with stepped(exported) as one, stepped(exported) as many:
        one.begin(valve_command=1e-3)
        many.begin(valve_command=1e-3)
        for _ in range(20):
            one.step()
        many.step(20 * PERIOD)
        assert np.array_equal(one.get(*SENSED), many.get(*SENSED))


def test_saved_states_continue_to_the_bit(exported):
    with stepped(exported) as rig, stepped(exported) as other:
        rig.begin()
        drive(rig, 0, 100)
        state = rig.state()
        data = rig.serialized(state)
        first = drive(rig, 100, 200)
        rig.restore(state, 100 * PERIOD)
        assert np.array_equal(drive(rig, 100, 200), first)
        other.begin()
        read = other.deserialized(data)
        other.restore(read, 100 * PERIOD)
        assert np.array_equal(drive(other, 100, 200), first)
        rig.free(state)
        other.free(read)


def test_reset_starts_anew(exported):
    with stepped(exported) as rig:
        first = drive(rig.begin(), 0, 50)
        rig.fmu.reset()
        rig.time = 0.0
        assert np.array_equal(drive(rig.begin(), 0, 50), first)


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"plant.moving_mass": 0.0}, "plant.moving_mass is 0; expected"),
        ({"valve_command": float("nan")}, "valve_command is nan"),
        ({"true.force": 1.0}, "true.force cannot be set"),
    ],
)
def test_unsuitable_values_are_refused_by_name(exported, values, line, capfd):
    with stepped(exported) as rig:
        rig.begin()
        with pytest.raises(FMICallException):
            rig.set(**values)
        assert line in "".join(capfd.readouterr())


def test_only_multiples_of_the_sample_period(exported, capfd):
    with stepped(exported) as rig:
        rig.begin()
        with pytest.raises(FMICallException):
            rig.step(0.4e-3)
        assert "multiple of the sample period, 0.001 s" in "".join(capfd.readouterr())


def test_lost_state_is_an_error(exported, capfd):
    with stepped(exported) as rig:
        rig.begin(**{"plant.moving_mass": 1e-30, "valve_command": 1e-3})
        with pytest.raises(FMICallException):
            rig.step(100 * PERIOD)
        assert "unsuitable parameters or inputs" in "".join(capfd.readouterr())


def test_model_exchange_follows_co_simulation(exported):
    """An importer's solver with located events, against the simulator's fixed steps."""
    start = {"valve_command": 1e-3}
    runs = [
        simulate_fmu(str(exported), stop_time=0.3, output_interval=1e-3, fmi_type=kind, start_values=start)
        for kind in ("CoSimulation", "ModelExchange")
    ]
    stepping, exchanged = (run[-1] for run in runs)
    assert abs(stepping["position"] - exchanged["position"]) < 1e-5
    assert stepping["force"] == pytest.approx(exchanged["force"], rel=1e-4)


def libraries_and_names(code):
    """Names of shared libraries in a binary, and whether Python is among its symbols."""
    found = set(re.findall(rb"[A-Za-z0-9_+-]+\.(?:dll|so(?:\.\d+)*)\b", code))
    return {name.decode() for name in found}, re.search(rb"\bPy[A-Z_]|NRT_|numba", code)


@pytest.mark.parametrize("system", SYSTEMS)
def test_libraries_need_only_the_c_library(model, system):
    code = shared_library(model, "{00000000-0000-0000-0000-000000000000}", system, "test")
    needed, python = libraries_and_names(code)
    wanted = {"linux": {"libc.so.6", "libm.so.6"}, "windows": {"ucrtbase.dll"}}[system]
    assert needed - {f"rig.{'so' if system == 'linux' else 'dll'}"} == wanted
    assert python is None
    assert b"fmi2DoStep" in code
    assert b"fmi3DoStep" in code
    assert code[:4] == {"linux": b"\x7fELF", "windows": b"MZ" + code[2:4]}[system]


def test_archive_has_rig_licence_and_terminals(exported):
    with zipfile.ZipFile(exported) as archive:
        names = set(archive.namelist())
    assert {"resources/rig.yaml", "documentation/index.html", "documentation/licenses/license.txt"} <= names
    icons = (
        {"terminalsAndIcons/terminalsAndIcons.xml", "terminalsAndIcons/icon.png"} if "_3" in exported.stem else {"model.png"}
    )
    assert icons <= names


def test_equal_models_make_equal_archives(model):
    parts = []
    for _ in range(2):
        made = fmu(model, "3.0", {}, "test", [])
        parts.append(re.sub(rb"generationDateAndTime=\S+", b"", made))
    assert len(parts[0]) == len(parts[1])


def test_name_becomes_an_identifier():
    assert identifier("2nd rig-a", "test") == "fmu_2nd_rig_a"
    with pytest.raises(BadInput, match="neither letter nor digit"):
        identifier("--", "test")
