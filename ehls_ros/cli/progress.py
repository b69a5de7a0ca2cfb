"""Progress bars for long work, on a terminal only."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class Update(Protocol):
    """Updates a progress bar."""

    def __call__(self, done: int, total: int, doing: str = "") -> None:
        """Set the steps done, the total, and optionally a new title."""


@contextmanager
def progress_bar(title: str) -> Iterator[Update]:
    """Show a progress bar on standard error; nothing if that is not a terminal.

    Yields:
        A function that sets the steps done and the total.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def update(done: int, total: int, doing: str = "") -> None:
            bar.update(task, completed=done, total=total, description=doing or None)

        yield update
