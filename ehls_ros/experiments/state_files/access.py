"""Access to state files: bounded reads of regular files, atomic replacement, and a trial of the folder before the run."""

import errno
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.recording.reason import reason
from ehls_ros.recording.regular_file import KINDS, check_regular

TRIAL = 1 << 16
"""Size of the file with which a folder is tried [B]; a full disk refuses it."""

LONGEST_NAME = 200
"""Characters of a file's name that the name of its unfinished successor repeats."""

MOST_UNFINISHED = 100
"""Unfinished files of one name and process beside each other; killed writers with the same process number left them."""

UNFINISHED = "part"
"""Suffix of an unfinished file."""

MOST_ASIDE = 10_000
"""Names under which one file is put aside."""


class NotWritten(WorkFailed):
    """A file that could not be written: its path and the reason."""


def read(path: Path, largest: int, expected: str, what: str = "the file") -> bytes | None:
    """Read a regular file.

    Args:
        path: the file, or a link to it.
        largest: largest permitted size [B].
        expected: description of a right file, for errors.
        what: name of the file in errors.

    Returns:
        Its content; None if there is no file, also behind a dangling link.

    Raises:
        BadInput: it is no regular file, too large, or cannot be read.
    """
    if is_absent(path):
        return None
    # Opening some devices has side effects, and a pipe would block; the second check meets a file exchanged in between.
    check_regular(path, largest, expected, what)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with open(descriptor, "rb") as file:  # noqa: PTH123 - a descriptor
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode) or status.st_size > largest:
                raise BadInput(f"{what} was exchanged while it was opened", str(path), expected)
            content = file.read(status.st_size + 1)
    except OSError as error:
        raise BadInput(f"{what} cannot be read ({reason(error)})", str(path), expected) from None
    if len(content) != status.st_size:
        raise BadInput(f"{what} changed while it was read", str(path), expected)
    return content


def is_absent(path: Path) -> bool:
    """Return whether there is no file, also behind a dangling link."""
    try:
        os.stat(path)  # noqa: PTH116 - raises ValueError for a path that contains a null
    except FileNotFoundError:
        return True
    except (OSError, ValueError):
        return False
    return False


def begins_with(path: Path, size: int) -> bytes:
    """Return the first bytes of a regular file; none if it is none, or cannot be read.

    Args:
        path: the file.
        size: most bytes.
    """
    with suppress(OSError, ValueError):
        if stat.S_ISREG(path.stat().st_mode):
            descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            with open(descriptor, "rb") as file:  # noqa: PTH123 - a descriptor
                return file.read(size)
    return b""


def replace(path: Path, write: Callable[[BinaryIO], object], *, durable: bool = True) -> None:
    """Replace a file atomically: whatever ends the process, the old content is there or the new.

    A symbolic link stays: the file it leads to is replaced.

    Args:
        path: the file; its folder exists.
        write: writes the content.
        durable: whether the content must survive a power failure from now on. That waits for the disk, for which no control
            loop has the time; without it, a file system that orders data before names (ext4, btrfs) may lose some seconds.

    Raises:
        NotWritten: with the path and the reason; the old file is as it was.
    """
    try:
        target = _target(path)
        part, descriptor = _unfinished(target)
        try:
            with open(descriptor, "wb") as file:  # noqa: PTH123 - a descriptor
                write(file)
                with suppress(FileNotFoundError):
                    os.fchmod(descriptor, stat.S_IMODE(target.stat().st_mode))
                file.flush()
                if durable:
                    os.fsync(descriptor)
            part.replace(target)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
        if durable:
            _sync_folder(target.parent)
    except (OSError, ValueError) as error:
        raise NotWritten(f"{path}: cannot be written ({reason(error)})") from None


def check_writable(path: Path, expected: str, what: str = "the file") -> None:
    """Check before a run that a file can be written at its end: its folder is made, and a file beside it tried.

    Args:
        path: the file.
        expected: description of a right place, for the error.
        what: name of the file in the error.

    Raises:
        BadInput: the folder cannot be made or written, its disk is full, or something other than a file has the name.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part, descriptor = _unfinished(_target(path))
        try:
            with open(descriptor, "wb") as file:  # noqa: PTH123 - a descriptor
                file.write(bytes(TRIAL))
                file.flush()
                os.fsync(descriptor)
        finally:
            part.unlink()
    except (OSError, ValueError) as error:
        raise BadInput(f"{what} cannot be written ({reason(error)})", str(path), expected) from None


def unused_name(path: Path) -> Path:
    """Return the first name of ``<stem>.1<suffix>``, ``<stem>.2<suffix>``, … that nothing has.

    Raises:
        NotWritten: all names are taken.
    """
    for number in range(1, MOST_ASIDE):
        other = path.with_name(f"{path.stem}.{number}{path.suffix}")
        if not os.path.lexists(other):
            return other
    raise NotWritten(f"{path}: cannot be put aside ({MOST_ASIDE} names are taken)")


def put_aside(path: Path) -> Path:
    """Rename a file, link, pipe or folder as it is, and return its new name.

    Raises:
        NotWritten: it cannot be renamed.
    """
    other = unused_name(path)
    try:
        path.rename(other)
    except OSError as error:
        raise NotWritten(f"{path}: cannot be put aside ({reason(error)})") from None
    return other


def _target(path: Path) -> Path:
    """Return the place that a path leads to; refuse anything but a regular file there."""
    target = Path(os.path.realpath(path))
    try:
        mode = target.lstat().st_mode
    except FileNotFoundError:
        return target
    if stat.S_ISLNK(mode):
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EEXIST, f"it is {KINDS.get(stat.S_IFMT(mode), 'not a regular file')}")
    return target


def _unfinished(target: Path) -> tuple[Path, int]:
    """Create an empty file beside another one, and return its path and descriptor."""
    for number in range(MOST_UNFINISHED):
        part = target.with_name(f".{target.name[:LONGEST_NAME]}.{os.getpid()}.{number}.{UNFINISHED}")
        with suppress(FileExistsError):
            return part, os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    raise OSError(errno.EEXIST, f"{MOST_UNFINISHED} unfinished files lie beside it")


def _sync_folder(folder: Path) -> None:
    """Let the entries of a folder survive a power failure, where its file system has that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
