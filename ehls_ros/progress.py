"""Progress bars for long work, on a terminal and in notebooks."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

REDRAWN_EVERY = 0.2
"""Shortest time between two drawings in a notebook [s]."""


class Update(Protocol):
    """Updates a progress bar."""

    def __call__(self, done: int, total: int, doing: str = "") -> None:
        """Set the steps done, the total, and optionally a new title."""


@contextmanager
def progress_bar(title: str, *, shown: bool = True) -> Iterator[Update]:
    """Show a progress bar below a notebook's cell or on standard error; nothing if that is not a terminal.

    It disappears once the work is done.

    Args:
        title: description of the work.
        shown: whether to show the bar.

    Yields:
        A function that sets the steps done and the total.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    terminal = shown and sys.stderr.isatty() and not console.is_jupyter
    with Progress(*columns, console=console, disable=not terminal, transient=True) as bar:
        task = bar.add_task(title, total=None)
        cell = _Cell(bar) if shown and console.is_jupyter else None

        def update(done: int, total: int, doing: str = "") -> None:
            bar.update(task, completed=done, total=total, description=doing or None)
            if cell is not None:
                cell.redraw()

        try:
            yield update
        finally:
            if cell is not None:
                cell.clear()


class _Cell:
    """Progress bar below a notebook's cell, without ipywidgets, which Rich would require."""

    def __init__(self, bar: Progress) -> None:
        self._ipython: Any = import_module("IPython.display")
        self._bar = bar
        self._handle = self._ipython.display(bar, display_id=True)
        self._drawn = time.monotonic()

    def redraw(self) -> None:
        now = time.monotonic()
        if now - self._drawn >= REDRAWN_EVERY:
            self._drawn = now
            self._handle.update(self._bar)

    def clear(self) -> None:
        self._handle.update(self._ipython.HTML(""))
