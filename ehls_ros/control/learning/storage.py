"""What was learnt, in a file beside the programme."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput

Stored = Mapping[str, NDArray[Any]]

FORMAT = "ehls_ros learning 1"


def write(path: Path, about: Mapping[str, str], lessons: Mapping[int, Stored]) -> None:
    """Write what was learnt; a file of that name is replaced at once or not at all.

    Args:
        path: the file.
        about: what it was learnt with, such as the law's name.
        lessons: arrays by name, of each block.
    """
    entries: dict[str, NDArray[Any]] = {"format": np.array(FORMAT), "blocks": np.array(sorted(lessons), dtype=np.int64)}
    entries |= {f"about.{key}": np.array(value) for key, value in about.items()}
    entries |= {f"{block}.{key}": value for block, lesson in lessons.items() for key, value in lesson.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    with unfinished.open("wb") as file:
        np.savez(file, **entries)  # type: ignore[arg-type]  # names of arrays, not of options
    unfinished.replace(path)


def read(path: Path, about: Mapping[str, str]) -> dict[int, dict[str, NDArray[Any]]]:
    """Read what was learnt.

    Args:
        path: the file.
        about: what it must have been learnt with.

    Returns:
        Arrays by name, of each block; empty if there is no file.

    Raises:
        BadInput: it is something else, or was learnt with something else.
    """
    if not path.exists():
        return {}
    expected = "a file that the companion learning wrote, or a name that does not exist yet"
    try:
        with np.load(path, allow_pickle=False) as data:
            entries = {name: data[name] for name in data.files}
    except (OSError, ValueError, BadZipFile) as error:
        raise BadInput(f"cannot be read ({error})", str(path), expected) from None
    if str(entries.get("format")) != FORMAT:
        raise BadInput("holds nothing learnt", str(path), expected)
    for key, value in about.items():
        found = str(entries.get(f"about.{key}"))
        if found != value:
            raise BadInput(f"was learnt with {key} {found}", str(path), f"{key} {value}, or another file")
    blocks = [int(block) for block in entries["blocks"]]
    prefixes = {block: f"{block}." for block in blocks}
    return {
        block: {name.removeprefix(prefix): value for name, value in entries.items() if name.startswith(prefix)}
        for block, prefix in prefixes.items()
    }
