"""No file blocks a reader or fills its memory; a file above a limit is refused in a line that names the limit."""

import importlib.util
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from recorded_runs import loader_state, make_trajectory, record, storage_file
from scipy.io import savemat
from tiers import tiered

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.contained import contained
from ehls_ros.recording.csv_file import write_csv
from ehls_ros.recording.load import load
from ehls_ros.trajectory import Trajectory

PROCESSOR = 30.0
"""Longest processor time for any input [s]."""

MEMORY = 1500.0
"""Largest resident set for any input [MB]."""

MEASURED = {
    "CSV, 100 MB in one line",
    "CSV, 100 MB of empty lines",
    "YAML, 300 MB",
    "SQLite, 600 messages of 1 MB",
    "mcap, 600 MB of overlapping chunks",
    "MAT, 3 MB expand to 3 GB",
    "MAT, 10^9 cells",
    "MAT, cells 200000 deep",
    "Parquet, 1.9·10^7 equal rows",
    "Excel, two cells 10^10 apart",
}
"""Inputs that would cost time or memory if a check failed; each is read in a separate process."""

LARGE = {
    "CSV, 100 MB in the second line",
    "CSV, 100 MB of lines in quotes",
    "reference file, 300 MB",
    "SQLite, a message of 600 MB",
    "SQLite, 10000 messages of 60 kB",
    "SQLite, definition of 600 MB",
    "SQLite, metadata of 600 MB",
    "SQLite, a million topics",
    "mcap, summary of 500 MB",
    "mcap, definition of 500 MB",
    "mcap, 2 million records",
    "MAT, 500000 variables",
    "Parquet, 30000 row groups",
    "Excel, 5 million rows in 1 MB",
}
"""Inputs read by the benchmark only, since they take long to make."""


SLOW = {
    "CSV, 9000 columns",
    "SQLite, messages of 5000 lengths",
    "mcap, messages of 5000 lengths",
    "Parquet, 3·10^7 equal rows",
    "Parquet, texts of 1 MB, 10^5 times",
}
"""Inputs whose refusal takes over a second."""


def imported(name: str) -> ModuleType:
    file = Path(__file__).resolve().parents[2] / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


HOSTILE = imported("hostile_inputs")


@pytest.fixture(scope="module")
def table():
    """Print a table row by row."""
    print(f"\n{HOSTILE.HEADER}")
    return lambda name, answer: print(HOSTILE.row(name, answer))


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(MEASURED & set(HOSTILE.INPUTS)))
def test_a_hostile_file_is_refused_quickly_and_in_little_memory(table, name: str):
    with tempfile.TemporaryDirectory() as folder:
        answer = HOSTILE.ask(HOSTILE.INPUTS[name](Path(folder)))
    table(name, answer)
    assert answer.refused, answer.line
    assert answer.line.isprintable()
    assert "expected" in answer.line
    assert answer.processor_s < PROCESSOR
    assert answer.memory_mb < MEMORY


READ_HERE = sorted(set(HOSTILE.INPUTS) - MEASURED - LARGE)


@pytest.mark.parametrize("name", tiered(READ_HERE, *set(READ_HERE) - SLOW))
def test_a_hostile_file_is_refused(name: str):
    with tempfile.TemporaryDirectory() as folder:
        path = HOSTILE.INPUTS[name](Path(folder))
        with pytest.raises(BadInput) as caught:
            HOSTILE.read(path)
    assert str(caught.value).isprintable()


def as_table(folder: Path, suffix: str, rows: int = 40) -> Path:
    """Write a table of two columns."""
    path = folder / f"data{suffix}"
    time_s, force_n = np.arange(rows) / 1000, np.ones(rows)
    match suffix:
        case ".csv":
            write_csv(path, Trajectory(time_s, {"force_n": force_n}))
        case ".mat":
            savemat(path, {"time_s": time_s, "force_n": force_n})
        case _:
            pyarrow = pytest.importorskip("pyarrow")
            pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table({"time_s": time_s, "force_n": force_n}), path)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".parquet"])
def test_a_link_to_a_file_is_read(tmp_path: Path, suffix: str):
    path = as_table(tmp_path, suffix)
    (tmp_path / f"link{suffix}").symlink_to(path)
    assert load(tmp_path / f"link{suffix}")["force_n"].tolist() == [1.0] * 40


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".parquet"])
def test_a_table_that_is_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str):
    path = as_table(tmp_path, suffix)
    monkeypatch.setattr(limits, "TABLE", 100)
    with pytest.raises(BadInput, match=r"the file has \d+ bytes; expected a .* of at most 100: split it by time, or write it"):
        load(path)


@pytest.mark.parametrize(("limit", "most"), [("ROWS", 39), ("VALUES", 79)])
def test_a_csv_with_too_many_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, most: int):
    path = as_table(tmp_path, ".csv")
    monkeypatch.setattr(limits, limit, most)
    with pytest.raises(BadInput, match="it has at least 40 rows in 2 columns to read; expected at most"):
        load(path)
    monkeypatch.setattr(limits, limit, most + 1)
    assert len(load(path)) == 40


def test_a_csv_with_a_line_that_is_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "data.csv"
    path.write_text("time_s,force_n\n0,1\n1,100000000000000\n", encoding="utf-8")
    monkeypatch.setattr(limits, "LINE", 16)
    with pytest.raises(
        BadInput, match=r"data\.csv, line 3: the line has more than 16 characters; expected a CSV file with one line per sample"
    ):
        load(path)
    monkeypatch.setattr(limits, "LINE", 17)
    assert len(load(path)) == 2


def as_bag(folder: Path, storage: str, messages: int = 5) -> Path:
    return record(folder / "bag", [loader_state(k) for k in range(messages)], storage)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("form", ["bag", "file"])
@pytest.mark.parametrize(
    ("limit", "most", "complaint"),
    [
        ("BAG", 1000, r"has \d+ bytes; expected an undamaged bag.* of at most 1000: `ros2 bag convert` splits it"),
        ("ROWS", 4, "it has 5 messages; expected at most 4; split"),
        ("MESSAGE", 50, r"a message has \d+ bytes; expected at most 50"),
    ],
)
def test_a_bag_that_is_too_large(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, storage: str, form: str, limit: str, most: int, complaint: str
):
    bag = as_bag(tmp_path, storage)
    monkeypatch.setattr(limits, limit, most)
    with pytest.raises(BadInput, match=complaint):
        read_bag(bag if form == "bag" else storage_file(bag))


@pytest.mark.parametrize("size", [100, 1 << 26])
def test_messages_are_decoded_in_parts_that_fit_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int):
    bag = as_bag(tmp_path, "mcap", 50)
    monkeypatch.setattr(limits, "GATHERED", size)
    assert read_bag(bag).time_s.tolist() == [k / 1000 for k in range(50)]


def test_a_bag_that_lists_a_file_twice(tmp_path: Path):
    bag = as_bag(tmp_path, "mcap")
    metadata = bag / "metadata.yaml"
    text = metadata.read_text(encoding="utf-8")
    metadata.write_text(text.replace("- bag.mcap\n", "- bag.mcap\n  - bag.mcap\n", 1), encoding="utf-8")
    with pytest.raises(BadInput, match=r"it lists the storage file 'bag\.mcap'; expected files .mcap or .db3, each once"):
        read_bag(bag)


def test_a_pipe_beside_the_files_of_a_bag(tmp_path: Path):
    bag = as_bag(tmp_path, "mcap")
    os.mkfifo(bag / "more.mcap")
    assert read_bag(bag).preparation.remarks == ("more.mcap is not listed in metadata.yaml and left out",)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(BadInput, match="it is a pipe"):
        read_bag(bag)


@pytest.mark.parametrize("form", ["csv", "mat", "mcap", "sqlite3"])
def test_a_file_that_takes_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str):
    path = as_table(tmp_path, f".{form}") if form in {"csv", "mat"} else as_bag(tmp_path, form, 2000)
    monkeypatch.setattr(limits, "SECONDS", 0.0)
    monkeypatch.setattr(limits, "MIN_RATE", float("inf"))
    with pytest.raises(BadInput, match="reading it takes more than 0 s; expected the recording in smaller files"):
        load(path)


def takes_memory(path: Path, argument: None) -> Trajectory:
    return make_trajectory(1) if np.ones(10**9).sum() else make_trajectory(2)


def takes_time(path: Path, argument: None) -> Trajectory:
    while True:
        pass


def dies(path: Path, argument: None) -> Trajectory:
    os.abort()


def prints(path: Path, argument: None) -> Trajectory:
    print("a library that talks", flush=True)
    return make_trajectory(1)


def imports(path: Path, argument: None) -> Trajectory:
    import colorsys

    return make_trajectory(3 if hasattr(colorsys, "planted") else 1)


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the functions of this file importable in another process."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)]))
    monkeypatch.setattr(limits, "SECONDS", 2.0)


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize(
    ("read", "complaint"),
    [
        (takes_memory, "its 4 bytes take more than 256 MB of memory; expected a file whose variables fit in memory"),
        (takes_time, "reading it takes more than 2 s"),
        (dies, r"it crashes the reading process \(SIGABRT\); expected a MAT file"),
    ],
)
def test_a_failing_library_does_not_take_this_process_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read, complaint: str
):
    if read is not takes_time:
        monkeypatch.setattr(limits, "SECONDS", 120.0)
    (tmp_path / "data").write_bytes(b"data")
    with pytest.raises(BadInput, match=complaint):
        contained(read, tmp_path / "data", None, "a MAT file", Trajectory)


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("read", [prints, imports])
def test_the_reading_process_ignores_prints_and_modules_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read
):
    monkeypatch.setattr(limits, "SECONDS", 120.0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "colorsys.py").write_text("planted = True", encoding="utf-8")
    (tmp_path / "data").write_bytes(b"data")
    assert len(contained(read, Path("data"), None, "a MAT file", Trajectory)) == 1
