"""Results of long benchmarks: a line of JSON per case, computed in processes, and resumed after an interruption."""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def read_rows(paths: Sequence[Path]) -> list[Row]:
    """Return the rows of files of results, without incomplete lines."""
    rows = list[Row]()
    for path in paths:
        for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
            try:
                rows.append(json.loads(line))
            except json.JSONDecodeError:
                print(f"{path}: an incomplete line is left out", file=sys.stderr)
    return rows


def run_all(one: Callable[[int], Row], numbers: Sequence[int], jobs: int) -> Iterator[Row]:
    """Yield the results of numbered cases as they are done.

    Args:
        one: computes a case from its number; picklable if there are several processes.
        numbers: the cases.
        jobs: number of processes.
    """
    if jobs == 1:
        yield from map(one, numbers)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        try:
            for done in as_completed([pool.submit(one, number) for number in numbers]):
                yield done.result()
        finally:
            pool.shutdown(cancel_futures=True)


def appended(path: Path, rows: Iterator[Row]) -> Iterator[Row]:
    """Append rows to a file as they come, and pass them on."""
    with path.open("a", encoding="utf-8") as file:
        for row in rows:
            file.write(as_json(row) + "\n")
            file.flush()
            yield row


def as_json(row: Row) -> str:
    """Return a row as JSON, numpy's numbers as Python's."""
    return json.dumps(row, default=lambda value: value.item() if hasattr(value, "item") else str(value))
