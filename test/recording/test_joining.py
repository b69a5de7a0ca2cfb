"""Tables of one recording, each with a different rate and clock, on one time axis."""

from pathlib import Path

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap, read_columns
from ehls_ros.recording.joining import centred_mean, held_mean, join
from ehls_ros.recording.load import load, recordings
from ehls_ros.trajectory import Trajectory

FREQUENCY = 7.0


def sine(t):
    return np.sin(2.0 * np.pi * FREQUENCY * t)


def table(rate, duration=4.0, start=0.0, **signals):
    t = start + np.arange(round(duration * rate)) / rate
    return Trajectory(t, {name: of(t) for name, of in signals.items()})


def lag(t, values):
    """Return the delay of a sine [s]."""
    angle = 2.0 * np.pi * FREQUENCY * t
    (into, across), *_ = np.linalg.lstsq(np.column_stack([np.sin(angle), np.cos(angle)]), values, rcond=None)
    return -np.arctan2(across, into) / (2.0 * np.pi * FREQUENCY)


@pytest.mark.parametrize(("fast", "base"), [(1000.0, "slow"), (1000.0, "fast"), (9700.0, "slow"), (9700.0, "")])
def test_a_sine_keeps_its_phase_to_a_hundredth_of_the_fast_sample(fast, base):
    # The slow clock drifts through the fast one's sample intervals.
    tables = {"fast": table(fast, force_n=sine), "slow": table(437.0, start=0.00137, position_m=sine)}
    joined = join(tables, base, "it")
    for name in ("force_n", "position_m"):
        inner = slice(5, -5)
        assert abs(lag(joined.time_s[inner], joined[name][inner])) < 0.01 / fast, name
        np.testing.assert_allclose(joined[name][inner], sine(joined.time_s[inner]), atol=2e-3)


def test_times_of_their_own_need_not_be_even():
    rng = np.random.default_rng(0)
    uneven = np.sort(rng.uniform(0.0, 4.0, 20_000))
    tables = {"fast": Trajectory(uneven, {"force_n": sine(uneven)}), "slow": table(200.0, position_m=sine)}
    joined = join(tables, "slow", "it")
    # Averaged over 5 ms, a sine of 7 Hz loses 0.2 % and nothing else.
    expected = np.sinc(FREQUENCY / 200.0) * sine(joined.time_s)
    # Between times drawn at random, 0.2 ms apart on average, straight lines cut some corners.
    np.testing.assert_allclose(joined["force_n"][5:-5], expected[5:-5], atol=5e-4)
    assert abs(lag(joined.time_s[5:-5], joined["force_n"][5:-5])) < 2e-6


def test_averaging_lowers_noise_and_interpolation_keeps_account_of_it():
    rng = np.random.default_rng(1)

    def noisy(t):
        return 0.01 * rng.standard_normal(len(t))

    joined = join({"a": table(1000.0, force_n=noisy), "b": table(100.0, position_m=noisy)}, "b", "it")
    assert np.std(joined["force_n"]) == pytest.approx(0.01 / np.sqrt(10.0), rel=0.15)
    joined = join({"a": table(1000.0, force_n=noisy), "b": table(100.0, position_m=noisy)}, "a", "it")
    own = joined.preparation.interpolated
    assert set(own) == {"position_m"}
    assert own["position_m"].period == pytest.approx(0.01)
    assert own["position_m"].noise == pytest.approx(0.01, rel=0.15)


def test_a_held_command_is_never_between_its_values_on_a_faster_clock():
    def steps(t):
        return np.floor(t * 10.0) % 3

    joined = join({"a": table(1000.0, force_n=sine), "b": table(100.0, valve_command_m=steps)}, "a", "it")
    assert set(np.unique(joined["valve_command_m"])) == {0.0, 1.0, 2.0}
    np.testing.assert_array_equal(joined["valve_command_m"], steps(np.floor(joined.time_s * 100.0 + 1e-6) / 100.0 + 1e-9))


def test_a_gap_stays_one_and_an_outlier_does_not_spread():
    slow = table(100.0, position_m=sine)
    values = slow["position_m"].copy()
    values[100:150] = np.nan
    values[300] += 50.0
    joined = join({"a": table(1000.0, force_n=sine), "b": Trajectory(slow.time_s, {"position_m": values})}, "a", "it")
    known = np.isfinite(joined["position_m"])
    assert not known[1000:1490].any()
    assert known[:990].all()
    assert known[1510:].sum() > 0.98 * len(known[1510:-15])
    np.testing.assert_allclose(joined["position_m"][known], sine(joined.time_s[known]), atol=0.05)


def test_means_of_straight_lines_are_exact():
    t = np.array([0.0, 1.0, 4.0, 6.0])
    line = 3.0 * t - 2.0
    np.testing.assert_allclose(centred_mean(t, line, np.array([1.5, 3.0]), 2.0), [2.5, 7.0])
    held = np.array([1.0, 5.0, 2.0, 0.0])
    # Half a second of 1 and a second and a half of 5; one second of 5 and one of 2.
    np.testing.assert_allclose(held_mean(t, held, np.array([0.5, 3.0]), 2.0), [4.0, 3.5])


@pytest.mark.parametrize(
    ("tables", "complaint"),
    [
        ({"a": table(100.0, force_n=sine), "b": table(50.0, force_n=sine)}, "force_n is in b and in another table"),
        ({"a": table(100.0, force_n=sine), "b": table(50.0, start=1e6, position_m=sine)}, "the tables hardly overlap"),
        ({"a": table(100.0, force_n=sine), "b": table(0.5, position_m=sine)}, "it has 2 samples"),
    ],
)
def test_tables_that_are_not_one_recording_are_bad_input(tables, complaint):
    with pytest.raises(BadInput, match=complaint):
        join(tables, "", "it")


# --- from files --------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    fast, slow = np.arange(2000), np.arange(200)
    (tmp_path / "fast.csv").write_text("t [ms],F\n" + "".join(f"{k},{2 * k}\n" for k in fast))
    (tmp_path / "slow.csv").write_text("Zeit,x,F\n" + "".join(f"{k / 100 + 5},{k},7\n" for k in slow))
    return tmp_path


MAP = """tables: {fast.csv: {name: "t [ms]", unit: ms}, slow.csv: {name: Zeit, offset: -5.0}}
force_n: {name: F, table: fast.csv}
position_m: {name: x, scale: 0.001}
"""


def test_files_are_joined_by_the_map(folder: Path):
    (folder / "columns.yaml").write_text(MAP)
    given = read_columns(folder / "columns.yaml")
    for path in (folder, folder / "fast.csv", folder / "slow.csv"):
        joined = load(path, given)
        np.testing.assert_allclose(joined["force_n"], 2e3 * joined.time_s, atol=1e-9)
        np.testing.assert_allclose(joined["position_m"], 0.1 * joined.time_s, atol=1e-9)
        assert any("interpolated from 100 Hz" in remark for remark in joined.preparation.remarks)
    assert recordings([folder / "fast.csv", folder / "slow.csv"], given) == [folder / "fast.csv"]
    assert recordings([folder / "fast.csv", folder / "slow.csv"], None) == [folder / "fast.csv", folder / "slow.csv"]


def test_a_folder_of_tables_with_our_names_needs_no_map(tmp_path: Path):
    (tmp_path / "a.csv").write_text("time_s,force_n\n" + "".join(f"{k / 1000},{k}\n" for k in range(1000)))
    (tmp_path / "b.csv").write_text("time_s,position_m\n" + "".join(f"{k / 10},{k}\n" for k in range(10)))
    joined = load(tmp_path)
    assert set(joined.signals) == {"force_n", "position_m"}
    np.testing.assert_allclose(joined["position_m"], 10.0 * joined.time_s, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ((", table: fast.csv", ""), "column 'F' for force_n is in fast.csv and slow.csv; expected 'table: fast.csv'"),
        (("name: x", "name: y"), "column 'y' for position_m is in no table"),
        (("slow.csv: {", "other.csv: {"), "other.csv"),
    ],
)
def test_an_incomplete_map_of_tables_is_bad_input(folder: Path, change: tuple[str, str], complaint: str):
    (folder / "columns.yaml").write_text(MAP.replace(*change))
    with pytest.raises(BadInput, match=complaint):
        load(folder, read_columns(folder / "columns.yaml"))


def test_a_file_outside_the_map_is_bad_input(folder: Path):
    given = ColumnMap({"force_n": Column("F")}, {"fast.csv": None, "slow.csv": None})
    with pytest.raises(BadInput, match="it is not among the tables of the map"):
        load(folder / "third.csv", given)
    with pytest.raises(BadInput, match="these are not the tables of one recording"):
        recordings([folder / "fast.csv", folder / "third.csv"], given)


@pytest.mark.parametrize("late", [-1e-5, 1e-5])
def test_a_command_whose_stamp_is_off_by_a_fraction_of_a_sample_is_that_of_its_cycle(late):
    command = table(1000.0, start=late, valve_command_m=lambda t: np.round(1000.0 * t))
    joined = join({"fast": table(1000.0, force_n=sine), "command": command}, "fast", "it")
    np.testing.assert_array_equal(joined["valve_command_m"][1:-1], np.round(1000.0 * joined.time_s)[1:-1])
