"""Reading of test programmes from YAML files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ehls_ros.control.programme.blocks import BLOCKS
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.errors import BadInput, one_of
from ehls_ros.experiments.points_file import read_points
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import parse


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
