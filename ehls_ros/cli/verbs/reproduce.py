"""`ehls reproduce`: the paper's simulation study run again, number beside number."""

import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ehls_ros.cli.folder import writable
from ehls_ros.cli.progress import progress_bar
from ehls_ros.cli.valid_json import valid_json
from ehls_ros.errors import BadInput
from ehls_ros.experiments.reproduction import paper
from ehls_ros.experiments.reproduction.study import compile_everything, reproduce
from ehls_ros.report.reproduction import write_reproduction_report

HELP = "Run the paper's simulation study again: table3.json, and a report with the paper's number beside ours."

TABLE, EVERYTHING, REPORT = "table3.json", "reproduction.json", "report.html"
"""What the folder receives."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--quick", action="store_true", help="Table 3 for the constant and the sine alone")
    parser.add_argument("--out", type=Path, default=Path("runs/reproduce"), help="folder of the results (%(default)s)")
    parser.add_argument("--workers", type=int, help="processes to run in (default: one a processor)")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON: table3.json")


def run(options: Namespace) -> int:
    """Run it."""
    if options.workers is not None and options.workers < 1:
        raise BadInput(f"--workers is {options.workers}", "command line", "1 or more")
    folder = writable(options.out, TABLE)
    with progress_bar("compiling"):
        compile_s = compile_everything(options.workers)
    with progress_bar("the paper's cases") as progress:
        study = reproduce(quick=options.quick, workers=options.workers, progress=progress)
    results = {**study.results, "compile_s": compile_s}
    table = {"cells": results["cells"]}
    (folder / TABLE).write_text(json.dumps(valid_json(table), indent=2) + "\n", encoding="utf-8")
    (folder / EVERYTHING).write_text(json.dumps(valid_json(results)) + "\n", encoding="utf-8")
    write_reproduction_report(results, {(c, r, d): run for (c, r, d), run in study.runs.items()}, folder / REPORT)
    _print(results, folder)
    if options.json:
        print(json.dumps(valid_json(table)))
    return 0


def _print(results: dict[str, Any], folder: Path) -> None:
    table = Table(title="Largest steady error [N], the paper's in brackets")
    for heading in ("", *(f"{r} {d}" for d in paper.DISTURBANCES for r in paper.REFERENCES if _there(results, r))):
        table.add_column(heading, justify="right" if heading else "left")
    for controller in paper.CONTROLLERS:
        table.add_row(controller, *_row([cell for cell in results["cells"] if cell["controller"] == controller]))
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 140).print(table)
    print(f"wall time {results['wall_s']:.1f} s, and {results['compile_s']:.1f} s to compile or load the kernels")
    print(f"  table   {folder / TABLE}")
    print(f"  all     {folder / EVERYTHING}")
    print(f"  report  {folder / REPORT}")


def _there(results: dict[str, Any], reference: str) -> bool:
    return any(cell["reference"] == reference for cell in results["cells"])


def _row(cells: Sequence[dict[str, Any]]) -> list[str]:
    def shown(cell: dict[str, Any]) -> str:
        published = cell["paper_percent"]
        beside = f" ({published * paper.FULL_SCALE / 100.0:.1f})" if published is not None else " (–)"
        return f"{cell['max_error_n']:.1f}{beside}"

    return [shown(cell) for cell in cells]
