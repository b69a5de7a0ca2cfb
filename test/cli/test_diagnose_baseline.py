"""`ehls diagnose NEW --baseline OLD`: output on the terminal, in the folder and in the report."""

import json
from pathlib import Path

import pytest
import yaml

from ehls_ros.cli.main import main
from ehls_ros.experiments.spec import load_rig

ROOT = Path(__file__).parents[2]
RIG = ROOT / "config" / "rig_paper_measured.yaml"
COLUMNS = ("position_m", "load_pressure_pa", "disturbance_force_n")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """A healthy recording, another one, and one with more friction; and a rig file with a wrong mass."""
    from truth_generator import record

    folder = tmp_path_factory.mktemp("recordings")
    true = yaml.safe_load(RIG.read_text())
    for name, effects, seed in (("old", {}, 1), ("same", {}, 2), ("changed", {"coulomb_shift": {"offset": 250.0}}, 3)):
        record(true, effects, "rich", seed=seed, duration=8.0, columns=COLUMNS).write_csv(folder / f"{name}.csv")
    true["plant"]["moving_mass"] *= 1.3
    (folder / "rig.yaml").write_text(yaml.safe_dump(true))
    return folder


def diagnose(recordings, new, out, capsys):
    old, rig = recordings / "old.csv", recordings / "rig.yaml"
    code = main(
        [
            *("diagnose", str(recordings / new), "--baseline", str(old), "--rig", str(rig)),
            *("--out", str(out), "--threads", "1", "--json"),
        ]
    )
    assert code == 0
    said = capsys.readouterr().out.strip().splitlines()
    return said, json.loads(said[-1])


@pytest.mark.long
def test_nothing_changed(recordings, tmp_path, capsys):
    said, result = diagnose(recordings, "same.csv", tmp_path, capsys)
    assert said[0].startswith("Nothing has changed since the baseline")
    assert (result["verdict"], result["summary"]) == ("unchanged", said[0])
    [name] = result["baseline"]["recordings"]
    assert name.endswith("old.csv")
    mass = result["baseline"]["coefficients"]["moving_mass"]
    assert mass["given"] == pytest.approx(91.0)
    assert mass["fitted"]["value"] == pytest.approx(70.0, rel=0.02)
    assert mass["fitted"]["unit"] == "kg"
    assert load_rig(tmp_path / "rig_extended.yaml").plant.moving_mass == pytest.approx(70.0, rel=0.02)
    assert "Nothing has changed" in (tmp_path / "report.html").read_text()


@pytest.mark.long
def test_a_change_is_told_and_shown_beside_the_baseline(recordings, tmp_path, capsys):
    said, result = diagnose(recordings, "changed.csv", tmp_path, capsys)
    assert said[0].startswith("Since the baseline")
    assert "Coulomb friction" in said[0]
    assert result["causes"][0]["name"] == "coulomb_shift"
    assert result["causes"][0]["parameters"]["offset"]["value"] == pytest.approx(250.0, abs=15.0)
    report = (tmp_path / "report.html").read_text()
    assert "Old and new" in report
    assert "mean, baseline" in report
    assert "New recording: rms" in report


def test_an_unreadable_baseline_is_named(recordings, tmp_path, capsys):
    same, nowhere = recordings / "same.csv", recordings / "nowhere.csv"
    code = main(["diagnose", str(same), "--baseline", str(nowhere), "--rig", str(RIG), "--out", str(tmp_path)])
    assert code == 2
    assert "nowhere.csv" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
