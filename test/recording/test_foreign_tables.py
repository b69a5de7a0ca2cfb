"""Files in the formats of other programs: read as intended, with a report of the interpretation, and without guessing."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.columns import Column, ColumnMap, read_columns
from ehls_ros.recording.load import load, raw
from ehls_ros.recording.proposal import look, proposed_map
from ehls_ros.trajectory import Trajectory

TIMES, PATH = [0.0, 0.01, 0.02], [-1.5e-3, 0.25e-3, 1234.5e-3]


def written(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(text.encode(encoding))
    return path


def by_proposal(path: Path) -> Trajectory:
    """Read a file by the proposed map."""
    text = proposed_map(look(path)).text
    (path.parent / "map.yaml").write_text(text, encoding="utf-8")
    return load(path, read_columns(path.parent / "map.yaml"))


LAYOUTS: dict[str, tuple[str, str, str]] = {
    "decimal comma, units below the names": (
        "Zeit;Weg;Öltemperatur\r\ns;mm;°C\r\n0,00;-1,5;20\r\n0,01;0,25;20\r\n0,02;1234,5;20\r\n",
        "cp1252",
        "cp1252, semicolons between cells, decimal comma, names in line 1, units in line 2, values from line 3",
    ),
    "units above the names, tabs": (
        "[ms]\t[mm]\ntime\tWeg\n0\t-1.5\n10\t0.25\n20\t1234.5\n",
        "utf-8",
        "utf-8, tabs between cells, decimal point, names in line 2, units in line 1, values from line 3",
    ),
    "keys before the names": (
        "Prüfer;Frau Meier\nPrüfstand;3\nDatum;04.05.2026\n\nZeit [s];Weg [mm]\n0,00;-1,5\n0,01;0,25\n0,02;1234,5\n",
        "utf-8-sig",
        "utf-8, semicolons between cells, decimal comma, names in line 5, values from line 6",
    ),
    "LabVIEW's keys, and tabs": (
        "Time\t12:03:04,125\n***End***\t\n\t\nTime [s]\tWeg [mm]\tComment\n0,00\t-1,5\t\n0,01\t0,25\t\n0,02\t1234,5\t\n",
        "utf-8",
        "utf-8, tabs between cells, decimal comma, names in line 4, values from line 5",
    ),
    "a row of channels below the units": (
        "Zeit;Weg\ns;mm\n;Kanal 1\n0,00;-1,5\n0,01;0,25\n0,02;1234,5\n",
        "utf-8",
        "utf-8, semicolons between cells, decimal comma, names in line 1, units in line 2, values from line 4",
    ),
    "comments, and names in one of them": (
        "% a run; of May, at 3 bar\n# time_ms x_mm\n 0   -1.5\n10    0.25\n20  1234.5\n",
        "utf-8",
        "utf-8, spaces between cells, decimal point, names in line 2, values from line 3",
    ),
    "quotes around commas": (
        '"t [s]","Weg\n[mm]","note, by hand"\n"0,00","-1,5","a, b"\n"0,01","0,25",""\n"0,02","1234,5",""\n',
        "utf-16",
        "utf-16, commas between cells, decimal comma, names in line 2, values from line 3",
    ),
    "UTF-16 without a mark": (
        "time_ms,x_mm\n0,-1.5\n10,0.25\n20,1234.5\n",
        "utf-16-le",
        "utf-16-le, commas between cells, decimal point, names in line 1, values from line 2",
    ),
    "a delimiter at the end of each row": (
        "Zeit [s];Weg [mm]\n0,00;-1,5;\n0,01;0,25;\n0,02;1234,5;\n",
        "utf-8",
        "utf-8, semicolons between cells, decimal comma, names in line 1, values from line 2",
    ),
    "dates": (
        "time;x_mm\n04.05.2026 23:59:59,990;-1.5\n05.05.2026 00:00:00,000;0.25\n05.05.2026 00:00:00,010;1234.5\n",
        "utf-8",
        "utf-8, semicolons between cells, decimal point, names in line 1, values from line 2",
    ),
    "times of day": (
        "Uhrzeit;Weg [mm]\n12:03:04,125;-1,5\n12:03:04,135;0,25\n12:03:04,145;1234,5\n",
        "utf-8",
        "utf-8, semicolons between cells, decimal comma, names in line 1, values from line 2",
    ),
    "times of day over midnight": (
        "Uhrzeit;Weg [mm]\n23:59:59,990;-1,5\n00:00:00,000;0,25\n00:00:00,010;1234,5\n",
        "utf-8",
        "utf-8, semicolons between cells, decimal comma, names in line 1, values from line 2",
    ),
    "ISO date times": (
        "time,x_mm\n2026-05-04T12:03:04.125Z,-1.5\n2026-05-04T12:03:04.135Z,0.25\n2026-05-04T12:03:04.145Z,1234.5\n",
        "utf-8",
        "",
    ),
}
"""Text, encoding and the report on it."""


UNITS_ROWS = {
    "one unknown unit": ("Zeit;Weg;Zyklen", "s;mm;cycles", {"Zeit": "s", "Weg": "mm", "Zyklen": "cycles"}),
    "half of them unknown": ("Zeit;Zyklen", "s;cycles", {"Zeit": "s", "Zyklen": "cycles"}),
    "a label in the first cell": ("Name;Zeit;Weg", "Unit;s;mm", {"Zeit": "s", "Weg": "mm"}),
    "a number for no unit": ("Zeit;Weg;Zyklen", "s;mm;1", {"Zeit": "s", "Weg": "mm"}),
    "delimiters at the end left out": ("Zeit;Weg;Zyklen;Notiz", "s;mm", {"Zeit": "s", "Weg": "mm"}),
    "names that look like units": ("s;V;N;F", "mm;V;1/min;kN", {"s": "mm", "V": "V", "N": "1/min", "F": "kN"}),
    "equal names": ("Zeit;Kraft;Kraft", "sec.;kip;ksi", {"Zeit": "sec.", "column 2": "kip", "column 3": "ksi"}),
    "few known ones": ("Zeit;N;D;Q", "s;cycles;strain;-", {"Zeit": "s", "N": "cycles", "D": "strain"}),
    "unknown ones in brackets": ("Zeit;N;D", "(s);(furlong);(foo)", {"Zeit": "s", "N": "furlong", "D": "foo"}),
    "units above the names": ("[ms];[mm];[cycles]", "t;x;n", {"t": "ms", "x": "mm", "n": "cycles"}),
}
"""Rows of names and of units, and the units found; values are semicolon-separated numbers."""


@pytest.mark.parametrize("name", UNITS_ROWS)
def test_a_row_of_units_is_one_whatever_single_units_are(tmp_path: Path, name: str):
    first, second, units = UNITS_ROWS[name]
    width = len(first.split(";"))
    values = "".join(";".join(f"{row},{column}" for column in range(width)) + "\n" for row in range(3))
    table = raw(written(tmp_path / "data.txt", f"{first}\n{second}\n{values}"))
    assert table.units == units
    assert table.names == tuple((second if "above" in name else first).split(";"))
    assert len(table.values) == width
    assert all(
        values.tolist() == [place / 10, 1 + place / 10, 2 + place / 10] for place, values in enumerate(table.values.values())
    )


def test_a_unit_that_is_not_known_leaves_its_column_open(tmp_path: Path):
    path = written(tmp_path / "data.txt", "Zeit\tKraft\tZyklen\ns\tkN\tcycles\n" + "0,0\t1,5\t0\n0,1\t2,5\t0\n" * 1)
    text = proposed_map(look(path)).text
    assert 'force_n: {name: "Kraft", unit: "kN"}' in text
    assert "unit 'cycles' is not known" in text


def test_a_column_can_be_chosen_by_its_number(tmp_path: Path):
    path = written(tmp_path / "data.csv", "t;F;F;\n0,0;1;5;\n0,1;2;6;\n")
    columns = {"time_s": Column("column 1"), "force_n": Column("column 3")}
    assert load(path, ColumnMap(columns))["force_n"].tolist() == [5.0, 6.0]
    summed = {"time_s": Column("t"), "force_n": Column(expression="`column 2` + `column 3`")}
    assert load(path, ColumnMap(summed))["force_n"].tolist() == [6.0, 8.0]
    with pytest.raises(BadInput, match=r"column 'F' occurs more than once; expected one .* or name: 'column 2' or 'column 3'"):
        load(path, ColumnMap({"time_s": Column("t"), "force_n": Column("F")}))
    with pytest.raises(BadInput, match="column 'column 5' for force_n is missing"):
        load(path, ColumnMap({"time_s": Column("t"), "force_n": Column("column 5")}))
    assert [column.header.column for column in look(path)[0].columns] == ["t", "column 2", "column 3", "column 4"]


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_text_file_is_read_as_its_program_meant_it(tmp_path: Path, name: str):
    text, encoding, said = LAYOUTS[name]
    trajectory = by_proposal(written(tmp_path / "data.csv", text, encoding))
    np.testing.assert_allclose(trajectory.time_s - trajectory.time_s[0], TIMES, atol=1e-10)
    np.testing.assert_allclose(trajectory["position_m"], PATH, rtol=1e-15)
    assert trajectory.preparation.remarks == ((f"read as {said}",) if said else ())


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("Zeit;Weg\ns;mm\n0,00;1,5\n0,00;1,5\n", "line 4: time_s is 0.0 after 0.0"),
        ("# by hand\nZeit;Weg\ns;mm\n0,1;1,5\n0,0;1,5\n", "line 5: time_s is 0.0 after 0.1"),
        ("Zeit;Weg\ns;mm\n0,0;1,5\n0,1;2,5\n0,2;defekt\n", "line 5: column 'Weg' is 'defekt'"),
        ("Zeit;Weg\ns;mm\n0,0;1,5\n0,1\n", "line 4: the row has 1 cells; expected 2"),
        ("Zeit;Weg\ns;mm\n0,0;1.234,5\n0,1;2,5\n", "line 3: column 'Weg' is '1.234,5'; expected a number with a decimal comma"),
        ("Zeit;Weg\ns;mm\n12:00:01;1,5\n12:00:xx;2,5\n12:00:03;1,5\n", "line 4: time_s is nan"),
    ],
)
def test_what_is_wrong_is_named_by_its_line_in_an_editor(tmp_path: Path, text: str, complaint: str):
    columns = ColumnMap({"time_s": Column("Zeit", unit="s"), "position_m": Column("Weg", unit="mm")})
    with pytest.raises(BadInput) as caught:
        load(written(tmp_path / "data.csv", text), columns)
    assert complaint in str(caught.value)


def test_the_line_is_right_in_a_long_file(tmp_path: Path):
    rows = [f"{k},{k}.123456789012" for k in range(150_000)]
    rows[140_000] = "140000,1_0"
    with pytest.raises(BadInput, match="line 140002: column 'force_n' is '1_0'"):
        load(written(tmp_path / "data.csv", "time_s,force_n\n" + "\n".join(rows)))


def test_a_column_that_is_not_wanted_may_hold_anything(tmp_path: Path):
    path = written(tmp_path / "data.csv", "time_s,state,force_n\n0,1,2\n1,overflow,3\n")
    assert load(path)["force_n"].tolist() == [2.0, 3.0]
    assert raw(path).values["state"] is None


def test_rows_without_names_are_columns_by_number(tmp_path: Path):
    path = written(tmp_path / "data.txt", "0.0 5\n0.1 6\n")
    trajectory = load(path, ColumnMap({"time_s": Column("column 1"), "force_n": Column("column 2")}))
    assert trajectory["force_n"].tolist() == [5.0, 6.0]


def test_times_are_counted_from_a_stated_rate(tmp_path: Path):
    path = written(tmp_path / "data.csv", "n,force_n\n100,1\n101,2\n")
    assert load(path, ColumnMap({"time_s": Column(rate=50.0)})).time_s.tolist() == [0.0, 0.02]
    assert load(path, ColumnMap({"time_s": Column("n", rate=50.0)})).time_s.tolist() == [2.0, 2.02]


def as_mat_7_3(path: Path) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        log = file.create_group("log")
        for name, values in (("t_ms", [0.0, 10.0, 20.0]), ("x_mm", [-1.5, 0.25, 1234.5])):
            log[name] = np.array([values]).T  # MATLAB's columns are rows of the file
        file["title"] = np.array([[82], [117], [110]], dtype=np.uint16)
        file["title"].attrs["MATLAB_class"] = np.bytes_("char")
        file["elsewhere"] = h5py.ExternalLink("/etc/passwd", "/x")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def as_excel(path: Path) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    rows = [["a run of May"], ["Zeit", "Weg", "Notiz"], ["ms", "mm"], [0, -1.5, "a"], [10, 0.25], [20, 1234.5]]
    for row in rows:
        book.active.append(row)
    book.save(path)
    return path


def as_tdms(path: Path) -> Path:
    nptdms = pytest.importorskip("nptdms")
    properties = {"unit_string": "mm", "wf_increment": 0.01}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("run", "Weg", np.array([-1.5, 0.25, 1234.5]), properties)])
    return path


def as_parquet(path: Path) -> Path:
    arrow = pytest.importorskip("pyarrow")
    times = arrow.array([1_777_888_999_000, 1_777_888_999_010, 1_777_888_999_020], arrow.timestamp("ms"))
    pytest.importorskip("pyarrow.parquet").write_table(arrow.table({"time": times, "x_mm": [-1.5, 0.25, 1234.5]}), path)
    return path


@pytest.fixture
def a_quarter_of_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave less memory for a small file than its library takes by itself."""
    monkeypatch.setattr(limits, "EXPANDED", limits.EXPANDED // 4)


@pytest.mark.usefixtures("a_quarter_of_the_memory")
@pytest.mark.parametrize(
    ("name", "make"), [("a.mat", as_mat_7_3), ("a.xlsx", as_excel), ("a.tdms", as_tdms), ("a.parquet", as_parquet)]
)
def test_files_of_other_programs_are_read_with_their_units(tmp_path: Path, name: str, make: Callable[[Path], Path]):
    trajectory = by_proposal(make(tmp_path / name))
    np.testing.assert_allclose(trajectory.time_s - trajectory.time_s[0], TIMES, atol=1e-10)
    np.testing.assert_allclose(trajectory["position_m"], PATH, rtol=1e-15)


def test_a_structure_of_mat_7_3_that_holds_itself_is_refused(tmp_path: Path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        log = file.create_group("log")
        log["self"] = log
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    with pytest.raises(BadInput, match="its structures are nested"):
        load(path)


def test_a_wrong_cell_of_excel_is_named_by_its_row(tmp_path: Path):
    columns = ColumnMap({"time_s": Column("Zeit", unit="ms"), "force_n": Column("Notiz")})
    with pytest.raises(BadInput, match="row 4: column 'Notiz' is 'a'; expected a number, a time or an empty cell"):
        load(as_excel(tmp_path / "a.xlsx"), columns)
