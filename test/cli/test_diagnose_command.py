"""`ehls diagnose` from the command line: its files, its output, and its reactions to errors."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from ehls_ros.cli.main import main
from ehls_ros.cli.verbs import diagnose as verb
from ehls_ros.diagnosis.result import Rival
from ehls_ros.estimate import Estimate
from ehls_ros.experiments import analysis
from ehls_ros.experiments import consequences as follows
from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.recording.load import load
from ehls_ros.report.page import number
from ehls_ros.report.quantities import percent

ROOT = Path(__file__).parents[2]
RIG = ROOT / "config" / "rig_paper_measured.yaml"
OFFSET = -234.6
CONTRACT = {
    "verdict", "stages", "causes", "remainder", "depends_on", "gain", "next_experiment", "extended_rig", "seed", "version",
}  # fmt: skip
STAGES = {"force_balance", "flow", "valve", "sensors"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """Twelve seconds of a rig whose Coulomb friction differs from its file's."""
    from truth_generator import record

    path = tmp_path_factory.mktemp("recording") / "axis.csv"
    made = record(yaml.safe_load(RIG.read_text()), {"coulomb_shift": {"offset": OFFSET}}, "rich", seed=1, duration=12.0)
    made.write_csv(path)
    return path


@pytest.fixture(scope="module")
def diagnosed(recording, tmp_path_factory):
    """The folder of a run, and the diagnosis it is based on."""
    out, kept = tmp_path_factory.mktemp("diagnosed"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(analysis, "diagnose", lambda *a, real=analysis.diagnose, **k: kept.append(real(*a, **k)) or kept[-1])
        assert main(["diagnose", str(recording), "--rig", str(RIG), "--out", str(out), "--threads", "1", "--seed", "3"]) == 0
    return out, kept[0]


@pytest.fixture
def again(diagnosed, recording, tmp_path, monkeypatch):
    """Run the command once more with a modified diagnosis instead of a new one."""

    def run(*arguments, **changes):
        found = replace(diagnosed[1], **changes)
        monkeypatch.setattr(analysis, "diagnose", lambda *a, **k: found)
        code = main(["diagnose", str(recording), "--rig", str(RIG), "--out", str(tmp_path), *arguments])
        return code, json.loads((tmp_path / "diagnosis.json").read_text()) if code == 0 else None

    return run


@pytest.mark.long
def test_a_foreign_file_is_diagnosed_by_the_map_proposed_for_it(diagnosed, recording, tmp_path, monkeypatch):
    whole, file, columns = load(recording), tmp_path / "Prüfstand.csv", tmp_path / "map.yaml"
    names = {
        "time_s": ("Zeit", "s", 1.0),
        "position_m": ("Weg", "mm", 1e3),
        "load_pressure_pa": ("Lastdruck", "bar", 1e-5),
        "valve_command_m": ("Stellsignal", "V", 1e3),
    }
    heads = [";".join(column) for column in zip(*((name, unit) for name, unit, _ in names.values()), strict=True)]
    values = [factor * (whole.time_s if name == "time_s" else whole[name]) for name, (_, _, factor) in names.items()]
    rows = [";".join(f"{value:.6f}".replace(".", ",") for value in row) for row in zip(*values, strict=True)]
    file.write_text("\n".join(["Bemerkung;kühl", *heads, *rows]), encoding="latin-1")
    seen = []
    monkeypatch.setattr(analysis, "diagnose", lambda trajectory, *a, **k: seen.append(trajectory) or diagnosed[1])
    assert main(["columns", str(file), "--valve", "10 V = 10 mm", "--out", str(columns)]) == 0
    assert main(["diagnose", str(file), "--columns", str(columns), "--rig", str(RIG), "--out", str(tmp_path / "out")]) == 0
    assert set(seen[0].signals) == names.keys() - {"time_s"}
    for name, read in seen[0].signals.items():
        np.testing.assert_allclose(read, whole[name], atol=1e-6 / names[name][2])


@pytest.mark.long
def test_several_recordings_are_judged_together(diagnosed, recording, tmp_path, monkeypatch):
    other, judged = tmp_path / "second.csv", []
    other.write_bytes(recording.read_bytes())
    monkeypatch.setattr(analysis, "diagnose", lambda trajectory, *a, **k: judged.append(trajectory) or diagnosed[1])
    assert main(["diagnose", str(recording), str(other), "--rig", str(RIG), "--out", str(tmp_path)]) == 0
    assert len(judged[0]) == 2 * len(load(recording))
    assert "axis.csv, second.csv, 24 s" in (tmp_path / "rig_extended.yaml").read_text()


def test_diagnosis_json_keeps_the_contract(diagnosed):
    result = json.loads((diagnosed[0] / "diagnosis.json").read_text())
    assert set(result) >= CONTRACT
    assert result["verdict"] == "effect"
    assert set(result["stages"]) == STAGES
    assert (result["seed"], result["extended_rig"]) == (3, "rig_extended.yaml")
    cause = result["causes"][0]
    assert cause["advice"].keys() == {"inspect", "measure", "change"}
    assert set(cause) >= {"name", "probability", "equivalent_to", "stage", "parameters", "evidence"}
    assert (cause["name"], cause["stage"]) == ("coulomb_shift", "force_balance")
    assert cause["parameters"]["offset"]["value"] == pytest.approx(OFFSET, rel=0.02)
    assert cause["parameters"]["offset"]["unit"] == "N"
    assert 0.0 < cause["parameters"]["offset"]["std"] < 5.0
    low, high = cause["parameters"]["offset"]["ci95"]
    assert low < OFFSET < high
    assert cause["share"] == pytest.approx(1.0, abs=0.02)
    assert set(result["remainder"]) <= STAGES
    assert result["remainder"]["force_balance"]["nrmse"] == result["stages"]["force_balance"]["nrmse_after"]
    gain = result["gain"]
    assert gain["heldout_nrmse_after"] < 0.1 * gain["heldout_nrmse_before"]
    low, high = gain["ci95"]
    assert 0.9 < low <= high <= 1.0
    assert 0.9 < gain["closed_fraction"] <= 1.0
    judged = result["stages"]["force_balance"]
    assert judged["judged"]
    assert judged["nrmse_before"] > 10.0 * judged["nrmse_after"]


def test_noise_is_the_same_in_every_number(diagnosed):
    out, found = diagnosed
    trace, stage = found.traces["force"], found.stages["force_balance"]
    noise, before, after = (float(np.sqrt(np.mean(values**2))) for values in (trace.floor, trace.before, trace.after))
    assert noise / trace.size == pytest.approx(stage.noise_floor) == found.gain.noise_floor
    assert (before / trace.size, after / trace.size) == pytest.approx((stage.nrmse_before, stage.nrmse_after))
    assert after < 1.5 * noise, "what is said to close to the noise does"
    assert np.mean(np.abs(trace.after) < 2.0 * trace.floor) > 0.95
    page = re.sub(r"\s+", " ", (out / "report.html").read_text())
    assert f"noise, 95 %, rms {number(noise, 2)} N" in page
    assert f"of its largest term, noise {percent(stage.noise_floor)};" in page
    assert f">{percent(stage.noise_floor)}</td>" in page


def test_measured_is_what_was_recorded(diagnosed, recording):
    trace, run = diagnosed[1].traces["force"], load(recording)
    area = load_rig(RIG).plant.piston_area
    recorded = area * np.interp(trace.time, run.time_s, run["load_pressure_pa"])
    assert trace.measured == pytest.approx(recorded, abs=0.02 * np.ptp(recorded))


def test_it_says_more_than_the_contract_asks_for(diagnosed):
    result = json.loads((diagnosed[0] / "diagnosis.json").read_text())
    assert "Coulomb friction" in result["summary"]
    assert result["sensitivities"]
    assert {"coupling_stiffness"} <= set(result["not_judged"])
    assert result["controller_gain"]["cases"]
    run = result["free_run"]["nrmse"]["load_pressure_pa"]
    assert run["after"] < run["before"]
    assert result["wall_s"] > result["diagnosis_s"] > 0.0


def test_the_extended_rig_loads_and_has_the_effect(diagnosed):
    path = diagnosed[0] / "rig_extended.yaml"
    heading = [line for line in path.read_text().splitlines() if line.startswith("#")]
    assert "axis.csv" in heading[0]
    assert any("coulomb_shift" in line and "N" in line for line in heading)
    rig = load_rig(path)
    assert [use.name for use in rig.effects] == ["coulomb_shift"]
    assert rig.effects[0].parameters.offset == pytest.approx(OFFSET, rel=0.02)
    assert rig_to_mapping(rig._replace(effects=())) == rig_to_mapping(load_rig(RIG))


def test_nothing_but_the_results_is_left(diagnosed):
    assert {path.name for path in diagnosed[0].iterdir()} == {"diagnosis.json", "report.html", "rig_extended.yaml"}
    assert (diagnosed[0] / "report.html").stat().st_size > 1e5


@pytest.mark.long
def test_json_is_the_last_line(again, capsys):
    code, result = again("--json")
    assert code == 0
    out = capsys.readouterr().out.strip().splitlines()
    assert json.loads(out[-1]) == result
    assert re.match(r"The Coulomb friction is 23[345]\S* ± \S+ N lower than in the rig file \(95 %\)", out[0])
    assert any("to confirm coulomb_shift: record a slow stroke" in line for line in out)
    assert any("report.html" in line for line in out)


@pytest.mark.long
def test_open_causes_get_an_experiment_that_can_be_run(again, diagnosed, tmp_path):
    cause = diagnosed[1].causes[0]
    rival = Rival("viscous_shift", 2.0, 0.95, {"added": Estimate(1800.0, 5.0, "N s/m")})
    code, result = again(causes=(cause._replace(probability=0.5, equivalent_to=("viscous_shift",), rivals=(rival,)),))
    assert code == 0
    proposed = result["next_experiment"]
    assert {proposed["separation"][0]["one"], proposed["separation"][0]["other"]} == {"coulomb_shift", "viscous_shift"}
    spec = load_spec(tmp_path / "next_experiment.yaml")
    assert [use.name for use in spec.rig.effects] == ["coulomb_shift"]
    assert spec.controller_rig.effects == ()
    assert main(["experiment", str(tmp_path / "next_experiment.yaml"), "--in-process", "--out", str(tmp_path / "run")]) == 0
    code, result = again()
    assert result["next_experiment"] is None
    assert not (tmp_path / "next_experiment.yaml").exists()


@pytest.mark.long
def test_an_unknown_cause_is_one_entry(again, tmp_path, diagnosed):
    result = diagnosed[1].stages["force_balance"]._replace(unexplained=True, depends_on=("position_m",))
    code, result = again(
        verdict="unknown",
        causes=(),
        unknown_stage="force_balance",
        depends_on=("position_m",),
        partial=("coulomb_shift",),
        gain=None,
        extended=diagnosed[1].rig,
        stages={**diagnosed[1].stages, "force_balance": result},
    )
    assert code == 0
    [cause] = result["causes"]
    assert (cause["name"], cause["stage"]) == ("unknown", "force_balance")
    assert cause["evidence"]["depends_on"] == result["depends_on"] == ["position_m"]
    assert result["gain"]["closed_fraction"] == 0.0
    assert (result["unknown_stage"], result["partial"]) == ("force_balance", ["coulomb_shift"])
    assert rig_to_mapping(load_rig(tmp_path / "rig_extended.yaml")) == rig_to_mapping(load_rig(RIG))
    assert "Nothing was added" in (tmp_path / "rig_extended.yaml").read_text()


@pytest.mark.long
def test_what_fails_beside_the_diagnosis_is_a_remark(again, monkeypatch):
    def fail(*arguments, **options):
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(follows, "free_run", fail)
    monkeypatch.setattr(follows, "controller_benefit", fail)
    monkeypatch.setattr(follows, "open_candidates", fail)
    code, result = again()
    assert code == 0
    assert sum("on purpose" in remark for remark in result["remarks"]) == 3
    assert result["free_run"] is result["controller_gain"] is result["next_experiment"] is None


@pytest.mark.long
@pytest.mark.parametrize(("module", "where"), [(analysis, "consequences"), (verb, "write_diagnosis_report")])
def test_an_interruption_leaves_no_halves(again, tmp_path, monkeypatch, module, where, capsys):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, where, interrupt)
    assert again()[0] == 130
    assert list(tmp_path.iterdir()) == []
    assert "interrupted" in capsys.readouterr().err


def test_too_little_to_judge_is_a_result(tmp_path, capsys):
    time = np.arange(3000) * 1e-3
    table = np.column_stack([time, 1e-5 * np.sin(time), 313.0 + 0.01 * np.random.default_rng(1).standard_normal(len(time))])
    np.savetxt(tmp_path / "few.csv", table, delimiter=",", header="time_s,valve_command_m,oil_temperature_k", comments="")
    out = tmp_path / "out"
    assert main(["diagnose", str(tmp_path / "few.csv"), "--rig", str(RIG), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert result["verdict"] == "insufficient"
    assert len(result["missing"]) == 4
    assert result["causes"] == []
    assert set(result["gain"]) >= {"heldout_nrmse_before", "heldout_nrmse_after", "noise_floor", "closed_fraction", "ci95"}
    assert "position_m" in (out / "report.html").read_text()
    assert load_rig(out / "rig_extended.yaml").effects == ()


def complaint(capsys, *arguments):
    assert main(["diagnose", *(str(argument) for argument in arguments)]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert "expected" in line
    return line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.csv"], "nowhere.csv"),
        (["{data}", "{data}"], "given twice"),
        (["{data}", "--threads", "0"], "--threads is 0"),
        (["{data}", "--seed", "-1"], "--seed is -1"),
        (["{data}", "--columns", "nowhere.yaml"], "nowhere.yaml"),
        (["{data}", "--rig", "nowhere.yaml"], "nowhere.yaml"),
        (["{data}", "--out", "{data}/results"], "writable folder"),
    ],
)
def test_bad_input_ends_with_2_and_one_line(recording, tmp_path, capsys, arguments, said):
    given = [argument.replace("{data}", str(recording)) for argument in arguments]
    options = [] if "--rig" in given else ["--rig", RIG]
    options += [] if "--out" in given else ["--out", tmp_path]
    assert said in complaint(capsys, *given, *options)
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_unit_is_named(recording, tmp_path, capsys):
    columns = tmp_path / "columns.yaml"
    columns.write_text("position_m: {name: position_m, scale: 1000.0}\n")
    line = complaint(capsys, recording, "--rig", RIG, "--columns", columns, "--out", tmp_path / "out")
    assert "position_m" in line
    assert "if its column is in mm" in line


def test_times_that_do_not_grow_are_named(recording, tmp_path, capsys):
    lines = recording.read_text().splitlines()
    (tmp_path / "back.csv").write_text("\n".join([*lines[:500], *lines[100:500]]))
    assert "back.csv" in complaint(capsys, tmp_path / "back.csv", "--rig", RIG, "--out", tmp_path / "out")


def test_a_free_run_needs_a_command(diagnosed, recording):
    run = load(recording)
    signals = {name: values for name, values in run.signals.items() if name != "valve_command_m"}
    done = follows.consequences(diagnosed[1], replace(run, signals=signals), "axis.csv")
    assert done.free_run is None
    assert any("valve_command_m" in remark for remark in done.remarks)
    assert done.controller is not None
