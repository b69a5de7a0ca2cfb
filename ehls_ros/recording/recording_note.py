"""Note beside a bag being written: the number of messages safely on disk.

Closing the bag removes the note. From the note of a killed recorder, :mod:`ehls_ros.recording.recovery` determines the number
of missing messages.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording.provenance import checksum_of
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.schema import from_json, quantity

NOTE = "being_recorded.json"
"""Name of the note in the bag's folder."""

AS_WRITTEN = "an unaltered note of the recorder"

MAX_SIZE = 1 << 20
"""Largest note [B]."""


class Flushed(NamedTuple):
    """Messages of one topic that are on disk.

    Attributes:
        messages: number of messages.
        newest_ns: latest time of sending [ns].
    """

    messages: Annotated[int, quantity("1", "number of messages", minimum=0, maximum=1 << 53)]
    newest_ns: Annotated[int, quantity("ns", "latest time of sending", minimum=0, maximum=(1 << 63) - 1)]


class _Note(NamedTuple):
    flushed: Mapping[str, Flushed]
    checksum: str


def write_note(folder: Path, flushed: Mapping[str, Flushed]) -> None:
    """Replace the note in a bag's folder atomically.

    Args:
        folder: the bag's folder.
        flushed: messages on disk, by the topic's full name.

    Raises:
        OSError: the disk is full or fails.
    """
    fresh = folder / f"{NOTE}.new"
    content = {"flushed": _plain(flushed), "checksum": _checksum(flushed)}
    fresh.write_text(json.dumps(content), encoding="utf-8")
    fresh.replace(folder / NOTE)


def remove_note(folder: Path) -> None:
    """Remove the note once the bag is complete."""
    (folder / NOTE).unlink(missing_ok=True)


def read_note(folder: Path) -> Mapping[str, Flushed]:
    """Read the note of a bag's folder.

    Args:
        folder: the bag's folder.

    Returns:
        The messages on disk, by the topic's full name.

    Raises:
        BadInput: there is no note, or it has been altered.
    """
    path = folder / NOTE
    check_regular(path, sys.maxsize, AS_WRITTEN, "the note")
    try:
        with path.open("rb") as stream:
            note: _Note = from_json(_Note, stream.read(MAX_SIZE))
    except OSError as error:
        raise BadInput(f"the note cannot be read ({reason(error)})", str(path), AS_WRITTEN) from None
    except ValueError:
        note = _Note({}, "")
    if not note.flushed:
        raise BadInput("the note is damaged", str(path), AS_WRITTEN)
    if note.checksum != _checksum(note.flushed):
        raise BadInput("the note has been altered", str(path), AS_WRITTEN)
    return note.flushed


def _plain(flushed: Mapping[str, Flushed]) -> dict[str, dict[str, int]]:
    return {path: topic._asdict() for path, topic in flushed.items()}


def _checksum(flushed: Mapping[str, Flushed]) -> str:
    return f"blake2b-{checksum_of(json.dumps(_plain(flushed)).encode()):016x}"
