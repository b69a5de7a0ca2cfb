"""`ehls columns` from the command line."""

from pathlib import Path

import pytest

from ehls_ros.cli.main import main
from ehls_ros.recording.columns import Column, read_columns

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
    for cell in ("100 Hz", "3 rows", "p [bar]", "certain", "wants a look", "3.5"):
        assert cell in shown.err


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
