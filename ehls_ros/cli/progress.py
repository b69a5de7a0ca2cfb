"""Progress of long work, on a terminal only."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class Update(Protocol):
    """Moves a bar."""

    def __call__(self, done: int, total: int, doing: str = "") -> None:
        """Say what is done and what there is in all; and, where it changes, what is being done."""


@contextmanager
def progress_bar(title: str) -> Iterator[Update]:
    """Show a bar on standard error while the work lasts; where that is no terminal, show nothing.

    Yields:
        A function to be called with what is done and what there is in all.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def update(done: int, total: int, doing: str = "") -> None:
            bar.update(task, completed=done, total=total, description=doing or None)

        yield update
