"""`ehls monitor` from the command line: its output, files and refusals."""

import csv
import json
from pathlib import Path

import pytest
import yaml

from ehls_ros.cli.main import main
from ehls_ros.cli.verbs import monitor as verb
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS
from ehls_ros.experiments.monitoring.replay import MonitoringResult

RIG = Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml"
SECONDS = 45.0


@pytest.fixture(scope="module")
def well(tmp_path_factory) -> Path:
    """A recording of a rig that matches its file."""
    from truth_generator import record

    path = tmp_path_factory.mktemp("recording") / "axis.csv"
    record(yaml.safe_load(RIG.read_text()), {}, "rich", seed=6, duration=SECONDS).write_csv(path)
    return path


@pytest.fixture(scope="module")
def watched(well, tmp_path_factory) -> Path:
    """The folder of a run."""
    out = tmp_path_factory.mktemp("watched")
    arguments = ["--rig", str(RIG), "--learning-time", "30", "--out", str(out), "--limit", "leakage_coefficient=1.2e-11"]
    assert main(["monitor", str(well), *arguments]) == 0
    return out


@pytest.fixture
def again(monkeypatch, tmp_path):
    """Run the command with a stored replay instead of a new one, and return the arguments it was called with."""
    calls = []

    class Reached(Exception):
        pass

    def kept(parts, rig, parameters, **options) -> MonitoringResult:
        calls.append((parts, parameters, options))
        raise Reached

    monkeypatch.setattr(verb, "replay", kept)

    def run(*arguments):
        with pytest.raises(Reached):
            main(["monitor", *map(str, arguments), "--rig", str(RIG)])
        return calls[-1]

    return run


@pytest.mark.long
def test_a_healthy_recording_gives_no_change(watched):
    document = json.loads((watched / "monitor.json").read_text())
    assert document["healthy"] is True
    assert document["changes"] == []
    assert document["state"] == "watching"
    assert document["mean_time_between_false_alarms"] == 1000.0
    assert document["summary"].startswith("No change detected")
    assert [event["kind"] for event in document["events"]] == ["learnt", "watching"]
    assert [stretch["name"] for stretch in document["recordings"]] == ["axis.csv"]
    assert 0.0 < document["watched"] < SECONDS - 30.0


@pytest.mark.long
def test_each_coefficient_has_a_value_in_its_interval_or_a_reason(watched):
    coefficients = json.loads((watched / "monitor.json").read_text())["coefficients"]
    assert set(coefficients) <= set(COEFFICIENTS)
    told = {name for name, entry in coefficients.items() if entry["told"]}
    assert "leakage_coefficient" in told
    for name, entry in coefficients.items():
        assert bool(entry["why_not"]) != (name in told)
        if name in told:
            low, high = entry["ci95"]
            assert low < entry["value"] < high
            assert high - low == pytest.approx(2.0 * 1.96 * entry["std"], rel=1e-3)
    leakage = coefficients["leakage_coefficient"]
    assert leakage["value"] == pytest.approx(leakage["healthy"], rel=0.05)
    assert leakage["limit"]["limit"] == 1.2e-11


@pytest.mark.long
def test_the_table_has_a_row_for_each_reading(watched):
    with (watched / "coefficients.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["coefficient"] for row in rows} <= set(COEFFICIENTS)
    for row in rows:
        assert bool(row["value"]) == bool(row["std"]) != bool(row["why_not"])
    assert (watched / "report.html").read_text().startswith("<!DOCTYPE html>")
    assert not list(watched.glob(".*"))


def test_settings_reach_the_monitor(again, well):
    parts, parameters, options = again(
        well, well, "--mean-time-between-false-alarms", 100, "--learning-time", 40, "--baseline", well
    )
    assert [part.name for part in parts] == ["axis.csv", "axis.csv"]
    assert (parameters.mean_time_between_false_alarms, parameters.learning_time) == (100.0, 40.0)
    assert list(options["baselines"]) == [str(well)]
    assert parameters.reading_time == pytest.approx(10.0)


def test_limits_come_from_a_file_too(again, well, tmp_path):
    file = tmp_path / "limits.yaml"
    file.write_text("leakage_coefficient: 1.2e-11\ncoulomb_force: 800\n")
    *_, options = again(well, "--limit", file, "--limit", "coulomb_force=900", "--reading-time", 20)
    assert options["limits"] == {"leakage_coefficient": 1.2e-11, "coulomb_force": 900.0}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--limit", "leakage=1"], "coefficient 'leakage' is unknown"),
        (["--limit", "leakage_coefficient"], "NAME=VALUE"),
        (["--mean-time-between-false-alarms", "0"], "mean_time_between_false_alarms is 0"),
        (["--learning-time", "1"], "learning_time is 1"),
        (["--reading-time", "1"], "reading_time is 1"),
    ],
)
def test_what_cannot_be_meant_is_refused(arguments, said, well, capsys):
    assert main(["monitor", str(well), "--rig", str(RIG), *arguments]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert said in line
