"""`ehls identify`: from a rig's recordings to a rig file with uncertainties."""

import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path

import yaml
from rich.console import Console
from rich.table import Table

from ehls_ros.cli.folder import writable
from ehls_ros.cli.progress import progress_bar
from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.identify import DEFAULT_OPTIMISER, identify
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.result import Identification, to_json
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.recording.columns import ColumnMap, read_columns
from ehls_ros.recording.load import load, recordings
from ehls_ros.report.identification import write_identification_report
from ehls_ros.trajectory import Trajectory

HELP = "Identify a rig's friction from recordings: a rig file, identification.json and a report."

RIG, RESULT, REPORT = "rig_identified.yaml", "identification.json", "report.html"
"""What the folder receives."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("data", type=Path, nargs="+", help="recordings: bags, or .csv, .mat or .parquet files")
    parser.add_argument(
        "--rig",
        type=Path,
        required=True,
        help="rig file as known so far: friction model, mass and piston area are taken from it",
    )
    parser.add_argument("--columns", type=Path, help="YAML that maps the files' own column names and units")
    parser.add_argument("--out", type=Path, default=Path("runs/identify"), help="folder of the results (%(default)s)")
    parser.add_argument(
        "--optimiser", choices=OPTIMISERS.names(), default=DEFAULT_OPTIMISER, help="of the static fit (%(default)s)"
    )
    parser.add_argument(
        "--elements", type=int, help="number of friction elements, of a model that has them (default: as many as the data show)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (%(default)s)")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON: identification.json")


def run(options: Namespace) -> int:
    """Run it."""
    if options.elements is not None and not 1 <= options.elements <= 20:
        raise BadInput(f"--elements is {options.elements}", "command line", "1 to 20")
    rig = load_rig(options.rig)
    columns = read_columns(options.columns) if options.columns else None
    folder = writable(options.out, RESULT)
    given = _recordings(recordings(options.data, columns), columns)
    with progress_bar("identifying") as bar:
        found = identify(
            given,
            rig,
            optimiser=options.optimiser,
            elements=options.elements,
            seed=options.seed,
            progress=lambda _, done, total: bar(done, total),
        )
    plain = json.loads(json.dumps(rig_to_mapping(found.rig)))
    (folder / RIG).write_text(_heading(options.data) + yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
    result = to_json(found)
    (folder / RESULT).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    write_identification_report(found, folder / REPORT, before=rig)
    _print(found, folder)
    if options.json:
        print(json.dumps(result))
    return 0


def _recordings(paths: Sequence[Path], columns: ColumnMap | None) -> dict[str, Trajectory]:
    names = [path.name or str(path) for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    return {name: load(path, columns) for name, path in zip(names, paths, strict=True)}


def _heading(data: Sequence[Path]) -> str:
    return f"# Identified by `ehls identify` from {', '.join(path.name for path in data)}.\n"


def _print(found: Identification, folder: Path) -> None:
    table = Table(title="Identified")
    for heading in ("coefficient", "value", "standard error", "unit"):
        table.add_column(heading, justify="left" if heading in ("coefficient", "unit") else "right")
    for name, estimate in found.estimates.items():
        table.add_row(name, f"{estimate.value:.5g}", f"{estimate.std:.2g}", estimate.unit)
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 140).print(table)
    if found.not_identifiable:
        print(f"not identifiable from these data: {', '.join(found.not_identifiable)}")
    for remark in found.remarks:
        print(f"  {remark}")
    print(f"wall time {found.wall_s:.1f} s")
    print(f"  rig     {folder / RIG}")
    print(f"  result  {folder / RESULT}")
    print(f"  report  {folder / REPORT}")
