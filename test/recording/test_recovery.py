"""A bag whose recorder died is made whole again: all that was flushed, and nothing that is not as it was written."""

import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import METADATA, loader_state, make_trajectory, same, serialized, storage_file, valve_command

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import BagWriter, Storage, write_trajectory
from ehls_ros.recording.recording_note import NOTE
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.topics import LOADER_STATE, VALVE_COMMAND

STORAGES: list[Storage] = ["mcap", "sqlite3"]
FLUSHED, LOST = 25_000, 700

KILLED_RECORDER = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from recorded_runs import METADATA, loader_state, serialized, valve_command
from ehls_ros.recording.bag_writer import BagWriter
from ehls_ros.recording.topics import LOADER_STATE, VALVE_COMMAND
writer = BagWriter.create(Path({bag!r}), {storage!r}, METADATA)
for cycle in range({flushed} + {lost}):
    writer.write(LOADER_STATE.name, cycle * 10**6, serialized(loader_state(cycle)))
    writer.write(VALVE_COMMAND.name, cycle * 10**6 + 5, serialized(valve_command(cycle)))
    if cycle in (100, {flushed} - 1):
        writer.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def killed(bag: Path, storage: Storage, flushed: int = 300, lost: int = LOST) -> Path:
    """Return the folder left behind by a recorder that was killed."""
    script = KILLED_RECORDER.format(tests=str(Path(__file__).parent), bag=str(bag), storage=storage, flushed=flushed, lost=lost)
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    return bag


@pytest.mark.parametrize("storage", STORAGES)
def test_a_killed_recorders_bag_holds_all_that_was_flushed(tmp_path: Path, storage: Storage):
    bag = killed(tmp_path / "bag", storage, flushed=FLUSHED)
    assert recover(bag, tmp_path / "whole") == 2 * FLUSHED
    trajectory = read_bag(tmp_path / "whole")
    assert len(trajectory) == FLUSHED
    assert trajectory.metadata == METADATA
    assert np.all(np.isfinite(trajectory["valve_command_m"]))
    assert recover(bag, tmp_path / "again") == 2 * FLUSHED


@pytest.mark.parametrize("storage", STORAGES)
def test_reading_says_how_to_recover_and_the_command_does_it(tmp_path: Path, storage: Storage, capsys):
    bag = killed(tmp_path / "bag", storage)
    with pytest.raises(BadInput, match="ehls recover"):
        read_bag(bag)
    assert main(["recover", str(bag)]) == 0
    assert "600 messages" in capsys.readouterr().out
    assert len(read_bag(tmp_path / "bag_recovered")) == 300
    assert main(["recover", str(bag)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize("storage", STORAGES)
def test_a_closed_bag_has_nothing_to_recover(tmp_path: Path, storage: Storage):
    with BagWriter.create(tmp_path / "bag", storage, METADATA) as writer:
        writer.write(LOADER_STATE.name, 0, serialized(loader_state(0)))
        writer.flush()
        writer.write(VALVE_COMMAND.name, 1, serialized(valve_command(0)))
    assert not (tmp_path / "bag" / NOTE).exists()
    assert len(read_bag(tmp_path / "bag")) == 1
    with pytest.raises(BadInput, match="no recording was cut off here"):
        recover(tmp_path / "bag", tmp_path / "out")


def test_flushing_leaves_the_recording_as_it_is(tmp_path: Path):
    trajectory = make_trajectory(50)
    write_trajectory(tmp_path / "bag", trajectory)
    assert same(read_bag(tmp_path / "bag"), trajectory)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_file_cut_before_the_flush_is_refused(tmp_path: Path, storage: Storage):
    bag = killed(tmp_path / "bag", storage)
    file = storage_file(bag)
    os.truncate(file, file.stat().st_size // 3)
    for journal in bag.glob("*-journal"):
        journal.unlink()
    with pytest.raises(BadInput):
        recover(bag, tmp_path / "whole")


def test_a_flipped_bit_is_found(tmp_path: Path):
    bag = killed(tmp_path / "bag", "mcap")
    file = storage_file(bag)
    content = bytearray(file.read_bytes())
    next_message = b"\x05"  # a snapshot begins as a command does, but goes on
    content[content.index(serialized(valve_command(20)) + next_message) + 30] ^= 1
    file.write_bytes(content)
    with pytest.raises(BadInput, match="messages on /ehls/valve_command are damaged"):
        recover(bag, tmp_path / "new" / "whole")
    assert list(tmp_path.iterdir()) == [bag]


@pytest.mark.parametrize("storage", STORAGES)
def test_a_full_disk_leaves_no_half_of_a_bag(tmp_path: Path, storage: Storage):
    bag = killed(tmp_path / "bag", storage, flushed=3000)
    command = [sys.executable, "-m", "ehls_ros.cli.main", "recover", str(bag)]

    def limit() -> None:
        size = storage_file(bag).stat().st_size // 2
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=limit)
    assert done.returncode == 1
    assert str(tmp_path / "bag_recovered") in done.stderr
    assert list(tmp_path.iterdir()) == [bag]


def test_the_new_bag_is_named_in_what_is_wrong_with_it(tmp_path: Path):
    bag = killed(tmp_path / "bag", "sqlite3")
    out = tmp_path / "100 %"
    with pytest.raises(BadInput, match="the path holds one of") as caught:
        recover(bag, out)
    assert caught.value.where == str(out)


def test_the_new_bag_may_lie_in_new_folders(tmp_path: Path):
    bag = killed(tmp_path / "bag", "mcap")
    assert recover(bag, tmp_path / "a" / "b" / "whole") == 600
    assert len(read_bag(tmp_path / "a" / "b" / "whole")) == 300
    assert sorted(tmp_path.iterdir()) == [tmp_path / "a", bag]


@pytest.mark.parametrize("damage", ["{", "[]", '{"storage": "mcap"}', json.dumps({"flushed": {"/ehls/force": 3}})])
def test_a_damaged_note_is_refused(tmp_path: Path, damage: str):
    bag = killed(tmp_path / "bag", "mcap")
    (bag / NOTE).write_text(damage)
    with pytest.raises(BadInput, match="the note is damaged"):
        recover(bag, tmp_path / "whole")
