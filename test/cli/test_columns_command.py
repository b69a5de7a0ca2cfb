"""`ehls columns` from the command line."""

from pathlib import Path

import pytest

from ehls_ros.cli.main import main
from ehls_ros.recording.columns import Column, read_columns
from ehls_ros.recording.load import load

DATA = "time [ms],Weg_mm,p [bar]\n0,1.0,5\n10,2.0,6\n20,3.5,7\n"


def test_the_output_is_a_map_and_the_table_stands_beside_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "data.csv").write_text(DATA)
    assert main(["columns", str(tmp_path / "data.csv")]) == 0
    shown = capsys.readouterr()
    (tmp_path / "columns.yaml").write_text(shown.out)
    assert read_columns(tmp_path / "columns.yaml").plain() == {
        "time_s": Column("time [ms]", 1e-3),
        "position_m": Column("Weg_mm", 1e-3),
    }
    assert "# load_pressure_pa: " in shown.out
    for cell in ("100 Hz", "3 rows", "p [bar]", "certain", "to be checked", "3.5"):
        assert cell in shown.err


def test_the_map_is_written_with_the_valves_data_and_what_is_missing_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    data, out = tmp_path / "data.csv", tmp_path / "map.yaml"
    data.write_text("Zeit;Weg;p;i\ns;mm;;mA\n0,0;1,0;5;4\n0,0;2,0;6;12\n0,2;2,0;6;20\n")
    assert main(["columns", str(data), "--out", str(out), "--valve", "4..20 mA = 1 mm"]) == 0
    shown = capsys.readouterr()
    assert f"{out}: the map. Next: ehls diagnose {data} --columns {out} --rig RIG" in shown.out
    column = read_columns(out).plain()["valve_command_m"]
    assert [column.scale * current + column.offset for current in (4, 12, 20)] == pytest.approx([-1e-3, 0.0, 1e-3])
    for said in (
        "decimal comma, names in line 1, units in line 2",
        "line 4: time_s is 0.0 after 0.0; expected a time that increases with every row",
        "columns that are certain: 3; to be checked: 1",
        "a diagnosis can judge: nothing yet",
        "not force_balance: it needs position_m",
    ):
        assert said in shown.err


def test_a_cell_that_is_no_number_is_named_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    data, out = tmp_path / "data.csv", tmp_path / "map.yaml"
    data.write_text("t [s];x [mm];F [N];state\n0,0;1,0;1.005,0;on\n0,1;2,0;1.006,0;on\n0,2;-;1.007,0;on\n0,3;3,0;1.008,0;on\n")
    assert main(["columns", str(data), "--out", str(out)]) == 0
    shown = capsys.readouterr().err
    for place in ("line 4 is '-'", "line 2 is '1.005,0'", "columns that are certain: 1; to be checked: 2"):
        assert place in shown
    assert "# \"x [mm]\" is not a column of numbers: line 4 is '-'" in out.read_text()


def test_a_file_that_needs_no_map_may_have_the_proposed_one(tmp_path: Path):
    data, out = tmp_path / "data.csv", tmp_path / "map.yaml"
    data.write_text("time_s,force_n\n0,1\n1,2\n")
    assert main(["columns", str(data), "--out", str(out)]) == 0
    assert load(data, read_columns(out))["force_n"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("said", ["1 mm", "10 bar = 1 mm", "10 V = 1 kN", "4..4 mA = 1 mm", "1e V = 1 mm"])
def test_valve_data_that_say_something_else_are_bad_input(said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "data.csv").write_text(DATA)
    assert main(["columns", str(tmp_path / "data.csv"), "--valve", said]) == 2
    assert "expected the signal of full stroke and the stroke, such as '10 V = 1 mm'" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["diagnose", "identify"])
def test_a_file_with_names_of_its_own_says_the_command(verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    data = tmp_path / "my data.csv"
    data.write_text(DATA)
    rig = Path(__file__).parents[2] / "config" / "rig_paper.yaml"
    assert main([verb, str(data), "--rig", str(rig), "--out", str(tmp_path / "out")]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert f"ehls columns '{data}' --out columns.yaml, then --columns columns.yaml" in line


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("bag.mcap", "", "truncated"),
        ("data.ods", "", "its format is unknown"),
        ("data.csv", None, "cannot be read"),
        ("data.csv", "time [s],x [mm]\n", "no column has numbers (found: time [s], x [mm])"),
        ("data.mat", "no", "not a MAT file"),
    ],
)
def test_what_has_no_columns_is_bad_input(
    name: str, content: str | None, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    if content is not None:
        (tmp_path / name).write_text(content)
    assert main(["columns", str(tmp_path / name)]) == 2
    assert said in capsys.readouterr().err


def test_a_file_without_any_unit_is_asked_for_them_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    # Five digits of 128.98 Hz: from 100 s on, some rows repeat the time before.
    rows = "".join(f"{k / 128.98:.5g},{k % 7},{k % 5}\n" for k in range(12_000, 16_000))
    (tmp_path / "data.csv").write_text(f"t,x,F\n{rows}")
    assert main(["columns", str(tmp_path / "data.csv")]) == 0
    shown = capsys.readouterr()
    for said in ("128.98 Hz", "the rate is that of 't' in s", "even grid of 128.98 Hz", 'in place of each "?" in the map'):
        assert said in shown.err
    assert shown.err.count("no column states a unit") == 1
    assert '# position_m: {name: "x", unit: "?"}  # 0 to 6; unit?' in shown.out
    assert "no unit is given" not in shown.out + shown.err
