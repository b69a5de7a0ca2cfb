"""`ehls columns`: propose a map of columns for a recording with foreign names and units."""

import math
import shlex
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Printed

from ehls_ros.diagnosis.stages import STAGES
from ehls_ros.errors import BadInput, reason
from ehls_ros.recording.columns import TIME
from ehls_ros.recording.load import READERS
from ehls_ros.recording.proposal import MIN_UNEVENNESS, Proposal, Table, look, proposed_map, valve_data, with_valve

CERTAINTY = {"contract": "certain: by its name", "stated": "certain", "unsure": "to be checked", "unknown": "unknown"}
"""Wording of the certainty of a column."""

HELP = "Propose a map of columns from a table's headers or a bag's topics: the map on the output, the interpretation beside it."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "data",
        type=Path,
        nargs="+",
        help=f"files {', '.join(READERS)}, several of one recording; or a bag",
    )
    parser.add_argument("--out", type=Path, metavar="MAP", help="file to write the map to (default: the standard output)")
    parser.add_argument(
        "--valve",
        metavar="DATA",
        help="rated data of the valve, to turn its current or voltage to spool: '10 V = 1 mm', '4..20 mA = 1 mm'",
    )


def run(options: Namespace) -> int:
    """Run it."""
    tables = [table for path in options.data for table in look(path)]
    if options.valve:
        tables = with_valve(tables, valve_data(options.valve))
    proposal = proposed_map(tables)
    console = Console(file=sys.stderr, width=None if sys.stderr.isatty() else 140)
    for table in tables:
        _print(table, console)
    for sentence in _summary(proposal):
        console.print(sentence, markup=False, highlight=False, soft_wrap=True)
    if options.out is None:
        print(proposal.text, end="")
        return 0
    try:
        options.out.write_text(proposal.text, encoding="utf-8")
    except OSError as error:
        raise BadInput(f"the map cannot be written ({reason(error)})", str(options.out), "a writable file") from None
    print(f"{options.out}: the map. Next: ehls diagnose {shlex.join(map(str, options.data))} --columns {options.out} --rig RIG")
    return 0


def _summary(proposal: Proposal) -> Iterator[str]:
    """Summarise the certain columns, those to be checked, and the missing inputs of a diagnosis."""
    looks = "; complete or delete their lines, which begin with #" if proposal.unsure else ""
    yield f"columns that are certain: {proposal.certain}; to be checked: {proposal.unsure}{looks}"
    if TIME not in proposal.signals:
        yield f"{TIME} is missing: complete the line of its column, or write {TIME}: {{rate: 1000}} for a row every 1/1000 s"
    unjudged = proposal.unjudged()
    yield f"a diagnosis can judge: {', '.join(stage for stage in STAGES if stage not in unjudged) or 'nothing yet'}"
    for stage, needed in unjudged.items():
        yield f"  not {stage}: it needs {needed}"


def _print(table: Table, console: Console) -> None:
    """Print the interpretation of the columns to standard error, so that the output can be the map alone."""
    rate = "rate unknown: no column of time is sure" if math.isnan(table.rate) else f"{table.rate:.5g} Hz"
    uneven = f", time steps differ by up to {100 * table.unevenness:.2g} %" if table.unevenness > MIN_UNEVENNESS else ""
    if len(table.axes) > 1:
        rate = f"{len(table.axes)} time axes"
    printed = Printed(title=f"{table.name}: {table.rows} rows, {rate}{uneven}")
    for heading in ("column", "smallest", "largest", "unit", "signal", "certainty", "open question"):
        printed.add_column(heading, justify="right" if heading in ("smallest", "largest") else "left")
    for column in table.columns:
        header = column.header
        span = (f"{column.smallest:.5g}", f"{column.largest:.5g}") if column.numeric else ("–", "–")
        gaps = [f"{100 * column.missing:.2g} % missing"] if column.numeric and column.missing > 0.0 else []
        unit = header.unit or ("SI" if header.certainty == "contract" else "?")
        sure = CERTAINTY[header.certainty] if column.numeric else "not of numbers"
        left_open = "; ".join(filter(None, [header.open, *gaps])) if column.numeric else column.wrong
        printed.add_row(escape(header.column), *span, unit, header.signal or "?", sure, escape(left_open))
    if table.columns:
        console.print(printed)
    absolute = [f"{column.header.column}: {column.absolute}" for column in table.columns if column.absolute]
    for remark in (*table.axes, *table.remarks, *absolute):
        console.print(f"{table.name}: {remark}", markup=False, highlight=False, soft_wrap=True)
