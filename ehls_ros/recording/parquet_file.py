"""Parquet files by the data contract: a column for each signal. Needs pyarrow, which is not installed with ehls_ros."""

from importlib import import_module
from pathlib import Path
from types import MappingProxyType

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Columns
from ehls_ros.recording.reason import reason
from ehls_ros.recording.table import assemble, choose
from ehls_ros.trajectory import Trajectory


def read_parquet(path: Path, columns: Columns = MappingProxyType({})) -> Trajectory:
    """Read a Parquet file.

    Args:
        path: the file; a null is NaN.
        columns: the user's own names and units.

    Returns:
        The trajectory, without metadata.

    Raises:
        BadInput: pyarrow is missing, the file cannot be read, a column is wrong, or time does not grow with every row.
    """
    where = str(path)
    try:
        parquet = import_module("pyarrow.parquet")
    except ImportError:
        raise BadInput("pyarrow is not installed", where, "pip install pyarrow, or the data as CSV") from None
    try:
        table = parquet.read_table(path)
    except (OSError, ValueError) as error:
        raise BadInput(f"it is no Parquet file ({reason(error)})", where, "a Parquet file") from None
    chosen = choose(table.column_names, columns, where)
    values = {name: table.column(column.name).to_numpy() for name, column in chosen.items()}
    return assemble(values, chosen, where, lambda row: f"row {row + 1}")
