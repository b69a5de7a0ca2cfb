"""Reading of Parquet files with pyarrow: one column per signal."""

from importlib import import_module
from pathlib import Path
from typing import Any

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import unique_names
from ehls_ros.recording.contained import check_library, contained, library_errors
from ehls_ros.recording.table import Pick, RawTable, check_length
from ehls_ros.recording.times import seconds_of_moments

OLDEST = (14, 0, 1)
"""First pyarrow version that does not run code from a file."""

LIBRARY = "pyarrow.parquet"
"""Module that reads the files."""

EXPECTED_FILE = "a Parquet file"


def read_parquet(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a Parquet file.

    Args:
        path: the file; a null is NaN.
        pick: returns the names of the columns to read, which must hold numbers or times; None for all.

    Returns:
        The table.

    Raises:
        BadInput: pyarrow is missing, the file cannot be read, or a column is wrong.
    """
    check_library(LIBRARY, "pyarrow", path)
    # pyarrow imports pandas with the first column that it converts.
    return contained(read_here, path, pick, EXPECTED_FILE, RawTable, [LIBRARY, "pandas"])


def read_here(path: Path, pick: Pick | None) -> RawTable:
    """Read a Parquet file in this process, without a memory limit; see :func:`read_parquet`."""
    arrow, where = import_module("pyarrow"), str(path)
    if tuple(int(part) for part in arrow.__version__.split(".")[:3]) < OLDEST:
        what = f"pyarrow is {arrow.__version__}, which may run code from a file"
        raise BadInput(what, where, f"pyarrow {'.'.join(map(str, OLDEST))} or later")
    with library_errors("a Parquet file", where, EXPECTED_FILE), import_module(LIBRARY).ParquetFile(path) as file:
        schema = file.schema_arrow
        wanted = unique_names(schema.names) if pick is None else list(pick(schema.names))
        numeric = [name for name in wanted if schema.names.count(name) == 1 and _is_number(arrow, schema.field(name).type)]
        check_length(file.metadata.num_rows, len(numeric), where)
        table = file.read(columns=numeric, use_threads=False)
    values = {name: table.column(name).to_numpy() if name in numeric else None for name in wanted}
    times = {
        name: seconds_of_moments(found) for name, found in values.items() if found is not None and found.dtype.kind in "mM"
    }
    return RawTable(tuple(schema.names), {**values, **times}, units=dict.fromkeys(times, "s"))


def _is_number(arrow: Any, kind: Any) -> bool:
    if arrow.types.is_dictionary(kind):
        kind = kind.value_type
    is_time = arrow.types.is_timestamp(kind) or arrow.types.is_duration(kind)
    return bool(is_time or arrow.types.is_integer(kind) or arrow.types.is_floating(kind) or arrow.types.is_boolean(kind))
