"""`ehls reproduce`: repeat the paper's simulation study, and compare the numbers."""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros.cli.arguments import add_results, check_range
from ehls_ros.cli.results import print_files, print_table, writable, write_json
from ehls_ros.progress import announce, duration_text, progress_bar
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
    parser.add_argument("--workers", type=int, help="number of processes (default: one per processor)")
    add_results(parser, "runs/reproduce", TABLE)


def run(options: Namespace) -> int:
    """Run it."""
    check_range(options, "workers", 1)
    folder = writable(options.out, TABLE)
    announce("compiling or loading the kernels of the study; compiled once for this version, which takes a minute or more")
    with progress_bar("compiling"):
        compile_s = compile_everything(options.workers)
    with progress_bar("the paper's cases") as progress:
        results, runs = reproduce(quick=options.quick, workers=options.workers, progress=progress, compile_s=compile_s)
    table = table3_document(results)
    write_json(folder / TABLE, table)
    (folder / EVERYTHING).write_text(json.dumps(reproduction_document(results)) + "\n", encoding="utf-8")
    write_reproduction_report(results, runs, folder / REPORT)
    _print(results, folder)
    if options.json:
        print(json.dumps(table))
    return 0


def _print(results: Results, folder: Path) -> None:
    places = [Place(r, d) for d in paper.DISTURBANCES for r in paper.REFERENCES if any(c.reference == r for c in results.cells)]
    columns = [" ".join(place) for place in places]
    rows = [[name, *(_shown(cell) for cell in results.cells if cell.controller == name)] for name in paper.CONTROLLERS]
    rows.append(["causal limit", *causal_limits(results.cells)])
    print_table("Largest steady error [N], the paper's in brackets", ["", *columns], rows, right=columns)
    print(f"wall time {duration_text(results.wall_s)}, and {duration_text(results.compile_s)} to compile or load the kernels")
    print_files([("table", folder / TABLE), ("all", folder / EVERYTHING), ("report", folder / REPORT)])


def _shown(cell: CellResult) -> str:
    published = "–" if cell.paper_percent is None else f"{cell.paper_percent * paper.FULL_SCALE / 100.0:.1f}"
    return f"{cell.max_error_n:.1f} ({published})"
