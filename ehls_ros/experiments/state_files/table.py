"""CSV tables that grow by lines and survive a kill of the process.

A table is checked before it is changed: its heading, and its last lines by a function specific to the table. Only then is an
incomplete last line cut off.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ehls_ros.errors import BadInput, reason
from ehls_ros.experiments.state_files import access
from ehls_ros.recording import limits
from ehls_ros.recording.regular_file import check_regular

MAX_LINE_LENGTH = 4096
"""Longest line of a table [B]."""

TAIL = 1 << 16
"""Size of the last part of a table whose lines are checked [B]."""

Check = Callable[[list[str]], object]
"""Function that checks the cells of one line; raises ValueError for an invalid one."""


class Judged(NamedTuple):
    """A checked table that may be continued.

    Attributes:
        lines: cells of its last lines, without the heading.
        end: size up to the end of the last complete line [B]; 0: there is none, not even a heading.
    """

    lines: tuple[list[str], ...]
    end: int


def judge(path: Path, heading: str, check: Check, expected: str, what: str) -> Judged:
    """Check whether a table may be continued, without changing it.

    Args:
        path: the file; it need not exist.
        heading: its first line.
        check: check of each of the last lines.
        expected: description of a valid file, for errors.
        what: name of the file in errors.

    Raises:
        BadInput: it is not a regular file, another table, or its last lines are damaged.
    """
    if access.is_absent(path):
        return Judged((), 0)
    size = check_regular(path, limits.TABLE, expected, what)
    first = f"{heading}\n".encode()
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:  # noqa: PTH123 - a descriptor
            head = file.read(len(first))
            begin = file.seek(max(min(len(first), size), size - TAIL))
            tail = file.read(TAIL)
    except OSError as error:
        raise BadInput(f"{what} cannot be read ({reason(error)})", str(path), expected) from None
    if head != first:
        if first.startswith(head):
            # Its first writer was killed, or the disk was full.
            return Judged((), 0)
        raise BadInput(f"{what} has other columns", str(path), expected)
    if begin > len(first):
        # The first line of the tail is incomplete.
        skipped = tail.find(b"\n") + 1
        begin, tail = begin + skipped, tail[skipped:]
    whole = tail.rfind(b"\n") + 1
    try:
        _check_text(tail)
        lines = tuple(line.split(",") for line in tail[:whole].decode("ascii").splitlines())
        for line in lines:
            check(line)
    except ValueError as error:
        raise BadInput(f"{what} is damaged at its end ({error})", str(path), expected) from None
    return Judged(lines, begin + whole)


def rows(path: Path, heading: str, check: Check, expected: str, what: str) -> Iterator[list[str]]:
    """Yield the cells of all complete lines of a table, without the heading; none if there is no file.

    Arguments as of :func:`judge`.

    Raises:
        BadInput: it is not a regular file, another table, or a line is damaged.
    """
    judged = judge(path, heading, check, expected, what)
    if not judged.end:
        return
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:  # noqa: PTH123 - a descriptor
            file.readline(MAX_LINE_LENGTH)
            while file.tell() < judged.end:
                cells = _cells(file.readline(MAX_LINE_LENGTH))
                check(cells)
                yield cells
    except OSError as error:
        raise BadInput(f"{what} cannot be read ({reason(error)})", str(path), expected) from None
    except ValueError as error:
        raise BadInput(f"{what} is damaged ({error})", str(path), expected) from None


def _cells(line: bytes) -> list[str]:
    """Return the cells of a line.

    Raises:
        ValueError: it is too long, or not text.
    """
    if not line.endswith(b"\n"):
        raise ValueError(f"a line has more than {MAX_LINE_LENGTH} bytes")
    _check_text(line)
    return line[:-1].decode("ascii").split(",")


def _check_text(tail: bytes) -> None:
    """Reject bytes that are not text, such as zeros after a power failure."""
    for line in tail.split(b"\n"):
        if len(line) > MAX_LINE_LENGTH:
            raise ValueError(f"a line has {len(line)} bytes")
        if not (line.isascii() and line.decode("ascii", "replace").isprintable()):
            raise ValueError("a line is not text")


class Table:
    """Table open for further lines; lines are buffered until completely written, so that a full disk loses or tears none."""

    def __init__(self, path: Path, heading: str, end: int) -> None:
        """Open a checked table, and cut off an incomplete last line.

        Args:
            path: the file.
            heading: its first line.
            end: see :class:`Judged`.

        Raises:
            access.NotWritten: writing failed, with the path and the reason.
        """
        self._path = path
        self._pending = b"" if end else f"{heading}\n".encode()
        self._descriptor = -1
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
            self._descriptor = os.open(path, flags, 0o666)
            if os.fstat(self._descriptor).st_size > end:
                os.ftruncate(self._descriptor, end)
            os.lseek(self._descriptor, end, os.SEEK_SET)
        except OSError as error:
            self.close()
            raise self._error(error) from None
        self.flush()

    def add(self, line: str) -> None:
        """Buffer a line, without its line end, for the next :meth:`flush`."""
        self._pending += f"{line}\n".encode()

    def flush(self) -> None:
        """Pass the added lines to the operating system.

        Raises:
            access.NotWritten: writing failed, with the path and the reason; unwritten lines are kept.
        """
        try:
            while self._pending:
                self._pending = self._pending[os.write(self._descriptor, self._pending) :]
        except OSError as error:
            raise self._error(error) from None

    def sync(self) -> None:
        """Secure flushed lines against a power failure, if supported by the file system."""
        with suppress(OSError):
            os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _error(self, error: OSError) -> access.NotWritten:
        return access.NotWritten(f"{self._path}: cannot be written ({reason(error)})")
