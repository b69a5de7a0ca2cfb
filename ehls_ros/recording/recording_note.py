"""The note beside a bag that is being written: how much is safely on the disk.

Closing the bag removes the note. With it :mod:`ehls_ros.recording.recovery` tells how much is missing of what a killed
recorder left behind.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field, TypeAdapter, ValidationError

from ehls_ros.errors import BadInput
from ehls_ros.recording.provenance import checksum_of
from ehls_ros.recording.reason import reason
from ehls_ros.recording.regular_file import check_regular

NOTE = "being_recorded.json"
"""Name of the note in the bag's folder."""

AS_WRITTEN = "a note as the recorder wrote it"

LARGEST = 1 << 20
"""Size of a note at most [B]."""


class Flushed(NamedTuple):
    """What is known to be on the disk of one topic.

    Attributes:
        messages: number of its messages.
        newest_ns: latest time of sending [ns].
    """

    messages: Annotated[int, Field(strict=True, ge=0, le=1 << 53)]
    newest_ns: Annotated[int, Field(strict=True, ge=0, lt=1 << 63)]


class Note(NamedTuple):
    """What the note says.

    Attributes:
        flushed: by the topic's full name.
    """

    flushed: Mapping[str, Flushed]


class _Written(NamedTuple):
    flushed: Annotated[Mapping[str, Flushed], Field(min_length=1)]
    checksum: str


_WRITTEN = TypeAdapter(_Written)


def write_note(folder: Path, note: Note) -> None:
    """Put the note in a bag's folder, in place of the last one, never half of it.

    Args:
        folder: the bag's folder.
        note: what it says.

    Raises:
        OSError: the disk is full or fails.
    """
    fresh = folder / f"{NOTE}.new"
    content = {"flushed": _plain(note.flushed), "checksum": _checksum(note.flushed)}
    fresh.write_text(json.dumps(content), encoding="utf-8")
    fresh.replace(folder / NOTE)


def remove_note(folder: Path) -> None:
    """Take the note away once the bag is whole."""
    (folder / NOTE).unlink(missing_ok=True)


def read_note(folder: Path) -> Note:
    """Return the note of a bag's folder.

    Args:
        folder: the bag's folder.

    Raises:
        BadInput: there is none, or it is not as it was written.
    """
    path = folder / NOTE
    check_regular(path, sys.maxsize, AS_WRITTEN, "the note")
    try:
        with path.open("rb") as stream:
            written = _WRITTEN.validate_json(stream.read(LARGEST))
    except OSError as error:
        raise BadInput(f"the note cannot be read ({reason(error)})", str(path), AS_WRITTEN) from None
    except ValidationError:
        raise BadInput("the note is damaged", str(path), AS_WRITTEN) from None
    if written.checksum != _checksum(written.flushed):
        raise BadInput("the note is not as it was written", str(path), AS_WRITTEN)
    return Note(written.flushed)


def _plain(flushed: Mapping[str, Flushed]) -> dict[str, dict[str, int]]:
    return {path: topic._asdict() for path, topic in flushed.items()}


def _checksum(flushed: Mapping[str, Flushed]) -> str:
    return f"blake2b-{checksum_of(json.dumps(_plain(flushed)).encode()):016x}"
