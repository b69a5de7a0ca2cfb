"""Parquet files in the format of the data contract: one column per signal. Needs pyarrow, which ehls_ros does not install."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, Columns
from ehls_ros.recording.contained import contained
from ehls_ros.recording.reason import reason
from ehls_ros.recording.table import assemble, check_length, choose, not_numeric
from ehls_ros.trajectory import Trajectory

OLDEST = (14, 0, 1)
"""The first pyarrow that does not run code from a file."""


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
    # Not imported here: that takes as long as reading a file.
    if find_spec("pyarrow") is None or find_spec("pyarrow.parquet") is None:
        raise BadInput("pyarrow is not installed", str(path), "pip install pyarrow, or the data as CSV")
    return contained(read_here, path, columns, "a Parquet file")


def read_here(path: Path, columns: Columns) -> Trajectory:
    """Read a Parquet file in this process, without a memory limit; see :func:`read_parquet`."""
    where = str(path)
    arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    if tuple(int(part) for part in arrow.__version__.split(".")[:3]) < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise BadInput(f"pyarrow is {arrow.__version__}, which may run code from a file", where, f"pyarrow {oldest} or later")
    try:
        with parquet.ParquetFile(path) as file:
            chosen = _chosen(arrow, file, columns, where)
            table = file.read(columns=[column.name for column in chosen.values()], use_threads=False)
    except BadInput:
        raise
    except (OSError, ValueError) as error:
        raise BadInput(f"it is not a Parquet file ({reason(error)})", where, "a Parquet file") from None
    values = {name: table.column(column.name).to_numpy() for name, column in chosen.items()}
    return assemble(values, chosen, where, lambda row: f"row {row + 1}")


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
