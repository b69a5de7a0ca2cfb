"""A rig file from data sheets, from a file of answers and on a terminal."""

import json
import sys

import pytest
import yaml
from terminal import INTERRUPT, dialogue

from ehls_ros.cli.main import main
from ehls_ros.experiments.spec import load_rig

ANSWERS = "bore: 63\nrod: 36 mm\nrods: two\nstroke: 200\nsupply_pressure: 210 bar\nrated_flow: 38\nrated_drop: 70\n"


@pytest.fixture
def answers(tmp_path):
    path = tmp_path / "answers.yaml"
    path.write_text(ANSWERS, encoding="utf-8")
    return path


def test_a_rig_from_a_file_of_answers(answers, tmp_path, capsys):
    assert main(["new-rig", "--out", str(tmp_path / "rig.yaml"), "--from", str(answers), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])["values"]
    rig = load_rig(tmp_path / "rig.yaml")
    assert rig.plant.supply_pressure == told["plant.supply_pressure"]["value"] == 21e6
    assert told["plant.piston_area"]["origin"] == "computed"
    lines = (tmp_path / "rig.yaml").read_text(encoding="utf-8").splitlines()
    [mass] = [line for line in lines if "moving_mass:" in line]
    assert mass.split("#")[1] == " kg; assumed: 100 kg; weigh piston, rod and load"
    values = [line for line in lines[1:] if ": " in line and not line.strip().startswith(("model", "effects", "sensors"))]
    assert all(" # " in line for line in values)


def test_the_loop_is_described_as_far_as_it_is_stated(answers, tmp_path):
    answers.write_text(
        ANSWERS + "delay: 1\ncoupling: 2000\nposition_noise: 2\npressure_noise: 0.1 bar\nforce_noise: 5\n", encoding="utf-8"
    )
    assert main(["new-rig", "--out", str(tmp_path / "rig.yaml"), "--from", str(answers)]) == 0
    rig = load_rig(tmp_path / "rig.yaml")
    told = {use.name: tuple(use.parameters) for use in rig.effects}
    assert told == {"command_delay": (1e-3,), "coupling_stiffness": pytest.approx((2e6, 2e3))}
    noise = {name: sensor.noise_std for name, sensor in rig.sensors.items() if sensor.noise_std}
    assert noise == {"position": 2e-6, "load_pressure": 1e4, "force": 5.0}


def test_the_template_has_every_question_and_needs_seven(capsys):
    assert main(["new-rig", "--template"]) == 0
    text = capsys.readouterr().out
    assert list(yaml.safe_load(text)) == list(yaml.safe_load(ANSWERS))
    assert "# leakage:" in text


def test_a_file_that_is_there_stays(answers, tmp_path, capsys):
    rig = tmp_path / "rig.yaml"
    rig.write_text("mine", encoding="utf-8")
    assert main(["new-rig", "--out", str(rig), "--from", str(answers)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert rig.read_text(encoding="utf-8") == "mine"
    assert main(["new-rig", "--out", str(rig), "--from", str(answers), "--overwrite"]) == 0


def test_answers_that_make_no_rig_write_none(answers, tmp_path, capsys):
    answers.write_text(ANSWERS.replace("63", "30"), encoding="utf-8")
    assert main(["new-rig", "--out", str(tmp_path / "rig.yaml"), "--from", str(answers)]) == 2
    assert "swapped" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["answers.yaml"]


def questions(rig, answers):
    """Answer the questions on a terminal as they are asked; return the exit code and the terminal's content."""
    return dialogue([sys.executable, "-m", "ehls_ros.cli.main", "new-rig", "--out", str(rig)], answers)


def test_questions_on_a_terminal(tmp_path):
    first = ["63\n", "36\n", "both\n", "two\n", "200\n", "3000 psi\n", "38\n", "70 bar\n"]
    code, shown = questions(tmp_path / "rig.yaml", [*first, *28 * ["\n"]])
    assert code == 0, shown
    assert "'both' is not valid" in shown
    assert "piston diameter" in shown
    rig = load_rig(tmp_path / "rig.yaml")
    assert rig.plant.supply_pressure == pytest.approx(206.84e5, rel=1e-4)
    assert rig.limits.position == (-0.1, 0.1)


@pytest.mark.parametrize(("key", "code"), [(INTERRUPT, 130), ("\x04", 2)], ids=["Ctrl-C", "Ctrl-D"])
def test_who_gives_up_leaves_nothing(key, code, tmp_path):
    found, shown = questions(tmp_path / "rig.yaml", ["63\n", "36\n", key])
    assert found == code, shown
    assert not list(tmp_path.iterdir())


def test_a_single_rod_of_two_chambers(tmp_path, capsys):
    answers, rig = tmp_path / "answers.yaml", tmp_path / "rig.yaml"
    answers.write_text(
        "{bore: 63, rod: 45, rods: one, stroke: 400, supply_pressure: 210 bar, rated_flow: 40, rated_drop: 70 bar,"
        " cylinder: two_chamber, hose_a: 250, flow_pb: 20}"
    )
    assert main(["new-rig", "--from", str(answers), "--out", str(rig)]) == 0
    made = load_rig(rig)
    assert (made.cylinder.model, made.valve.model, made.valve.parameters.gain_pb) == ("two_chamber", "four_edges", 0.5)
    assert "π/4 (bore² - rod²)" in rig.read_text(encoding="utf-8")
