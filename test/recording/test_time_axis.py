"""The time axis of any reader: repaired where the repair is certain, otherwise refused in one line."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import load
from ehls_ros.recording.proposal import look
from ehls_ros.recording.time_axis import MISFIT, TimeAxis, time_axis

UNIX = 1.764e9
EVEN = 0.002 * np.arange(400)


def axis(times: np.ndarray, written: np.ndarray | None = None) -> TimeAxis:
    return time_axis(np.asarray(times, dtype=np.float64), "run.csv", lambda row: f"line {row + 2}", written)


def digits(times: np.ndarray, count: int) -> np.ndarray:
    return np.array([float(f"{t:.{count}g}") for t in times])


def with_values(times: np.ndarray, **rows: float) -> np.ndarray:
    out = np.array(times)
    for row, value in rows.items():
        out[int(row.removeprefix("r"))] = value
    return out


ROUNDED = {
    # As a logger that prints five significant digits: from 100 s on, a row in six repeats the time before.
    "five significant digits": (digits(np.arange(10_000, 16_000) / 128.98, 5), 128.98, 0.005),
    "milliseconds": (np.round(np.arange(5000) / 1024, 3), 1024.0, 0.0005),
    "cut off, not rounded": (np.floor(np.arange(200_000) / 1000.0), 1000.0, 0.5),
    "single precision": (np.float32(50_000.0 + 0.001 * np.arange(20_000)), 1000.0, 0.002),
    "with a gap": (np.round(np.arange(5000) / 1024 + 7.5 * (np.arange(5000) >= 2000), 3), 1024.0, 0.0005),
    "without a repeated time": (np.round(np.arange(500) / 120.0, 3), 120.0, 0.0005),
}


@pytest.mark.parametrize("name", ROUNDED)
def test_rounded_times_are_put_back_on_their_even_grid(name: str):
    times, rate, half = ROUNDED[name]
    found = axis(times)
    assert found.rate == pytest.approx(rate, rel=1e-4)
    assert np.max(np.abs(found.time - times)) <= MISFIT * half
    assert np.all(np.diff(found.time) > 0.0)
    assert "even grid" in found.remarks[0]
    assert (len(found.remarks) == 2) == (name == "with a gap")


def test_the_rounding_is_that_of_the_unit_in_the_file():
    minutes = np.round(np.arange(3000) / 60.0 / 100.0, 3)
    assert axis(60.0 * minutes, minutes).rate == pytest.approx(100.0)


@pytest.mark.parametrize("times", [EVEN, np.cumsum(np.random.default_rng(0).exponential(0.01, 400)), [0.0, 1.0, 3.0], [5.0]])
def test_an_increasing_axis_is_kept_to_the_bit(times: np.ndarray):
    found = axis(times)
    assert found.time.tolist() == np.asarray(times).tolist()
    assert (found.rows, found.remarks) == (None, ())


def test_few_repeated_times_are_placed_where_the_even_steps_have_a_place():
    held, late = with_values(EVEN, r200=EVEN[199]), with_values(EVEN, r199=EVEN[200])
    for times, line in ((held, 202), (late, 201)):
        found = axis(times)
        np.testing.assert_allclose(found.time, EVEN, atol=1e-12)
        assert found.rows is None
        assert f"line {line} has a repeated time" in found.remarks[0]


def test_a_row_written_twice_is_left_out():
    found = axis(np.insert(EVEN, 200, EVEN[200]))
    assert found.time.tolist() == EVEN.tolist()
    assert 201 not in found.rows
    assert found.remarks == ("line 203 repeats the time before (0.4 s) and is left out",)


def test_a_gap_is_described():
    times = EVEN + 12.5 * (np.arange(400) >= 100)
    found = axis(times)
    assert found.time.tolist() == times.tolist()
    assert found.remarks == ("time_s has a gap before line 102, from 0.198 to 12.7 s (12.502 s)",)
    assert found.unevenness < 1e-9


def test_gaps_between_short_blocks_are_no_unevenness():
    found = axis([block + 0.002 * row for block in (10.0, 30.0, 50.0) for row in range(3)])
    assert found.remarks == ("time_s has 2 gaps, the longest before line 5, from 10.004 to 30.0 s (19.996 s)",)
    assert (found.rate, found.unevenness) == (pytest.approx(500.0), pytest.approx(0.0, abs=1e-9))


REFUSED = {
    "many repeats": (np.round(np.cumsum(np.random.default_rng(0).exponential(0.01, 400)), 2), ("repeat the time before",)),
    "first stamp zero": (with_values(UNIX + EVEN, r0=0.0), ("line 2: time_s is 0.0; the others have 1764000000.002 to",)),
    "a zero in the middle": (with_values(UNIX + EVEN, r77=0.0), ("line 79: time_s is 0.0; the others have 1764000000.0",)),
    "several zeros": (
        with_values(UNIX + EVEN, r0=0.0, r1=0.0, r2=0.0),
        ("line 2: time_s is 0.0; the others have 1764000000.006", "and 2 more rows are astray"),
    ),
    "zeros here and there": (
        with_values(UNIX + EVEN, r7=0.0, r300=0.0),
        ("line 9: time_s is 0.0; the others have 1764000000.0",),
    ),
    "zero before a clock since boot": (with_values(5e4 + EVEN, r0=0.0), ("line 2: time_s is 0.0; the others have 50000.002",)),
    "a stamp in the future": (with_values(EVEN, r300=5e9), ("line 302: time_s is 5000000000.0; the others have 0.0 to 0.798",)),
    "two rows are enough": (np.array([0.0, UNIX, UNIX + 0.002]), ("line 2: time_s is 0.0",)),
    "time synchronised on the way": (EVEN + UNIX * (np.arange(400) >= 150), ("line 152: time_s jumps from 0.298", "days")),
    "a gap of days": (
        EVEN + 3e5 * (np.arange(400) >= 200),
        ("line 202: time_s jumps from 0.398 to 300000.4, by 3.47222 days",),
    ),
    "more samples than fit": (1e-4 * np.arange(400) + 5e3 * (np.arange(400) >= 200), ("its 400 rows extend over 5e+07",)),
    "clock set back": (EVEN - 0.1013 * (np.arange(400) >= 200), ("line 202: time_s is 0.2987 after 0.398", "back by 0.1013 s")),
    "runs one after another": (np.tile(EVEN, 3), ("the clock is set back by 0.8 s in 2 rows", "time_s: {rate: 500}")),
    "one time out of order": (with_values(EVEN, r7=0.001), ("line 9: time_s is 0.001 after 0.012 and before 0.016",)),
    "one time ahead": (with_values(EVEN, r7=3600.014), ("line 9: time_s is 3600.014 after 0.012 and before 0.016",)),
    "a missing time": (with_values(EVEN, r7=np.nan), ("line 9: time_s is nan",)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_any_other_axis_is_refused_with_row_time_and_remedy(name: str):
    times, said = REFUSED[name]
    with pytest.raises(BadInput) as caught:
        axis(times)
    message = str(caught.value)
    assert message.startswith("run.csv, line ")
    assert all(part in message for part in (*said, "; expected ")), message
    assert "\n" not in message


def test_a_stray_stamp_costs_no_memory_and_is_named_by_every_way_in(tmp_path: Path):
    path = tmp_path / "data.csv"
    path.write_text("time_s,force_n\n0,1\n" + "".join(f"{UNIX + t:.4f},1\n" for t in EVEN[1:]))
    tracemalloc.start()
    with pytest.raises(BadInput, match=r"data\.csv, line 2: time_s is 0\.0; the others have 1764000000\.002 to"):
        load(path)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    [table] = look(path)
    assert table.rate == pytest.approx(500.0, rel=1e-3)
    assert any("line 2: time_s is 0.0" in remark for remark in table.remarks)


def test_signals_lose_the_row_that_the_axis_loses(tmp_path: Path):
    path = tmp_path / "data.csv"
    rows = [f"{t:.3f},{k}" for k, t in enumerate(EVEN)]
    path.write_text("\n".join(["t,F", *rows[:200], "0.398,777", *rows[200:]]) + "\n")
    found = load(path, ColumnMap({"time_s": Column("t"), "force_n": Column("F")}))
    assert found["force_n"].tolist() == list(range(400))
    assert found.preparation.remarks == ("line 202 repeats the time before (0.398 s) and is left out",)


def test_rows_written_twice_are_left_out(tmp_path: Path):
    path = tmp_path / "data.csv"
    path.write_text("time_s,force_n\n" + "".join(2 * f"{t:.3f},{k}\n" for k, t in enumerate(EVEN)))
    found = load(path)
    assert found.time_s.tolist() == pytest.approx(EVEN.tolist())
    assert found["force_n"].tolist() == list(range(400))
    assert found.preparation.remarks == ("400 rows that repeat the row before are left out",)
