"""`ehls reproduce`: repeat the paper's simulation study, and compare the numbers."""

import json
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ehls_ros.cli.folder import writable
from ehls_ros.errors import BadInput
from ehls_ros.progress import progress_bar
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.report import write_reproduction_report
from ehls_ros.reproduction.report_findings import causal_limits
from ehls_ros.reproduction.results import (
    CellResult,
    Place,
    Results,
    reproduction_document,
    table3_document,
)
from ehls_ros.reproduction.study import compile_everything, reproduce

HELP = "Run the paper's simulation study again: table3.json, and a report with the paper's number beside ours."

TABLE, EVERYTHING, REPORT = "table3.json", "reproduction.json", "report.html"
"""Files in the folder of the results."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--quick", action="store_true", help="Table 3 for the constant and the sine reference only")
    parser.add_argument("--out", type=Path, default=Path("runs/reproduce"), help="folder of the results (%(default)s)")
    parser.add_argument("--workers", type=int, help="number of processes (default: one per processor)")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON: table3.json")


def run(options: Namespace) -> int:
    """Run it."""
    if options.workers is not None and options.workers < 1:
        raise BadInput(f"--workers is {options.workers}", "command line", "1 or more")
    folder = writable(options.out, TABLE)
    with progress_bar("compiling"):
        compile_s = compile_everything(options.workers)
    with progress_bar("the paper's cases") as progress:
        results, runs = reproduce(quick=options.quick, workers=options.workers, progress=progress, compile_s=compile_s)
    table = table3_document(results)
    (folder / TABLE).write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    (folder / EVERYTHING).write_text(json.dumps(reproduction_document(results)) + "\n", encoding="utf-8")
    write_reproduction_report(results, runs, folder / REPORT)
    _print(results, folder)
    if options.json:
        print(json.dumps(table))
    return 0


def _print(results: Results, folder: Path) -> None:
    table = Table(title="Largest steady error [N], the paper's in brackets")
    places = [Place(r, d) for d in paper.DISTURBANCES for r in paper.REFERENCES if any(c.reference == r for c in results.cells)]
    for heading in ("", *(" ".join(place) for place in places)):
        table.add_column(heading, justify="right" if heading else "left")
    for controller in paper.CONTROLLERS:
        table.add_row(controller, *(_shown(cell) for cell in results.cells if cell.controller == controller))
    table.add_row("causal limit", *causal_limits(results.cells))
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 140).print(table)
    print(f"wall time {results.wall_s:.1f} s, and {results.compile_s:.1f} s to compile or load the kernels")
    print(f"  table   {folder / TABLE}")
    print(f"  all     {folder / EVERYTHING}")
    print(f"  report  {folder / REPORT}")


def _shown(cell: CellResult) -> str:
    published = "–" if cell.paper_percent is None else f"{cell.paper_percent * paper.FULL_SCALE / 100.0:.1f}"
    return f"{cell.max_error_n:.1f} ({published})"
