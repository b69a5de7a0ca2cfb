"""A damaged bag is refused in one line or gives exactly the recorded data."""

import random
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import loader_state, make_trajectory, record, same, storage_file

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import Storage, write_trajectory

STORAGES: list[Storage] = ["mcap", "sqlite3"]
MUTATIONS = 160
TRAJECTORY = make_trajectory(30)


def refuses(path: Path) -> str:
    """Return the one-line refusal."""
    with pytest.raises(BadInput) as caught:
        read_bag(path)
    line = str(caught.value)
    assert line.startswith(str(path))
    assert "\n" not in line
    return line


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("kept", [0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_storage_file_is_refused_with_and_without_its_folder(tmp_path: Path, storage: Storage, kept: float):
    write_trajectory(tmp_path / "bag", TRAJECTORY, storage)
    file = storage_file(tmp_path / "bag")
    whole = file.read_bytes()
    file.write_bytes(whole[: int(kept * len(whole))])
    for path in (tmp_path / "bag", file):
        assert "the file is truncated or still being written; expected an undamaged bag, closed by its recorder" in refuses(
            path
        )


@pytest.mark.parametrize("storage", STORAGES)
def test_a_storage_file_that_lacks_its_last_byte_is_refused(tmp_path: Path, storage: Storage):
    write_trajectory(tmp_path / "bag", TRAJECTORY, storage)
    file = storage_file(tmp_path / "bag")
    file.write_bytes(file.read_bytes()[:-1])
    assert "truncated" in refuses(file)


@pytest.mark.parametrize("kept", [0, 0.2, 0.5, 0.8, 0.99])
def test_truncated_metadata_are_refused(tmp_path: Path, kept: float):
    write_trajectory(tmp_path / "bag", TRAJECTORY)
    metadata = tmp_path / "bag" / "metadata.yaml"
    whole = metadata.read_bytes()
    metadata.write_bytes(whole[: int(kept * len(whole))])
    assert "expected an undamaged bag, closed by its recorder" in refuses(tmp_path / "bag")


@pytest.mark.parametrize("storage", STORAGES)
def test_a_folder_without_metadata_is_read_from_its_file(tmp_path: Path, storage: Storage):
    write_trajectory(tmp_path / "bag", TRAJECTORY, storage)
    file = storage_file(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    found = read_bag(tmp_path / "bag")
    assert same(found, TRAJECTORY)
    [remark] = found.preparation.remarks
    assert remark == f"metadata.yaml is missing: {file.name} read without it; the last messages may be missing too"
    assert same(read_bag(file), TRAJECTORY)


def test_a_database_that_our_recorder_did_not_close_is_refused(tmp_path: Path):
    write_trajectory(tmp_path / "bag", TRAJECTORY, "sqlite3")
    with closing(sqlite3.connect(storage_file(tmp_path / "bag"))) as database, database:
        database.execute("DELETE FROM metadata")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    assert "bag.db3: the file is truncated or still being written" in refuses(tmp_path / "bag")


def test_a_damaged_bag_names_the_command_that_saves_the_rest(tmp_path: Path):
    write_trajectory(tmp_path / "my bag", TRAJECTORY)
    file = storage_file(tmp_path / "my bag")
    file.write_bytes(file.read_bytes()[:-1000])
    for path in (tmp_path / "my bag", file):
        assert refuses(path).endswith(f"closed by its recorder; `ehls recover '{file}'` saves the sound messages")
    (tmp_path / "my bag" / "metadata.yaml").write_text("no: metadata", encoding="utf-8")
    assert f"`ehls recover '{tmp_path / 'my bag'}'` saves" in refuses(tmp_path / "my bag")


@pytest.mark.parametrize("ending", ["-journal", "-wal"])
def test_a_database_that_was_never_closed_is_refused(tmp_path: Path, ending: str):
    write_trajectory(tmp_path / "bag", TRAJECTORY, "sqlite3")
    (tmp_path / "bag" / f"bag.db3{ending}").write_bytes(b"what was not written back yet")
    assert f"the file was never closed: bag.db3{ending} is beside it" in refuses(storage_file(tmp_path / "bag"))


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("part", ["folder", "file"])
def test_one_flipped_bit_of_a_value_is_found(tmp_path: Path, storage: Storage, part: str):
    write_trajectory(tmp_path / "bag", TRAJECTORY, storage)
    file = storage_file(tmp_path / "bag")
    content = bytearray(file.read_bytes())
    content[content.index(TRAJECTORY["u2_kg_pa_s2"][11].tobytes())] ^= 1
    file.write_bytes(content)
    path = file if part == "file" else tmp_path / "bag"
    found = "Chunk checksum mismatch" if storage == "mcap" else "/ehls/controller_status: messages have been altered"
    assert found in refuses(path)


def test_a_configuration_changed_afterwards_is_found(tmp_path: Path):
    write_trajectory(tmp_path / "bag", TRAJECTORY)
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text(encoding="utf-8").replace("70.5", "71.5"), encoding="utf-8")
    assert "the configuration in the bag is damaged" in refuses(tmp_path / "bag")


def test_the_metadata_of_another_bag_are_found(tmp_path: Path):
    write_trajectory(tmp_path / "bag", TRAJECTORY)
    write_trajectory(tmp_path / "other" / "bag", make_trajectory(31))
    (tmp_path / "other" / "bag" / "metadata.yaml").replace(tmp_path / "bag" / "metadata.yaml")
    assert "its metadata are those of another bag" in refuses(tmp_path / "bag")


def test_a_topic_that_got_lost_is_found(tmp_path: Path):
    write_trajectory(tmp_path / "bag", TRAJECTORY)
    metadata = tmp_path / "bag" / "metadata.yaml"
    text = metadata.read_text(encoding="utf-8").replace("name: /ehls/disturbance", "name: /ehls/disturbanxe")
    metadata.write_text(text, encoding="utf-8")
    assert "topic /ehls/disturbance was not recorded with the others" in refuses(tmp_path / "bag")


def test_messages_shorter_than_their_type_are_refused(tmp_path: Path):
    bag = record(tmp_path / "theirs", [loader_state(0), loader_state(1)], "sqlite3")
    file = storage_file(bag)
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("UPDATE messages SET data = substr(data, 1, 60) WHERE id = 2")
    assert "/ehls/loader_state: message is truncated after 60 bytes" in refuses(bag)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda path: path / "nothing", "it does not exist; expected a folder of a rosbag2, or a file .mcap or .db3"),
        (lambda path: path / "empty", "metadata.yaml is missing, and there is no storage file; expected a folder of a rosbag2"),
        (lambda path: path / "old.bag", "it is a bag of ROS 1; expected one of ROS 2: `rosbags-convert --src"),
        (lambda path: path / "notes.txt", "it is not a bag; expected a folder of a rosbag2, or a file .mcap or .db3"),
        (
            lambda path: path / "notes.db3",
            "the file is not a SQLite database; expected an undamaged bag, closed by its recorder",
        ),
        (lambda path: path / "notes.mcap", "the file is truncated or still being written"),
    ],
)
def test_anything_but_a_bag_is_refused(tmp_path: Path, make: Callable[[Path], Path], complaint: str):
    (tmp_path / "empty").mkdir()
    for name in ("notes.txt", "notes.db3", "notes.mcap", "old.bag"):
        (tmp_path / name).write_bytes(b"not a recording at all" * 20)
    assert complaint in refuses(make(tmp_path))


def mutated(content: bytes, dice: random.Random) -> bytes:
    """Damage the content in one way: flipped bits, truncation, zeros, a gap, an insertion, or a displaced block."""
    result = bytearray(content)
    position, length = dice.randrange(len(content)), dice.choice([1, 4, 16, 200])
    match dice.randrange(6):
        case 0:
            for _ in range(length):
                result[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
        case 1:
            del result[position:]
        case 2:
            result[position : position + length] = bytes(len(result[position : position + length]))
        case 3:
            del result[position : position + length]
        case 4:
            result[position:position] = dice.randbytes(length)
        case _:
            other = dice.randrange(len(content))
            result[position : position + length] = content[other : other + length]
    return bytes(result)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_randomly_damaged_bag_is_refused_or_right(tmp_path: Path, storage: Storage):
    dice = random.Random(4)
    write_trajectory(tmp_path / "bag", TRAJECTORY, storage)
    file = storage_file(tmp_path / "bag")
    refusals: list[str] = []
    for _ in range(MUTATIONS):
        victim = dice.choice([file, file, tmp_path / "bag" / "metadata.yaml"])
        path = dice.choice([tmp_path / "bag", file]) if victim == file else tmp_path / "bag"
        whole = victim.read_bytes()
        victim.write_bytes(mutated(whole, dice))
        try:
            trajectory = read_bag(path)
        except BadInput as error:
            refusals.append(str(error))
        else:
            assert same(trajectory, TRAJECTORY)
        victim.write_bytes(whole)
    assert MUTATIONS / 2 < len(refusals) < MUTATIONS
    assert not any("\n" in line for line in refusals)
    assert same(read_bag(tmp_path / "bag"), TRAJECTORY)


def test_a_damaged_bag_of_another_recorder_is_refused_or_read_as_one_run(tmp_path: Path):
    dice = random.Random(6)
    bag = record(tmp_path / "theirs", [loader_state(k, force=float(k)) for k in range(30)])
    file = storage_file(bag)
    whole = file.read_bytes()
    refused = 0
    for _ in range(100):
        file.write_bytes(mutated(whole, dice))
        try:
            trajectory = read_bag(bag)
        except BadInput:
            refused += 1
        else:
            assert len(trajectory) == 30
            assert (np.diff(trajectory.time_s) > 0).all()
    assert 50 < refused < 100
