"""Parquet files in the format of the data contract: one column per signal. Needs pyarrow, which ehls_ros does not install."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ehls_ros.errors import BadInput
from ehls_ros.extras import missing
from ehls_ros.recording.columns import Column, Columns
from ehls_ros.recording.contained import contained
from ehls_ros.recording.reason import reason
from ehls_ros.recording.table import RawTable, assemble, check_length, choose, not_numeric
from ehls_ros.trajectory import Trajectory

OLDEST = (14, 0, 1)
"""The first pyarrow that does not run code from a file."""

EXPECTED_FILE = "a Parquet file"


def read_parquet(path: Path, columns: Columns = MappingProxyType({})) -> Trajectory:
    """Read a Parquet file.

    Args:
        path: the file; a null is NaN.
        columns: the user's own names and units.

    Returns:
        The trajectory, without metadata.

    Raises:
        BadInput: pyarrow is missing, the file cannot be read, a column is wrong, or time does not increase with every row.
    """
    _check_installed(path)
    return contained(read_here, path, columns, EXPECTED_FILE, Trajectory)


def raw_parquet(path: Path) -> RawTable:
    """Return all columns of a Parquet file that are numbers, by name; None for the others.

    Raises:
        BadInput: pyarrow is missing, or the file cannot be read.
    """
    _check_installed(path)
    return contained(raw_here, path, {}, EXPECTED_FILE, dict)


def _check_installed(path: Path) -> None:
    # Not imported here: that takes as long as reading a file.
    if find_spec("pyarrow") is None or find_spec("pyarrow.parquet") is None:
        raise missing("pyarrow is not installed", "files", str(path), "the data as CSV")


def read_here(path: Path, columns: Columns) -> Trajectory:
    """Read a Parquet file in this process, without a memory limit; see :func:`read_parquet`."""
    arrow, where = _arrow(path), str(path)
    with _open(path) as file:
        chosen = _chosen(arrow, file, columns, where)
        table = file.read(columns=[column.name for column in chosen.values()], use_threads=False)
    values = {name: table.column(column.name).to_numpy() for name, column in chosen.items()}
    return assemble(values, chosen, where, lambda row: f"row {row + 1}")


def raw_here(path: Path, columns: Columns) -> RawTable:
    """Do the same as :func:`raw_parquet` in this process, without a memory limit."""
    arrow = _arrow(path)
    with _open(path) as file:
        schema = file.schema_arrow
        numeric = [
            name for name in schema.names if schema.names.count(name) == 1 and _is_number(arrow, schema.field(name).type)
        ]
        check_length(file.metadata.num_rows, len(numeric), str(path))
        table = file.read(columns=numeric, use_threads=False)
    return {name: table.column(name).to_numpy().astype(np.float64) if name in numeric else None for name in schema.names}


def _arrow(path: Path) -> Any:
    arrow = import_module("pyarrow")
    if tuple(int(part) for part in arrow.__version__.split(".")[:3]) < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        what = f"pyarrow is {arrow.__version__}, which may run code from a file"
        raise BadInput(what, str(path), f"pyarrow {oldest} or later")
    return arrow


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    try:
        with import_module("pyarrow.parquet").ParquetFile(path) as file:
            yield file
    except BadInput:
        raise
    except (OSError, ValueError) as error:
        raise BadInput(f"it is not a Parquet file ({reason(error)})", str(path), EXPECTED_FILE) from None


def _chosen(arrow: Any, file: Any, columns: Columns, where: str) -> dict[str, Column]:
    """Select the columns to read, and check their types and length before reading them."""
    chosen = choose(file.schema_arrow.names, columns, where)
    for name, column in chosen.items():
        if not _is_number(arrow, file.schema_arrow.field(column.name).type):
            raise not_numeric(column, name, where)
    check_length(file.metadata.num_rows, len(chosen), where)
    return chosen


def _is_number(arrow: Any, kind: Any) -> bool:
    if arrow.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(arrow.types.is_integer(kind) or arrow.types.is_floating(kind) or arrow.types.is_boolean(kind))
