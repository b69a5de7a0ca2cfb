"""The report of a commissioning."""

from report_pages import parts, rows

from ehls_ros.report.commissioning import write_commissioning_report

FOUND = {"name": "plant.moving_mass", "given": 80.0, "value": 70.0, "std": 0.5, "unit": "kg"}
NEW = {"name": "effects.command_delay.delay", "given": None, "value": 1e-3, "std": 1e-6, "unit": "s"}


def test_numbers_found_stand_beside_those_of_the_file(tmp_path):
    log = {
        "at_rest": {"done": True, "findings": [], "sentences": []},
        "nudge": {"done": False},
        "motion": {"done": True, "findings": [FOUND, NEW], "sentences": ["a remark"]},
    }
    write_commissioning_report(log, "my_rig.yaml", tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert parts(text) == ["Sensors at rest", "Signs", "The rig identified", "Coupling", "Law tuned", "First run"]
    table = rows(text, "The rig identified")
    assert [row[0] for row in table if row[0].startswith("plant")] == ["plant.moving_mass"]
    [mass] = [row for row in table if row[0] == "plant.moving_mass"]
    assert mass[1] == "80.00"
    assert mass[4] == "−12.5 %"
    [delay] = [row for row in table if row[0] == "effects.command_delay.delay"]
    assert delay[1] == delay[4] == "–"
    assert "a remark" in text
    assert "Signs, Coupling, Law tuned and First run" in text
