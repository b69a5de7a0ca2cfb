"""Recovery of files made to cost time, memory or other files: bounded by their true size, and ended by Ctrl-C."""

import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from patience import PATIENCE
from recorded_runs import storage_file
from test_recovery import cut_off
from tiers import tiered

from ehls_ros.recording import ledger
from ehls_ros.recording.damaged_bag import JOURNAL_MAGIC, damaged_bag
from ehls_ros.recording.mcap_salvage import MESSAGE_HEAD
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.salvage import MAX_WORK, SPENT

PAGE = 4096


@pytest.fixture
def compared(monkeypatch):
    """Return a list of the sizes of all messages that are compared with a ledger."""
    sizes = []
    checksum = ledger.message_checksum

    def counted(topic, stamp_ns, serialized):
        sizes.append(len(serialized))
        return checksum(topic, stamp_ns, serialized)

    monkeypatch.setattr(ledger, "message_checksum", counted)
    return sizes


def unsynced(tmp_path: Path, **header: object) -> tuple[Path, Path]:
    """Return the storage file and the journal, both hot, of a recorder that was killed before the journal was synchronised."""
    bag = cut_off(tmp_path / "bag", "sqlite3", unflushed=50)
    journal = bag / "bag.db3-journal"
    content = bytearray(journal.read_bytes())
    content[:12] = JOURNAL_MAGIC + b"\xff" * 4
    content[16:20] = struct.pack(">I", header.get("pages", int.from_bytes(content[16:20], "big")))
    content[24:28] = struct.pack(">I", header.get("page_size", PAGE))
    journal.write_bytes(bytes(content) + header.get("end", b""))
    return storage_file(bag), journal


@pytest.mark.parametrize("page_size", tiered([PAGE, 512, 0], PAGE))
@pytest.mark.parametrize("pages", [2**31, 2**32 - 1, 1000, 0])
def test_a_journal_that_claims_pages_that_are_not_there_costs_their_true_size(tmp_path: Path, pages: int, page_size: int):
    file, journal = unsynced(tmp_path, pages=pages, page_size=page_size)
    (tmp_path / "work").mkdir()
    with damaged_bag(file, tmp_path / "work") as (bag, _):
        assert len(bag.content) <= file.stat().st_size + journal.stat().st_size
    assert recover(file, tmp_path / "whole").recovered == 600


def test_a_journal_that_claims_what_is_there_is_rolled_back(tmp_path: Path):
    file, _ = unsynced(tmp_path)
    recovery = recover(file, tmp_path / "whole")
    assert (recovery.recovered, recovery.lost) == (600, 0)


def test_a_journal_cannot_have_another_file_deleted(tmp_path: Path):
    victim = tmp_path / "victim"
    victim.write_text("kept")
    name = str(victim).encode()
    end = struct.pack(">I", (1 << 30) // PAGE + 1) + name + struct.pack(">II", len(name), sum(name)) + JOURNAL_MAGIC
    file, _ = unsynced(tmp_path, end=end)
    assert recover(file, tmp_path / "whole").recovered == 600
    assert victim.read_text() == "kept"


def test_messages_that_begin_inside_each_other_cost_no_more_than_some_times_the_file(tmp_path: Path, compared: list[int]):
    bag = cut_off(tmp_path / "bag", "mcap")
    file = storage_file(bag)
    count, size = 6000, MESSAGE_HEAD.size
    nested = (MESSAGE_HEAD.pack(5, (count - number) * size - 9, 1, 0, number, number) for number in range(count))
    file.write_bytes(file.read_bytes() + b"".join(nested))
    recovery = recover(bag, tmp_path / "whole")
    assert (recovery.recovered, recovery.lost) == (600, 0)
    assert sum(compared) < (MAX_WORK + 2) * file.stat().st_size
    assert any(SPENT in remark for remark in recovery.remarks)


def varint(number: int) -> bytes:
    groups = [number & 0x7F]
    while number := number >> 7:
        groups.append(number & 0x7F | 0x80)
    return bytes(reversed(groups))


def test_rows_listed_again_and_again_cost_no_more_than_some_times_the_file(tmp_path: Path, compared: list[int]):
    bag = cut_off(tmp_path / "bag", "sqlite3")
    file = storage_file(bag)
    content = file.read_bytes()
    assert len(content) % PAGE == 0
    # SQLite keeps this many bytes of such a row in its page; the rest fills the overflow pages.
    here, times, overflowing = (PAGE - 12) * 32 // 255 - 23, 1000, 16
    length = here + overflowing * (PAGE - 4)
    row = b"\x07\x00\x01\x06" + varint(12 + 2 * (length - 16)) + b"\x01" + struct.pack(">q", 5)
    assert len(row) == 16
    cell = varint(length) + varint(1) + row
    first = len(content) // PAGE + 2
    at = 8 + 2 * times
    leaf = b"\x0d\x00\x00" + struct.pack(">H", times) + bytes(3) + struct.pack(">H", at) * times
    leaf += cell + bytes(here - len(row)) + struct.pack(">I", first)
    assert len(leaf) <= PAGE
    overflow = b"".join(struct.pack(">I", number + 1).ljust(PAGE, b"\0") for number in range(first, first + overflowing))
    file.write_bytes(content + leaf.ljust(PAGE, b"\0") + overflow)
    recovery = recover(bag, tmp_path / "whole")
    assert (recovery.recovered, recovery.lost) == (600, 0)
    assert sum(compared) < (MAX_WORK + 2) * file.stat().st_size
    assert any(SPENT in remark for remark in recovery.remarks)


@pytest.mark.parametrize("name", ["bag.db3", "bag.mcap"])
def test_a_search_through_a_large_file_is_ended_by_ctrl_c(tmp_path: Path, name: str):
    file = tmp_path / name
    file.write_bytes(b"SQLite format 3\0" if name.endswith("db3") else b"")
    with file.open("r+b") as stream:
        stream.truncate(1 << 40)
    command_line = [sys.executable, "-m", "ehls_ros.cli.main", "recover", str(file), "--out", str(tmp_path / "whole")]
    process = subprocess.Popen(command_line, stderr=subprocess.PIPE, text=True)
    try:
        until = time.monotonic() + PATIENCE
        while str(file) not in Path(f"/proc/{process.pid}/maps").read_text() and time.monotonic() < until:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60.0)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == [name]
