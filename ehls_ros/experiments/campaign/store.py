"""Files of a campaign: parts while it runs, one table at its end.

A part holds the metrics of runs by their digests, independent of the campaign, so that a changed campaign reuses the runs it
shares with the previous one. A part is complete or missing. A folder is used by one process at a time.
"""

import json
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput, WorkFailed, reason
from ehls_ros.experiments.campaign.plan import Column, Run
from ehls_ros.experiments.campaign.work import METRICS, Row
from ehls_ros.experiments.state_files.access import FolderLock
from ehls_ros.extras import library

COUNTS = ("cycles", "missed_cycles")
"""Metrics that are integers."""


class Folder(NamedTuple):
    """Folder with the files of a campaign."""

    path: Path

    @property
    def parts(self) -> Path:
        """Path of the parts."""
        return self.path / "parts"

    @property
    def results(self) -> Path:
        """Path of the table."""
        return self.path / "results.parquet"

    @property
    def report(self) -> Path:
        """Path of the report."""
        return self.path / "report.html"

    @property
    def campaign(self) -> Path:
        """Path of the campaign file with its base written out."""
        return self.path / "campaign.yaml"


@contextmanager
def opened(path: Path) -> Iterator[Folder]:
    """Create a campaign's folder, or continue in it, and lock it against other processes.

    Raises:
        BadInput: it cannot be written, another campaign is running in it, or pyarrow is not installed.
    """
    _parquet()
    folder = Folder(path)
    try:
        folder.parts.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"the folder cannot be written ({error.strerror})", str(path), "a writable folder") from None
    lock = FolderLock(folder.parts, "campaign")
    try:
        if lock.remark:
            raise BadInput(lock.remark, str(path), "a folder of a local disk")
        yield folder
    finally:
        lock.release()


def _parquet() -> Any:
    return library("pyarrow.parquet", "campaign", "campaign")


def _schema() -> Any:
    arrow: Any = import_module("pyarrow")
    kinds = {name: arrow.int64() if name in COUNTS else arrow.float64() for name in METRICS}
    return arrow.schema([("digest", arrow.string()), *kinds.items(), ("error", arrow.string())])


def digests_done(folder: Folder) -> set[str]:
    """Return the digests of the runs whose metrics are stored."""
    done: set[str] = set()
    for path in sorted(folder.parts.glob("*.parquet")):
        done.update(_read(path, ["digest"]).column("digest").to_pylist())
    return done


def write_part(folder: Folder, rows: Sequence[tuple[str, Row]]) -> None:
    """Write a part.

    Args:
        folder: folder of the campaign.
        rows: digest and metrics of each run.
    """
    if not rows:
        return
    arrow: Any = import_module("pyarrow")
    table = arrow.Table.from_pylist([{"digest": digest, **row} for digest, row in rows], schema=_schema())
    _write(table, folder.parts / f"{rows[0][0]}.parquet")


def _write(table: Any, path: Path) -> None:
    scratch = path.with_suffix(".writing")
    try:
        _parquet().write_table(table, scratch)
        scratch.replace(path)
    except OSError as error:
        raise WorkFailed(f"{path} cannot be written ({reason(error)})") from None


def _read(path: Path, columns: list[str] | None = None) -> Any:
    try:
        return _parquet().read_table(path, columns=columns)
    except (OSError, ValueError) as error:
        expected = "a part as it was written; delete it to have its runs made again"
        raise BadInput(f"the part cannot be read ({reason(error)})", str(path), expected) from None


class Index:
    """The runs of a campaign as columns: number, draw, digest, varied values."""

    def __init__(self, columns: Sequence[Column]) -> None:
        """Start without a run."""
        self._columns = columns
        self._digests: list[str] = []
        self._draws = array("q")
        self._values: dict[str, Any] = {column.path: array("d") if column.numeric else [] for column in columns}

    def add(self, run: Run, digest: str) -> None:
        """Add the next run."""
        self._digests.append(digest)
        self._draws.append(run.draw)
        for column in self._columns:
            value = run.values[column.path]
            self._values[column.path].append(value if column.numeric else str(value))

    def write_results(self, folder: Folder, about: Mapping[str, Any]) -> None:
        """Write the table: one row per run, in their order.

        Args:
            folder: folder of the campaign, with the metrics of every run.
            about: metadata of the file.
        """
        arrow: Any = import_module("pyarrow")
        compute: Any = import_module("pyarrow.compute")
        parts = [_read(path) for path in sorted(folder.parts.glob("*.parquet"))]
        metrics_table = arrow.concat_tables(parts).combine_chunks()
        at = compute.index_in(
            arrow.array(self._digests, arrow.string()), value_set=metrics_table.column("digest").combine_chunks()
        )
        if at.null_count:
            raise WorkFailed(f"{at.null_count} runs are missing in {folder.parts}; start the campaign again")
        metrics = metrics_table.take(at)
        columns = {"run": arrow.array(range(len(self._digests))), "draw": arrow.array(self._draws)}
        columns |= {path: arrow.array(values) for path, values in self._values.items()}
        columns |= {name: metrics.column(name) for name in (*METRICS, "error", "digest")}
        table = arrow.table(columns).replace_schema_metadata({"ehls_ros": json.dumps(about)})
        _write(table, folder.results)


def read_results(path: Path) -> dict[str, list[Any]]:
    """Return the table's columns by name; a missing value is None."""
    columns: dict[str, list[Any]] = _read(path).to_pydict()
    return columns
