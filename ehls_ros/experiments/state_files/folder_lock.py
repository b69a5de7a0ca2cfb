"""Exclusive lock on a folder, so that one process at a time writes into it."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from ehls_ros.errors import BadInput, reason

LOCKS = Path("/proc/locks")
"""The system's list of locks."""


class FolderLock:
    """Exclusive lock on a folder, held until it is released or the process ends for any reason.

    The folder itself is locked (flock), so that files in it can be replaced and no lock file is needed.

    Attributes:
        remark: sentence for the operator if the file system cannot lock folders, as some network file systems; empty if locked.
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
    """Return the process that has locked an open file, without its number if the system does not list it."""
    status = os.fstat(descriptor)
    place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    with suppress(OSError):
        for line in LOCKS.read_text(encoding="ascii").splitlines():
            # Number, type, mode, access, process, place, first and last byte. A process of another container has the number 0.
            words = line.split()
            if len(words) == 8 and (words[1], words[5]) == ("FLOCK", place) and words[4] != "0":
                return f"process {words[4]}"
    return "another process"
