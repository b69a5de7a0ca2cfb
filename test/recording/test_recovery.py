"""Recovery of damaged or unclosed bags: all sound messages and no others are recovered, and losses are reported."""

import importlib.util
import json
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml
from full_disk import no_file_larger_than
from recorded_runs import METADATA, loader_state, make_trajectory, record, same, serialized, storage_file, valve_command
from tiers import tiered

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import BagWriter, Storage, write_trajectory
from ehls_ros.recording.ledger import ENTRY, MARK
from ehls_ros.recording.provenance import KEY, message_checksum
from ehls_ros.recording.recording_note import NOTE, Flushed, read_note, write_note
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.topics import CYCLE_TOPICS, DRIVING, LOADER_STATE, VALVE_COMMAND

STORAGES: list[Storage] = ["mcap", "sqlite3"]
STORAGE = pytest.mark.parametrize("storage", STORAGES)
FLUSHED, LOST = 2000, 700
START_NS = 1_700_000_000 * 10**9
STATES, COMMANDS = "/ehls/loader_state", "/ehls/valve_command"

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


def stamp_of(cycle: int) -> int:
    return START_NS + cycle * 10**6


@cache
def state(cycle: int) -> bytes:
    return serialized(loader_state(cycle, stamp_ns=stamp_of(cycle), force=float(cycle)))


@cache
def command(cycle: int) -> bytes:
    return serialized(valve_command(cycle, spool=cycle * 1e-6))


def cut_off(bag: Path, storage: Storage, cycles: int = 300, unflushed: int = 0, **metadata: object) -> Path:
    """Return a bag's folder as during the recording, flushed every hundred cycles; unflushed cycles are all equal."""
    writer = BagWriter.create(bag.with_name("at work") / bag.name, storage, metadata or METADATA)
    for cycle in range(cycles + unflushed):
        writer.write(LOADER_STATE.name, stamp_of(cycle), state(min(cycle, cycles)))
        writer.write(VALVE_COMMAND.name, stamp_of(cycle) + 5, command(min(cycle, cycles)))
        if cycle < cycles and cycle % 100 == 99:
            writer.flush()
    shutil.copytree(bag.with_name("at work") / bag.name, bag)
    writer.abort()
    shutil.rmtree(bag.with_name("at work"))
    return bag


def change(file: Path, old: bytes, new: bytes) -> None:
    content = file.read_bytes()
    assert content.count(old) == 1
    file.write_bytes(content.replace(old, new))


def flip(file: Path, at: int, bit: int = 0) -> None:
    content = bytearray(file.read_bytes())
    content[at] ^= 1 << bit
    file.write_bytes(content)


def forces(bag: Path) -> list[float]:
    return read_bag(bag)["force_n"].tolist()


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@STORAGE
def test_everything_a_killed_recorder_flushed_is_recovered(tmp_path: Path, storage: Storage):
    bag = tmp_path / "bag"
    script = KILLED_RECORDER.format(tests=str(Path(__file__).parent), bag=str(bag), storage=storage, flushed=FLUSHED, lost=LOST)
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    recovery = recover(bag, tmp_path / "whole")
    assert (recovery.recovered, recovery.lost, recovery.unverified) == (2 * FLUSHED, 0, 0)
    trajectory = read_bag(tmp_path / "whole")
    assert len(trajectory) == FLUSHED
    assert trajectory.metadata == METADATA
    assert np.all(np.isfinite(trajectory["valve_command_m"]))


@STORAGE
def test_reading_an_unclosed_bag_advises_recover_which_works(tmp_path: Path, storage: Storage, capsys):
    bag = cut_off(tmp_path / "bag", storage)
    with pytest.raises(BadInput, match="ehls recover"):
        read_bag(bag)
    assert main(["recover", str(bag)]) == 0
    assert "600 messages" in capsys.readouterr().out
    assert len(read_bag(tmp_path / "bag_recovered")) == 300
    assert main(["recover", str(bag)]) == 2
    assert "exists already" in capsys.readouterr().err


@STORAGE
def test_recovery_leaves_the_damaged_bag_unchanged(tmp_path: Path, storage: Storage):
    bag = cut_off(tmp_path / "bag", storage, unflushed=15_000)
    assert (bag / "bag.db3-journal").exists() == (storage == "sqlite3")
    before = contents(bag)
    recovery = recover(bag, tmp_path / "whole")
    assert contents(bag) == before
    assert recovery.unverified == 0
    assert forces(tmp_path / "whole")[:300] == list(range(300))


@STORAGE
def test_an_undamaged_bag_is_recovered_exactly(tmp_path: Path, storage: Storage):
    trajectory = make_trajectory(50)
    write_trajectory(tmp_path / "bag", trajectory, storage)
    recovery = recover(tmp_path / "bag", tmp_path / "whole")
    assert (recovery.lost, recovery.unverified, list(recovery.remarks)) == (0, 0, [])
    assert same(read_bag(tmp_path / "whole"), trajectory)


@STORAGE
@pytest.mark.parametrize(
    "rename",
    [
        lambda bag: bag.rename(bag.with_name("another")),
        lambda bag: storage_file(bag).rename(bag / "another.dat").parent,
        lambda bag: storage_file(bag).rename(bag.with_name("another.dat")),
    ],
    ids=["folder", "file", "file alone"],
)
def test_names_do_not_matter(tmp_path: Path, storage: Storage, rename: Callable[[Path], Path]):
    bag = rename(cut_off(tmp_path / "bag", storage))
    assert recover(bag, tmp_path / "whole").recovered == 600
    assert forces(tmp_path / "whole") == list(range(300))
    assert read_bag(tmp_path / "whole").metadata == METADATA


@STORAGE
@pytest.mark.parametrize(
    ("damage", "remark"),
    [
        (Path.unlink, "No such file"),
        (lambda note: os.truncate(note, 40), "damaged"),
        (lambda note: note.write_text("[" * 100_000), "damaged"),
        (lambda note: note.write_text(json.dumps({**json.loads(note.read_text()), "configuration": "x" * 10**7})), "damaged"),
        (lambda note: flip(note, note.read_bytes().index(b"300"), 1), "altered"),
    ],
    ids=["missing", "truncated", "deep", "huge", "flipped"],
)
def test_a_missing_or_damaged_note_costs_no_message_and_is_reported(
    tmp_path: Path, storage: Storage, damage: Callable[[Path], object], remark: str
):
    bag = cut_off(tmp_path / "bag", storage)
    damage(bag / NOTE)
    recovery = recover(bag, tmp_path / "whole")
    assert (recovery.recovered, recovery.lost, recovery.unverified) == (600, 0, 0)
    assert any(remark in line and "messages lost from the end are not counted" in line for line in recovery.remarks)
    assert read_bag(tmp_path / "whole").metadata == METADATA


@pytest.mark.parametrize("messages", [-5, 10**30, 1.5, "7", float("nan"), float("inf"), None, True])
@pytest.mark.parametrize("key", ["messages", "newest_ns"])
def test_a_note_with_an_invalid_number_is_refused(tmp_path: Path, key: str, messages: object):
    note = {"flushed": {STATES: {"messages": 1, "newest_ns": 1, key: messages}}, "checksum": ""}
    (tmp_path / NOTE).write_text(json.dumps(note))
    with pytest.raises(BadInput, match="the note is damaged"):
        read_note(tmp_path)


def test_a_note_without_topics_is_refused(tmp_path: Path):
    write_note(tmp_path, {})
    with pytest.raises(BadInput, match="the note is damaged"):
        read_note(tmp_path)


@STORAGE
def test_a_note_that_counts_too_few_messages_costs_none(tmp_path: Path, storage: Storage):
    bag = cut_off(tmp_path / "bag", storage)
    write_note(bag, {STATES: Flushed(0, 0)})
    assert recover(bag, tmp_path / "whole").recovered == 600
    assert forces(tmp_path / "whole") == list(range(300))


@STORAGE
@pytest.mark.parametrize("value", [float("nan"), "y" * 10**7], ids=["NaN", "huge"])
def test_a_configuration_that_would_make_the_bag_unreadable_is_left_out_and_reported(
    tmp_path: Path, storage: Storage, value: object
):
    recovery = recover(cut_off(tmp_path / "bag", storage, note=value), tmp_path / "whole")
    assert forces(tmp_path / "whole") == list(range(300))
    assert read_bag(tmp_path / "whole").metadata == {}
    assert recovery.remarks == ["the configuration of the run is lost"]


@STORAGE
def test_a_missing_tail_costs_its_messages_and_is_reported(tmp_path: Path, storage: Storage):
    bag = cut_off(tmp_path / "bag", storage, 1600)
    file = storage_file(bag)
    os.truncate(file, file.read_bytes().index(state(1400)))
    recovery = recover(bag, tmp_path / "whole")
    recovered = forces(tmp_path / "whole")
    assert recovered[:1360] == list(range(1360))  # a page of SQLite, which may be cut, holds fewer than 40 snapshots
    assert recovery.topics[STATES].lost == 1600 - len(recovered)
    assert recovery.topics[STATES].lost_between[-1].last_ns == stamp_of(1599)


@STORAGE
@pytest.mark.parametrize("noted", [True, False])
def test_a_damaged_message_costs_only_itself_and_is_reported(tmp_path: Path, storage: Storage, noted: bool):
    bag = cut_off(tmp_path / "bag", storage)
    if not noted:
        (bag / NOTE).unlink()
    file = storage_file(bag)
    flip(file, file.read_bytes().index(state(123)) + 40)
    recovery = recover(bag, tmp_path / "whole")
    assert forces(tmp_path / "whole") == [cycle for cycle in range(300) if cycle != 123]
    states = recovery.topics[STATES]
    assert (states.recovered, states.lost, states.unverified) == (299, 1, 0)
    assert [tuple(between) for between in states.lost_between] == [(1, stamp_of(123), stamp_of(123))]


@STORAGE
@pytest.mark.parametrize("bit", tiered([0, 32, 56], 32))
def test_any_flipped_bit_of_a_stamp_is_detected(tmp_path: Path, storage: Storage, bit: int):
    bag = cut_off(tmp_path / "bag", storage)
    stamp = stamp_of(7) + 5
    layout = "<QQ" if storage == "mcap" else ">Q"
    stamps = [struct.pack(layout, *[value] * len(layout[1:])) for value in (stamp, stamp ^ 1 << bit)]
    change(storage_file(bag), *(stamp + command(7) for stamp in stamps))
    assert recover(bag, tmp_path / "whole").topics[COMMANDS].lost == 1
    trajectory = read_bag(tmp_path / "whole")
    assert np.flatnonzero(np.isnan(trajectory["response_s"])).tolist() == [7]
    assert np.nanmax(trajectory["response_s"]) == 5e-9


def test_the_checksum_covers_topic_and_full_stamp():
    message = state(0)
    checksums = {
        message_checksum(topic, stamp, message) for topic in (STATES, COMMANDS) for stamp in (5, 5 + (1 << 32), 5 + (1 << 62))
    }
    assert len(checksums) == 6
    assert max(checksums) >= 1 << 32


@STORAGE
def test_a_message_moved_to_another_topic_is_dropped(tmp_path: Path, storage: Storage):
    bag = cut_off(tmp_path / "bag", storage)
    file = storage_file(bag)
    content = file.read_bytes()
    at = content.index(command(20))
    at -= 22 if storage == "mcap" else 9
    number = 1 + [topic.resolve() for topic in CYCLE_TOPICS].index(COMMANDS)
    assert content[at] == number, "not where the number of the topic stands"
    flip(file, at)
    recovery = recover(bag, tmp_path / "whole")
    assert (recovery.recovered, recovery.lost, recovery.topics[COMMANDS].lost) == (599, 1, 1)


@STORAGE
@pytest.mark.parametrize("start", tiered([256, 4096, 40_000, -9000], 4096))
def test_an_overwritten_block_costs_only_its_messages(tmp_path: Path, storage: Storage, start: int):
    bag = cut_off(tmp_path / "bag", storage)
    file = storage_file(bag)
    content = bytearray(file.read_bytes())
    start %= len(content)
    content[start : start + 4096] = bytes(4096)
    file.write_bytes(content)
    left = {cycle for cycle in range(300) if state(cycle) in content}
    recovery = recover(bag, tmp_path / "whole")
    recovered = set(forces(tmp_path / "whole"))
    assert recovered <= left
    if storage == "mcap" and start == 256:
        # The first chunk has lost its header and its block of the ledger.
        assert recovered == set(range(100, 300))
    else:
        # A message may have lost its header although its bytes are there.
        assert len(left - recovered) <= 2
    assert recovery.topics[STATES].lost == 300 - len(recovered)


def test_a_repeated_chunk_counts_once(tmp_path: Path):
    bag = cut_off(tmp_path / "bag", "mcap")
    file = storage_file(bag)
    file.write_bytes(file.read_bytes() + file.read_bytes())
    assert recover(bag, tmp_path / "whole").recovered == 600
    assert forces(tmp_path / "whole") == list(range(300))


@STORAGE
def test_a_damaged_ledger_costs_no_message(tmp_path: Path, storage: Storage):
    bag = cut_off(tmp_path / "bag", storage)
    file = storage_file(bag)
    checksum = message_checksum(STATES, stamp_of(150), state(150)).to_bytes(8, "little")
    flip(file, file.read_bytes().index(checksum))
    recovery = recover(bag, tmp_path / "whole")
    assert forces(tmp_path / "whole") == list(range(300))
    assert recovery.unverified == (0 if storage == "mcap" else 1)  # mcap's chunks have checksums too
    assert any("of the file's ledger are damaged" in remark for remark in recovery.remarks)


@STORAGE
def test_messages_that_do_not_decode_are_dropped(tmp_path: Path, storage: Storage):
    writer = BagWriter.create(tmp_path / "bag", storage, {})
    for cycle in range(5):
        writer.write(LOADER_STATE.name, stamp_of(cycle), state(cycle)[: -8 if cycle == 2 else None])
    writer.write(DRIVING.name, stamp_of(5), b"\0\1\0\0")
    writer.write(DRIVING.name, stamp_of(6), b"\0\1\0\0\1")
    writer.flush()
    writer.abort()
    recovery = recover(tmp_path / "bag", tmp_path / "whole")
    assert forces(tmp_path / "whole") == [0, 1, 3, 4]
    assert [recovery.topics[path].malformed for path in (STATES, "/ehls/driving")] == [1, 1]
    assert [recovery.topics[path].lost for path in (STATES, "/ehls/driving")] == [1, 1]


@STORAGE
def test_without_a_sound_snapshot_there_is_no_new_bag(tmp_path: Path, storage: Storage):
    writer = BagWriter.create(tmp_path / "bag", storage, {})
    writer.write(LOADER_STATE.name, 5, b"\0\1\0\0")
    writer.write(VALVE_COMMAND.name, 5, command(0))
    writer.flush()
    writer.abort()
    with pytest.raises(BadInput, match="no sound message of loader_state is left"):
        recover(tmp_path / "bag", tmp_path / "new" / "whole")
    assert list(tmp_path.iterdir()) == [tmp_path / "bag"]


@STORAGE
def test_a_new_bag_that_cannot_be_read_back_is_removed(tmp_path: Path, storage: Storage):
    writer = BagWriter.create(tmp_path / "bag", storage, {})
    for cycle in range(2):  # time goes backwards
        writer.write(LOADER_STATE.name, stamp_of(cycle), serialized(loader_state(cycle, stamp_ns=stamp_of(-cycle))))
    writer.flush()
    writer.abort()
    with pytest.raises(BadInput, match="its sound messages do not make a readable bag"):
        recover(tmp_path / "bag", tmp_path / "whole")
    assert list(tmp_path.iterdir()) == [tmp_path / "bag"]


@STORAGE
def test_messages_without_checksums_are_kept_and_reported(tmp_path: Path, storage: Storage):
    foreign = [loader_state(cycle, stamp_ns=stamp_of(cycle), force=float(cycle)) for cycle in range(500)]
    bag = record(tmp_path / "bag", foreign, storage)
    (bag / "metadata.yaml").unlink()
    file = storage_file(bag)
    os.truncate(file, file.stat().st_size // 2 // 4096 * 4096)
    recovery = recover(bag, tmp_path / "whole")
    recovered = forces(tmp_path / "whole")
    assert recovered == list(range(len(recovered)))
    assert 100 < len(recovered) == recovery.unverified
    assert any("no ledger" in remark for remark in recovery.remarks)


@STORAGE
def test_a_message_without_checksum_and_with_an_absurd_time_is_dropped(tmp_path: Path, storage: Storage):
    foreign = [loader_state(cycle, stamp_ns=stamp_of(cycle)) for cycle in range(50)]
    foreign[20] = foreign[20]._replace(received_ns=stamp_of(20) ^ 1 << 56)
    recovery = recover(record(tmp_path / "bag", foreign, storage), tmp_path / "whole")
    assert (recovery.recovered, recovery.topics[STATES].malformed) == (49, 1)


def test_a_foreign_chunk_with_a_wrong_checksum_is_dropped_and_reported(tmp_path: Path):
    bag = cut_off(tmp_path / "bag", "mcap")
    file = storage_file(bag)
    content = file.read_bytes()
    # Without the ledger the file is like another recorder's.
    file.write_bytes(content.replace(MARK, bytes(len(MARK))))
    flip(file, content.index(state(150)) + 40)
    recovery = recover(bag, tmp_path / "whole")
    assert forces(tmp_path / "whole") == [*range(100), *range(200, 300)]
    assert (recovery.unverified, recovery.topics[STATES].lost) == (0, 100)
    assert any("is damaged" in remark for remark in recovery.remarks)


@STORAGE
def test_the_loss_is_reported_as_text_as_json_and_in_the_bag(tmp_path: Path, storage: Storage, capsys):
    bag = cut_off(tmp_path / "bag", storage)
    flip(storage_file(bag), storage_file(bag).read_bytes().index(state(123)) + 40)
    assert main(["recover", str(bag), "--out", str(tmp_path / "whole"), "--json"]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert lines == [
        f"599 messages in {tmp_path / 'whole'}, 1 known to be lost",
        f"  {STATES}: 1 lost of 300",
        f"    1 sent at {stamp_of(123) / 1e9:.3f} s",
    ]
    reported = json.loads(last)
    assert reported.pop("bag") == str(tmp_path / "whole")
    assert (reported["recovered"], reported["lost"], reported["unverified"]) == (599, 1, 0)
    metadata = yaml.safe_load((tmp_path / "whole" / "metadata.yaml").read_text(encoding="utf-8"))
    assert json.loads(metadata["rosbag2_bagfile_information"]["custom_data"][KEY])["recovery"] == reported


@STORAGE
def test_flushing_does_not_change_the_recording(tmp_path: Path, storage: Storage):
    with BagWriter.create(tmp_path / "bag", storage, METADATA) as writer:
        for cycle in range(30):
            writer.write(LOADER_STATE.name, stamp_of(cycle), state(cycle))
            writer.flush()
    assert forces(tmp_path / "bag") == list(range(30))


@pytest.mark.long
@STORAGE
def test_a_full_disk_leaves_no_partial_bag(tmp_path: Path, storage: Storage):
    bag = cut_off(tmp_path / "bag", storage, 600)
    command_line = [sys.executable, "-m", "ehls_ros.cli.main", "recover", str(bag)]

    def limit() -> None:
        size = storage_file(bag).stat().st_size // 2
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    done = subprocess.run(command_line, capture_output=True, text=True, check=False, preexec_fn=limit)
    assert done.returncode == 1
    assert str(tmp_path / "bag_recovered") in done.stderr
    assert list(tmp_path.iterdir()) == [bag]


@STORAGE
def test_messages_flushed_before_the_disk_was_full_are_recovered(tmp_path: Path, storage: Storage):
    flushed = []

    def fill() -> None:
        writer = BagWriter.create(tmp_path / "bag", storage, METADATA)
        for cycle in range(10_000):
            writer.write(LOADER_STATE.name, stamp_of(cycle), state(cycle))
            if cycle % 100 == 99:
                writer.flush()
                flushed.append(cycle)

    with no_file_larger_than(300_000), pytest.raises(OSError, match="the bag is incomplete"):
        fill()
    recovery = recover(tmp_path / "bag", tmp_path / "whole")
    recovered = forces(tmp_path / "whole")
    assert 1000 < flushed[-1] < len(recovered)
    assert recovered == list(range(len(recovered)))
    assert recovery.unverified == 0


def test_an_error_names_the_new_bag(tmp_path: Path):
    bag = cut_off(tmp_path / "bag", "sqlite3")
    out = tmp_path / "100 %"
    with pytest.raises(BadInput, match="the path contains") as caught:
        recover(bag, out)
    assert caught.value.where == str(out)


def test_the_new_bag_may_lie_in_new_folders(tmp_path: Path):
    bag = cut_off(tmp_path / "bag", "mcap")
    assert recover(bag, tmp_path / "a" / "b" / "whole").recovered == 600
    assert len(read_bag(tmp_path / "a" / "b" / "whole")) == 300
    assert sorted(tmp_path.iterdir()) == [tmp_path / "a", bag]


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda _: None, "it does not exist"),
        (Path.mkdir, "there is no storage file"),
        (Path.touch, "it is empty"),
        (os.mkfifo, "it is a"),
        (lambda path: path.write_bytes(bytes(5000)), "no topic loader_state is left"),
        (lambda path: (path.mkdir(), (path / "a.mcap").touch(), (path / "b.db3").touch()), "2 storage files: a.mcap, b.db3"),
    ],
)
def test_anything_but_a_bag_is_refused(tmp_path: Path, make: Callable[[Path], object], complaint: str):
    make(tmp_path / "bag")
    with pytest.raises(BadInput, match=complaint):
        recover(tmp_path / "bag", tmp_path / "whole")


def test_blocks_of_the_ledger_fit_a_page_however_long_the_names_are(tmp_path: Path):
    namespace = "/" + "".join(chr(97 + index % 26) for index in range(200))
    writer = BagWriter.create(tmp_path / "bag", "sqlite3", {}, namespace=namespace)
    for cycle in range(400):
        writer.write(LOADER_STATE.name, stamp_of(cycle), state(cycle))
    writer.close()
    content = storage_file(tmp_path / "bag").read_bytes()
    marks = [at for at in range(len(content)) if content.startswith(MARK, at)]
    assert len(marks) >= 400 * ENTRY.size // 4000
    recovery = recover(tmp_path / "bag", tmp_path / "whole")
    assert (recovery.recovered, recovery.unverified) == (400, 0)


KINDS = ("truncations", "flips", "notes")


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "recovery.py"
    spec = importlib.util.spec_from_file_location("recovery_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["recovery_benchmark"] = module
    spec.loader.exec_module(module)
    return module


@STORAGE
@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_random_damage_costs_only_what_it_hits(tmp_path: Path, benchmark: ModuleType, storage: Storage, kind: str):
    left = benchmark.left_behind(tmp_path / "bag", storage, 60, 1)
    outcomes = benchmark.tried(left, kind, 12, 2)
    assert sum(outcome.lost for outcome in outcomes) == 0
    assert sum(outcome.wrong for outcome in outcomes) == 0
    assert not any(outcome.unreadable or outcome.told_wrong for outcome in outcomes)
    assert sum(outcome.recovered for outcome in outcomes) > 0
