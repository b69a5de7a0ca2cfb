"""The only reader and writer of state files."""

import io
import json
import os
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from full_disk import no_file_larger_than

from ehls_ros.declared_arrays import Entry, check_arrays
from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.state_files import access, archive, table
from ehls_ros.experiments.state_files.access import LOCKS, FolderLock, NotWritten
from ehls_ros.experiments.state_files.state_file import Kind, OfAnotherOrigin, Origin, StateFile

RIG = load_rig(Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml")
ORIGIN = Origin.of(RIG, 1e-3)


class Content(NamedTuple):
    """Content written by the test."""

    value: float


KIND = Kind("test state", 1, 1 << 16, Content, "the test's")
OTHER = KIND._replace(name="other state")
WITH_ARRAYS = KIND._replace(arrays=4)
ARRAYS = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(1 + 2j), "c": np.zeros(0, np.int64), "d": np.ones(3, np.float32)}


@pytest.fixture
def file(tmp_path: Path) -> StateFile:
    made = StateFile(tmp_path / "state.json", KIND, ORIGIN)
    made.write({"value": 1.5})
    return made


@pytest.fixture
def with_arrays(tmp_path: Path) -> StateFile:
    made = StateFile(tmp_path / "state.npz", WITH_ARRAYS, ORIGIN)
    made.write({"value": 1.5}, ARRAYS)
    return made


def test_what_was_written_is_read(file, with_arrays):
    assert file.read().content == Content(1.5)
    read = with_arrays.read()
    assert read.content == Content(1.5)
    assert read.arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert read.arrays[name].dtype == array.dtype
        assert np.array_equal(read.arrays[name], array)
    # Plain numpy can read it.
    with np.load(with_arrays.path, allow_pickle=False) as data:
        assert np.array_equal(data["a"], ARRAYS["a"])


@pytest.mark.parametrize(
    ("origin", "said"),
    [
        (Origin.of(RIG, 2e-3), "a control_period of 0.001 s, not 0.002 s"),
        (Origin.of(RIG._replace(plant=RIG.plant._replace(piston_area=3e-3)), 1e-3), "plant.piston_area is 0.0026, not 0.003"),
    ],
)
def test_another_rig_or_rate_is_named(file, origin, said):
    with pytest.raises(OfAnotherOrigin, match="the test state is of") as refused:
        StateFile(file.path, KIND, origin).read()
    assert said in str(refused.value)
    assert StateFile(file.path, KIND, None).read().content == Content(1.5)


def test_a_flipped_digit_and_another_layout_are_refused(file):
    content = file.path.read_bytes()
    file.path.write_bytes(content.replace(b'"value": 1.5', b'"value": 9.5'))
    with pytest.raises(BadInput, match="its checksum is wrong"):
        file.read()
    file.path.write_bytes(content)
    for other in (OTHER, KIND._replace(version=2)):
        with pytest.raises(BadInput, match="something else, or of another version"):
            StateFile(file.path, other, ORIGIN).read()


def test_a_file_of_something_else_is_not_replaced(file, tmp_path):
    for foreign in (b"", b"mine", (tmp_path / "state.json").read_bytes()):
        path = tmp_path / "foreign"
        path.write_bytes(foreign)
        with pytest.raises(NotWritten, match=r"foreign: is not replaced \(it is no other state\)"):
            StateFile(path, OTHER, ORIGIN).write({"value": 2.0})
        assert path.read_bytes() == foreign


def test_a_link_stays_a_link(file, tmp_path):
    target = tmp_path / "elsewhere" / "own.json"
    target.parent.mkdir()
    file.path.rename(target)
    file.path.symlink_to(target)
    file.write({"value": 2.0})
    assert file.path.is_symlink()
    assert json.loads(target.read_bytes())["content"] == {"value": 2.0}
    # Also one whose target does not exist yet.
    target.unlink()
    assert file.read() is None
    file.write({"value": 3.0})
    assert target.exists()
    assert file.read().content == Content(3.0)


@pytest.mark.parametrize("made", ["a pipe", "a directory", "a device", "levels of symbolic links"])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, made):
    path = tmp_path / "state.json"
    {
        "a pipe": lambda: os.mkfifo(path),
        "a directory": path.mkdir,
        "a device": lambda: path.symlink_to("/dev/zero"),
        "levels of symbolic links": lambda: path.symlink_to(path),
    }[made]()
    file, began = StateFile(path, KIND, ORIGIN), time.monotonic()
    with pytest.raises(BadInput, match=made):
        file.read()
    with pytest.raises(BadInput, match=made):
        file.check_writable()
    with pytest.raises(NotWritten):
        file.write({"value": 1.0})
    assert time.monotonic() - began < 5.0
    assert not file.is_own()


def test_a_full_disk_leaves_the_file_as_it_was_and_nothing_beside_it(file, tmp_path):
    before = file.path.read_bytes()
    with no_file_larger_than(100):
        with pytest.raises(NotWritten, match=r"state\.json: cannot be written \(File too large\)"):
            file.write({"value": 2.0})
        with pytest.raises(BadInput, match=r"the test state cannot be written \(File too large\)"):
            file.check_writable()
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]
    assert file.path.read_bytes() == before


def test_the_mode_of_a_file_is_kept(file):
    file.path.chmod(0o640)
    file.write({"value": 2.0})
    assert file.path.stat().st_mode & 0o777 == 0o640


def test_a_number_that_is_not_finite_is_never_written(file):
    with pytest.raises(NotWritten, match=r"state\.json: cannot be written"):
        file.write({"value": float("nan")})
    assert file.read().content == Content(1.5)


def test_a_file_is_not_larger_in_memory_than_on_disk(with_arrays):
    path = with_arrays.path
    with zipfile.ZipFile(path) as whole:
        entries = {name: whole.read(name) for name in whole.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in entries.items():
            packed.writestr(name, content)
    with pytest.raises(BadInput, match="compressed"):
        with_arrays.read()
    os.truncate(path, KIND.largest + 1)
    with pytest.raises(BadInput, match=f"has {KIND.largest + 1} bytes"):
        with_arrays.read()


def test_objects_and_lies_about_size_are_no_arrays(with_arrays):
    path = with_arrays.path
    held = archive.read(path.read_bytes(), 4)
    content = io.BytesIO()
    archive.write(content, held.document, {"a": np.zeros(3)})
    for found, put in ((b"(3,)", b"(9,)"), (b"'<f8'", b"'|O8'"), (b"False", b"True ")):
        spoilt = content.getvalue().replace(found, put)
        begin = spoilt.index(b"\x93NUMPY")
        crc = zlib.crc32(spoilt[begin : spoilt.index(b"PK\1\2")]).to_bytes(4, "little")
        where = spoilt.index(b"a.npy") - archive.LOCAL_HEADER.size + 14
        path.write_bytes(spoilt[:where] + crc + spoilt[where + 4 :])
        with pytest.raises(BadInput, match=r"the array 'a' has another (layout|size)"):
            with_arrays.read()


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"x": np.zeros(3), "y": np.zeros(4)}, "'y' has the shape"),
        ({"x": np.zeros(3, np.float32), "y": np.zeros(3)}, "'x' has the type float32, not float64"),
        ({"x": np.zeros((3, 1)), "y": np.zeros(3)}, "'x' has 2 dimensions, not 1"),
        ({"x": np.full(3, np.inf), "y": np.zeros(3)}, "'x' has an infinite value"),
        ({"x": np.full(3, np.nan), "y": np.zeros(3)}, "'x' has a value that is not a number"),
        ({"x": np.full(3, -2.0), "y": np.zeros(3)}, "'x' has a value out of -1 to 1"),
        ({"x": np.zeros(3)}, "'y' is missing"),
        ({"x": np.zeros(3), "y": np.zeros(3), "z": np.zeros(3)}, "'z' is unknown"),
    ],
)
def test_arrays_are_what_is_declared(arrays, said):
    declared = {"x": Entry(shape=("n",), minimum=-1.0, maximum=1.0), "y": Entry(shape=("n",), infinite=True)}
    with pytest.raises(ValueError, match=said):
        check_arrays(arrays, declared)
    assert check_arrays({"x": np.zeros(3), "y": np.full(3, np.inf)}, declared) == {"n": 3}


HEADING = "number,value"


def check(cells: list[str]) -> None:
    if len(cells) != 2 or int(cells[0]) < 1:
        raise ValueError(f"a line is {cells}")


def judge(path: Path) -> table.Judged:
    return table.judge(path, HEADING, check, "a table of the test", "the table")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a,b\n1,2\n", "has other columns"),
        (b"number,value\n1,2\n\0\0\0\0", "is not text"),
        (b"number,value\n1,2\nthis is a text\n", "a line is"),
        (b"number,value\n1,2\n" + 5000 * b"1", "a line has 5000 bytes"),
        (b"number,value\n" + b"1,2\n" * 20_000 + b"x,2\n", "invalid literal"),
        (b"number,value\n" + 70_000 * b"1", "bytes"),
    ],
)
def test_a_table_is_judged_before_it_is_touched(tmp_path, content, said):
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=said):
        judge(path)
    assert path.read_bytes() == content


@pytest.mark.parametrize("begun", [b"", b"num", b"number,value\n", b"number,value\n1,2\n", b"number,value\n1,2\n2,"])
def test_a_table_goes_on_after_its_last_whole_line(tmp_path, begun):
    path = tmp_path / "table.csv"
    path.write_bytes(begun)
    grown = table.Table(path, HEADING, judge(path).end)
    grown.add("2,3")
    grown.flush()
    grown.close()
    assert path.read_bytes() == (b"number,value\n1,2\n2,3\n" if b"1,2" in begun else b"number,value\n2,3\n")
    assert [cells[0] for cells in table.rows(path, HEADING, check, "a table", "the table")][-1] == "2"


def test_lines_that_a_full_disk_did_not_take_are_written_later(tmp_path):
    path = tmp_path / "table.csv"
    grown = table.Table(path, HEADING, 0)
    with no_file_larger_than(20):
        for number in range(1, 9):
            grown.add(f"{number},0")
        with pytest.raises(NotWritten, match=r"table\.csv: cannot be written \(File too large\)"):
            grown.flush()
    grown.flush()
    grown.close()
    assert [cells[0] for cells in table.rows(path, HEADING, check, "a table", "the table")] == [str(n) for n in range(1, 9)]


def refusal(folder: Path) -> str:
    with pytest.raises(BadInput) as refused:
        FolderLock(folder, "test")
    return str(refused.value)


def test_a_locked_folder_names_its_process_and_is_free_after_it(tmp_path):
    held = FolderLock(tmp_path, "test")
    assert not held.remark
    holder = f"process {os.getpid()}" if LOCKS.exists() else "another process"
    said = f"{tmp_path}: {holder} runs another test in the folder; expected another folder, or that process stopped first"
    assert refusal(tmp_path) == said
    # By another name, too.
    link = tmp_path.parent / "link"
    link.symlink_to(tmp_path)
    assert holder in refusal(link)
    held.release()
    held.release()
    FolderLock(link, "test").release()
    assert not list(tmp_path.iterdir())


def test_a_killed_process_holds_no_folder(tmp_path):
    program = "import sys, pathlib; from ehls_ros.experiments.state_files.access import FolderLock\n"
    program += "lock = FolderLock(pathlib.Path(sys.argv[1]), 'test'); print('locked', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"locked\n"
        said = refusal(tmp_path)
        holder.kill()
    assert (f"process {holder.pid} runs" if LOCKS.exists() else "another process runs") in said
    FolderLock(tmp_path, "test").release()


@pytest.mark.parametrize("made", [lambda path: None, lambda path: path.write_bytes(b"")])
def test_a_folder_that_cannot_be_locked_is_said(tmp_path, made):
    made(tmp_path / "folder")
    lock = FolderLock(tmp_path / "folder", "test")
    assert lock.remark.startswith(f"{tmp_path / 'folder'} cannot be locked (N")
    assert lock.remark.endswith("): start no other test in it")
    lock.release()


def test_what_is_put_aside_gets_a_name_that_nothing_has(tmp_path):
    names = []
    for _ in range(3):
        (tmp_path / "log.csv").write_bytes(b"1")
        names.append(access.put_aside(tmp_path / "log.csv").name)
    (tmp_path / "log.csv").mkdir()
    names.append(access.put_aside(tmp_path / "log.csv").name)
    assert names == ["log.1.csv", "log.2.csv", "log.3.csv", "log.4.csv"]
