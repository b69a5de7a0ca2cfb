"""Files that may be opened: regular ones of bounded size, so that no pipe, device or socket keeps a reader waiting."""

import os
import stat
from pathlib import Path

from ehls_ros.errors import BadInput
from ehls_ros.recording.reason import reason

KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_regular(path: Path, largest: int, expected: str, what: str = "the file", larger: str = "") -> int:
    """Refuse what is no regular file, or a link to one, or too large.

    It is asked of the file system; nothing is opened, which some devices would notice.

    Args:
        path: the file.
        largest: its largest size [B].
        expected: what it should be, for the error.
        what: what the file is to the user.
        larger: what to do with a larger one.

    Returns:
        Its size [B].

    Raises:
        BadInput: it is not there, no regular file, or larger.
    """
    try:
        status = os.stat(path)  # noqa: PTH116 - a path with a null in it is told apart there
    except (OSError, ValueError) as error:
        raise BadInput(f"{what} cannot be read ({reason(error)})", str(path), expected) from None
    if not stat.S_ISREG(status.st_mode):
        kind = KINDS.get(stat.S_IFMT(status.st_mode), "no regular file")
        raise BadInput(f"{what} cannot be read (it is {kind})", str(path), expected)
    if status.st_size > largest:
        raise BadInput(f"{what} has {status.st_size} bytes", str(path), f"{expected} of at most {largest}{larger}")
    return status.st_size


def read_text(path: Path, largest: int, expected: str, what: str = "the file") -> str:
    """Return what a small text file holds.

    Args:
        path: the file, UTF-8.
        largest: its largest length [characters].
        expected: what it should be, for the error.
        what: what the file is to the user.

    Raises:
        BadInput: it cannot be read, is no text, or is longer.
    """
    check_regular(path, 4 * largest, expected, what)
    try:
        with path.open(encoding="utf-8") as stream:
            text = stream.read(largest + 1)
    except OSError as error:
        raise BadInput(f"{what} cannot be read ({reason(error)})", str(path), expected) from None
    except UnicodeDecodeError:
        raise BadInput(f"{what} is no text", str(path), f"{expected} in UTF-8") from None
    if len(text) > largest:
        raise BadInput(f"{what} has more than {largest} characters", str(path), f"{expected} of at most so many")
    return text
