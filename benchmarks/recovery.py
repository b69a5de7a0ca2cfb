"""Damaged bags: result of `ehls recover`, compared with the recorded messages.

usage: python -m benchmarks.recovery [--truncations 200] [--flips 200] [--notes 30] [--cycles 400] [--seed 1]

A recorder is killed; then its file is truncated, a bit of it flipped, or the note edited. The truth is the list of the messages
written and their places in the intact file, independent of the recovery. Two columns count intact messages that were lost:
outside the damaged message, and outside the damaged mcap chunk or SQLite page. `wrong` are recovered messages that were never
written; `wrong losses` are bags with a wrong report of losses.
"""

import json
import multiprocessing
import os
import random
import shutil
import signal
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag2 import Reader

from benchmarks.common import parser_of, print_heading, print_row
from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import BagWriter, Storage
from ehls_ros.recording.recording_note import NOTE
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.topics import DRIVING
from ehls_ros.recording.trajectory_messages import streams_of
from ehls_ros.trajectory import SIGNALS, Trajectory

STORAGES: tuple[Storage, ...] = ("mcap", "sqlite3")
START_NS = 1_700_000_000 * 10**9
FLUSHES = 6
"""Flushes before the recorder is killed."""

UNFLUSHED = 0.1
"""Fraction of the messages written after the last flush."""

SNAPSHOTS = "/ehls/loader_state"

FAST = Path("/dev/shm") if Path("/dev/shm").is_dir() else None  # noqa: S108 - a separate folder in it, if there is one
"""Folder of the bags in memory, so that the disk is not measured."""

Message = tuple[str, int, bytes]
"""Full topic name, sending time [ns], and the message as CDR."""


class Place(NamedTuple):
    """Place of a message in the intact file: its bytes, and those of its chunk or page."""

    message: Message
    start: int
    end: int
    unit_start: int
    unit_end: int


class Left(NamedTuple):
    """Files left by a killed recorder, and the truth about them."""

    folder: Path
    storage: Storage
    file: str
    written: Counter[Message]
    flushed: int
    places: list[Place]


class Outcome(NamedTuple):
    """Result for one damaged bag."""

    refused: bool
    recovered: int
    lost: int
    lost_beyond: int
    wrong: int
    unreadable: bool
    told_wrong: bool
    seconds: float


def messages(cycles: int, seed: int) -> list[tuple[str, int, bytes]]:
    """Return the messages of a graph over some cycles: the writer's topic name, sending time, and message, in order."""
    draw = np.random.default_rng(seed)
    signals = {name: draw.normal(size=cycles) for name in SIGNALS}
    signals["friction_elements_n"] = draw.normal(size=(cycles, 4))
    signals["friction_slipping"] = draw.integers(0, 2, (cycles, 4)).astype(float)
    signals["saturated"] = signals["at_bound"] = signals["friction_fallback"] = draw.integers(0, 2, cycles).astype(float)
    signals["response_s"] = draw.integers(10**5, 10**6, cycles) / 1e9
    trajectory = Trajectory(START_NS / 1e9 + 1e-3 * np.arange(cycles, dtype=np.float64), signals, {})
    sent = [
        (stamp_ns, stream.topic.name, message)
        for stream in streams_of(trajectory, "benchmark")
        for stamp_ns, message in zip(stream.sent_ns.tolist(), stream.messages, strict=True)
    ]
    sent += [(START_NS + 10**7 * index + 7, DRIVING.name, b"\0\1\0\0" + bytes([index % 2])) for index in range(cycles // 10)]
    return [(topic, stamp_ns, message) for stamp_ns, topic, message in sorted(sent)]


def record_and_die(folder: Path, storage: Storage, sent: Sequence[tuple[str, int, bytes]]) -> None:
    """Record messages in a process that kills itself before it closes the bag."""

    def recorder() -> None:
        writer = BagWriter.create(folder, storage, {"rig": {"moving_mass": 70.5}})
        last = int((1 - UNFLUSHED) * len(sent))
        for index, message in enumerate(sent):
            if index <= last and index and index % (last // FLUSHES) == 0:
                writer.flush()
            writer.write(*message)
        os.kill(os.getpid(), signal.SIGKILL)

    process = multiprocessing.get_context("fork").Process(target=recorder)
    process.start()
    process.join()
    if process.exitcode != -signal.SIGKILL:
        sys.exit("the recorder did not die as it should")


def left_behind(folder: Path, storage: Storage, cycles: int, seed: int) -> Left:
    """Return the files left by a killed recorder."""
    sent = messages(cycles, seed)
    record_and_die(folder, storage, sent)
    last = int((1 - UNFLUSHED) * len(sent))
    flushed = last // (last // FLUSHES) * (last // FLUSHES)
    written = [(f"/ehls/{topic}", stamp_ns, message) for topic, stamp_ns, message in sent]
    file = f"{folder.name}{'.mcap' if storage == 'mcap' else '.db3'}"
    content = (folder / file).read_bytes()
    where = in_mcap if storage == "mcap" else in_sqlite
    return Left(folder, storage, file, Counter(written), flushed, where(content, written[:flushed]))


def in_mcap(content: bytes, written: Sequence[Message]) -> list[Place]:
    """Find the messages in an intact mcap file."""
    places, chunk, behind = [], 0, 0
    offset = 8
    chunks = []
    while offset + 9 <= len(content):
        kind, length = struct.unpack_from("<BQ", content, offset)
        if kind == 0x06:
            chunks.append((offset, offset + 9 + length))
        offset += 9 + length
    for message in written:
        body = struct.pack("<QQ", message[1], message[1]) + message[2]
        at = content.index(body, behind)
        behind = at + len(body)
        while chunks[chunk][1] < behind:
            chunk += 1
        places.append(Place(message, at - 15, behind, *chunks[chunk]))
    return places


def in_sqlite(content: bytes, written: Sequence[Message]) -> list[Place]:
    """Find the messages in an intact SQLite file, whose pages have 4096 bytes."""
    places = []
    for message in written:
        body = struct.pack(">Q", message[1]) + message[2]
        at = content.index(body)
        page = at // 4096 * 4096
        places.append(Place(message, at - 12, at + len(body), page, page + 4096))
    return places


def resealed(note: Any) -> Any:
    """Return a note with a valid checksum, following the note's documented format."""
    digest = int.from_bytes(blake2b(json.dumps(note["flushed"]).encode(), digest_size=8).digest(), "little")
    return {**note, "checksum": f"blake2b-{digest:016x}"}


def edited(draw: random.Random, bag: Path, file: str) -> str:
    """Edit a bag's note, or rename its folder or file; return the change."""
    path = bag / NOTE
    whole = json.loads(path.read_bytes())
    topic = draw.choice(list(whole["flushed"]))
    counts: dict[str, object] = {
        "zero": 0,
        "negative": -5,
        "huge": 10**30,
        "float": 1.5,
        "NaN": float("nan"),
        "infinite": float("inf"),
        "text": "7",
    }
    changes: dict[str, Callable[[], object]] = {
        "absent": path.unlink,
        "empty": lambda: path.write_bytes(b""),
        "cut": lambda: os.truncate(path, draw.randrange(path.stat().st_size)),
        "rubbish": lambda: path.write_bytes(draw.randbytes(200)),
        "deep": lambda: path.write_text("[" * 100_000, encoding="utf-8"),
        "no topics": lambda: path.write_text(json.dumps(resealed({"flushed": {}})), encoding="utf-8"),
        "huge configuration": lambda: path.write_text(json.dumps({**whole, "configuration": "x" * 10**7}), encoding="utf-8"),
        "a flipped bit": lambda: flipped(path, draw.randrange(8 * path.stat().st_size)),
        "folder renamed": lambda: bag.rename(bag.with_name("renamed")),
        "file renamed": lambda: (bag / file).rename(bag / "renamed.dat"),
    }
    for name, count in counts.items():
        for key in ("messages", "newest_ns"):
            note = {**whole, "flushed": {**whole["flushed"], topic: {**whole["flushed"][topic], key: count}}}
            sealed = resealed(note) if draw.random() < 0.5 else note
            changes[f"{name} {key}"] = partial(path.write_text, json.dumps(sealed), encoding="utf-8")
    what = draw.choice(list(changes))
    changes[what]()
    return what


def flipped(path: Path, bit: int) -> None:
    """Flip one bit of a file."""
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def judged(left: Left, bag: Path, intact: Callable[[Place], bool], beyond: Callable[[Place], bool], *, told: bool) -> Outcome:
    """Recover a bag and compare it with the messages written.

    Args:
        left: the bag before the damage.
        bag: the damaged bag.
        intact: whether a message's bytes are unchanged.
        beyond: whether its chunk or page is unchanged.
        told: whether the bag still contains its number of messages.
    """
    out = bag.with_name("out")
    began = time.process_time()
    try:
        recovery = recover(bag, out)
    except BadInput:
        recovery = None
    took = time.process_time() - began
    found: Counter[Message] = Counter()
    unreadable = False
    if recovery is not None:
        try:
            unreadable = not len(read_bag(out))
            with Reader(out) as reader:
                found.update((connection.topic, stamp_ns, data) for connection, stamp_ns, data in reader.messages())
        except Exception:  # noqa: BLE001 - any exception means unreadable
            unreadable = True
    sound = [place for place in left.places if intact(place)]
    # Without a snapshot there is no run.
    possible = recovery is not None or any(place.message[0] == SNAPSHOTS for place in sound)
    missing = (Counter(place.message for place in left.places) - found) if possible else Counter[Message]()
    lost = [place for place in sound if missing[place.message]]
    really = left.flushed - sum((found & Counter(place.message for place in left.places)).values())
    told_wrong = recovery is not None and told and recovery.lost != really
    return Outcome(
        recovery is None,
        sum(found.values()),
        len(lost),
        sum(beyond(place) for place in lost),
        sum((found - left.written).values()),
        unreadable,
        told_wrong,
        took,
    )


def truncated(draw: random.Random, left: Left, bag: Path) -> Outcome:
    """Truncate the storage file at random and recover it."""
    size = draw.randrange((bag / left.file).stat().st_size)
    os.truncate(bag / left.file, size)
    return judged(left, bag, lambda place: place.end <= size, lambda place: place.unit_end <= size, told=True)


def bit_flipped(draw: random.Random, left: Left, bag: Path) -> Outcome:
    """Flip a random bit of the storage file and recover it."""
    bit = draw.randrange(8 * (bag / left.file).stat().st_size)
    flipped(bag / left.file, bit)
    at = bit // 8
    return judged(
        left,
        bag,
        lambda place: not place.start <= at < place.end,
        lambda place: not place.unit_start <= at < place.unit_end,
        told=True,
    )


def note_edited(draw: random.Random, left: Left, bag: Path) -> Outcome:
    """Edit the note and recover the bag."""
    what = edited(draw, bag, left.file)
    told = "huge" not in what and "1e" not in what
    return judged(left, bag if bag.exists() else bag.with_name("renamed"), lambda _: True, lambda _: True, told=told)


TRIALS: dict[str, Callable[[random.Random, Left, Path], Outcome]] = {
    "truncations": truncated,
    "flips": bit_flipped,
    "notes": note_edited,
}


def tried(left: Left, kind: str, trials: int, seed: int) -> list[Outcome]:
    """Damage fresh copies of a bag many times."""
    draw = random.Random(f"{seed} {kind}")  # noqa: S311 - random damage
    outcomes = []
    for _ in range(trials):
        with tempfile.TemporaryDirectory(dir=FAST) as folder:
            bag = Path(folder) / left.folder.name
            shutil.copytree(left.folder, bag)
            outcomes.append(TRIALS[kind](draw, left, bag))
    return outcomes


def writers_time(storage: Storage, cycles: int, seed: int) -> tuple[float, float]:
    """Return the processor time per message, including flushes, and per flush; the best of five [s]."""
    sent, best, flush = messages(cycles, seed), np.inf, np.inf
    every = len(sent) // FLUSHES
    for _ in range(5):
        with tempfile.TemporaryDirectory(dir=FAST) as folder:
            writer = BagWriter.create(Path(folder) / "bag", storage, {})
            flushing, began = 0.0, time.process_time()
            for index, message in enumerate(sent):
                writer.write(*message)
                if index % every == every - 1:
                    before = time.process_time()
                    writer.flush()
                    flushing += time.process_time() - before
            best = min(best, (time.process_time() - began) / len(sent))
            flush = min(flush, flushing / FLUSHES)
            writer.close()
    return best, flush


COLUMNS = (
    "trials",
    "refused",
    "recovered (median)",
    "intact lost",
    "outside chunk or page",
    "wrong",
    "unreadable",
    "wrong losses",
    "slowest [processor s]",
)


def row(outcomes: Sequence[Outcome]) -> list[float]:
    """Return a row of the table."""
    return [
        len(outcomes),
        sum(outcome.refused for outcome in outcomes),
        np.median([outcome.recovered for outcome in outcomes]),
        sum(outcome.lost for outcome in outcomes),
        sum(outcome.lost_beyond for outcome in outcomes),
        sum(outcome.wrong for outcome in outcomes),
        sum(outcome.unreadable for outcome in outcomes),
        sum(outcome.told_wrong for outcome in outcomes),
        max(outcome.seconds for outcome in outcomes),
    ]


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    for kind, trials in (("truncations", 200), ("flips", 200), ("notes", 30)):
        parser.add_argument(f"--{kind}", type=int, default=trials)
    parser.add_argument("--cycles", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print_heading("storage", "damage", *COLUMNS)
    for storage in STORAGES:
        with tempfile.TemporaryDirectory(dir=FAST) as folder:
            left = left_behind(Path(folder) / "bag", storage, options.cycles, options.seed)
            for kind in TRIALS:
                outcomes = tried(left, kind, getattr(options, kind), options.seed)
                print_row(storage, kind, *(f"{figure:.4g}" for figure in row(outcomes)))
    for storage in STORAGES:
        message, flush = writers_time(storage, options.cycles, options.seed)
        per_message, per_flush = f"{message * 1e6:.2f} µs per message with flushes", f"{flush * 1e3:.2f} ms per flush"
        print(f"writing to {storage}, processor time: {per_message}, {per_flush}")


if __name__ == "__main__":
    main()
