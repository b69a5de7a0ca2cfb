"""Reading of recorded load spectra."""

import csv
from io import StringIO
from pathlib import Path

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.regular_file import read_text


def read_points(path: Path) -> list[tuple[float, float]]:
    """Read a load spectrum: a CSV with the columns ``time_s`` and ``value``.

    Raises:
        BadInput: a column is missing, a cell is not a finite number, or time does not increase.
    """
    text = read_text(path, limits.TEXT, "a CSV file", "reference file")
    try:
        rows = list(csv.DictReader(StringIO(text, newline="")))
    except csv.Error as error:
        raise BadInput(f"reference file cannot be read ({error})", str(path), "a CSV file") from None
    points: list[tuple[float, float]] = []
    for number, row in enumerate(rows, start=2):
        try:
            time, value = float(row["time_s"]), float(row["value"])
        except (KeyError, TypeError, ValueError):
            raise BadInput(f"row is {row}", f"{path}:{number}", "numbers in the columns time_s and value") from None
        if not (abs(time) < float("inf") and abs(value) < float("inf")):
            raise BadInput(f"row holds {time}, {value}", f"{path}:{number}", "finite numbers")
        if points and time <= points[-1][0]:
            raise BadInput(f"time_s is {time} after {points[-1][0]}", f"{path}:{number}", "increasing times")
        points.append((time, value))
    if len(points) < 2:
        raise BadInput(f"{len(points)} rows", str(path), "a header time_s,value and at least two rows")
    return points
