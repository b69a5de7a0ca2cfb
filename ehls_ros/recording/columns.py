"""Maps the user's own column names and units to the names of the data contract."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import parse, quantity, text
from ehls_ros.trajectory import SIGNALS

TIME = "time_s"

ELEMENT_SIGNALS = ("friction_elements_n", "friction_slipping")
"""Signals with one column per friction element: ``friction_elements_n_1``, ``friction_elements_n_2`` and so on."""

EXPECTED_MAP = "a mapping like 'position_m: {name: x, scale: 0.001, offset: 0.0}'"


class Column(NamedTuple):
    """A column of the user's file; the signal is ``scale`` times its value plus ``offset``."""

    name: Annotated[str, text("name of the column in the file")]
    scale: Annotated[float, quantity("1", "SI units per unit of the column")] = 1.0
    offset: Annotated[float, quantity("SI", "added after scaling")] = 0.0


Columns = Mapping[str, Column]
"""Columns by contract name."""


def read_columns(path: Path) -> Columns:
    """Read a map of column names.

    Args:
        path: YAML file with an entry ``contract_name: {name: ..., scale: 1.0, offset: 0.0}`` for each mapped column.

    Returns:
        The columns by contract name.

    Raises:
        BadInput: the file cannot be read, or an entry is wrong.
    """
    content = read_yaml(path, "map of columns")
    if not isinstance(content, dict):
        raise BadInput(f"it contains {content!r}", str(path), EXPECTED_MAP)
    return {str(name): _column(str(name), entry, path) for name, entry in content.items()}


def _column(name: str, entry: object, path: Path) -> Column:
    if not is_contract_name(name):
        raise BadInput(f"name '{name}' is unknown", str(path), f"one of {', '.join((TIME, *SIGNALS))}")
    where = f"{path}, {name}"
    if not isinstance(entry, dict):
        raise BadInput(f"it is {entry!r}", where, EXPECTED_MAP)
    column = parse(Column, entry, where)
    if column.scale == 0:
        raise BadInput("scale is 0", where, "a factor other than 0")
    return column


def is_contract_name(name: str) -> bool:
    """Tell whether a column name belongs to the data contract."""
    return name == TIME or name in SIGNALS or element_of(name) is not None


def element_of(name: str) -> tuple[str, int] | None:
    """Return signal and element number, from 1, of a friction element's column; None for any other column."""
    signal, _, number = name.rpartition("_")
    known = signal in ELEMENT_SIGNALS and number.isascii() and number.isdecimal() and not number.startswith("0")
    return (signal, int(number)) if known else None
