"""TDMS files: waveforms with different starts and rates, groups with channels of times, and properties that were never set."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import load
from ehls_ros.recording.tdms_file import read_here
from ehls_ros.trajectory import Trajectory

nptdms: Any = pytest.importorskip("nptdms")

NOON = np.datetime64("2026-05-04T12:00:00", "us")
UNSET = np.datetime64("1904-01-01T00:00:00", "us")
BOTH = ColumnMap({"force_n": Column("Kraft"), "position_m": Column("Weg", 1e-3)})


def after(seconds: float) -> np.datetime64:
    return NOON + np.timedelta64(round(1e6 * seconds), "us")


def waveform(rate: float, start: np.datetime64 | None = NOON, **more: Any) -> dict[str, Any]:
    return {"wf_increment": 1.0 / rate, **({} if start is None else {"wf_start_time": start}), **more}


def file(path: Path, *channels: tuple[str, str, Any, dict[str, Any]]) -> Path:
    """Write channels: group, name, values and properties."""
    with nptdms.TdmsWriter(path / "a.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject(group, name, np.asarray(v), p) for group, name, v, p in channels])
    return path / "a.tdms"


def read(path: Path, given: ColumnMap = BOTH) -> Trajectory:
    """Read a file in this process, which takes less time."""
    load_here = pytest.MonkeyPatch()
    with load_here.context() as patch:
        patch.setitem(load.__globals__, "READERS", {".tdms": read_here})
        return load(path, given)


def ramp(rate: float, count: int, start: float = 0.0) -> np.ndarray:
    return start + np.arange(count) / rate


@pytest.mark.parametrize(
    "late",
    [
        waveform(1000.0, after(0.25)),
        waveform(1000.0, wf_start_offset=0.25),
        waveform(1000.0, after(-0.5), wf_start_offset=0.75),
    ],
)
def test_signals_in_phase_stay_so_whatever_the_start_of_each(tmp_path: Path, late: dict[str, Any]):
    path = file(
        tmp_path, ("G", "Kraft", ramp(1000.0, 2000), waveform(1000.0)), ("G", "Weg", 1e3 * ramp(1000.0, 2000, 0.25), late)
    )
    joined = read(path)
    np.testing.assert_allclose(joined["force_n"], joined["position_m"], atol=1e-12)
    assert len(joined) == 1750
    named = read(path, ColumnMap({**BOTH.columns, "time_s": Column("time")}))
    np.testing.assert_allclose(named["force_n"], named["position_m"], atol=1e-12)


def test_two_rates_are_two_axes(tmp_path: Path):
    path = file(
        tmp_path, ("G", "Kraft", ramp(1000.0, 5000), waveform(1000.0)), ("G", "Weg", 1e3 * ramp(100.0, 500), waveform(100.0))
    )
    table = read_here(path, None)
    assert table.time_of == {"Kraft": "time", "Weg": "time 2"}
    assert table.remarks == ("time, time 2 are counted from the channels' wf_start_time, wf_start_offset and wf_increment",)
    joined = read(path)
    np.testing.assert_allclose(joined["force_n"], joined["position_m"], atol=1e-9)


def test_starts_that_differ_by_less_than_a_thousandth_of_a_sample_are_one_axis(tmp_path: Path):
    late = waveform(100.0, NOON + np.timedelta64(5, "us"))
    path = file(tmp_path, ("G", "Kraft", ramp(100.0, 50), waveform(100.0)), ("H", "Weg", ramp(100.0, 50), late))
    assert set(read_here(path, None).time_of.values()) == {"time"}
    assert not any("joined" in remark for remark in read(path).preparation.remarks)


@pytest.mark.parametrize("start", [None, UNSET])
def test_without_a_start_the_waveforms_begin_together(tmp_path: Path, start: np.datetime64 | None):
    path = file(
        tmp_path,
        ("G", "Kraft", ramp(100.0, 50), waveform(100.0, start)),
        ("G", "Weg", 1e3 * ramp(100.0, 30, 0.1), waveform(100.0, start, wf_start_offset=0.1)),
    )
    joined = read(path)
    np.testing.assert_allclose(joined["force_n"], joined["position_m"], atol=1e-9)


@pytest.mark.parametrize("start", [None, UNSET])
def test_a_waveform_without_a_start_begins_with_its_group_or_has_no_times(tmp_path: Path, start: np.datetime64 | None):
    kraft, weg = ("G", "Kraft", ramp(100.0, 50), waveform(100.0)), ("G", "Weg", ramp(100.0, 50), waveform(100.0, start))
    assert (
        "Weg has no wf_start_time and is taken to begin with its group" in read(file(tmp_path, kraft, weg)).preparation.remarks
    )
    path = file(tmp_path, kraft, ("H", *weg[1:]))
    with pytest.raises(BadInput, match="column 'Weg' has no times in the file; expected time_s"):
        read(path)
    replaced = read(path, ColumnMap({**BOTH.columns, "time_s": Column(rate=100.0)}))
    assert len(replaced) == 50


def test_a_channel_that_is_no_waveform_takes_the_times_that_the_map_names(tmp_path: Path):
    path = file(
        tmp_path,
        ("G", "Kraft", ramp(100.0, 50), waveform(100.0)),
        ("G", "Weg", ramp(100.0, 50), {}),
        ("G", "Summe", [3.5], {}),
    )
    assert read_here(path, None).time_of == {"Kraft": "time"}
    with pytest.raises(BadInput, match="column 'Weg' has no times in the file"):
        read(path)
    assert len(read(path, ColumnMap({**BOTH.columns, "time_s": Column("time")}))) == 50


def test_each_group_may_have_a_channel_of_times(tmp_path: Path):
    path = file(
        tmp_path,
        ("fast", "Zeit", 1e3 * ramp(100.0, 200), {"unit_string": "ms"}),
        ("fast", "Kraft", ramp(100.0, 200), {"wf_increment": 1.0}),
        ("slow", "Zeit", ramp(20.0, 30, 0.5), {"unit_string": "s"}),
        ("slow", "Weg", 1e3 * ramp(20.0, 30, 0.5), {}),
        ("slow", "Summe", [3.5], {}),
    )
    table = read_here(path, None)
    assert table.time_of == {"Kraft": "fast/Zeit", "Weg": "slow/Zeit"}
    assert table.remarks == ("Kraft: times of their group, not wf_increment",)
    joined = read(path)
    np.testing.assert_allclose(joined["force_n"], joined["position_m"], atol=1e-9)


def test_times_of_groups_without_a_unit_are_seconds_unless_the_map_states_another(tmp_path: Path):
    path = file(
        tmp_path,
        ("fast", "Time", 1e3 * ramp(100.0, 200), {}),
        ("fast", "Kraft", ramp(100.0, 200), {}),
        ("slow", "Time", 1e3 * ramp(20.0, 30, 0.5), {}),
        ("slow", "Weg", 1e3 * ramp(20.0, 30, 0.5), {}),
        ("none", "Uhrzeit", np.array([], dtype="datetime64[us]"), {}),
    )
    taken = "fast/Time, slow/Time: taken as times in s; time_s in the map, with the name of one and its unit, states another"
    assert read_here(path, None).remarks == (taken,)
    assert read(path).time_s[-1] == pytest.approx(1950.0)
    joined = read(path, ColumnMap({**BOTH.columns, "time_s": Column("fast/Time", unit="ms")}))
    np.testing.assert_allclose(joined["force_n"], joined.time_s, atol=1e-9)
    np.testing.assert_allclose(joined["position_m"], joined.time_s, atol=1e-9)


def test_dates_and_starts_are_on_one_clock_over_midnight(tmp_path: Path):
    evening, night = np.datetime64("2026-05-04T23:59:59", "us"), np.datetime64("2026-05-05T00:00:00", "us")
    steps = np.arange(200) * np.timedelta64(10_000, "us")
    path = file(
        tmp_path,
        ("a", "Kraft", ramp(100.0, 300), waveform(100.0, evening)),
        ("b", "Uhrzeit", night + steps, {}),
        ("b", "Weg", 1e3 * ramp(100.0, 200, 1.0), {}),
    )
    joined = read(path)
    np.testing.assert_allclose(joined["force_n"], joined["position_m"], atol=1e-6)
    assert joined.time_s[0] == pytest.approx(86400.0)


@pytest.mark.parametrize(
    "properties",
    [
        {"wf_increment": 0.0},
        {"wf_increment": -0.001},
        {"wf_increment": np.nan},
        {"wf_increment": 0.5, "wf_xunit_string": "Hz"},  # a spectrum
        {"wf_increment": 1.0, "wf_start_time": UNSET},  # as LabVIEW writes them for an array that is no waveform
    ],
)
def test_a_period_that_is_none_gives_no_times(tmp_path: Path, properties: dict[str, Any]):
    path = file(tmp_path, ("G", "Kraft", [1.0, 2.0], properties))
    with pytest.raises(BadInput, match=r"column time_s is missing \(found: Kraft\)"):
        read(path, ColumnMap({"force_n": Column("Kraft")}))


def test_properties_that_were_never_set_are_named(tmp_path: Path):
    path = file(tmp_path, ("G", "Kraft", [1.0, 2.0], {"wf_increment": 1.0, "wf_start_time": UNSET}))
    read = read_here(path, None)
    assert read.remarks == ("Kraft: wf_increment of 1 s and wf_start_time were never set and are not used",)


def test_a_period_may_be_in_another_unit_of_time(tmp_path: Path):
    path = file(tmp_path, ("G", "Kraft", [1.0, 2.0], {"wf_increment": 10.0, "wf_start_offset": 5.0, "wf_xunit_string": "ms"}))
    assert read(path, ColumnMap({"force_n": Column("Kraft")})).time_s.tolist() == pytest.approx([0.005, 0.015])


def test_starts_of_different_days_are_refused_with_both_ranges(tmp_path: Path):
    path = file(
        tmp_path,
        ("G", "Kraft", ramp(100.0, 50), waveform(100.0)),
        ("G", "Weg", ramp(100.0, 50), waveform(100.0, NOON + np.timedelta64(1, "D"))),
    )
    with pytest.raises(BadInput, match=r"the tables hardly overlap \(time 0 to 0.49 s, time 2 86400 to 86400.5 s\).*rate: ..."):
        read(path)
