"""Unforeseen exceptions of nodes: one line in the log and on stderr, a traceback file, the end of the process."""

import os
import sys
import traceback
from pathlib import Path
from typing import Protocol

import rclpy.logging
from rclpy.impl.rcutils_logger import RcutilsLogger

from ehls_ros.process import Stopping

LONGEST = 300
"""Longest text of an exception in the log [characters]; the traceback has all of it."""


class Logging(Protocol):
    """A node that has a name and a log."""

    def get_name(self) -> str:
        """Return the name."""

    def get_logger(self) -> RcutilsLogger:
        """Return the log."""


class Failures:
    """The unforeseen exceptions of one process.

    Attributes:
        stopping: is set with the first one.
        noted: number of exceptions and of failed parts of the work.
    """

    def __init__(self, stopping: Stopping) -> None:
        """Start with no exceptions."""
        self.stopping = stopping
        self.noted = 0

    def note(self, error: BaseException, node: Logging | None, activity: str) -> None:
        """Log an exception and stop the process.

        Args:
            error: the exception.
            node: node whose code raised it; None before there is one.
            activity: during which it was raised, such as ``configure``.
        """
        self.noted += 1
        line = f"{activity} failed, so the node ends: {described(error)}; {_kept(error, node)}"
        if node is None:
            print(line, file=sys.stderr, flush=True)
        else:
            node.get_logger().fatal(line)
        self.stopping.set()

    def fail_at_end(self) -> None:
        """Make the process end with exit code 1 whenever it ends: part of its work failed, as the log reports."""
        self.noted += 1


def described(error: BaseException) -> str:
    """Return an exception in one line, with the file and line that raised it."""
    text = " ".join(str(error).split())
    text = text if len(text) <= LONGEST else f"{text[:LONGEST]}…"
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}{': ' if text else ''}{text}{place}"


def _kept(error: BaseException, node: Logging | None) -> str:
    """Write the traceback to a file of the log folder, and return the phrase that points to it."""
    content = "".join(traceback.format_exception(error))
    try:
        folder = Path(rclpy.logging.get_logging_directory())
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{'ehls_ros' if node is None else node.get_name()}-{os.getpid()}.traceback"
        with path.open("a", encoding="utf-8") as file:
            file.write(content)
    except (OSError, RuntimeError) as failure:
        print(content, file=sys.stderr, flush=True)
        return f"the traceback is on stderr, as no file could be written ({failure})"
    return f"traceback: {path}"
