"""LabVIEW's measurement files, in the layouts of National Instruments' specification."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap, read_columns
from ehls_ros.recording.load import load, raw
from ehls_ros.recording.proposal import look, proposed_map

ROWS = 40


def header(x_columns: str, separator: str = "Tab", decimal: str = ".") -> str:
    keys = {
        "LabVIEW Measurement": "",
        "Writer_Version": "2",
        "Separator": separator,
        "Decimal_Separator": decimal,
        "Multi_Headings": "Yes",
        "X_Columns": x_columns,
        "Time_Pref": "Absolute",
        "Date": "2024/01/01",
        "Time": "09:00:00.5",
    }
    lines = "".join(f"{key}\t{value}\n" for key, value in keys.items())
    return lines.replace("\t.\n", f"\t{decimal}\n") + "***End_of_Header***\t\n\t\n"


def segment(
    rows: Sequence[Sequence[object]], *, times: str = "09:00:01.0", steps: tuple[float, float] = (0.01, 0.01), wide=False
) -> str:
    """Return a segment of the channels Kraft [kN] and Weg [mm]; ``wide``: with a column of times before each."""
    gap = "\t\t" if wide else "\t"
    first, second = (times.split() * 2)[:2]
    names = "X_Value\tKraft\tX_Value\tWeg\tComment" if wide else "X_Value\tKraft\tWeg\tComment"
    return (
        f"Channels\t2\t\t\nSamples\t{len(rows)}{gap}{len(rows)}\nDate\t2024/01/01{gap}2024/01/01\nTime\t{first}{gap}{second}\n"
        f"Y_Unit_Label\tkN{gap}mm\nX_Dimension\tTime{gap}Time\nX0\t0.0E+0{gap}0.0E+0\n"
        f"Delta_X\t{steps[0]}{gap}{steps[1]}\n***End_of_Header***\t\t\n{names}\n"
        + "".join("\t".join(map(str, row)) + "\n" for row in rows)
        + "\n"
    )


COUNTED = [("", k + 0.5, -k) for k in range(ROWS)]
FORCES, TIMES = [k + 0.5 for k in range(ROWS)], [0.01 * k for k in range(ROWS)]


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="cp1252")
    return path


def by_proposal(path: Path):
    (path.parent / "map.yaml").write_text(proposed_map(look(path)).text, encoding="utf-8")
    return load(path, read_columns(path.parent / "map.yaml"))


@pytest.mark.parametrize("separator", ["Tab", "Comma"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("name", ["a.lvm", "a.txt"])
def test_times_are_counted_from_the_header(tmp_path: Path, separator: str, decimal: str, name: str):
    text = header("No", separator, decimal) + segment(COUNTED)
    text = text.replace("0.5", f"0{decimal}5") if decimal == "." else text.replace(".", ",")
    if separator == "Comma":
        if decimal == ",":
            return  # no reader could tell cells from decimals
        text = text.replace("\t", ",")
    found = by_proposal(written(tmp_path / name, text))
    np.testing.assert_allclose(found.time_s, TIMES)
    np.testing.assert_allclose(found["force_n"], [1e3 * force for force in FORCES])
    np.testing.assert_allclose(found["position_m"], [-1e-3 * k for k in range(ROWS)])
    assert "times are counted from Delta_X of 0.01 s (100 Hz)" in found.preparation.remarks


def test_segments_are_joined_by_their_times(tmp_path: Path):
    text = header("No") + segment(COUNTED) + segment(COUNTED, times="09:00:03.25")
    table = raw(written(tmp_path / "a.lvm", text))
    np.testing.assert_allclose(table.values["time"], [*TIMES, *(2.25 + t for t in TIMES)])
    assert table.values["Kraft"].tolist() == 2 * FORCES
    assert (table.place(0), table.place(ROWS)) == ("line 22", "line 73")
    assert "2 segments joined by their times" in table.remarks[0]


def test_channels_of_different_rate_or_start_have_separate_times(tmp_path: Path):
    text = header("No") + segment(COUNTED, times="09:00:01.0 09:00:01.1", steps=(0.01, 0.02))
    table = raw(written(tmp_path / "a.lvm", text))
    assert table.time_of == {"Kraft": "time", "Weg": "time 2"}
    np.testing.assert_allclose(table.values["time 2"], [0.1 + 0.02 * k for k in range(ROWS)])
    found = by_proposal(tmp_path / "a.lvm")
    np.testing.assert_allclose(found["force_n"], 1e3 * (0.5 + found.time_s / 0.01))
    np.testing.assert_allclose(found["position_m"], -1e-3 * (found.time_s - 0.1) / 0.02, atol=1e-12)


def test_a_column_of_times_is_used_and_comments_are_left_out(tmp_path: Path):
    rows = [
        (t, force, -k, *(["lost, and found"] if k % 7 == 0 else []))
        for k, (t, force) in enumerate(zip(TIMES, FORCES, strict=True))
    ]
    found = by_proposal(written(tmp_path / "a.lvm", header("One") + segment(rows)))
    np.testing.assert_allclose(found.time_s, TIMES)
    np.testing.assert_allclose(found["force_n"], [1e3 * force for force in FORCES])


def test_columns_of_times_that_begin_anew_count_from_their_segment(tmp_path: Path):
    rows = [(t, force, 0) for t, force in zip(TIMES, FORCES, strict=True)]
    text = header("One") + segment(rows) + segment(rows, times="09:00:03.25")
    np.testing.assert_allclose(raw(written(tmp_path / "a.lvm", text)).values["X_Value"], [*TIMES, *(2.25 + t for t in TIMES)])


def test_columns_of_times_for_each_channel(tmp_path: Path):
    same = [(t, force, t, -k) for k, (t, force) in enumerate(zip(TIMES, FORCES, strict=True))]
    table = raw(written(tmp_path / "same.lvm", header("Multi") + segment(same, wide=True)))
    assert (table.names, table.time_of) == (("X_Value", "Kraft", "Weg"), {})
    # The second channel has half the rate, and ends sooner.
    other = [(t, force, *((2 * t, -2 * k) if k < ROWS // 2 else ())) for k, (t, force, *_) in enumerate(same)]
    text = (header("Multi") + segment(other, wide=True)).replace(
        f"Samples\t{ROWS}\t\t{ROWS}", f"Samples\t{ROWS}\t\t{ROWS // 2}"
    )
    table = raw(written(tmp_path / "other.lvm", text))
    assert table.time_of == {"Kraft": "X_Value", "Weg": "X_Value 2"}
    assert len(table.values["Weg"]) == ROWS // 2
    found = by_proposal(tmp_path / "other.lvm")
    np.testing.assert_allclose(found["position_m"], -1e-3 * found.time_s / 0.01, atol=1e-12)


def test_a_file_without_headers_is_a_plain_table(tmp_path: Path):
    path = written(tmp_path / "a.lvm", "".join(f"{t:.2f}\t{force}\n" for t, force in zip(TIMES, FORCES, strict=True)))
    found = load(path, ColumnMap({"time_s": Column("column 1"), "force_n": Column("column 2")}))
    assert found["force_n"].tolist() == FORCES


def test_rows_beyond_those_of_the_header_are_said(tmp_path: Path):
    text = (header("No") + segment(COUNTED)).replace(f"Samples\t{ROWS}\t{ROWS}", "Samples\t20\t20")
    table = raw(written(tmp_path / "a.lvm", text))
    assert len(table.values["time"]) == ROWS
    assert table.remarks[-1] == "rows behind the 20 of the header are taken to go on at its rate"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (header("No").replace("***End_of_Header***", ""), ": its header has no line ***End_of_Header***"),
        (header("No"), ": it has no values"),
        (header("No") + segment([*COUNTED, ("", 7)]), ", line 62: the row has 2 cells; expected 3, as in the line of names"),
        (header("No") + segment([*COUNTED, ("", 7, 8, "a", 9)]), ", line 62: the row has 5 cells; expected 3"),
        (
            header("No") + segment(COUNTED) + segment(COUNTED).replace("Weg", "Druck"),
            ", line 73: the channels are Kraft, Druck",
        ),
        (
            header("No") + segment(COUNTED).replace("0.01", "fast"),
            ", header above line 22: Delta_X is 'fast'; expected a number",
        ),
        (header("No") + segment(COUNTED, times="noon"), ", header above line 22: Date and Time are '2024/01/01' and 'noon'"),
        (header("No", decimal=",").replace("Tab", "Comma").replace("\t", ","), ": Decimal_Separator is ',' and cells are"),
    ],
)
def test_an_error_names_its_place(tmp_path: Path, text: str, complaint: str):
    path = written(tmp_path / "a.lvm", text)
    with pytest.raises(BadInput) as caught:
        raw(path)
    assert str(caught.value).startswith(f"{path}{complaint}")


def test_a_wrong_cell_is_named_by_its_line(tmp_path: Path):
    rows = [*COUNTED[:5], ("", "saturated", 1), *COUNTED[6:]]
    path = written(tmp_path / "a.lvm", header("No") + segment(rows))
    assert raw(path).wrong == {"Kraft": "line 27 is 'saturated'"}
    with pytest.raises(BadInput, match="line 27: column 'Kraft' is 'saturated'; expected a number"):
        load(path, ColumnMap({"time_s": Column("time"), "force_n": Column("Kraft")}))


def test_a_missing_time_is_named_by_its_line(tmp_path: Path):
    rows = [(t if k != 5 else "", k, -k) for k, t in enumerate(TIMES)]
    path = written(tmp_path / "a.lvm", header("One") + segment(rows))
    with pytest.raises(BadInput, match="line 27: time_s is nan; expected a finite time"):
        by_proposal(path)
