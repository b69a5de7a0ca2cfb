"""`ehls doctor`: look whether everything is there that a run needs, and say what to do where it is not."""

import json
from argparse import ArgumentParser, Namespace

from rich.console import Console
from rich.table import Table

from ehls_ros.cli.checks import CHECKS, Finding
from ehls_ros.nodes.shared_memory import leftovers

HELP = "Check Python, ROS, DDS, shared memory, processors, clock, permissions and files, and say what to do."

COLOURS = {"ok": "green", "note": "yellow", "problem": "red"}


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--clean", action="store_true", help="first remove what killed processes left in shared memory")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON: every finding")


def run(options: Namespace) -> int:
    """Look, and return 1 where something will not work."""
    if options.clean:
        left = leftovers()
        for file in left:
            file.unlink(missing_ok=True)
        print(f"removed {len(left)} files from shared memory")
    console = Console()
    with console.status("looking"):
        findings = [check() for check in CHECKS]
    console.print(_table(findings))
    if options.json:
        print(json.dumps([finding._asdict() for finding in findings]))
    return int(any(finding.level == "problem" for finding in findings))


def _table(findings: list[Finding]) -> Table:
    table = Table("", "check", "found", "what to do", box=None, pad_edge=False)
    for finding in findings:
        colour = COLOURS[finding.level]
        table.add_row(f"[{colour}]{finding.level}[/{colour}]", finding.check, finding.found, finding.advice)
    return table
