"""CSV files by the data contract: a header row with the names of the signals, SI units."""

import csv
from array import array
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import ELEMENT_SIGNALS, TIME, Columns
from ehls_ros.recording.table import assemble, choose
from ehls_ros.trajectory import Trajectory

DELIMITERS = ",;\t"
BLOCK = 16384
"""Rows written together."""


def read_csv(path: Path, columns: Columns = MappingProxyType({})) -> Trajectory:
    """Read a CSV file.

    Columns without a name of the data contract are not read, unless the map names them. An empty cell is NaN.

    Args:
        path: the file, UTF-8, with a header row; separated by commas, semicolons or tabs.
        columns: the user's own names and units.

    Returns:
        The trajectory, without metadata.

    Raises:
        BadInput: the file cannot be read, a column or cell is wrong, or time is not strictly increasing.
    """
    where = str(path)
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            header_line = stream.readline()
            delimiter = max(DELIMITERS, key=header_line.count)
            header = [name.strip() for name in next(csv.reader([header_line], delimiter=delimiter), [])]
            chosen = choose(header, columns, where)
            ...
    except OSError as error:
        raise
