"""Contradictory rig files and recordings: the error is named; healthy, faulty and strange rigs are not accused."""

import copy
import re
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.diagnosis.contradictions import check_suits
from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.load import load
from ehls_ros.trajectory import Trajectory
from truth_generator import LISTED, OUTSIDE, draw_effect

ROOT = Path(__file__).parents[2]
NAME = "recording.csv"


@pytest.fixture(scope="module")
def columns(recorded):
    return recorded({}, "rich", seed=3, duration=8.0).columns


def trajectory(columns):
    return Trajectory(1e-3 * np.arange(len(columns["position_m"])), columns)


def changed(rig_file, section, key, value):
    content = copy.deepcopy(rig_file)
    content[section][key] = value
    return rig_from_mapping(content, "rig.yaml")


def refusal(columns, rig):
    with pytest.raises(BadInput) as caught:
        check_suits(trajectory(columns), rig, NAME)
    return caught.value


@pytest.mark.parametrize(
    ("section", "key", "value", "said", "meant"),
    [
        ("plant", "supply_pressure", 70.0, "is 70 Pa: bar?", "7e+06 Pa, if 70 bar was meant"),
        ("plant", "supply_pressure", 7.0, "is 7 Pa: MPa?", "7e+06 Pa, if 7 MPa was meant"),
        ("plant", "piston_area", 2600.0, "is 2600 m^2: mm^2?", "0.0026 m^2, if 2600 mm^2 was meant"),
        ("plant", "piston_area", 26.0, "is 26 m^2: cm^2?", "0.0026 m^2, if 26 cm^2 was meant"),
        ("plant", "moving_mass", 7e4, "is 70000 kg: g?", "70 kg, if 70000 g was meant"),
        ("plant", "bulk_modulus", 690.0, "is 690 Pa: MPa?", "6.9e+08 Pa, if 690 MPa was meant"),
        ("plant", "total_volume", 1500.0, "is 1500 m^3: cm^3?", "0.0015 m^3, if 1500 cm^3 was meant"),
        ("plant", "valve_area_gradient", 26.7, "is 26.7 m: mm?", "0.0267 m, if 26.7 mm was meant"),
        ("limits", "position", [-300.0, 300.0], "is [-300, 300] m: mm?", "[-0.3, 0.3] m, if [-300, 300] mm was meant"),
        ("limits", "force", 18.2, "is 18.2 N: kN?", "18200 N, if 18.2 kN was meant"),
    ],
)
def test_a_value_in_another_unit_is_named_with_the_unit(rig_file, columns, section, key, value, said, meant):
    error = refusal(columns, changed(rig_file, section, key, value))
    assert error.what.startswith(f"{section}.{key} of the rig file {said}")
    assert error.expected == meant


@pytest.mark.parametrize(
    ("signal", "factor", "said", "meant"),
    [
        ("load_pressure_pa", 1e-5, "load_pressure_pa reaches", "in bar"),
        ("load_pressure_pa", 1e5, "load_pressure_pa reaches", "not in bar but in Pa already"),
        ("load_pressure_pa", -1.0, "load_pressure_pa goes the wrong way", "other sign"),
        ("force_n", -1.0, "force_n goes the wrong way", "other sign"),
        ("force_n", 1e-3, "force_n reaches", "in kN"),
        ("position_m", 1e3, "position_m reaches", "in mm"),
        ("velocity_m_s", 1e3, "velocity_m_s reaches", "in mm/s"),
        ("valve_command_m", -1.0, "valve_command_m goes the wrong way", "other sign"),
        ("spool_m", 1e3, "spool_m reaches", "in mm"),
    ],
)
def test_a_column_in_another_unit_or_sign_is_named(rig_file, columns, signal, factor, said, meant):
    error = refusal({**columns, signal: factor * columns[signal]}, rig_from_mapping(rig_file, "rig.yaml"))
    assert error.what.startswith(said)
    assert meant in error.expected


def test_exchanged_columns_and_a_turned_valve_are_named(rig_file, columns):
    rig = rig_from_mapping(rig_file, "rig.yaml")
    error = refusal({**columns, "position_m": columns["force_n"], "force_n": columns["position_m"]}, rig)
    assert error.what.startswith("position_m and force_n do not fit")
    assert error.expected == "the two columns exchanged"
    turned = {signal: -columns[signal] for signal in ("valve_command_m", "spool_m")}
    assert refusal({**columns, **turned}, rig).what.startswith("valve_command_m and spool_m go the wrong way")


def test_two_wrong_units_are_both_named(rig_file, columns):
    rig = changed(rig_file, "plant", "supply_pressure", 70.0)
    error = refusal({**columns, "position_m": 1e3 * columns["position_m"]}, rig)
    assert "supply_pressure of the rig file is 70 Pa: bar?" in error.what
    assert re.search(r"position_m reaches \S+ m: mm\?", error.what)


def test_what_no_unit_explains_is_told_with_its_figures(rig_file, columns):
    error = refusal(columns, changed(rig_file, "plant", "leakage_coefficient", 4.7e-6))
    assert error.what == "plant.leakage_coefficient is 4.7e-06, where rigs have 0 to 1e-08"
    assert "SI units" in error.expected


@pytest.mark.parametrize(("low", "high", "offset"), [(92e-3, 209e-3, "-0.15"), (-0.31, -0.2, "0.255"), (1.0, 1.2, "-1.1")])
def test_a_position_on_an_absolute_scale_is_named_with_its_offset(rig_file, columns, low, high, offset):
    position = columns["position_m"]
    position = low + (high - low) * (position - position.min()) / np.ptp(position)
    rig = changed(rig_file, "limits", "position", [-0.15, 0.15])
    error = refusal({**columns, "position_m": position}, rig)
    assert re.match(r"position_m runs from \S+ to \S+ mm, limits.position of the rig file from -150 to 150 mm", error.what)
    assert f"`offset: {offset}`" in error.expected
    check_suits(trajectory({**columns, "position_m": position + float(offset)}), rig, NAME)


def test_a_position_far_from_0_within_the_stroke_gets_a_remark(rig_file, columns):
    rig = changed(rig_file, "limits", "position", [-1.0, 1.0])
    shifted = {name: values for name, values in columns.items() if name in ("position_m", "force_n", "load_pressure_pa")}
    shifted["position_m"] = 0.1 * columns["position_m"] + 0.8
    [doubt] = [d for d in check_suits(trajectory(shifted), rig, NAME) if "mid-stroke" in d]
    assert re.search(r"exerts \S+ N, more than the recorded", doubt)
    assert "`offset: -0." in doubt


def test_a_position_that_leaves_the_stroke_by_little_is_accepted(rig_file, columns):
    position = columns["position_m"]
    low, high = float(position.min()), float(position.max())
    margin = 0.05 * (high - low)
    rig = changed(rig_file, "limits", "position", [low + margin, high + margin])
    assert check_suits(trajectory(columns), rig, NAME) == ()


def test_what_the_rig_file_lacks_is_not_compared(rig_file, columns):
    content = {"friction": rig_file["friction"], "plant": {"supply_pressure": rig_file["plant"]["supply_pressure"]}}
    assert check_suits(trajectory(columns), rig_from_mapping(content, "rig.yaml"), NAME) == ()
    content["plant"]["supply_pressure"] = 70.0
    assert "70 bar was meant" in refusal(columns, rig_from_mapping(content, "rig.yaml")).expected


@pytest.mark.parametrize("name", [*sorted(LISTED)[::4], *sorted(OUTSIDE)[::4]])
def test_faulty_rigs_are_rigs(rig_file, recorded, name):
    sizes = draw_effect(name, np.random.default_rng(1), rig_file)
    experiment = "servo" if name == "coupling_stiffness" else "rich"
    given = recorded({name: sizes}, experiment, seed=2, duration=4.0).columns
    assert check_suits(trajectory(given), rig_from_mapping(rig_file, "rig.yaml"), NAME) == ()


@pytest.mark.parametrize("times", [[], [0.0], [0.0, 2.0, 1.0], [0.0, np.nan, 1.0]])
def test_times_that_make_no_recording_are_left_to_who_reads_them(rig_file, times):
    given = Trajectory(np.array(times), {"position_m": np.arange(float(len(times)))})
    assert check_suits(given, rig_from_mapping(rig_file, "rig.yaml"), NAME) == ()


def test_a_rig_at_rest_is_a_rig(rig_file, recorded):
    given = recorded({}, "rest", seed=207, duration=5.0).columns
    assert check_suits(trajectory(given), rig_from_mapping(rig_file, "rig.yaml"), NAME) == ()


def test_a_fitted_value_that_the_data_do_not_tell_is_no_contradiction(rig_file, columns):
    fitted = changed(rig_file, "plant", "moving_mass", 0.02)
    assert check_suits(trajectory(columns), fitted, NAME, fitted=True) == ()
    assert "if 0.02 t was meant" in refusal(columns, fitted).expected


@pytest.mark.parametrize("path", sorted(ROOT.glob("examples/*/*.csv")), ids=lambda path: path.stem)
def test_rigs_of_others_are_rigs(path):
    rig = load_rig(path.parent / "rig.yaml")
    assert check_suits(load(path, read_columns(path.parent / "columns.yaml")), rig, path.name) == ()
