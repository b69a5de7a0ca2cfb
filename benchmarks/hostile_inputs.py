"""Files designed to hang a reader or exhaust its memory: the answer to each, and the time and memory it takes.

python -m benchmarks.hostile_inputs [--only Parquet]

Each is read in a separate process. Time is processor time, of that process and its children; memory is the
largest resident set of any of them. The first line is a process that only imports the readers.
"""

import argparse
import json
import os
import resource
import socket
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import yaml

from benchmarks.common import ROOT, parser_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.recording.bag_writer import BagWriter
from ehls_ros.recording.cdr import encode, flatten
from ehls_ros.recording.load import load
from ehls_ros.recording.topics import LOADER_STATE
from ehls_ros.recording.typestore import typestore

if find_spec("h5py"):
    import h5py
if find_spec("pyarrow"):
    import pyarrow as pa
    from pyarrow import parquet as parquet_

MB = 10**6

PATIENCE = 600.0
"""Time after which a reader counts as hung [s]."""

HEADER = "| input | answer | processor time [s] | wall time [s] | peak memory [MB] |\n|---|---|---|---|---|"


class Answer(NamedTuple):
    """Outcome of an input.

    Attributes:
        line: the error message, or that the file was accepted.
        refused: whether it was refused in one line.
        processor_s: processor time [s].
        wall_s: wall time [s].
        memory_mb: largest resident set [MB].
    """

    line: str
    refused: bool
    processor_s: float
    wall_s: float
    memory_mb: float


def read(path: Path) -> None:
    """Read a file as `ehls` does: YAML as a rig, or as a spec if it is named so; everything else as data."""
    if path.suffix == ".yaml":
        (load_spec if path.stem == "spec" else load_rig)(path)
    else:
        load(path)


def ask(path: Path | None) -> Answer:
    """Read a file in a separate process; None only starts the process."""
    command = [sys.executable, "-m", "benchmarks.hostile_inputs", "--read", str(path or "")]
    start = time.perf_counter()
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE, check=False)
        words = json.loads(done.stdout) if done.returncode == 0 else None
    except subprocess.TimeoutExpired:
        done, words = None, None
    wall = time.perf_counter() - start
    if words is None:
        line = "hangs" if done is None else f"dies with {done.returncode}: {done.stderr.strip()[-200:]}"
        return Answer(line, refused=False, processor_s=float("nan"), wall_s=wall, memory_mb=float("nan"))
    return Answer(words["line"], words["refused"], words["processor_s"], wall, words["memory_mb"])


def read_and_tell(path: str) -> None:
    """Read a file in this process and print the outcome."""
    line, refused = "taken", False
    try:
        if path:
            read(Path(path))
    except BadInput as error:
        line, refused = str(error).replace(str(Path(path).parent) + "/", ""), True
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    used = sum(usage.ru_utime + usage.ru_stime for usage in usages)
    # getrusage's peak memory of this process includes its parent's before exec.
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    memory = max(int(status["VmHWM"].split()[0]), usages[1].ru_maxrss) / 1000
    print(json.dumps({"line": line, "refused": refused, "processor_s": used, "memory_mb": memory}))


# CSV


def text(name: str, content: Callable[[], str]) -> Callable[[Path], Path]:
    """A text file."""

    def make(folder: Path) -> Path:
        file = folder / name
        file.write_text(content())
        return file

    return make


def sparse(name: str, size: int) -> Callable[[Path], Path]:
    """A sparse file of null bytes."""

    def make(folder: Path) -> Path:
        file = folder / name
        with file.open("wb") as stream:
            stream.truncate(size)
        return file

    return make


def many_columns(folder: Path) -> Path:
    """A CSV file with nine thousand columns of friction elements."""
    file = folder / "columns.csv"
    names = ["time_s", *(f"friction_elements_n_{k}" for k in range(1, 9001))]
    file.write_text("\n".join([",".join(names), *(",".join([str(k)] + ["1"] * 9000) for k in range(20)), "end"]))
    return file


# Not regular files


def pipe(suffix: str) -> Callable[[Path], Path]:
    """A pipe without a writer."""

    def make(folder: Path) -> Path:
        file = folder / f"pipe{suffix}"
        os.mkfifo(file)
        return file

    return make


def device(suffix: str) -> Callable[[Path], Path]:
    """A link to /dev/zero."""

    def make(folder: Path) -> Path:
        file = folder / f"zero{suffix}"
        file.symlink_to("/dev/zero")
        return file

    return make


def listening_socket(folder: Path) -> Path:
    """A socket."""
    file = folder / "socket.csv"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(file))
    return file


def directory(folder: Path) -> Path:
    """A directory with the name of a file."""
    file = folder / "directory.csv"
    file.mkdir()
    return file


def pipe_in_a_bag(folder: Path) -> Path:
    """A bag whose storage file is a pipe."""
    bag = bag_of(folder, 3, "mcap")
    [file] = bag.glob("*.mcap")
    file.unlink()
    os.mkfifo(file)
    return bag


def pipe_of_another_name(folder: Path) -> Path:
    """A bag whose metadata name a pipe without a storage file's suffix."""
    bag = bag_of(folder, 3, "mcap")
    os.mkfifo(bag / "data")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- bag.mcap", "- data").replace("path: bag.mcap", "path: data"))
    return bag


# YAML


def aliases(folder: Path) -> Path:
    """A rig file that expands to 10^9 strings."""
    file = folder / "laughs.yaml"
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    lines += [
        f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
    ]
    file.write_text("\n".join(lines))
    return file


def yes_for_a_number(folder: Path) -> Path:
    """A rig file whose moving mass is yes."""
    rig = yaml.safe_load((config_folder() / "rig_paper.yaml").read_text())
    rig["plant"]["moving_mass"] = True
    file = folder / "yes.yaml"
    file.write_text(yaml.safe_dump(rig).replace("moving_mass: true", "moving_mass: yes"))
    return file


def long_reference(folder: Path) -> Path:
    """A spec with a reference file of 300 MB."""
    (folder / "load.csv").write_text("time_s,value\n" + "".join(f"{k},1\n" for k in range(10)) + "1" * (300 * MB))
    spec = yaml.safe_load((config_folder() / "experiments" / "sine_fd1.yaml").read_text())
    spec["rig"] = yaml.safe_load((config_folder() / "rig_paper.yaml").read_text())
    spec["reference"] = {"name": "load_spectrum", "file": "load.csv"}
    file = folder / "spec.yaml"
    file.write_text(yaml.safe_dump(spec))
    return file


# Bags


def bag_of(folder: Path, messages: int, storage: Any, frame: Callable[[int], str] = lambda _: "rig") -> Path:
    """Return a bag of snapshots with the given frame names."""
    fields = flatten(typestore().fielddefs, LOADER_STATE.type)
    writer = BagWriter.create(folder / "bag", storage, topics=[LOADER_STATE])
    for k in range(messages):
        values: dict[str, Any] = {field.name: np.zeros(1) for field in fields}
        values |= {"header.frame_id": frame(k), "header.stamp.nanosec": np.array([k * 1000]), "cycle": np.array([k])}
        writer.write(LOADER_STATE.name, k * 1000, encode(fields, values)[0])
    writer.close()
    return folder / "bag"


def changed_database(statement: str, values: Iterable[tuple[int, ...]] = ((),)) -> Callable[[Path], Path]:
    """A small SQLite bag after a statement, executed for each of some values."""

    def make(folder: Path) -> Path:
        [file] = bag_of(folder, 3, "sqlite3").glob("*.db3")
        with closing(sqlite3.connect(file)) as database, database:
            database.executemany(statement, values)
        return file

    return make


INSERT = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, zeroblob({}))"
MANY_TOPICS = (
    "WITH RECURSIVE n(i) AS (SELECT 2 UNION ALL SELECT i + 1 FROM n WHERE i < 1000000) "
    "INSERT INTO topics SELECT i, '/t' || i, 'std_msgs/msg/Bool', 'cdr', '', '' FROM n"
)


def stamps(count: int) -> list[tuple[int]]:
    """Return the stamps of messages to insert."""
    return [(k,) for k in range(10, 10 + count)]


def many_lengths(storage: str) -> Callable[[Path], Path]:
    """A bag whose frame names all differ in length."""

    def make(folder: Path) -> Path:
        return bag_of(folder, 20_000, storage, lambda k: "x" * (k % 5000))

    return make


MCAP_MAGIC = b"\x89MCAP0\r\n"


def mcap(folder: Path, data: bytes, summary: bytes) -> Path:
    """Assemble an mcap file from data and summary."""

    def record(kind: int, content: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(content)) + content

    head = MCAP_MAGIC + record(1, struct.pack("<I4sI", 4, b"ros2", 0))
    end = record(15, bytes(4))
    start = len(head) + len(data) + len(end)
    file = folder / "made.mcap"
    file.write_bytes(head + data + end + summary + record(2, struct.pack("<QQI", start, 0, 0)) + MCAP_MAGIC)
    return file


def overlapping_chunks(folder: Path) -> Path:
    """An mcap file of 6 MB whose chunks expand to 600 MB and overlap."""
    content = lz4.frame.compress(bytes(60 * MB), compression_level=9)
    data, summary = b"", b""
    for _ in range(10):
        head = struct.pack("<QQQII", 0, 10, 60 * MB, 0, 3) + b"lz4" + struct.pack("<Q", len(content))
        start = len(MCAP_MAGIC) + 9 + 12 + len(data)
        chunk = struct.pack("<BQ", 6, len(head) + len(content)) + head + content
        index = struct.pack("<QQQQI", 0, 10, start, len(chunk), 0) + struct.pack("<QI", 0, 3) + b"lz4"
        index += struct.pack("<QQ", len(content), 60 * MB)
        data, summary = data + chunk, summary + struct.pack("<BQ", 8, len(index)) + index
    return mcap(folder, data + struct.pack("<BQ", 9, 6 * MB) + bytes(6 * MB), summary)


def long_summary(folder: Path) -> Path:
    """An mcap file with a summary of 500 MB."""
    return mcap(folder, b"", struct.pack("<BQ", 11, 500 * MB) + bytes(500 * MB))


def large_schema(folder: Path) -> Path:
    """An mcap file without index, with a message definition of 500 MB."""
    file = mcap(folder, struct.pack("<BQ", 3, 500 * MB) + bytes(500 * MB), b"")
    content = file.read_bytes()
    file.write_bytes(content[:-28] + bytes(20) + content[-8:])
    return file


def many_records(folder: Path) -> Path:
    """An mcap file of two million empty records."""
    return mcap(folder, struct.pack("<BQ", 0x7F, 0) * (2 * MB), b"")


# MAT


def mat(folder: Path, name: str, content: bytes) -> Path:
    """Assemble a MAT file."""
    file = folder / name
    file.write_bytes(b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<H2s", 0x0100, b"IM") + content)
    return file


def element(kind: int, content: bytes, size: int | None = None) -> bytes:
    """Return an element of a MAT file, whose stated size may be wrong."""
    return struct.pack("<II", kind, len(content) if size is None else size) + content + bytes(-len(content) % 8)


def array_head(kind: int, shape: tuple[int, ...], name: bytes = b"time_s") -> bytes:
    """Return the head of an array of a MAT file: flags, shape and name."""
    dimensions = struct.pack(f"<{len(shape)}i", *shape)
    return element(6, struct.pack("<II", kind, 0)) + element(5, dimensions) + element(1, name)


def expanding_array(folder: Path) -> Path:
    """A MAT file of 3 MB that expands to 3 GB."""
    size = 3 * 10**9
    head = array_head(6, (size // 8, 1)) + struct.pack("<II", 9, size)
    compressor = zlib.compressobj()
    begin = compressor.compress(struct.pack("<II", 14, len(head) + size) + head) + compressor.flush(zlib.Z_FULL_FLUSH)
    piece = compressor.compress(bytes(MB)) + compressor.flush(zlib.Z_FULL_FLUSH)
    # Pieces between full flushes are independent.
    return mat(folder, "expanding.mat", element(15, begin + piece * (size // MB) + compressor.flush()))


def huge_cells(folder: Path) -> Path:
    """A MAT file of 200 bytes with 10^9 cells."""
    return mat(folder, "cells.mat", element(14, array_head(1, (10**9, 1))))


def huge_text(folder: Path) -> Path:
    """A MAT file of 200 bytes with 10^9 characters."""
    return mat(folder, "text.mat", element(14, array_head(4, (1, 10**9)) + element(4, b"")))


def huge_structure(folder: Path) -> Path:
    """A MAT file of 200 bytes with 10^9 structures."""
    fields = element(5, struct.pack("<i", 8)) + element(1, b"a".ljust(8, b"\0"))
    return mat(folder, "structures.mat", element(14, array_head(2, (10**9, 1)) + fields))


def nested_cells(folder: Path) -> Path:
    """A MAT file of cells nested 200 000 deep."""
    head, depth = array_head(1, (1, 1), b""), 200_000
    step = len(head) + 8
    content = b"".join(struct.pack("<II", 14, len(head) + step * (depth - k)) + head for k in range(depth))
    return mat(folder, "nested.mat", content + element(14, head))


def many_variables(folder: Path) -> Path:
    """A MAT file of half a million variables."""
    variable = element(14, array_head(6, (1, 1), b"x") + element(9, bytes(8)))
    return mat(folder, "variables.mat", variable * 500_000)


def huge_old_matrix(folder: Path) -> Path:
    """A MAT file of version 4 that claims 10^9 numbers."""
    file = folder / "old.mat"
    file.write_bytes(struct.pack("<5i", 0, 10**9, 1, 0, 7) + b"time_s\0" + bytes(100))
    return file


def old_sparse_matrix(folder: Path) -> Path:
    """A MAT file of version 4 with a sparse matrix of 2^31 rows."""
    file = folder / "sparse.mat"
    file.write_bytes(struct.pack("<5i", 2, 1, 3, 0, 7) + b"time_s\0" + struct.pack("<3d", 2**31 - 1, 1, 0))
    return file


# Parquet


def parquet(name: str, groups: int, **columns: Any) -> Callable[[Path], Path]:
    """A Parquet file that repeats columns."""

    def make(folder: Path) -> Path:
        table = pa.table({key: column() for key, column in columns.items()})
        with parquet_.ParquetWriter(folder / name, table.schema, compression="zstd") as writer:
            for _ in range(groups):
                writer.write_table(table, row_group_size=len(table))
        return folder / name

    return make


def nested_lists(folder: Path) -> Path:
    """A Parquet file with lists 200 deep."""
    kind = pa.float64()
    value: float | list[Any] = 0.0
    for _ in range(200):
        kind, value = pa.list_(kind), [value]
    table = pa.table({"time_s": [0.0], "force_n": pa.array([value], kind)})
    parquet_.write_table(table, folder / "nested.parquet")
    return folder / "nested.parquet"


TABLES: Mapping[str, Callable[[Path], Path]] = {
    "CSV, 100 MB in one line": text("one_line.csv", lambda: "time_s,force_n," + "1," * (50 * MB)),
    "CSV, 100 MB in the second line": text("one_row.csv", lambda: "time_s,force_n\n" + "1," * (50 * MB)),
    "CSV, 100 MB of lines in quotes": text("one_cell.csv", lambda: 'time_s,force_n\n0,"' + "1\n" * (50 * MB)),
    "CSV, numbers of 262000 digits": text(
        "digits.csv", lambda: "time_s,force_n\n" + "".join(f"{k},{'9' * 262_000}\n" for k in range(100))
    ),
    "CSV, 100 MB of empty lines": text("empty_lines.csv", lambda: "time_s,force_n\n" + "\n" * (100 * MB)),
    "CSV, 9000 columns": many_columns,
    "CSV, an infinite force": text("inf.csv", lambda: "time_s,force_n\n0,1\n0.1,inf\n"),
    "CSV, 20 GB": sparse("sparse.csv", 20 * 10**9),
    "CSV, 1 GB of nulls": sparse("nulls.csv", 10**9),
}
NO_FILES: Mapping[str, Callable[[Path], Path]] = {
    **{f"pipe{suffix}": pipe(suffix) for suffix in (".csv", ".yaml", ".mat", ".parquet", ".mcap", ".db3", "")},
    **{f"/dev/zero as {suffix}": device(suffix) for suffix in (".csv", ".yaml", ".mat", ".mcap")},
    "socket": listening_socket,
    "directory": directory,
    "bag with a pipe in it": pipe_in_a_bag,
    "bag that names a pipe": pipe_of_another_name,
}
TEXTS: Mapping[str, Callable[[Path], Path]] = {
    "YAML, aliases of 10^9 texts": aliases,
    "YAML, 2 million brackets": text("deep.yaml", lambda: "[" * (2 * MB)),
    "YAML, 300 MB": text("long.yaml", lambda: "a: " + "x" * (300 * MB)),
    "YAML, moving_mass: yes": yes_for_a_number,
    "reference file, 300 MB": long_reference,
}
BAGS: Mapping[str, Callable[[Path], Path]] = {
    "SQLite, 600 messages of 1 MB": changed_database(INSERT.format(MB), stamps(600)),
    "SQLite, a message of 600 MB": changed_database(INSERT.format(600 * MB), stamps(1)),
    "SQLite, 10000 messages of 60 kB": changed_database(INSERT.format(60_000), stamps(10_000)),
    "SQLite, definition of 600 MB": changed_database(
        "UPDATE message_definitions SET encoded_message_definition = CAST(zeroblob(600000000) AS TEXT)"
    ),
    "SQLite, metadata of 600 MB": changed_database("UPDATE metadata SET metadata = CAST(zeroblob(600000000) AS TEXT)"),
    "SQLite, a million topics": changed_database(MANY_TOPICS),
    "SQLite, messages of 5000 lengths": many_lengths("sqlite3"),
    "mcap, messages of 5000 lengths": many_lengths("mcap"),
    "mcap, 600 MB of overlapping chunks": overlapping_chunks,
    "mcap, summary of 500 MB": long_summary,
    "mcap, definition of 500 MB": large_schema,
    "mcap, 2 million records": many_records,
}
MATS: Mapping[str, Callable[[Path], Path]] = {
    "MAT, 3 MB expand to 3 GB": expanding_array,
    "MAT, 10^9 cells": huge_cells,
    "MAT, 10^9 characters": huge_text,
    "MAT, 10^9 structures": huge_structure,
    "MAT, cells 200000 deep": nested_cells,
    "MAT, 500000 variables": many_variables,
    "MAT 4, 10^9 numbers": huge_old_matrix,
    "MAT 4, sparse with 2^31 rows": old_sparse_matrix,
}


def times(rows: int) -> Callable[[], Any]:
    """Return a maker of a column of times."""
    return lambda: np.arange(rows) / 1000.0


def still(rows: int) -> Callable[[], Any]:
    """Return a maker of a constant column."""
    return lambda: np.zeros(rows)


def texts(rows: int) -> Callable[[], Any]:
    """Return a maker of a column that repeats one long text."""

    def make() -> Any:
        return pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), ["x" * MB])

    return make


PARQUETS: Mapping[str, Callable[[Path], Path]] = {
    "Parquet, 3·10^7 equal rows": parquet("rows.parquet", 30, time_s=still(MB), force_n=still(MB)),
    "Parquet, 1.9·10^7 equal rows": parquet("equal.parquet", 19, time_s=still(MB), force_n=still(MB)),
    "Parquet, 30000 row groups": parquet("groups.parquet", 30_000, time_s=times(1), force_n=still(1)),
    "Parquet, texts of 1 MB, 10^5 times": parquet("texts.parquet", 1, time_s=times(100_000), force_n=texts(100_000)),
    "Parquet, lists 200 deep": nested_lists,
}


def hdf(folder: Path, fill: Callable[[Any], object]) -> Path:
    """A MAT file of version 7.3."""
    file = folder / "new.mat"
    with h5py.File(file, "w", userblock_size=512) as content:
        fill(content)
    with file.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return file


def holding_itself(folder: Path) -> Path:
    """A structure of version 7.3 that is a field of itself."""

    def fill(content: Any) -> None:
        log = content.create_group("log")
        log["log"] = log

    return hdf(folder, fill)


def unwritten(folder: Path) -> Path:
    """Two variables of version 7.3 with 10^12 values that were never written."""
    return hdf(
        folder, lambda content: [content.create_dataset(n, (10**12,), float, chunks=(MB,)) for n in ("time_s", "force_n")]
    )


def excel(folder: Path, rows: str) -> Path:
    """An Excel file with these rows, as XML."""
    file = folder / "data.xlsx"
    names = {
        "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"/>',
        "_rels/.rels": (
            '<Relationships><Relationship Id="r1" Target="xl/workbook.xml" '
            'Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/officeDocument"/></Relationships>'
        ),
        "xl/workbook.xml": (
            '<workbook xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships">'
            '<sheets><sheet name="a" sheetId="1" r:id="r1"/></sheets></workbook>'
        ),
        "xl/_rels/workbook.xml.rels": (
            '<Relationships><Relationship Id="r1" Target="worksheets/sheet1.xml" '
            'Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet"/></Relationships>'
        ),
        "xl/worksheets/sheet1.xml": f"<worksheet><sheetData>{rows}</sheetData></worksheet>",
    }
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in names.items():
            archive.writestr(name, content)
    return file


def expanding_sheet(folder: Path) -> Path:
    """An Excel file whose rows expand to a thousand times its size."""
    return excel(folder, "<row><c><v>1</v></c><c><v>1</v></c></row>" * 5_000_000)


def far_corner(folder: Path) -> Path:
    """An Excel file with one cell in each of two corners of the largest sheet."""
    return excel(folder, '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"><v>1</v></c></row>')


HDFS: Mapping[str, Callable[[Path], Path]] = {
    "MAT 7.3, a structure in itself": holding_itself,
    "MAT 7.3, 10^12 values that were never written": unwritten,
}
SHEETS: Mapping[str, Callable[[Path], Path]] = {
    "Excel, 5 million rows in 1 MB": expanding_sheet,
    "Excel, two cells 10^10 apart": far_corner,
}

INPUTS: Mapping[str, Callable[[Path], Path]] = {
    **TABLES,
    **NO_FILES,
    **TEXTS,
    **BAGS,
    **MATS,
    **(PARQUETS if find_spec("pyarrow") else {}),
    **(HDFS if find_spec("h5py") else {}),
    **(SHEETS if find_spec("python_calamine") else {}),
}
"""Makers of the inputs by name."""


def row(name: str, answer: Answer) -> str:
    """Return a line of the table."""
    line = answer.line.replace("|", "\\|")
    line = line if len(line) < 220 else f"{line[:140]} … {line[-70:]}"
    return f"| {name} | {line} | {answer.processor_s:.1f} | {answer.wall_s:.1f} | {answer.memory_mb:.0f} |"


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--only", default="", metavar="TEXT", help="inputs with this in their names")
    parser.add_argument("--read", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read is not None:
        read_and_tell(options.read)
        return
    print(HEADER)
    print(row("(nothing)", ask(None)))
    for name in [name for name in INPUTS if options.only in name]:
        with tempfile.TemporaryDirectory() as folder:
            print(row(name, ask(INPUTS[name](Path(folder)))), flush=True)


if __name__ == "__main__":
    main()
