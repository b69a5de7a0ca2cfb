"""The note beside a bag that is being written: what of it is safely on the disk.

Closing the bag removes the note. With it :mod:`ehls_ros.recording.recovery` tells what a killed recorder left behind.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from ehls_ros.errors import BadInput
from ehls_ros.recording.reason import reason

NOTE = "being_recorded.json"
"""Name of the note in the bag's folder."""

RECOVERABLE = "the folder of a bag that ehls_ros was recording"


class Flushed(NamedTuple):
    """What is known to be on the disk of one topic.

    Attributes:
        messages: number of its messages.
        checksum: sum of :func:`~ehls_ros.recording.provenance.message_checksum` over them.
    """

    messages: int
    checksum: int


class Note(NamedTuple):
    """What the note says.

    Attributes:
        storage: rosbag2 storage plugin.
        namespace: namespace of the topics.
        configuration: what the run was made with, JSON values.
        flushed: by the topic's full name.
    """

    storage: str
    namespace: str
    configuration: Mapping[str, Any]
    flushed: Mapping[str, Flushed]


_NOTE = TypeAdapter(Note)


def write_note(folder: Path, note: Note) -> None:
    """Put the note in a bag's folder, in place of the last one, never half of it.

    Args:
        folder: the bag's folder.
        note: what it says.

    Raises:
        OSError: the disk is full or fails.
    """
    fresh = folder / f"{NOTE}.new"
    fresh.write_text(json.dumps(note._asdict()), encoding="utf-8")
    fresh.replace(folder / NOTE)


def remove_note(folder: Path) -> None:
    """Take the note away once the bag is whole."""
    (folder / NOTE).unlink(missing_ok=True)


def read_note(folder: Path) -> Note:
    """Return the note of a bag's folder.

    Args:
        folder: the bag's folder.

    Raises:
        BadInput: there is none, or it is damaged.
    """
    path = folder / NOTE
    try:
        return _NOTE.validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        what = "no recording was cut off here" if folder.exists() else "it does not exist"
        raise BadInput(what, str(folder), RECOVERABLE) from None
    except OSError as error:
        raise BadInput(f"the note cannot be read ({reason(error)})", str(path), RECOVERABLE) from None
    except ValidationError:
        raise BadInput("the note is damaged", str(path), RECOVERABLE) from None
