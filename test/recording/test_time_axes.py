"""Files whose columns have times of their own: several rates, or several starts, in one file."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.recording import load as loading
from ehls_ros.recording.columns import Column, ColumnMap, read_columns
from ehls_ros.recording.load import load
from ehls_ros.recording.proposal import look, proposed_map
from ehls_ros.recording.table import RawTable

FAST, SLOW = np.arange(2000) / 1000.0, 0.3 + np.arange(150) / 100.0
VALUES = {"t1": 1e3 * FAST, "Kraft": 5.0 * FAST, "t2": SLOW, "Weg": 2.0 * SLOW, "Notiz": np.ones(2000)}
TABLE = RawTable(
    tuple(VALUES),
    VALUES,
    units={"t1": "ms", "Kraft": "N", "Weg": "m"},
    remarks=("read somehow",),
    time_of={"Kraft": "t1", "Weg": "t2"},
)
MAP = {"force_n": Column("Kraft"), "position_m": Column("Weg")}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a file that is read as the table."""

    def read(path, pick=None):
        wanted = TABLE.names if pick is None else pick(TABLE.names, TABLE.time_of)
        return TABLE._replace(values={name: VALUES[name] for name in wanted})

    monkeypatch.setattr(loading, "READERS", {**loading.READERS, ".foreign": read})
    (tmp_path / "a.foreign").touch()
    return tmp_path / "a.foreign"


def test_columns_with_times_of_their_own_are_joined_where_they_overlap(file: Path):
    joined = load(file, ColumnMap(MAP))
    np.testing.assert_allclose(joined["force_n"], 5.0 * joined.time_s)
    np.testing.assert_allclose(joined["position_m"], 2.0 * joined.time_s)
    assert (joined.time_s[0], joined.time_s[-1]) == pytest.approx((0.3, 1.79))
    assert joined.preparation.remarks == (
        "2 tables are joined at the times of t1 (1000 Hz)",
        "read somehow",
        "position_m: interpolated from 100 Hz by a cubic spline",
    )


def test_a_map_that_names_one_of_the_axes_takes_its_clock_for_all(file: Path):
    joined = load(file, ColumnMap({**MAP, "time_s": Column("t2", offset=1.0)}))
    np.testing.assert_allclose(joined.time_s, 1.0 + SLOW)
    np.testing.assert_allclose(joined["position_m"], 2.0 * (joined.time_s - 1.0))
    np.testing.assert_allclose(joined["force_n"], 5.0 * (joined.time_s - 1.0))


def test_signals_of_one_axis_are_not_resampled(file: Path):
    only = load(file, ColumnMap({"position_m": Column("Weg")}))
    assert only.time_s.tolist() == SLOW.tolist()
    assert only.preparation.remarks == ("read somehow",)


def test_one_file_of_a_recording_may_have_several_axes(file: Path):
    (file.parent / "b.csv").write_text("time_s,velocity_m_s\n" + "".join(f"{k / 50},{k}\n" for k in range(100)))
    given = ColumnMap(MAP, {"a.foreign": None, "b.csv": None}, base="a.foreign")
    joined = load(file.parent, given)
    np.testing.assert_allclose(joined["velocity_m_s"], 50.0 * joined.time_s, atol=1e-9)
    np.testing.assert_allclose(joined["position_m"], 2.0 * joined.time_s)
    assert any("3 tables are joined at the times of a.foreign, t1 (1000 Hz)" in r for r in joined.preparation.remarks)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({**MAP, "time_s": Column(rate=1000.0)}, "time_s of the map is one axis, and the file has several (t1: 2000 rows, "),
        ({"force_n": Column("Notiz")}, "column 'Notiz' has no times in the file; expected time_s: {name: ...}"),
        ({"force_n": Column("Notiz"), "time_s": Column("t2")}, "force_n has 2000 values; expected 150, as time_s has"),
        ({"force_n": Column(expression="Kraft + Weg")}, "the columns of Kraft + Weg for force_n have different times (t1, t2)"),
        ({}, "no signal is among the columns t1, Kraft, t2, Weg, Notiz"),
    ],
)
def test_times_that_do_not_belong_together_are_bad_input(file: Path, given: dict[str, Column], complaint: str):
    with pytest.raises(BadInput) as caught:
        load(file, ColumnMap(given))
    assert complaint in str(caught.value)


@pytest.mark.parametrize("named", ["", "t2"])
def test_axes_with_the_same_times_are_one(file: Path, monkeypatch: pytest.MonkeyPatch, named: str):
    outlier = np.where(FAST == 1.0, 1e6, FAST)
    same = RawTable(
        ("t1", "Kraft", "t2", "Weg"), {"t1": FAST, "Kraft": FAST, "t2": FAST, "Weg": outlier}, time_of=TABLE.time_of
    )
    monkeypatch.setitem(loading.READERS, ".foreign", lambda path, pick=None: same)
    read = load(file, ColumnMap(MAP | ({"time_s": Column(named)} if named else {})))
    np.testing.assert_array_equal(read["position_m"], outlier)
    assert read.preparation.remarks == ()


def test_a_column_without_times_takes_those_that_the_map_names(file: Path):
    both = load(file, ColumnMap({"force_n": Column("Notiz"), "time_s": Column("t1", 1e-3)}))
    assert both.time_s.tolist() == pytest.approx(FAST.tolist())


def test_a_map_may_replace_axes_of_one_length_and_the_report_says_so(file: Path, monkeypatch: pytest.MonkeyPatch):
    late = RawTable(("t1", "Kraft", "t2", "Weg"), {**VALUES, "t2": FAST + 0.25, "Weg": FAST}, time_of=TABLE.time_of)
    monkeypatch.setitem(loading.READERS, ".foreign", lambda path, pick=None: late)
    given = load(file, ColumnMap({**MAP, "time_s": Column(rate=1000.0)}))
    assert given.time_s.tolist() == pytest.approx(FAST.tolist())
    assert given.preparation.remarks == (
        "time_s of the map replaces the times of the file (t1: 2000 rows, 0 to 1999, t2: 2000 rows, 0.25 to 2.249)",
    )


def test_the_rate_of_each_axis_is_shown_and_the_map_needs_no_time(file: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["columns", str(file), "--out", str(file.parent / "map.yaml")]) == 0
    shown = capsys.readouterr().err
    for said in (
        "a.foreign: 2000 rows, 2 time axes",
        "a.foreign: t1: 2000 rows, 1000 Hz, 0 to 1.999 s (Kraft)",
        "a.foreign: t2: 150 rows, 100 Hz, 0.3 to 1.79 s (Weg)",
        "columns that are certain: 2; to be checked: 1",
    ):
        assert said in shown
    assert "time_s is missing" not in shown
    assert set(load(file, read_columns(file.parent / "map.yaml")).signals) == {"force_n", "position_m"}


def test_the_map_of_several_files_leaves_the_times_to_a_file_that_has_them(file: Path):
    (file.parent / "b.csv").write_text("t [ms],v [m/s]\n" + "".join(f"{20 * k},{k}\n" for k in range(100)))
    text = proposed_map([*look(file), *look(file.parent / "b.csv")]).text
    assert '"a.foreign": null' in text
    (file.parent / "map.yaml").write_text(text)
    assert set(load(file, read_columns(file.parent / "map.yaml")).signals) == {"force_n", "position_m", "velocity_m_s"}
