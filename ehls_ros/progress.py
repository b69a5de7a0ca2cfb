"""Progress of long work: a bar on a terminal and in notebooks, plain lines elsewhere."""

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

LINE_EVERY = 10.0
"""Shortest time between two lines of progress where standard error is no terminal [s]."""

REDRAWN_EVERY = 0.2
"""Shortest time between two drawings in a notebook [s]."""


class Update(Protocol):
    """Updates a progress bar."""

    def __call__(self, done: int, total: int, doing: str = "") -> None:
        """Set the steps done, the total, and optionally a new title."""


@contextmanager
def progress_bar(title: str, *, shown: bool = True, lines: bool = True) -> Iterator[Update]:
    """Show a progress bar below a notebook's cell or on standard error; where that is a file or a pipe, plain lines.

    The bar disappears once the work is done. Work of less than :data:`LINE_EVERY` gives no line.

    Args:
        title: description of the work.
        shown: whether to show the progress.
        lines: whether to print lines where there is neither a terminal nor a notebook.

    Yields:
        A function that sets the steps done and the total.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    terminal = shown and sys.stderr.isatty() and not console.is_jupyter
    with Progress(*columns, console=console, disable=not terminal, transient=True) as bar:
        task = bar.add_task(title, total=None)
        cell = _Cell(bar) if shown and console.is_jupyter else None
        printed = _Lines(title) if shown and lines and not terminal and cell is None else None

        def update(done: int, total: int, doing: str = "") -> None:
            bar.update(task, completed=done, total=total, description=doing or None)
            if cell is not None:
                cell.redraw()
            if printed is not None:
                printed.print(done, total, doing)

        try:
            yield update
        finally:
            if cell is not None:
                cell.clear()


def announce(text: str) -> None:
    """Print a line on standard error at once, above a progress bar if there is one."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def duration_text(seconds: float) -> str:
    """Write a duration: seconds, minutes and seconds, or hours and minutes."""
    if not math.isfinite(seconds):
        return "–"
    if seconds < 100.0:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60} min"


class _Lines:
    """Progress as lines on standard error."""

    def __init__(self, title: str) -> None:
        self._doing = title
        self._began = self._printed = time.monotonic()

    def print(self, done: int, total: int, doing: str) -> None:
        self._doing = doing or self._doing
        now = time.monotonic()
        if now - self._printed >= LINE_EVERY:
            self._printed = now
            part = f"{100 * done // total} %, " if total else ""
            announce(f"{self._doing}: {part}{duration_text(now - self._began)}")


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
