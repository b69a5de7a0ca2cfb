"""`ehls doctor`: check the prerequisites of a run, and advise on problems."""

import json
from argparse import ArgumentParser, Namespace

from rich.console import Console
from rich.table import Table

from ehls_ros.cli.arguments import add_json
from ehls_ros.cli.checks import CHECKS, Finding
from ehls_ros.nodes.shared_memory import leftovers

HELP = "Check Python, ROS, DDS, shared memory, processors, clock, permissions and files, with advice."

COLOURS = {"ok": "green", "note": "yellow", "problem": "red"}


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--clean", action="store_true", help="first remove shared memory left by killed processes")
    add_json(parser, "every finding")


def run(options: Namespace) -> int:
    """Run the checks; return 1 if there is a problem."""
    if options.clean:
        left = leftovers()
        for file in left:
            file.unlink(missing_ok=True)
        print(f"removed {len(left)} files from shared memory")
    console = Console()
    with console.status("checking"):
        findings = [check() for check in CHECKS]
    console.print(_table(findings))
    if options.json:
        print(json.dumps([finding._asdict() for finding in findings]))
    return int(any(finding.level == "problem" for finding in findings))


def _table(findings: list[Finding]) -> Table:
    table = Table("", "check", "found", "advice", box=None, pad_edge=False)
    for finding in findings:
        colour = COLOURS[finding.level]
        table.add_row(f"[{colour}]{finding.level}[/{colour}]", finding.check, finding.found, finding.advice)
    return table
