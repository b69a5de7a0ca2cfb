"""Loads recorded or measured data in any format of the data contract."""

from collections.abc import Callable, Mapping
from pathlib import Path

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import STORAGE_SUFFIXES, read_bag
from ehls_ros.recording.columns import Columns
from ehls_ros.recording.csv_file import read_csv
from ehls_ros.recording.mat_file import read_mat
from ehls_ros.recording.parquet_file import read_parquet
from ehls_ros.trajectory import Trajectory

TABLES: Mapping[str, Callable[[Path, Columns], Trajectory]] = {
    ".csv": read_csv,
    ".mat": read_mat,
    ".parquet": read_parquet,
}
"""Readers of files with named columns, by suffix."""


def load(path: Path, columns: Columns | None = None) -> Trajectory:
    """Read data in any supported format.

    Args:
        path: folder of a rosbag2, or a file ``.mcap``, ``.db3``, ``.csv``, ``.mat`` or ``.parquet``.
        columns: the user's own names and units; not for bags.

    Returns:
        The trajectory.

    Raises:
        BadInput: the data cannot be read in any of these formats.
    """
    suffix = path.suffix.lower()
    if suffix in TABLES:
        return TABLES[suffix](path, columns or {})
    if columns:
        raise BadInput("a bag has no columns to map", str(path), "a map of columns only with a .csv, .mat or .parquet file")
    if suffix not in STORAGE_SUFFIXES and _is_file(path):
        expected = f"the folder of a rosbag2 or a file {', '.join((*STORAGE_SUFFIXES, *TABLES))}"
        raise BadInput("its format is unknown", str(path), expected)
    return read_bag(path)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        return False  # reading it will say why
