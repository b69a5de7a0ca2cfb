"""Reading of files with references: recorded load spectra and test programmes."""

import csv
from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import Any

from ehls_ros.control.programme.blocks import BLOCKS
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.errors import BadInput, one_of
from ehls_ros.recording import limits
from ehls_ros.recording.regular_file import read_text
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import parse


def read_points(path: Path) -> list[tuple[float, float]]:
    """Read a load spectrum: a CSV with the columns ``time_s`` and ``value``.

    Raises:
        BadInput: a column is missing, a cell is not a finite number, or time does not increase.
    """
    text = read_text(path, limits.TEXT, "a CSV file", "reference file")
    try:
        rows = list(csv.DictReader(StringIO(text, newline="")))
    except csv.Error as error:
        raise BadInput(f"reference file cannot be read ({error})", str(path), "a CSV file") from None
    points: list[tuple[float, float]] = []
    for number, row in enumerate(rows, start=2):
        try:
            time, value = float(row["time_s"]), float(row["value"])
        except (KeyError, TypeError, ValueError):
            raise BadInput(f"row is {row}", f"{path}:{number}", "numbers in the columns time_s and value") from None
        if not (abs(time) < float("inf") and abs(value) < float("inf")):
            raise BadInput(f"row holds {time}, {value}", f"{path}:{number}", "finite numbers")
        if points and time <= points[-1][0]:
            raise BadInput(f"time_s is {time} after {points[-1][0]}", f"{path}:{number}", "increasing times")
        points.append((time, value))
    if len(points) < 2:
        raise BadInput(f"{len(points)} rows", str(path), "a header time_s,value and at least two rows")
    return points


def load_programme(path: Path) -> Programme:
    """Read a programme's file; files named in it are relative to its folder.

    Args:
        path: the file.

    Raises:
        BadInput: a file or one of its keys is wrong.
    """
    return Programme(parse(Parameters, programme_values(path), str(path)), str(path))


def programme_values(path: Path) -> dict[str, Any]:
    """Return the content of a programme's file, with the names of point files replaced by their points.

    Args:
        path: the file.

    Raises:
        BadInput: a file cannot be read, or the programme is no mapping.
    """
    data = read_yaml(path, "programme")
    if not isinstance(data, Mapping):
        raise BadInput(f"a programme is {type(data).__name__}", str(path), "a mapping with the key blocks")
    for key in data:
        if key not in Parameters._fields:
            raise BadInput(f"key {key!r} is unknown", str(path), one_of(key, Parameters._fields))
    blocks = data.get("blocks")
    return {**data, **({"blocks": _with_points(blocks, path.parent)} if isinstance(blocks, list) else {})}


def _with_points(entries: list[Any], folder: Path) -> list[Any]:
    return [_entry(entry, folder) if isinstance(entry, Mapping) else entry for entry in entries]


def _entry(entry: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    made = dict(entry)
    if isinstance(made.get("blocks"), list):
        made["blocks"] = _with_points(made["blocks"], folder)
    kind = made.get("block")
    if "file" in made and kind in BLOCKS.names() and "points" in BLOCKS.load(kind).Parameters._fields:
        made["points"] = [list(point) for point in read_points(folder / str(made.pop("file")))]
    return made
