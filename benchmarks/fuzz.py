"""Random and damaged inputs for the readers of foreign data: none may crash, hang, or leak memory.

python -m benchmarks.fuzz --target csv --inputs 1000000 --keep failed

Every input is either accepted or refused in one line (``BadInput``). A worker process with limited memory reads them, so that a
crash within a C library is detected too; the files of an input that fails are copied to ``--keep``.
"""

import argparse
import json
import math
import multiprocessing
import random
import resource
import shutil
import signal
import sqlite3
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, MutableSequence, Sequence
from contextlib import closing
from functools import partial
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from benchmarks.common import parser_of
from ehls_ros.errors import LONGEST as PART
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.hardware.bridge_file import bridge_from_mapping
from ehls_ros.hardware.packet import HEADER, MAGIC, MAX_SIZE, MAX_VALUES, VERSION, Codec, Kind, Packet
from ehls_ros.recording.bag_writer import BagWriter, Storage, write_trajectory
from ehls_ros.recording.columns import Column, ColumnMap, read_columns
from ehls_ros.recording.load import load
from ehls_ros.recording.provenance import Provenance
from ehls_ros.recording.recording_note import NOTE
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.topics import FRICTION_ESTIMATE, LOADER_STATE
from ehls_ros.recording.trajectory_messages import streams_of
from ehls_ros.recording.typestore import typestore
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.trajectory import SIGNALS, Trajectory

SLOWEST = 3.0
"""Processor time for one input above which it counts as a hang [s]."""

STUCK = 60.0
"""Time without any progress after which the worker is killed [s]."""

MEMORY = 2**29
"""Maximum memory of an input beyond the worker's at its start [bytes]."""

LONGEST = 3 * PART + 100
"""Longest readable error message [characters]."""

FAST = Path("/dev/shm")  # noqa: S108 - a folder in memory; the subfolder for the inputs is made by tempfile
"""Folder for the inputs' files, if it exists."""

Target = Callable[[random.Random, Path], Callable[[], object]]
"""Writes one input to a folder and returns the function that reads it."""


class Hang(BaseException):
    """Timeout of an input; a BaseException, so that no handler catches it."""


def on_time_up(number: int, frame: FrameType | None) -> None:
    """Interrupt a reader that takes too long."""
    raise Hang


def outcome_of(read: Callable[[], object]) -> str:
    """Read one input and return the outcome: ``taken``, ``refused``, or the error."""
    signal.setitimer(signal.ITIMER_PROF, SLOWEST)
    try:
        read()
    except BadInput as error:
        line = str(error)
        return "refused" if line.isprintable() and len(line) <= LONGEST else "refused, but not in one readable line"
    except Hang:
        return "hang"
    except Exception as error:  # noqa: BLE001 - any exception is a finding
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        place = f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}" if trace else ""
        return f"{type(error).__name__} in {place}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return "taken"


def fuzz(
    target: Target,
    inputs: int,
    seed: int,
    folder: Path,
    keep: Path | None = None,
    progress: "Synchronized[int] | None" = None,
    seconds: float = math.inf,
) -> Counter[str]:
    """Feed a reader.

    Args:
        target: makes the inputs.
        inputs: number of inputs.
        seed: seed of the inputs.
        folder: folder for the inputs; afterwards it holds the last one.
        keep: folder for one input of each failure.
        progress: set to the number of the present input.
        seconds: time limit for making further inputs [s].

    Returns:
        Number of inputs by outcome.
    """
    signal.signal(signal.SIGPROF, on_time_up)
    draw = random.Random(seed)  # noqa: S311
    outcomes: Counter[str] = Counter()
    end = time.monotonic() + seconds
    for number in range(inputs):
        if time.monotonic() > end:
            break
        if progress is not None:
            progress.value = number
        outcome = outcome_of(target(draw, folder))
        outcomes[outcome] += 1
        if keep is not None and outcome not in {"taken", "refused"} and outcomes[outcome] == 1:
            shutil.copytree(folder, keep / f"{seed}_{number}", dirs_exist_ok=True)
            print(f"{keep}/{seed}_{number}: {outcome}", flush=True)
    return outcomes


NUMBERS = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)


def spoilt(draw: random.Random, whole: bytes) -> bytes:
    """Return damaged bytes: cut, bits flipped, a number overwritten, a section removed, repeated or moved."""
    result = bytearray(whole)
    if not result:
        return draw.randbytes(draw.randint(1, 16))
    place, length = draw.randrange(len(result)), draw.choice((1, 1, 2, 4, 8, 64))
    match draw.randrange(8):
        case 0:
            del result[place:]
        case 1:
            for _ in range(length):
                result[draw.randrange(len(result))] ^= 1 << draw.randrange(8)
        case 2:
            width = draw.choice((1, 2, 4, 8))
            number = (draw.choice(NUMBERS) + draw.choice((0, 0, 1, -1))) % 2 ** (8 * width)
            result[place : place + width] = number.to_bytes(width, draw.choice(("little", "big")))
        case 3:
            del result[place : place + length]
        case 4:
            result[place:place] = result[place : place + length] * draw.randint(1, 4)
        case 5:
            result[place:place] = draw.randbytes(length)
        case 6:
            other = draw.randrange(len(result))
            result[place : place + length] = result[other : other + length]
        case _:
            result[place : place + length] = bytes(length)
    return bytes(result)


def sample_packet(draw: random.Random) -> Packet:
    """Return a valid packet."""
    kind = draw.choice(list(Kind))
    count = {Kind.HELLO: 0, Kind.COMMAND: 1}.get(kind, draw.randint(1, MAX_VALUES))
    return Packet(
        kind=kind,
        session=draw.getrandbits(64) | 1,
        peer=draw.getrandbits(64),
        sequence=draw.getrandbits(draw.choice((8, 32, 64))),
        answered=draw.getrandbits(draw.choice((8, 32, 64))),
        time_ns=draw.getrandbits(63) - 2**62,
        watchdog_us=draw.randint(1, 10**6) if kind == Kind.COMMAND else 0,
        status=draw.randint(0, 2) if kind == Kind.MEASUREMENT else 0,
        values=tuple(draw.uniform(-10.0, 10.0) for _ in range(count)),
    )


def spoilt_packets(seed: int, codec: Codec) -> Iterator[bytes]:
    """Yield damaged packets without end: noise, noise after a valid header, and packets cut, extended, altered or joined."""
    draw = random.Random(seed)  # noqa: S311
    while True:
        whole = codec.pack(sample_packet(draw))
        match draw.randrange(7):
            case 0:
                yield draw.randbytes(draw.randrange(2 * MAX_SIZE))
            case 1:
                yield MAGIC + bytes([VERSION, draw.randrange(5)]) + draw.randbytes(draw.randrange(MAX_SIZE))
            case 2:
                yield whole[: draw.randrange(len(whole))]
            case 3:
                yield whole + draw.randbytes(draw.randint(1, 64))
            case 4:
                turned = bytearray(whole)
                for _ in range(draw.randint(1, 4)):
                    turned[draw.randrange(len(turned))] ^= 1 << draw.randrange(8)
                yield bytes(turned)
            case 5:
                # A damaged packet with a valid checksum.
                body = bytearray(whole[:-8])
                position = draw.randrange(len(body))
                body[position] = draw.randrange(256)
                if draw.random() < 0.1:
                    body[8:16] = bytes(8)
                if len(body) > HEADER.size and draw.random() < 0.5:
                    body[HEADER.size : HEADER.size + 8] = struct.pack("<d", draw.choice((float("nan"), float("inf"), 1e300)))
                yield bytes(body) + codec.tag(bytes(body))
            case _:
                yield whole


def fuzz_packet(inputs: int, seed: int) -> Counter[str]:
    """Feed the packet parser; return the number of packets by outcome."""
    codec = Codec()
    outcomes: Counter[str] = Counter()
    for _, data in zip(range(inputs), spoilt_packets(seed, codec), strict=False):
        start = time.perf_counter()
        packet = codec.parse(data)
        if time.perf_counter() - start > SLOWEST:
            outcomes["hang"] += 1
        if packet is None:
            continue
        # An accepted packet is complete: packed again, it gives the same bytes.
        outcomes["taken"] += 1
        outcomes["changed"] += codec.pack(packet) != data
    return outcomes + Counter({f"refused_{reason}": count for reason, count in codec.refused.items()})


CELLS = (
    *("", " ", "nan", "NaN", "inf", "-inf", "1e308", "1e309", "-1e999", "5e-324", "0x10", "1_000", "1,5", "1;5", "--1", "1e"),
    *(
        "true",
        "'1'",
        '"',
        '"1',
        '""',
        '"1\n2"',
        "\n",
        "\r",
        "\r\n",
        "\0",
        "\x1b[31m",
        "\u2028",
        "\x85",
        "\u0663",
        "\u2212" + "1",
    ),
    *("\ufeff", "a" * 500, "9" * 400, "0." + "1" * 400, "9" * 5000, "9" * 140_000, "time_s", "force_n"),
    *("friction_elements_n_2", "friction_slipping_1"),
)
"""Contents of a cell, mostly invalid."""

HEADERS = ("time_s", *SIGNALS, "friction_elements_n_1", "friction_elements_n_2", "friction_elements_n_99", "other")


def csv_input(draw: random.Random, folder: Path) -> Callable[[], object]:
    """Write a table with a few wrong cells, rows, separators or bytes."""
    names = ["time_s", *draw.sample(HEADERS, draw.randint(1, 4))]
    table = [names, *([repr(0.001 * k), *(repr(draw.gauss(0.0, 1e3)) for _ in names[1:])] for k in range(draw.randrange(6)))]
    for _ in range(draw.choice((0, 1, 1, 1, 2, 3))):
        row = draw.choice(table)
        match draw.randrange(7):
            case 0 | 1 | 2:
                if row:
                    row[draw.randrange(len(row))] = draw.choice(CELLS)
            case 3:
                row.append(draw.choice(CELLS))
            case 4:
                del row[-1:]
            case 5:
                table.insert(draw.randrange(len(table) + 1), list(row))
            case _:
                row[:] = row * draw.choice((0, 2, 1000)) if sum(map(len, row)) < 1000 and draw.random() < 0.1 else row[::-1]
    separator = draw.choice((",", ",", ";", "\t", " ", ", "))
    text = draw.choice(("\n", "\n", "\r\n", "\r")).join(separator.join(row) for row in table)
    content = text.encode(draw.choice(("utf-8",) * 8 + ("utf-8-sig", "utf-16")))
    if draw.random() < 0.3:
        content = spoilt(draw, content)
    path = folder / "data.csv"
    path.write_bytes(content)
    columns: dict[str, Column] = {}
    if draw.random() < 0.1:
        columns = {"force_n": Column(draw.choice(HEADERS), draw.choice((1.0, 1e308))), "time_s": Column("other")}
    return lambda: load(path, ColumnMap(columns))


VALUES = (
    *("", "~", "1", "-1", "0", "1e400", ".nan", ".inf", "-.inf", "1e-320", "0x" + "f" * 40, "0x" + "f" * 5000, "9" * 5000),
    *("1_0", "0o17", "true", "no", "[]", "{}", "[1, 2, 3]", "{a: 1}", "[[[[1]]]]", "{name: sine}", "sine", "gms", "'text'"),
    *('"\\ud800"', '"\\0"', "../..", "nothing.yaml", "rig.yaml", "spec.yaml", "/", "/dev/null", "2001-01-01", "2001-99-99"),
    *(
        "1:60:60",
        "1" + ":59" * 500 + ".5",
        "*a",
        "&a [*a]",
        "&a 1",
        "!!python/object:os.system x",
        "!!binary aGk=",
        "!!binary x",
    ),
    *("!!set {a, b}", "!!float x", "!!int ''", "!!bool x", "!!timestamp x", "!!omap [a: 1]", "!!pairs [a]", "!!null x", "!x y"),
    *("|", ">-", "'", '"', "[", "{", "]", "? a", "- 1", "[" * 60 + "]" * 60, "[" * 5000, "{a: " * 3000, "- " * 3000 + "1"),
    *("a" * 2000, "\x1b[31m", "\t", "\u2028", "é", "\U0001f600", "%YAML 9.9"),
)
"""YAML values, mostly invalid."""

KEYS = (
    *(
        "name",
        "<<",
        "=",
        "1",
        "~",
        "[a]",
        "{a: 1}",
        "? [a]",
        "''",
        "2001-01-01",
        "'a\\nb'",
        '"a\\nb\\e"',
        "plant",
        "rig",
        "scale",
    ),
    "x" * 500,
)

BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(9)
)


def without_comments(text: str) -> str:
    """Return a YAML text in the fewest possible bytes."""
    return "\n".join(line.split(" #")[0].rstrip() for line in text.splitlines() if not line.startswith("#")) + "\n"


RIG = without_comments((config_folder() / "rig_paper.yaml").read_text(encoding="utf-8"))
SPEC = """title: a sine
rig: rig.yaml
duration: 1.0
seed: 3
reference: {name: sine, amplitude: 1.0e+4, frequency: 0.5}
effects:
- {name: valve_dead_zone}
disturbance:
  name: force
  signal: {name: load_spectrum, file: points.csv}
controller: {name: fasmc}
compensation: gms
"""
BRIDGE = without_comments((config_folder() / "bridge_udp.yaml").read_text(encoding="utf-8"))
COLUMNS = "time_s: {name: t}\nforce_n: {name: F, scale: 1000.0, offset: 2}\nposition_m:\n  name: x\n  scale: 0.001\n"
POINTS = "time_s,value\n0,1\n0.5,2\n1,3\n"

YAML_READERS: Sequence[tuple[str, Callable[[Path], object]]] = (
    (RIG, load_rig),
    (SPEC, load_spec),
    (BRIDGE, lambda path: bridge_from_mapping(read_yaml(path, "bridge file"), str(path))),
    (COLUMNS, read_columns),
)


def spoilt_yaml(draw: random.Random, whole: str) -> bytes:
    """Return a YAML text with wrong values, keys, lines or bytes."""
    lines = whole.splitlines()
    for _ in range(draw.choice((0, 1, 1, 1, 2, 3))):
        place = draw.randrange(len(lines)) if lines else 0
        line = lines[place] if lines else ""
        indent = line[: len(line) - len(line.lstrip())]
        key, colon, value = line.partition(":")
        match draw.randrange(11):
            case 0 | 1 | 2:
                line = f"{key}{colon} {draw.choice(VALUES)}"
            case 3:
                line = f"{indent}{draw.choice(KEYS)}:{value}"
            case 4:
                line = f"{line}\n{draw.choice(lines or [''])}"
            case 5:
                line = f"{line}\n{line}"
            case 6:
                line = draw.choice(("", " ", "  ", "\t")) + line
            case 7:
                line = line.lstrip() if draw.random() < 0.5 else ""
            case 8:
                inner = [n for n, char in enumerate(line) if char in " :,[]{}"]
                cut = draw.choice(inner) if inner else 0
                line = f"{line[:cut]}{draw.choice((' ', ',', '{', '}', '[', ']', ': '))}{draw.choice(VALUES)}{line[cut:]}"
            case 9:
                line = f"{line}\n{draw.choice(KEYS)}: {draw.choice(VALUES)}"
            case _:
                line = draw.choice((BOMB, "---", "...", "--- &a\n*a", "%TAG ! x", line * 50))
        if lines:
            lines[place] = line
    content = ("\n".join(lines) + "\n").encode("utf-8", errors="surrogatepass")
    return spoilt(draw, content) if draw.random() < 0.3 else content


def yaml_input(draw: random.Random, folder: Path) -> Callable[[], object]:
    """Write a damaged rig file, spec, bridge file or column map."""
    whole, read = draw.choice(YAML_READERS)
    if not (folder / "points.csv").exists() or draw.random() < 0.05:
        (folder / "points.csv").write_bytes(spoilt(draw, POINTS.encode()) if draw.random() < 0.5 else POINTS.encode())
        (folder / "rig.yaml").write_bytes(spoilt_yaml(draw, RIG) if draw.random() < 0.3 else RIG.encode())
    path = folder / "input.yaml"
    path.write_bytes(spoilt_yaml(draw, whole))
    return lambda: read(path)


Files = Mapping[str, bytes]
"""A bag: its files' contents by name."""

SAMPLES = 3


def short_run() -> Trajectory:
    """Return a run with a few samples."""
    time_s = 0.001 * np.arange(SAMPLES, dtype=np.float64)
    signals = {name: np.linspace(1.0, 2.0, SAMPLES) for name in ("position_m", "force_n")}
    signals["friction_elements_n"] = np.ones((SAMPLES, 2))
    return Trajectory(time_s, signals, {"seed": 3})


def files_in(folder: Path) -> Files:
    """Return the files of a folder, named as if the folder were ``bag``."""
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


def own_bag(folder: Path, storage: Storage) -> Files:
    """Return a bag written by this project's recorder."""
    write_trajectory(folder / "bag", short_run(), storage)
    return files_in(folder / "bag")


def foreign_bag(folder: Path, storage: Storage, compression: CompressionMode) -> Files:
    """Return a bag in the style of another recorder, without checksums."""
    writer = Writer(folder / "bag", version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        for topic, sent_ns, messages in streams_of(short_run(), "bag"):
            connection = writer.add_connection(topic.resolve(), topic.type, typestore=typestore())
            for stamp_ns, message in zip(sent_ns.tolist(), messages, strict=True):
                writer.write(connection, stamp_ns, message)
    return files_in(folder / "bag")


def killed_bag(folder: Path, storage: Storage) -> Files:
    """Return the files left by a killed recorder."""
    writer = BagWriter.create(folder / "bag", storage, {"seed": 3}, topics=(LOADER_STATE, FRICTION_ESTIMATE))
    for topic, sent_ns, messages in streams_of(short_run(), "bag"):
        if topic in (LOADER_STATE, FRICTION_ESTIMATE):
            for stamp_ns, message in zip(sent_ns.tolist(), messages, strict=True):
                writer.write(topic.name, stamp_ns, message)
    writer.flush()
    files = files_in(folder / "bag")
    writer.abort()
    return files


def bags() -> list[Files]:
    """Return a bag of each kind."""
    made: list[Files] = []
    makers: list[Callable[[Path], Files]] = []
    storages: tuple[Storage, ...] = ("mcap", "sqlite3")
    for storage in storages:
        makers += [partial(own_bag, storage=storage), partial(killed_bag, storage=storage)]
        makers += [
            partial(foreign_bag, storage=storage, compression=mode)
            for mode in (CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.STORAGE)
            if (storage, mode) != ("sqlite3", CompressionMode.STORAGE)
        ]
    for make in makers:
        with tempfile.TemporaryDirectory() as folder:
            made.append(make(Path(folder)))
    return made


def mcap_records(content: bytes) -> Iterator[tuple[int, int]]:
    """Yield start and end of the records' contents, including those in uncompressed chunks."""
    place = 8
    while place + 9 <= len(content) - 8:
        kind, length = struct.unpack_from("<BQ", content, place)
        start, end = place + 9, place + 9 + length
        yield start, end
        place = start + 40 if kind == 0x06 and content[start + 28 : start + 32] == bytes(4) else end


def spoilt_mcap(draw: random.Random, whole: bytes) -> bytes:
    """Return an mcap file with the kind, length or content of one record altered; the rest stays unchanged."""
    result = bytearray(whole)
    for _ in range(draw.choice((1, 1, 2))):
        start, end = draw.choice(list(mcap_records(whole)))
        match draw.randrange(6):
            case 0:
                result[start - 9] = draw.randrange(16)
            case 1:
                length = (draw.choice((end - start, *NUMBERS)) + draw.choice((-1, 0, 1))) % 2**64
                result[start - 8 : start] = length.to_bytes(8, "little")
            case _:
                content = spoilt(draw, bytes(result[start:end]))[: end - start]
                result[start : start + len(content)] = content
    if draw.random() < 0.1:
        # Without a summary, a reader must scan the file.
        result[-28:-12] = bytes(16)
    return bytes(result)


SQL_VALUES: tuple[Any, ...] = (
    *(None, "", "text", "\ud7ff\0", b"", b"\0\1\0\0", b"\0" * 60, 0, -1, 1.5, float("inf"), 2**63 - 1, -(2**63), "x" * 1000),
    *("/ehls/loader_state", "/ehls/friction_estimate", "ehls_msgs/msg/LoaderState", "std_msgs/msg/Float64", "ros2idl", "cdr"),
    *("a: [", "&a [*a]"),
)

ENDLESS_VIEW = """
    ALTER TABLE messages RENAME TO old;
    CREATE VIEW messages AS
        WITH RECURSIVE endless(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM endless)
        SELECT endless.id, topic_id, timestamp, data FROM endless, old;
"""
COMPUTED_COLUMN = """
    ALTER TABLE messages RENAME TO old;
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(1000000000)));
    INSERT INTO messages(id, topic_id, timestamp) SELECT id, topic_id, timestamp FROM old;
"""
SQL = (
    ENDLESS_VIEW,
    COMPUTED_COLUMN,
    "DROP TABLE metadata",
    "DROP TABLE messages",
    "DROP TABLE message_definitions",
    "DELETE FROM topics",
    "DELETE FROM messages WHERE id = 2",
    "INSERT INTO messages SELECT id + 100, topic_id, timestamp, data FROM messages",
    "UPDATE topics SET name = (SELECT name FROM topics LIMIT 1)",
    "ALTER TABLE messages RENAME COLUMN data TO content",
    "UPDATE message_definitions SET encoded_message_definition = replace(encoded_message_definition, 'float64', 'float32')",
    "UPDATE message_definitions SET encoded_message_definition = replace(encoded_message_definition, 'std_msgs', 'ehls_msgs')",
)

SQL_COLUMNS = (
    *(("messages", column) for column in ("id", "topic_id", "timestamp", "data")),
    *(("topics", column) for column in ("name", "type", "serialization_format", "offered_qos_profiles")),
    *(("topics", "type_description_hash"), ("message_definitions", "type_description_hash")),
    *(("message_definitions", column) for column in ("topic_type", "encoding", "encoded_message_definition")),
    *(("metadata", "metadata_version"), ("metadata", "metadata"), ("schema", "schema_version")),
)


def spoilt_sqlite(draw: random.Random, whole: bytes) -> bytes:
    """Return an intact database with invalid contents."""
    with closing(sqlite3.connect(":memory:")) as database:
        database.deserialize(whole)
        try:
            for _ in range(draw.choice((1, 1, 2))):
                if draw.random() < 0.25:
                    database.executescript(draw.choice(SQL))
                    break
                table, column = draw.choice(SQL_COLUMNS)
                (rowid,) = draw.choice(database.execute(f"SELECT rowid FROM {table}").fetchall() or [(0,)])  # noqa: S608
                (old,) = database.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (rowid,)).fetchone() or (None,)  # noqa: S608
                value = draw.choice(SQL_VALUES)
                if draw.random() < 0.5:
                    raw = old if isinstance(old, bytes) else str(old).encode()
                    value = spoilt(draw, raw) if isinstance(old, bytes) else spoilt(draw, raw).decode(errors="replace")
                database.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, rowid))  # noqa: S608
            database.commit()
        except sqlite3.Error:
            database.rollback()
        return database.serialize()


JSON_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1.5, float("nan"), float("inf"), 10**30, "", "text", "\ud800", "\0", [], {}, [1, 2], ["force_n"]),
    *({"a": 1}, {"rig": {}}, {"messages": 1, "checksum": 2}, [1, 2, 3], ["a", "b"], {"type_hash": "", "checksum": 0}),
    [float("inf"), 0],
)


def spoilt_json(draw: random.Random, content: str) -> str:
    """Return a JSON text with wrong values or bytes."""
    if draw.random() < 0.2:
        return spoilt(draw, content.encode()).decode(errors="replace")
    if draw.random() < 0.05:
        return "[" * 100_000
    whole = json.loads(content)
    part: Any = whole
    while True:
        keys = list(part) if isinstance(part, dict) else range(len(part))
        key = draw.choice(keys)
        if not isinstance(part[key], dict | list) or not part[key] or draw.random() < 0.4:
            break
        part = part[key]
    if isinstance(part, MutableSequence) or draw.random() < 0.8:
        part[key] = draw.choice(JSON_VALUES)
    else:
        del part[key]
    return json.dumps(whole)


def spoilt_configuration(draw: random.Random, metadata: bytes) -> bytes:
    """Return metadata with a wrong configuration and a valid checksum."""
    spoilt_text = spoilt_json(draw, json.dumps(Provenance({"seed": 3}, {}, ["force_n"])._asdict()))
    own = Provenance({}, {}, None).custom_data()
    checksum_of = sys.modules[Provenance.__module__]._text_checksum  # noqa: SLF001 - the checksum is no secret
    entries = dict(zip(own, (spoilt_text, checksum_of(spoilt_text)), strict=True))
    content = yaml.safe_load(metadata)
    content["rosbag2_bagfile_information"]["custom_data"] = entries
    return yaml.safe_dump(content).encode()


def bag_inputs() -> Target:
    """Return a target that damages a file of a bag, closed or not, and reads or recovers the bag."""
    kinds = bags()

    def bag_input(draw: random.Random, folder: Path) -> Callable[[], object]:
        files = dict(draw.choice(kinds))
        victim = draw.choice([*(name for name in files if name.endswith((".mcap", ".db3")) for _ in range(3)), *files])
        whole = files[victim]
        structured = draw.random() < 0.7
        if draw.random() < 0.02:
            pass
        elif structured and victim.endswith(".mcap"):
            files[victim] = spoilt_mcap(draw, whole)
        elif structured and victim.endswith(".db3") and not any(name.endswith("-journal") for name in files):
            files[victim] = spoilt_sqlite(draw, whole)
        elif structured and victim == "metadata.yaml":
            files[victim] = spoilt_configuration(draw, whole) if draw.random() < 0.3 else spoilt_yaml(draw, whole.decode())
        elif structured and victim == NOTE:
            files[victim] = spoilt_json(draw, whole.decode()).encode(errors="surrogatepass")
        else:
            files[victim] = spoilt(draw, whole)
        bag, out = folder / "bag", folder / "out"
        for old in (bag, out):
            shutil.rmtree(old, ignore_errors=True)
        bag.mkdir()
        for name, content in files.items():
            (bag / name).write_bytes(content)
        if NOTE in files:
            return lambda: recover(bag, out)
        return lambda: load(bag if draw.random() < 0.3 or victim == "metadata.yaml" else bag / victim)

    return bag_input


TARGETS: Mapping[str, Callable[[], Target]] = {"csv": lambda: csv_input, "yaml": lambda: yaml_input, "bag": bag_inputs}
"""Makers of inputs that are files."""


def work(options: argparse.Namespace, folder: Path, progress: "Synchronized[int]") -> None:
    """Run in the worker: a short run that loads all code, then the long one; print the outcomes."""
    target = None if options.target == "packet" else TARGETS[options.target]()

    def run(inputs: int) -> Counter[str]:
        if target is None:
            return fuzz_packet(inputs, options.seed)
        return fuzz(target, inputs, options.seed, folder, options.keep, progress, options.seconds)

    run(min(options.inputs, 1000))
    taken = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, taken + MEMORY))
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    outcomes = run(options.inputs)
    took = time.perf_counter() - start
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    inputs = options.inputs if target is None else outcomes.total()
    for outcome, count in sorted(outcomes.items()):
        print(f"{outcome:60}{count:12d}")
    rate = f"{inputs / took:.0f} per second of wall time, {inputs / time.process_time():.0f} of processor time"
    print(f"{options.target}: {inputs} inputs in {took:.1f} s, {rate}, peak memory grew by {growth} KiB")


def main() -> None:
    """Run a worker and supervise it."""
    parser = parser_of(__doc__)
    parser.add_argument("--target", choices=("packet", *TARGETS), default="packet")
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=math.inf, help="time after which no further input is made")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for inputs that fail")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=FAST if FAST.is_dir() else None) as folder:
        progress: Synchronized[int] = multiprocessing.Value("q", -1)
        worker = multiprocessing.Process(target=work, args=(options, Path(folder), progress))
        worker.start()
        last = -2
        while worker.is_alive():
            worker.join(STUCK)
            if worker.is_alive() and progress.value == last and options.target != "packet":
                worker.kill()
            last = progress.value
        if worker.exitcode:
            if options.keep:
                shutil.copytree(folder, options.keep / "crash", dirs_exist_ok=True)
            sys.exit(f"the worker ended with {worker.exitcode} at input {progress.value}")


if __name__ == "__main__":
    main()
