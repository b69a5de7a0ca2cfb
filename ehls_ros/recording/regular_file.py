"""Checks before a file is opened: only regular files of bounded size, so that no pipe, device or socket blocks a reader."""

import os
import stat
from pathlib import Path

from ehls_ros.errors import BadInput, reason

KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_regular(path: Path, largest: int, expected: str, what: str = "the file", larger: str = "") -> int:
    """Check that a path is a regular file, or a link to one, and not too large.

    The file is not opened, since opening some devices has side effects.

    Args:
        path: the file.
        largest: largest permitted size [B].
        expected: description of a valid file, for the error.
        what: name of the file in the error.
        larger: advice for a larger file, appended to the error.

    Returns:
        The size [B].

    Raises:
        BadInput: the file is missing, not regular, or too large.
    """
    try:
        status = os.stat(path)  # noqa: PTH116 - raises ValueError for a path that contains a null
    except (OSError, ValueError) as error:
        raise BadInput(f"{what} cannot be read ({reason(error)})", str(path), expected) from None
    if not stat.S_ISREG(status.st_mode):
        kind = KINDS.get(stat.S_IFMT(status.st_mode), "not a regular file")
        raise BadInput(f"{what} cannot be read (it is {kind})", str(path), expected)
    if status.st_size > largest:
        raise BadInput(f"{what} has {status.st_size} bytes", str(path), f"{expected} of at most {largest}{larger}")
    return status.st_size


def read_text(path: Path, largest: int, expected: str, what: str = "the file") -> str:
    """Read a small text file.

    Args:
        path: the file, in UTF-8.
        largest: largest permitted length [characters].
        expected: description of a valid file, for the error.
        what: name of the file in the error.

    Raises:
        BadInput: the file cannot be read, is not text, or is too long.
    """
    check_regular(path, 4 * largest, expected, what)
    try:
        with path.open(encoding="utf-8") as stream:
            text = stream.read(largest + 1)
    except OSError as error:
        raise BadInput(f"{what} cannot be read ({reason(error)})", str(path), expected) from None
    except UnicodeDecodeError:
        raise BadInput(f"{what} is not text", str(path), f"{expected} in UTF-8") from None
    if len(text) > largest:
        raise BadInput(f"{what} has more than {largest} characters", str(path), f"{expected} within this limit")
    return text
