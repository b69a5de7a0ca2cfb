"""ASAM MDF files: groups with their own times, units, conversions, and samples marked as invalid."""

import datetime as dt
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.extras import install_command
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import READERS, load, raw

FAST, SLOW = np.arange(200) / 100.0, 0.05 + np.arange(30) / 20.0
START = dt.datetime(2026, 5, 4, 12, 0, tzinfo=dt.UTC)


@pytest.fixture(scope="module")
def asammdf() -> Any:
    return pytest.importorskip("asammdf", reason="asammdf is not installed, which reads MDF files")


@pytest.fixture
def in_this_process(asammdf: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read in this process, which takes less time."""
    from ehls_ros.recording import load as loading
    from ehls_ros.recording.mdf_file import read_here

    monkeypatch.setattr(loading, "read_mdf", read_here)
    for suffix in (".mf4", ".mdf"):
        monkeypatch.setitem(READERS, suffix, read_here)


def saved(path: Path, version: str, *groups: list[Any]) -> Path:
    """Write groups of signals."""
    from asammdf import MDF

    with MDF(version=version) as file:
        file.header.start_time = START
        for group in groups:
            file.append(group)
        return Path(file.save(path, overwrite=True))


def signal(name: str, values: Any, times: Any, unit: str = "", **more: Any) -> Any:
    from asammdf import Signal
    from asammdf.blocks.conversion_utils import from_dict

    conversion = from_dict(more.pop("conversion")) if "conversion" in more else None
    return Signal(np.asarray(values), np.asarray(times), name=name, unit=unit, conversion=conversion, **more)


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("version", ["3.30", "4.10", "4.20"])
def test_each_group_has_its_own_times(tmp_path: Path, version: str):
    fast = [
        signal("Weg", 2e3 * FAST, FAST, "mm"),
        signal("Kraft", np.round(100.0 * FAST).astype(np.int16), FAST, "kN", conversion={"a": 0.5, "b": 1.0}),
    ]
    slow = [signal("Druck", 5.0 * SLOW, SLOW, "bar"), signal("Weg", 7.0 * SLOW, SLOW, "m")]
    path = saved(tmp_path / ("a.mdf" if version < "4" else "a.mf4"), version, fast, slow)
    table = raw(path)
    assert table.names == ("group 1/Weg", "Kraft", "Druck", "group 2/Weg", "time", "time 2")
    assert table.units == {"group 1/Weg": "mm", "Kraft": "kN", "Druck": "bar", "group 2/Weg": "m", "time": "s", "time 2": "s"}
    assert table.remarks == ("time, time 2: counted from 2026-05-04T12:00:00+00:00",)
    given = {
        "position_m": Column("group 1/Weg", unit="mm"),
        "load_pressure_pa": Column("Druck", unit="bar"),
        "force_n": Column("Kraft"),
    }
    joined = load(path, ColumnMap(given))
    np.testing.assert_allclose(joined["position_m"], 2.0 * joined.time_s, atol=1e-9)
    np.testing.assert_allclose(joined["load_pressure_pa"], 5e5 * joined.time_s, atol=1e-3)
    np.testing.assert_allclose(joined["force_n"], 1.0 + 50.0 * joined.time_s, atol=1e-9)


@pytest.mark.usefixtures("in_this_process")
def test_invalid_samples_are_missing_and_text_is_not_numeric(tmp_path: Path):
    invalid = np.zeros(200, dtype=np.bool_)
    invalid[3] = True
    states = {"val_0": 0, "text_0": "off", "val_1": 1, "text_1": "on", "default": "?"}
    path = saved(
        tmp_path / "a.mf4",
        "4.10",
        [
            signal("Kraft", 5.0 * FAST, FAST, invalidation_bits=invalid),
            signal("state", np.ones(200, dtype=np.uint8), FAST, conversion=states),
        ],
    )
    read = load(path, ColumnMap({"force_n": Column("Kraft")}))
    assert np.flatnonzero(np.isnan(read["force_n"])).tolist() == [3]
    assert raw(path).values["state"] is None
    with pytest.raises(BadInput, match=r"column 'state' for force_n is not numeric \(text, or a record"):
        load(path, ColumnMap({"force_n": Column("state")}))


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("formula", "accepted"), [("2.0 * X + 1e-1", True), ("sin(X)", True), ("X.real", False), ("__import__('os')", False)]
)
def test_a_formula_is_arithmetic(tmp_path: Path, formula: str, accepted: bool):
    path = saved(tmp_path / "a.mf4", "4.10", [signal("Kraft", FAST, FAST, conversion={"formula": formula})])
    if accepted:
        assert len(load(path, ColumnMap({"force_n": Column("Kraft")}))) == 200
        return
    with pytest.raises(BadInput, match=r"column 'Kraft' has the formula .* expected arithmetic of X"):
        load(path, ColumnMap({"force_n": Column("Kraft")}))


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("suffix", [".mf4", ".dat"])
def test_the_suffix_of_a_text_file_does_not_matter(tmp_path: Path, suffix: str):
    path = saved(tmp_path / "a.mdf", "3.30", [signal("Kraft", FAST, FAST)]).rename(tmp_path / f"a{suffix}")
    assert len(load(path, ColumnMap({"force_n": Column("Kraft")}))) == 200


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "it does not begin with MDF"),
        (b"nothing of the kind", "it does not begin with MDF"),
    ],
)
def test_a_file_of_another_kind_is_bad_input(tmp_path: Path, content: bytes, complaint: str):
    (tmp_path / "a.mf4").write_bytes(content)
    with pytest.raises(BadInput, match=complaint):
        load(tmp_path / "a.mf4")


@pytest.mark.usefixtures("asammdf")
def test_the_separate_process_reads_and_refuses_the_same(tmp_path: Path):
    path = saved(tmp_path / "a.mf4", "4.10", [signal("Kraft", FAST, FAST)])
    assert load(path, ColumnMap({"force_n": Column("Kraft")}))["force_n"].tolist() == FAST.tolist()
    path.write_bytes(path.read_bytes()[:64].ljust(200, b"\xff"))
    with pytest.raises(BadInput, match="it is not an MDF file"):
        load(path)


def test_without_the_library_its_command_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(BadInput) as caught:
        load(tmp_path / "a.mf4")
    assert "asammdf is not installed" in str(caught.value)
    assert f"`{install_command('files')}`, or the data as CSV" in str(caught.value)
