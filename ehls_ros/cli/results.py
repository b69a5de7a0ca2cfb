"""Output of the verbs: folders of results, tables and file names on the terminal."""

import json
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ehls_ros.errors import BadInput

DIAGNOSIS, EXTENDED_RIG = "diagnosis.json", "rig_extended.yaml"
"""Files in the folder of a diagnosis that other verbs read."""


def writable(folder: Path, file: str) -> Path:
    """Create a folder if needed, and check in advance that a file can be written in it.

    Raises:
        BadInput: the file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        new = not (folder / file).exists()
        (folder / file).touch()
        if new:
            (folder / file).unlink()  # interrupted work must leave no empty result
    except OSError as error:
        raise BadInput(f"the folder cannot be written ({error.strerror})", str(folder), "a writable folder") from None
    return folder


@contextmanager
def all_or_nothing(folder: Path) -> Iterator[Path]:
    """Give a scratch folder whose files are moved to the folder at the end, so that an interruption leaves no partial results.

    Raises:
        BadInput: the results cannot be written.
    """
    try:
        scratch = Path(tempfile.mkdtemp(prefix=".ehls-", dir=folder))
        try:
            yield scratch
            for file in sorted(scratch.iterdir()):
                file.replace(folder / file.name)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise BadInput(f"the results cannot be written ({error.strerror})", str(folder), "a writable folder") from None


def write_json(path: Path, document: object) -> None:
    """Write a JSON document for readers and programs."""
    path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def print_table(
    title: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: Sequence[str] = (),
    unbroken: Sequence[str] = (),
) -> None:
    """Print a table; where the output is no terminal, 140 characters wide.

    Args:
        title: above the table.
        header: one title per column.
        rows: one text per cell.
        right: titles of the columns aligned to the right.
        unbroken: titles of the columns whose texts are not broken into lines.
    """
    table = Table(title=title)
    for heading in header:
        table.add_column(heading, justify="right" if heading in right else "left", no_wrap=heading in unbroken)
    for row in rows:
        table.add_row(*row)
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 140).print(table)


def print_files(files: Iterable[tuple[str, Path]]) -> None:
    """Print the names and paths of the written files."""
    for name, path in files:
        print(f"  {name:<8}{path}")
