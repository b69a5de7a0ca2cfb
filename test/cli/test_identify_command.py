"""`ehls identify` from the command line, on a drive whose columns and units differ from the data contract's."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from ehls_ros.cli.main import main
from ehls_ros.experiments.spec import load_rig
from truth_generator import record

CONFIG = Path(__file__).parents[2] / "config"
EXAMPLE = Path(__file__).parents[2] / "examples" / "emps"
COULOMB, VISCOUS, MASS, OFFSET = 21.0, 205.0, 95.0, -3.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """A CSV file in the example's format: time, position, voltage of 35.15 N each."""
    random = np.random.default_rng(4)
    t = np.arange(24_000) * 1e-3
    speeds = (0.12, 0.08, 0.04, 0.1, 0.06)
    velocity = np.zeros_like(t)
    for i, speed in enumerate(speeds):
        start, way = 4.8 * i, 0.16
        for sign, begin in ((1.0, start + 0.2), (-1.0, start + 2.5)):
            since = t - begin
            lasts = min(way / speed, 2.0)
            velocity += sign * speed * np.clip(np.minimum(since, lasts - since) / 0.15, 0.0, 1.0)
    acceleration = np.gradient(velocity, 1e-3)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1])) * 1e-3])
    friction = COULOMB * np.tanh(velocity / 1e-4) + VISCOUS * velocity
    force = MASS * acceleration + friction + OFFSET + 0.5 * random.standard_normal(len(t))
    path = tmp_path_factory.mktemp("drive") / "drive.csv"
    rows = np.column_stack([t, position + 2e-7 * random.standard_normal(len(t)), force / 35.15])
    np.savetxt(path, rows, delimiter=",", header="t,qm,vir", comments="", fmt="%.10g")
    return path


@pytest.fixture(scope="module")
def folder(drive, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("identify")
    arguments = ["identify", str(drive), "--rig", str(EXAMPLE / "rig.yaml"), "--columns", str(EXAMPLE / "columns.yaml")]
    assert main([*arguments, "--out", str(out), "--json"]) == 0
    return out


def test_identification_json_holds_values_with_errors_and_units(folder):
    result = json.loads((folder / "identification.json").read_text())
    for name, true, unit in (
        ("coulomb_force", COULOMB, "N"),
        ("viscous_coefficient", VISCOUS, "N s/m"),
        ("moving_mass", MASS, "kg"),
    ):
        estimate = result["parameters"][name]
        assert estimate["value"] == pytest.approx(true, rel=0.05)
        assert estimate["unit"] == unit
        assert 0.0 < estimate["std"] < 0.1 * true
    assert {"method", "cost", "wall_s", "not_identifiable"} <= set(result)
    assert "viscous_damping" in result["not_identifiable"]
    matrix = np.array(result["correlations"]["matrix"])
    assert matrix.shape == (len(result["parameters"]),) * 2
    assert np.allclose(np.diag(matrix), 1.0)


def test_the_rig_file_loads_and_says_where_it_comes_from(folder):
    path = folder / "rig_identified.yaml"
    assert path.read_text().startswith("# Identified by `ehls identify` from drive.csv.")
    rig = load_rig(path)
    assert rig.friction.coulomb_force == pytest.approx(COULOMB, rel=0.05)
    assert rig.plant.gravity * rig.plant.moving_mass == pytest.approx(OFFSET, abs=0.3)
    assert set(yaml.safe_load(path.read_text())) == {"plant", "friction", "effects", "sensors", "limits"}


def test_the_report_is_there(folder):
    assert (folder / "report.html").stat().st_size > 1e5


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--elements", "0"], "--elements is 0"),
        (["--seed", "-1"], "--seed is -1"),
        (["--rig", "nowhere.yaml"], "nowhere.yaml"),
        (["--columns", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_bad_input_ends_with_2_and_one_line(drive, tmp_path, capsys, arguments, said):
    given = ["identify", str(drive), "--rig", str(EXAMPLE / "rig.yaml"), "--out", str(tmp_path)]
    assert main([*given, *arguments]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert said in line


def test_unmapped_columns_are_named(drive, tmp_path, capsys):
    assert main(["identify", str(drive), "--rig", str(EXAMPLE / "rig.yaml"), "--out", str(tmp_path)]) == 2
    assert "time_s" in capsys.readouterr().err


@pytest.fixture(scope="module")
def rig_folder(tmp_path_factory) -> Path:
    """A recording with hydraulic signals, identified from a rig file whose mass and flow gain are off by a factor of two."""
    folder = tmp_path_factory.mktemp("rig")
    truth = yaml.safe_load((CONFIG / "rig_paper_measured.yaml").read_text())
    record(truth, {}, "random", seed=2, duration=12.0).write_csv(folder / "recording.csv")
    guess = {**truth, "plant": {**truth["plant"], "moving_mass": 35.0, "discharge_coefficient": 1.24}}
    (folder / "guess.yaml").write_text(yaml.safe_dump(guess))
    given = ["identify", str(folder / "recording.csv"), "--rig", str(folder / "guess.yaml"), "--out", str(folder)]
    assert main([*given, "--whole-rig"]) == 0
    return folder


@pytest.mark.long
def test_the_whole_rig_is_identified_when_asked_for(rig_folder):
    result = json.loads((rig_folder / "identification.json").read_text())
    rig = load_rig(rig_folder / "rig_identified.yaml")
    for path, true in (("plant.moving_mass", 70.0), ("plant.discharge_coefficient", 0.62)):
        assert result["parameters"][path]["value"] == pytest.approx(true, rel=0.02)
        assert getattr(rig.plant, path.partition(".")[2]) == result["parameters"][path]["value"]
    assert "plant.total_volume" in result["not_identifiable"]
    assert result["residuals"]["force"]["after"] < result["residuals"]["force"]["before"]


@pytest.mark.long
def test_the_report_of_the_whole_rig_shows_coefficients_and_residuals(rig_folder):
    text = (rig_folder / "report.html").read_text(encoding="utf-8")
    assert "Rig identified" in text
    assert "plant.moving_mass" in text
    assert "volume balance" in text


@pytest.mark.long
def test_the_whole_rig_needs_no_number_of_elements(rig_folder, capsys):
    given = ["identify", str(rig_folder / "recording.csv"), "--rig", str(rig_folder / "guess.yaml"), "--out", str(rig_folder)]
    assert main([*given, "--whole-rig", "--elements", "2"]) == 2
    assert "--elements" in capsys.readouterr().err
