"""`ehls columns`: propose a map of columns for a recording with names and units of its own."""

import math
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Printed

from ehls_ros.recording.proposal import Table, look, proposed_map

HELP = "Propose a map of columns from a table's headers or a bag's topics: the map as output, what was understood beside it."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "data",
        type=Path,
        nargs="+",
        help="files .csv, .mat or .parquet, several of one recording; or a bag",
    )


def run(options: Namespace) -> int:
    """Run it."""
    tables = [table for path in options.data for table in look(path)]
    for table in tables:
        _print(table)
    print(proposed_map(tables), end="")
    return 0


def _print(table: Table) -> None:
    """Print what is understood to the error stream, so that the output is the map alone."""
    rate = "rate unknown: no column of time is sure" if math.isnan(table.rate) else f"{table.rate:.4g} Hz"
    uneven = f", time steps differ by up to {100 * table.unevenness:.2g} %" if table.unevenness > 0.01 else ""
    printed = Printed(title=f"{table.name}: {table.rows} rows, {rate}{uneven}")
    for heading in ("column", "least", "greatest", "unit", "signal", "how sure", "what is open"):
        printed.add_column(heading, justify="right" if heading in ("least", "greatest") else "left")
    for column in table.columns:
        header = column.header
        span = (f"{column.smallest:.5g}", f"{column.largest:.5g}") if column.numeric else ("–", "–")
        gaps = [f"{100 * column.missing:.2g} % missing"] if column.numeric and column.missing > 0.0 else []
        unit = header.unit or ("SI" if header.sureness == "contract" else "?")
        left_open = "; ".join(filter(None, [header.open, *gaps])) if column.numeric else "not a column of numbers"
        printed.add_row(escape(header.column), *span, unit, header.signal or "?", header.sureness, left_open)
    Console(file=sys.stderr, width=None if sys.stderr.isatty() else 140).print(printed)
