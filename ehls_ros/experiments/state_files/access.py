"""Access to state files: bounded reads, atomic replacement, a write test before a run, and exclusive use of a folder."""

import errno
import fcntl
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from ehls_ros.errors import BadInput, WorkFailed, reason
from ehls_ros.recording.regular_file import KINDS, check_regular

TEST_SIZE = 1 << 16
"""Size of the test file in a folder [B]; writing it fails on a full disk."""

MAX_NAME_LENGTH = 200
"""Maximum length of a file's name in the name of its unfinished successor [characters]."""

MAX_UNFINISHED = 100
"""Maximum number of unfinished files of one name and process number, left by killed writers."""

UNFINISHED = "part"
"""Suffix of an unfinished file."""

MAX_ASIDE = 10_000
"""Bound of the number in the name of a file put aside."""


class NotWritten(WorkFailed):
    """A file that could not be written: its path and the reason."""


def read(path: Path, largest: int, expected: str, what: str = "the file") -> bytes | None:
    """Read a regular file.

    Args:
        path: the file, or a link to it.
        largest: largest permitted size [B].
        expected: description of a valid file, for errors.
        what: name of the file in errors.

    Returns:
        Its content; None if there is no file, including a dangling link.

    Raises:
        BadInput: it is not a regular file, too large, or cannot be read.
    """
    if is_absent(path):
        return None
    # Opening some devices has side effects, and a pipe would block; the second check detects a file exchanged in between.
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
    """Return whether there is no file; a dangling link counts as none."""
    try:
        os.stat(path)  # noqa: PTH116 - raises ValueError for a path that contains a null
    except FileNotFoundError:
        return True
    except (OSError, ValueError):
        return False
    return False


def first_bytes(path: Path, size: int) -> bytes:
    """Return the first bytes of a regular file; empty if it is not one, or cannot be read.

    Args:
        path: the file.
        size: maximum number of bytes.
    """
    with suppress(OSError, ValueError):
        if stat.S_ISREG(path.stat().st_mode):
            descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            with open(descriptor, "rb") as file:  # noqa: PTH123 - a descriptor
                return file.read(size)
    return b""


def replace(path: Path, write: Callable[[BinaryIO], object], *, durable: bool = True) -> None:
    """Replace a file atomically: if the process ends, either the old or the new content exists.

    A symbolic link is kept, and its target replaced.

    Args:
        path: the file; its folder exists.
        write: function that writes the content.
        durable: whether the content must survive a power failure from now on. This waits for the disk, too long for a control
            loop. Without it, a file system that orders data before names (ext4, btrfs) may lose some seconds.

    Raises:
        NotWritten: writing failed, with the path and the reason; the old file is unchanged.
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
    """Check before a run that a file can be written: create its folder and write a test file beside it.

    Args:
        path: the file.
        expected: description of a valid place, for the error.
        what: name of the file in the error.

    Raises:
        BadInput: the folder cannot be created or written, the disk is full, or the path is not a regular file.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part, descriptor = _unfinished(_target(path))
        try:
            with open(descriptor, "wb") as file:  # noqa: PTH123 - a descriptor
                file.write(bytes(TEST_SIZE))
                file.flush()
                os.fsync(descriptor)
        finally:
            part.unlink()
    except (OSError, ValueError) as error:
        raise BadInput(f"{what} cannot be written ({reason(error)})", str(path), expected) from None


def unused_name(path: Path) -> Path:
    """Return the first unused name of ``<stem>.1<suffix>``, ``<stem>.2<suffix>``, ….

    Raises:
        NotWritten: all names are taken.
    """
    for number in range(1, MAX_ASIDE):
        other = path.with_name(f"{path.stem}.{number}{path.suffix}")
        if not os.path.lexists(other):
            return other
    raise NotWritten(f"{path}: cannot be put aside ({MAX_ASIDE} names are taken)")


def put_aside(path: Path) -> Path:
    """Rename a file, link, pipe or folder unchanged, and return its new name.

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
    """Resolve a path; reject anything but a regular file there."""
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
    for number in range(MAX_UNFINISHED):
        part = target.with_name(f".{target.name[:MAX_NAME_LENGTH]}.{os.getpid()}.{number}.{UNFINISHED}")
        with suppress(FileExistsError):
            return part, os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    raise OSError(errno.EEXIST, f"{MAX_UNFINISHED} unfinished files lie beside it")


def _sync_folder(folder: Path) -> None:
    """Secure the entries of a folder against a power failure, if supported by its file system."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


LOCKS = Path("/proc/locks")
"""The system's list of locks."""


class FolderLock:
    """Exclusive lock on a folder, held until it is released or the process ends for any reason.

    The folder itself is locked (flock), so that files in it can be replaced and no lock file is needed.

    Attributes:
        remark: sentence for the operator if the file system cannot lock folders, as in some networks; empty if locked.
    """

    def __init__(self, folder: Path, work: str) -> None:
        """Lock a folder.

        Args:
            folder: the folder; it exists.
            work: kind of work in the folder, such as ``programme``, for the error.

        Raises:
            BadInput: the folder is locked already; the error names the process.
        """
        self.remark, self._descriptor = "", -1
        try:
            self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            what = f"{_holder(self._descriptor)} runs another {work} in the folder"
            self.release()
            raise BadInput(what, str(folder), "another folder, or that process stopped first") from None
        except OSError as error:
            self.remark = f"{folder} cannot be locked ({reason(error)}): start no other {work} in it"
            self.release()

    def release(self) -> None:
        """Release the lock, if it is held."""
        if self._descriptor >= 0:
            # After closing alone, processes forked meanwhile would still hold the lock.
            with suppress(OSError):
                fcntl.flock(self._descriptor, fcntl.LOCK_UN)
            os.close(self._descriptor)
            self._descriptor = -1


def _holder(descriptor: int) -> str:
    """Return the process with the lock on an open file; without its number if the system does not list it."""
    status = os.fstat(descriptor)
    place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    with suppress(OSError):
        for line in LOCKS.read_text(encoding="ascii").splitlines():
            # Number, type, mode, access, process, place, first and last byte. A process of another container has the number 0.
            words = line.split()
            if len(words) == 8 and (words[1], words[5]) == ("FLOCK", place) and words[4] != "0":
                return f"process {words[4]}"
    return "another process"
