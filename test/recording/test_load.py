"""Every format of the data contract, recognised by its path."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import folder_for_nobody, make_trajectory, storage_file
from scipy.io import savemat

from ehls_ros.errors import BadInput
from ehls_ros.extras import install_command
from ehls_ros.recording.bag_writer import write_trajectory
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.csv_file import write_csv
from ehls_ros.recording.load import load
from ehls_ros.trajectory import Trajectory

TRAJECTORY = make_trajectory()


def as_mat(path: Path, **variables: Any) -> Path:
    savemat(path, variables)
    return path


def as_parquet(path: Path, **columns: Any) -> Path:
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pytest.importorskip("pyarrow").table(columns), path)
    return path


def assert_same_values(first: Trajectory, second: Trajectory) -> None:
    assert first.time_s.tobytes() == second.time_s.tobytes()
    assert {name: first[name].tobytes() for name in first.signals} == {name: second[name].tobytes() for name in second.signals}


@pytest.mark.parametrize("form", ["bag", "mcap", "db3", "csv", "CSV", "mat"])
def test_every_format_gives_the_same_values(tmp_path: Path, form: str):
    path = tmp_path / f"data.{form}"
    match form:
        case "bag":
            write_trajectory(path, TRAJECTORY)
        case "mcap" | "db3":
            write_trajectory(tmp_path / "bag", TRAJECTORY, "mcap" if form == "mcap" else "sqlite3")
            storage_file(tmp_path / "bag").rename(path)
        case "csv" | "CSV":
            write_csv(path, TRAJECTORY)
        case _:
            as_mat(path, time_s=TRAJECTORY.time_s, **TRAJECTORY.signals)
    assert_same_values(load(path), TRAJECTORY)


def test_parquet_gives_the_same_values(tmp_path: Path):
    signals = {name: values for name, values in TRAJECTORY.signals.items() if values.ndim == 1}
    path = as_parquet(tmp_path / "data.parquet", time_s=TRAJECTORY.time_s, note=["x"] * len(TRAJECTORY), **signals)
    assert_same_values(load(path), Trajectory(TRAJECTORY.time_s, signals))


def test_a_null_of_parquet_is_nan(tmp_path: Path):
    path = as_parquet(tmp_path / "data.parquet", time_s=[0, 1], force_n=[None, 2], position_m=[None, 0.5])
    np.testing.assert_array_equal(load(path)["force_n"], [np.nan, 2.0])
    np.testing.assert_array_equal(load(path)["position_m"], [np.nan, 0.5])


@pytest.mark.parametrize("form", ["csv", "mat", "parquet"])
def test_the_columns_map_serves_every_table(tmp_path: Path, form: str):
    path = tmp_path / f"data.{form}"
    match form:
        case "csv":
            path.write_text("t,x\n0,1\n10,2\n", encoding="utf-8")
        case "mat":
            as_mat(path, t=[0, 10], x=[1, 2])
        case _:
            as_parquet(path, t=[0, 10], x=[1, 2])
    trajectory = load(path, ColumnMap({"time_s": Column("t", 0.5), "position_m": Column("x", 2.0, 1.0)}))
    assert trajectory.time_s.tolist() == [0.0, 5.0]
    assert trajectory["position_m"].tolist() == [3.0, 5.0]


def test_a_structure_of_matlab_is_addressed_by_its_fields(tmp_path: Path):
    path = as_mat(tmp_path / "data.mat", log={"t": [0.0, 1.0], "motion": {"x": [3.0, 4.0]}}, title="a run")
    trajectory = load(path, ColumnMap({"time_s": Column("log.t"), "position_m": Column("log.motion.x")}))
    assert trajectory["position_m"].tolist() == [3.0, 4.0]


def test_one_sample_of_matlab_is_one_sample(tmp_path: Path):
    assert load(as_mat(tmp_path / "data.mat", time_s=2.0, force_n=5.0))["force_n"].tolist() == [5.0]


@pytest.mark.parametrize(
    ("variables", "complaint"),
    [
        ({"force_n": [1, 2]}, ": column time_s is missing (found: force_n)"),
        ({"time_s": [0, 1], "force_n": [1, 2, 3]}, ": force_n has 3 values; expected 2, as time_s has"),
        ({"time_s": [0, 1], "force_n": "ab"}, ": column 'force_n' is not numeric"),
        ({"time_s": [0, 1], "force_n": [1j, 2]}, ": column 'force_n' is not numeric"),
        ({"time_s": [0, 1], "force_n": np.ones((2, 2))}, ": column 'force_n' for force_n has the shape (2, 2)"),
        ({"time_s": [1, 0], "force_n": [1, 2]}, ", sample 2: time_s is 0.0 after 1.0"),
    ],
)
def test_matlab_variables_that_are_not_signals_are_bad_input(tmp_path: Path, variables: dict[str, Any], complaint: str):
    path = as_mat(tmp_path / "data.mat", **variables)
    with pytest.raises(BadInput) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}{complaint}")


@pytest.mark.parametrize(
    ("name", "reader", "content", "complaint"),
    [
        ("data.mat", "scipy", b"nothing of the kind" * 20, "it is not a MAT file"),
        ("data.mat", "h5py", b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM", "it is not a MAT file"),
        ("data.xlsx", "python_calamine", b"PK nothing more", "it is not an Excel file"),
        ("data.tdms", "nptdms", b"nothing of the kind", "it has no channel; expected a TDMS file"),
        (
            "data.ods",
            "pandas",
            b"",
            "its format is unknown; expected the folder of a rosbag2 or a file .mcap, .db3, .csv, .tsv",
        ),
        ("data", "pandas", b"", "its format is unknown"),
        ("data.mcap", "rosbags", b"", "the file is truncated or still being written"),
    ],
)
def test_files_without_data_are_bad_input(tmp_path: Path, name: str, reader: str, content: bytes, complaint: str):
    pytest.importorskip(reader)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=complaint):
        load(tmp_path / name)


def test_a_damaged_parquet_file_is_bad_input(tmp_path: Path):
    pytest.importorskip("pyarrow")
    (tmp_path / "data.parquet").write_bytes(b"PAR1 nothing more")
    with pytest.raises(BadInput, match="it is not a Parquet file"):
        load(tmp_path / "data.parquet")


@pytest.mark.parametrize(
    ("suffix", "module", "package"),
    [
        (".parquet", "pyarrow.parquet", "pyarrow"),
        (".xlsx", "python_calamine", "python-calamine"),
        (".tdms", "nptdms", "npTDMS"),
    ],
)
def test_a_library_that_is_missing_is_named_with_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, module: str, package: str
):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(BadInput) as caught:
        load(tmp_path / f"data{suffix}")
    assert f"{package} is not installed" in str(caught.value)
    assert f"`{install_command('files')}`, or the data as CSV" in str(caught.value)


@pytest.mark.parametrize("name", ["nothing", "nothing.csv", "nothing.mcap", "nothing.mat"])
def test_a_missing_path_is_bad_input(tmp_path: Path, name: str):
    with pytest.raises(BadInput, match=r"does not exist|No such file"):
        load(tmp_path / name)


@pytest.mark.parametrize("name", ["", "bag", "run.mcap", "data.csv", "data.mat"])
def test_an_unreadable_path_is_bad_input(name: str):
    with folder_for_nobody(0o000) as folder, pytest.raises(BadInput, match="Permission denied"):
        load(folder / name)


def test_a_folder_that_is_not_a_bag_is_bad_input(tmp_path: Path):
    with pytest.raises(BadInput, match=r"metadata\.yaml is missing"):
        load(tmp_path)
