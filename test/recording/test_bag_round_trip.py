from pathlib import Path

import numpy as np
import pytest
from recorded_runs import METADATA, make_trajectory, same, storage_file

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_topic import BLOCK
from ehls_ros.recording.bag_writer import Storage, write_trajectory
from ehls_ros.trajectory import Trajectory

STORAGES: list[Storage] = ["mcap", "sqlite3"]


def changed(trajectory: Trajectory, **signals: np.ndarray) -> Trajectory:
    """Return the trajectory with some signals replaced."""
    return Trajectory(trajectory.time_s, {**trajectory.signals, **signals}, trajectory.metadata)


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("samples", [1, 2, 300])
def test_a_trajectory_comes_back_to_the_last_bit(tmp_path: Path, storage: Storage, samples: int):
    trajectory = make_trajectory(samples)
    write_trajectory(tmp_path / "bag", trajectory, storage)
    assert same(read_bag(tmp_path / "bag"), trajectory)


@pytest.mark.parametrize("storage", STORAGES)
def test_the_storage_file_alone_is_enough(tmp_path: Path, storage: Storage):
    trajectory = make_trajectory()
    write_trajectory(tmp_path / "bag", trajectory, storage)
    alone = storage_file(tmp_path / "bag").rename(tmp_path / f"alone{storage_file(tmp_path / 'bag').suffix}")
    assert same(read_bag(alone), trajectory)


@pytest.mark.long
def test_a_long_bag_is_put_together_from_blocks(tmp_path: Path):
    trajectory = make_trajectory(BLOCK + 5)
    elements, slipping = trajectory["friction_elements_n"].copy(), trajectory["friction_slipping"].copy()
    elements[:BLOCK], slipping[:BLOCK] = np.nan, np.nan
    only_late = changed(trajectory, friction_elements_n=elements, friction_slipping=slipping)
    only_late.signals["friction_gms_n"][:BLOCK] = np.nan
    only_late.signals["friction_viscous_n"][:BLOCK] = np.nan
    write_trajectory(tmp_path / "bag", only_late)
    assert same(read_bag(tmp_path / "bag"), only_late)


def test_cycles_without_a_message_are_nan(tmp_path: Path):
    trajectory = make_trajectory()
    for name in ("valve_command_m", "response_s", "disturbance_force_n"):
        trajectory[name][[0, 7, 19]] = np.nan
    for name in ("friction_gms_n", "friction_viscous_n", "friction_elements_n", "friction_slipping"):
        trajectory[name][3:9] = np.nan
    write_trajectory(tmp_path / "bag", trajectory)
    assert same(read_bag(tmp_path / "bag"), trajectory)


@pytest.mark.parametrize("storage", STORAGES)
def test_answers_that_overtake_each_other_stay_with_their_cycles(tmp_path: Path, storage: Storage):
    trajectory = make_trajectory()
    trajectory["response_s"][:] = np.arange(20, 0, -1) * 3 / 1e3
    write_trajectory(tmp_path / "bag", trajectory, storage)
    assert same(read_bag(tmp_path / "bag"), trajectory)


def test_extreme_values_come_back(tmp_path: Path):
    trajectory = make_trajectory(6)
    trajectory["force_n"][:] = [0.0, -0.0, np.inf, -np.inf, 5e-324, 1.7976931348623157e308]
    write_trajectory(tmp_path / "bag", trajectory)
    assert same(read_bag(tmp_path / "bag"), trajectory)


@pytest.mark.parametrize(
    "names",
    [
        [],
        ["force_n"],
        ["e3_pa"],
        ["valve_command_m", "position_m"],
        ["position_m", "position_reference_m", "position_reference_rate_m_s", "position_reference_acceleration_m_s2"],
        ["friction_gms_n"],
        ["valve_command_m", "response_s"],
    ],
    ids=", ".join,
)
def test_absent_signals_stay_absent(tmp_path: Path, names: list[str]):
    whole = make_trajectory()
    part = Trajectory(whole.time_s, {name: whole[name] for name in whole.signals if name in names})
    write_trajectory(tmp_path / "bag", part)
    assert same(read_bag(tmp_path / "bag"), part)


def test_a_run_that_starts_late_keeps_its_times(tmp_path: Path):
    trajectory = make_trajectory(start_s=3.25)
    write_trajectory(tmp_path / "bag", trajectory)
    assert read_bag(tmp_path / "bag").time_s[0] == 3.25


@pytest.mark.parametrize("rate_hz", [100, 1000, 3000])
def test_times_are_kept_to_half_a_nanosecond(tmp_path: Path, rate_hz: int):
    time_s = np.arange(500) / rate_hz
    write_trajectory(tmp_path / "bag", Trajectory(time_s, {"force_n": time_s}))
    np.testing.assert_allclose(read_bag(tmp_path / "bag").time_s, time_s, rtol=0, atol=0.51e-9)


def test_numpy_values_in_metadata_become_plain_ones(tmp_path: Path):
    metadata = {**METADATA, "weights": np.array([0.25, 0.75]), "seed": np.int64(3)}
    trajectory = make_trajectory(2)
    write_trajectory(tmp_path / "bag", Trajectory(trajectory.time_s, trajectory.signals, metadata))
    assert read_bag(tmp_path / "bag").metadata == {**METADATA, "weights": [0.25, 0.75], "seed": 3}


@pytest.mark.parametrize(
    ("time_s", "complaint"),
    [
        ([-0.001, 0.0], "time_s goes from -0.001 to 0.0"),
        ([0.0, 1e-10], "time_s goes from 0.0 to 1e-10"),
        ([0.0, 2.0**31], "time_s goes from 0.0 to 2147483648.0"),
        ([0.0, np.nan], "time_s goes from 0.0 to nan"),
        ([], "the trajectory has no samples"),
    ],
)
def test_times_that_a_stamp_cannot_express_are_refused(tmp_path: Path, time_s: list[float], complaint: str):
    with pytest.raises(BadInput, match=complaint):
        write_trajectory(tmp_path / "bag", Trajectory(np.array(time_s), {}))
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("signal", "value", "complaint"),
    [
        ("saturated", 0.5, "saturated is 0.5 at sample 4"),
        ("saturated", np.nan, "saturated is nan at sample 4"),
        ("friction_slipping", 2.0, "friction_slipping is 2.0 at sample 4"),
        ("response_s", np.nan, "response_s is nan at sample 4"),
        ("response_s", -1e-3, "response_s is -0.001 at sample 4"),
        ("response_s", 1e12, "response_s is 1000000000000.0 at sample 4"),
    ],
)
def test_values_that_a_message_cannot_express_are_refused(tmp_path: Path, signal: str, value: float, complaint: str):
    trajectory = make_trajectory()
    trajectory[signal][4] = value
    with pytest.raises(BadInput, match=complaint):
        write_trajectory(tmp_path / "bag", trajectory)
    assert not (tmp_path / "bag").exists()


def test_topics_without_a_wanted_signal_are_left_out(tmp_path: Path):
    trajectory = make_trajectory()
    write_trajectory(tmp_path / "bag", trajectory)
    read = read_bag(tmp_path / "bag", ("force_n", "valve_command_m", "e3_pa"))
    assert list(read.signals) == ["valve_command_m", "force_n", "e3_pa"]
    assert all(read[name].tobytes() == trajectory[name].tobytes() for name in read.signals)
