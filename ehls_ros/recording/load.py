"""Loading of recorded or measured data in any format of the data contract."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import STORAGE_SUFFIXES, read_bag
from ehls_ros.recording.columns import TABLES, TIME, Column, ColumnMap, Columns, is_contract_name, is_topic
from ehls_ros.recording.conversion import converted
from ehls_ros.recording.csv_file import read_csv
from ehls_ros.recording.excel_file import read_excel
from ehls_ros.recording.joining import join
from ehls_ros.recording.lvm_file import is_lvm, read_lvm
from ehls_ros.recording.mat_file import read_mat
from ehls_ros.recording.mdf_file import is_mdf, read_mdf
from ehls_ros.recording.named_topics import read_named_topics
from ehls_ros.recording.parquet_file import read_parquet
from ehls_ros.recording.rpc_file import read_rpc
from ehls_ros.recording.storage_file import METADATA_FILE
from ehls_ros.recording.table import Pick, RawTable, no_names, sources, trajectories_of
from ehls_ros.recording.tdms_file import read_tdms
from ehls_ros.trajectory import SIGNALS, Trajectory

Answer = TypeVar("Answer")


def read_text(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a text file: a LabVIEW measurement file by its first line, whatever its suffix, otherwise a plain table."""
    return read_lvm(path, pick) if is_lvm(path) else read_csv(path, pick)


READERS: Mapping[str, Callable[[Path, Pick | None], RawTable]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm"), read_text),
    ".mat": read_mat,
    ".parquet": read_parquet,
    **dict.fromkeys((".xlsx", ".xls"), read_excel),
    ".tdms": read_tdms,
    **dict.fromkeys((".mf4", ".mdf"), read_mdf),
    **dict.fromkeys((".rsp", ".drv", ".rpc", ".tim"), read_rpc),
}
"""Readers of files with named columns, by suffix."""

OTHERS_HAVE = (".txt", ".dat", ".asc", ".rsp", ".drv", ".rpc", ".tim")
"""Suffixes also used by files other than tables: such a file in a folder is a table only if a map lists it."""


def load(path: Path, columns: ColumnMap | None = None, wanted: Collection[str] = SIGNALS) -> Trajectory:
    """Read data in any supported format.

    Args:
        path: folder of a rosbag2; a file ``.mcap``, ``.db3`` or one of :data:`READERS`; a folder with several of the latter,
            which are the tables of one recording; or one of the tables that the map lists.
        columns: names, units and tables of foreign data, or topics of a bag. None: those of the data contract.
        wanted: names of the signals needed from a bag of this package; its other topics are not read.

    Returns:
        The trajectory.

    Raises:
        BadInput: the data cannot be read in any of these formats.
    """
    given = columns or ColumnMap()
    tables = _tables(path, given)
    if tables:
        return converted(_joined(tables, given, str(path)), given, str(path))
    if is_table(path):
        axes = _read(path, given.plain())
        named = given.columns[TIME].name if TIME in given.columns else ""
        return converted(_on_one_clock(axes, named if named in axes else "", str(path)), given, str(path))
    if columns is None:
        return read_bag(path, wanted)
    return converted(_on_one_clock(read_named_topics(path, given), given.base, str(path)), given, str(path))


def recordings(paths: Sequence[Path], columns: ColumnMap | None) -> list[Path]:
    """Return one path per recording of a command line; all files that the map lists as tables count as one recording.

    Raises:
        BadInput: tables of several recordings are given, or some of a recording's are missing.
    """
    listed = set(columns.tables) if columns else set()
    given = [path for path in paths if path.name in listed]
    if not given:
        return list(paths)
    places = {path.parent for path in given}
    if len(places) > 1 or len(given) < len(paths):
        names = ", ".join(map(str, paths))
        expected = f"the files under '{TABLES}' in the map, all in one folder: {', '.join(sorted(listed))}"
        raise BadInput(f"these are not the tables of one recording: {names}", "command line", expected)
    return [given[0]]


def is_table(path: Path) -> bool:
    """Return whether a file has named columns; otherwise it is a bag.

    Raises:
        BadInput: it is a file of another format.
    """
    suffix = path.suffix.lower()
    if suffix not in READERS and suffix not in STORAGE_SUFFIXES and _known(path.is_file, otherwise=False):
        expected = f"the folder of a rosbag2 or a file {', '.join((*STORAGE_SUFFIXES, *READERS))}"
        raise BadInput("its format is unknown", str(path), expected)
    return suffix in READERS


def holds_tables(path: Path) -> bool:
    """Return whether a recording consists of files with named columns; otherwise it is a bag."""
    return bool(_tables(path, ColumnMap())) or is_table(path)


def raw(path: Path, pick: Pick | None = None) -> RawTable:
    """Return one table unconverted.

    Args:
        path: the file, of one of :data:`READERS`.
        pick: returns the names of the columns to read; None for all.

    Raises:
        BadInput: it cannot be read.
    """
    suffix = path.suffix.lower()
    # Older programs write MDF files with a suffix of text files.
    return (read_mdf if suffix in OTHERS_HAVE and is_mdf(path) else READERS[suffix])(path, pick)


def _read(path: Path, columns: Columns) -> dict[str, Trajectory]:
    """Read one table; return its trajectories by time axis."""
    where = str(path)
    return trajectories_of(raw(path, partial(sources, columns=columns, where=where)), columns, where)


def _tables(path: Path, given: ColumnMap) -> list[Path]:
    """Return the tables that form one recording; none if the path itself is a recording."""
    folder = path if _known(path.is_dir, otherwise=False) else path.parent
    if given.tables and not any(map(is_topic, given.tables)):
        if folder != path and path.name not in given.tables:
            expected = f"one of its tables {', '.join(given.tables)}, or their folder"
            raise BadInput(f"it is not among the tables of the map ({', '.join(given.tables)})", str(path), expected)
        return [folder / name for name in given.tables]
    files = _known(lambda: sorted(path.iterdir()), otherwise=list[Path]()) if folder == path else []
    return (
        []
        if any(file.name == METADATA_FILE for file in files)
        else [f for f in files if f.suffix.lower() in READERS.keys() - set(OTHERS_HAVE)]
    )


def _joined(paths: Sequence[Path], given: ColumnMap, where: str) -> Trajectory:
    """Read the tables of one recording, and resample them to one clock."""
    for path in paths:
        if path.suffix.lower() not in READERS:
            raise BadInput(f"table {path.name} is no file of named columns", where, f"files {', '.join(READERS)}")
    names = {path.name: raw(path, no_names).names for path in paths}
    for name, column in given.columns.items():
        if not any(column.sources_in(header) for table, header in names.items() if column.table in ("", table)):
            shown = "; ".join(f"{table}: {', '.join(header)}" for table, header in names.items())
            raise BadInput(f"column '{column.shown}' for {name} is in no table ({shown})", where, "a column of that name")
    chosen = {path.name: _columns_of(path.name, names, given, where) for path in paths}
    read, base = dict[str, Trajectory](), given.base
    for path in paths:
        axes = _read(path, chosen[path.name])
        named = {f"{path.name}, {axis}" if len(axes) > 1 else path.name: trajectory for axis, trajectory in axes.items()}
        if path.name == given.base:
            base = max(named, key=lambda name: len(named[name]))
        read |= named
    return _on_one_clock(read, base, where)


def _on_one_clock(tables: Mapping[str, Trajectory], base: str, where: str) -> Trajectory:
    return next(iter(tables.values())) if len(tables) == 1 else join(tables, base, where)


def _columns_of(table: str, names: Mapping[str, Sequence[str]], given: ColumnMap, where: str) -> dict[str, Column]:
    """Return the columns of the map that are in a table."""
    out = {}
    for name, column in given.columns.items():
        if not column.sources_in(names[table]) or (column.table and column.table != table):
            continue
        others = [other for other, header in names.items() if column.sources_in(header)]
        if name != TIME and len(others) > 1 and not column.table:
            what = f"column '{column.shown}' for {name} is in {' and '.join(others)}"
            raise BadInput(what, where, f"'table: {others[0]}', or another, beside its name in the map")
        out[name] = column.plain()
    time = given.tables.get(table)
    if time is not None:
        out[TIME] = time.plain()
    if set(out) <= {TIME} and not any(is_contract_name(name) and name != TIME for name in names[table]):
        raise BadInput(
            f"no signal of {table} is mapped (found: {', '.join(names[table])})", where, "a signal of it, or no such table"
        )
    return out


def _known(ask: Callable[[], Answer], otherwise: Answer) -> Answer:
    """Return an answer of the file system, or a substitute if it fails: reading the path reports the reason."""
    try:
        return ask()
    except OSError:
        return otherwise
