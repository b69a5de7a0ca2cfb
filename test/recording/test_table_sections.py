"""Text files with several tables: blocks with a header each are joined, another table is chosen by its number."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import load, raw
from ehls_ros.recording.proposal import look

CYCLIC = "MTS793|MPT|ENU|1|2|.|,|:|1|0|0|A\n\n" + "\n".join(
    f"Cyclic Acquisition\t\t\tTime:\t{10 * k}.05\tSec\t01/01/2024 09:00:0{k}\nStored at:\t{100 * k}\tcycle\nPoints:\t40\n"
    "Time\tAxial Force\tAxial Count\nSec\tkN\tsegments\n"
    + "".join(f"{10 * k + 0.002 * row:.3f}\t{k}.{row:02d}\t{198 * k}\n" for row in range(40))
    for k in (1, 2, 3)
)
"""Blocks of some cycles, as an MTS controller stores them."""

GERMAN = """MTS793|MPT|DEU|1|2|,|.|:|49|1|1|A

Bediener Information\t\t\tZeit:\t71,000977\ts\t28.01.2015 10:33:47
Datum : \t28.02.2014
Masse :\t5328
Bediener Information Ende

Datenerfassung\t\t\t\t\t\tZeit:\t172,12207\ts\t28.01.2015 10:35:28
Weg\tKraft
mm\tkN
0,5\t0,25
-6,5\t-354,5

Datenerfassung\t\t\t\t\t\tZeit:\t172,12988\ts\t28.01.2015 10:35:28
Datum\tLaufzeit\tKraft\tWeg
d\ts\tkN\tmm
""" + "".join(f"42032\t{81 + k / 10:.1f}\t{k},5\t-{k},25\n".replace(".", ",") for k in range(20))
"""Two acquisitions with other columns, as the same controller stores them in German."""

RESULTS = """"Specimen properties : Anvil height","3.11",mm
Specimen properties : Geometry,Circular
Results Table 1
,Maximum Load,Strain at maximum
,(kN),(%)
1,123.4,5.6
2,100.4,5.1
Mean,111.9,5.3
Standard deviation,,

Time,Extension,Load
(s),(mm),(kN)
""" + "".join(f'"{k / 10}","{k}.25","{k}.5"\n' for k in range(20))
"""Results above the raw data, as a testing machine exports them."""


def written(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(text.encode(encoding))
    return path


def test_blocks_of_one_header_are_one_table(tmp_path: Path):
    path = written(tmp_path / "a.dat", CYCLIC)
    table = raw(path)
    assert table.names == ("Time", "Axial Force", "Axial Count")
    assert table.units == {"Time": "Sec", "Axial Force": "kN", "Axial Count": "segments"}
    np.testing.assert_allclose(table.values["Time"], [10 * k + 0.002 * row for k in (1, 2, 3) for row in range(40)])
    assert [table.place(row) for row in (0, 39, 40, 119)] == ["line 8", "line 47", "line 54", "line 139"]
    assert "sections with the same columns are joined: 120 rows in 3 sections, the first from line 8 on" in table.remarks
    columns = ColumnMap({"time_s": Column("Time", unit="s"), "force_n": Column("Axial Force", unit="kN")})
    found = load(path, columns)
    assert found["force_n"][[0, 40, 119]].tolist() == [1000.0, 2000.0, 3390.0]
    assert "time_s has 2 gaps, the longest before line 54" in found.preparation.remarks[-1]
    assert look(path)[0].rate == pytest.approx(500.0)


def test_tables_with_other_columns_are_chosen_by_number(tmp_path: Path):
    path = written(tmp_path / "a.dat", GERMAN, "cp1252")
    table = raw(path)
    assert table.names == ("Datum", "Laufzeit", "Kraft", "Weg", "table 1/Weg", "table 1/Kraft")
    assert (len(table.values["Kraft"]), table.values["table 1/Kraft"].tolist()) == (20, [0.25, -354.5])
    assert table.units["table 1/Kraft"] == "kN"
    assert any("table 1, 2 rows from line 11 on, is read only if" in remark for remark in table.remarks)
    few = ColumnMap({"time_s": Column(rate=2.0), "force_n": Column("table 1/Kraft", unit="kN")})
    assert load(path, few)["force_n"].tolist() == [250.0, -354500.0]
    with pytest.raises(BadInput, match="force_n has 2 values; expected 20, as time_s has"):
        load(path, ColumnMap({"time_s": Column("Laufzeit"), "force_n": Column("table 1/Kraft")}))


def test_raw_data_below_a_table_of_results_are_read(tmp_path: Path):
    path = written(tmp_path / "a.csv", RESULTS)
    table = raw(path)
    assert table.names[:3] == ("Time", "Extension", "Load")
    assert table.values["Load"].tolist() == [k + 0.5 for k in range(20)]
    assert {name: table.units[name] for name in table.names[:3]} == {"Time": "s", "Extension": "mm", "Load": "kN"}
    assert table.first == 13


def test_files_written_one_behind_another_are_not_mixed_up(tmp_path: Path):
    one = "t [s],F [N]\n" + "".join(f"{k / 100},{k}\n" for k in range(20))
    path = written(tmp_path / "a.csv", one + one)
    assert raw(path).values["F [N]"].tolist() == 2 * list(range(20))
    with pytest.raises(BadInput, match=r"line 23: time_s is 0\.0 after 0\.19; the clock is set back by 0\.2 s"):
        load(path, ColumnMap({"time_s": Column("t [s]"), "force_n": Column("F [N]")}))


@pytest.mark.parametrize(
    ("spoilt", "line"),
    [
        (CYCLIC.replace("20.004\t2.02\t396", "20.004\t2.02"), 56),
        (CYCLIC.replace("20.004\t2.02\t396", "20.004\t2.02\t396\t7"), 56),
        (CYCLIC + "\nend of test\n", 140),
        (CYCLIC.replace("20.004\t2.02\t396", "power failure"), 56),
    ],
    ids=["a cell too few", "a cell too many", "words at the end", "words among the values"],
)
def test_a_damaged_row_is_named_in_any_section(tmp_path: Path, spoilt: str, line: int):
    with pytest.raises(BadInput, match=rf"a\.dat, line {line}: the row has \d cells; expected 3, as in the header"):
        raw(written(tmp_path / "a.dat", spoilt))


def test_sections_beyond_the_beginning_of_the_file_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("ehls_ros.recording.csv_file.BEGINNING", 300)
    assert len(raw(written(tmp_path / "a.dat", CYCLIC)).values["Time"]) == 120


def test_a_long_line_is_refused_there_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(limits, "LINE", 100)
    spoilt = CYCLIC.replace("30.004\t", "30.004" + 200 * "0" + "\t")
    with pytest.raises(BadInput, match=r"line 102: the line has more than 100 characters"):
        raw(written(tmp_path / "a.dat", spoilt))
