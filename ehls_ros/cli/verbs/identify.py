"""`ehls identify`: identify a rig from recordings; write a rig file with uncertainties."""

import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ehls_ros.cli.configured import Configured
from ehls_ros.cli.folder import writable
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.analysis import identify_whole_rig
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.stroke_experiments import stroke_experiments
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.identification.identify import DEFAULT_OPTIMISER, MissingStrokes, identify
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.result import Identification, to_json
from ehls_ros.identification.rig_result import RigIdentification, rig_to_json
from ehls_ros.identification.strokes import Missing
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.progress import progress_bar
from ehls_ros.recording.columns import ColumnMap, read_columns
from ehls_ros.recording.load import load, recordings
from ehls_ros.report.identification import write_identification_report
from ehls_ros.report.rig_identification import write_rig_report
from ehls_ros.trajectory import Trajectory

HELP = "Identify a rig, or its friction alone, from recordings: a rig file, identification.json and a report."

RIG, RESULT, REPORT = "rig_identified.yaml", "identification.json", "report.html"
"""Files in the folder of the results."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("data", type=Path, nargs="+", help="recordings: bags, or tables (text, Excel, MAT, TDMS, Parquet)")
    parser.add_argument(
        "--rig",
        type=Path,
        action=Configured,
        required=True,
        help="rig file as known so far, where the search starts: friction model, piston area and volume are taken from it",
    )
    parser.add_argument(
        "--whole-rig",
        action="store_true",
        help="identify valve, flow, mass, spring and sensors as well, as far as they are recorded, not the friction alone",
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
    if options.seed < 0:
        raise BadInput(f"--seed is {options.seed}", "command line", "0 or more")
    rig = load_rig(options.rig)
    columns = read_columns(options.columns) if options.columns else None
    folder = writable(options.out, RESULT)
    given = _recordings(recordings(options.data, columns), columns)
    identified = (_whole_rig if options.whole_rig else _friction)(given, rig, options, folder)
    if options.json:
        print(json.dumps(identified))
    return 0


def _friction(recordings: Mapping[str, Trajectory], rig: Rig, options: Namespace, folder: Path) -> dict[str, Any]:
    try:
        with progress_bar("identifying") as bar:
            found = identify(
                recordings,
                rig,
                optimiser=options.optimiser,
                elements=options.elements,
                seed=options.seed,
                progress=lambda _, done, total: bar(done, total),
            )
    except MissingStrokes as error:
        _offer(error.missing, rig, options.rig, folder)
        raise
    result = to_json(found)
    _write(folder, found.rig, result, options.data)
    write_identification_report(found, folder / REPORT, before=rig)
    _print(found, folder)
    _offer(found.lacking, rig, options.rig, folder)
    return result


def _offer(missing: Missing, rig: Rig, path: Path, folder: Path) -> None:
    """Write the experiments for the missing strokes, and print the commands to run them."""
    try:
        for asked in stroke_experiments(missing, rig, path.resolve(), folder.resolve()):
            (folder / asked.file).write_text(asked.text, encoding="utf-8")
            print(f"  missing strokes: ehls experiment {folder / asked.file}")
    except BadInput as error:
        print(f"  missing strokes: no experiment delivers them on this rig ({error})")


def _whole_rig(recordings: Mapping[str, Trajectory], rig: Rig, options: Namespace, folder: Path) -> dict[str, Any]:
    if options.elements is not None:
        what = "--elements and --whole-rig are given"
        raise BadInput(what, "command line", "one of them: the whole rig keeps the rig file's number of friction elements")
    with progress_bar("identifying") as bar:
        found = identify_whole_rig(recordings, rig, seed=options.seed, progress=bar)
    result = rig_to_json(found)
    _write(folder, found.rig, result, options.data)
    write_rig_report(found, folder / REPORT, before=rig)
    _print_rig(found, folder)
    return result


def _write(folder: Path, rig: Rig, result: Mapping[str, Any], data: Sequence[Path]) -> None:
    (folder / RIG).write_text(_heading(data) + rig_text(rig_to_mapping(rig)), encoding="utf-8")
    (folder / RESULT).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def _recordings(paths: Sequence[Path], columns: ColumnMap | None) -> dict[str, Trajectory]:
    names = [path.name or str(path) for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    return {name: load(path, columns) for name, path in zip(names, paths, strict=True)}


def _heading(data: Sequence[Path]) -> str:
    return f"# Identified by `ehls identify` from {', '.join(path.name for path in data)}.\n"


def _print(found: Identification, folder: Path) -> None:
    _print_estimates(found.estimates)
    if found.not_identifiable:
        print(f"not identifiable from these data: {', '.join(found.not_identifiable)}")
    _print_end(found.remarks, found.wall_s, folder)


def _print_rig(found: RigIdentification, folder: Path) -> None:
    _print_estimates(found.estimates)
    if found.not_identifiable:
        print("not identifiable from these data:")
    for path, reason in found.not_identifiable.items():
        print(f"  {path}: {reason}")
    if found.absent:
        print(f"looked for, and not told from none: {', '.join(found.absent)}")
    _print_end(found.remarks, found.wall_s, folder)


def _print_estimates(estimates: Mapping[str, Estimate]) -> None:
    table = Table(title="Identified")
    for heading in ("coefficient", "value", "standard error", "unit"):
        table.add_column(heading, justify="left" if heading in ("coefficient", "unit") else "right")
    for name, estimate in estimates.items():
        table.add_row(name, f"{estimate.value:.5g}", f"{estimate.std:.2g}", estimate.unit)
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 140).print(table)


def _print_end(remarks: Sequence[str], wall: float, folder: Path) -> None:
    for remark in remarks:
        print(f"  {remark}")
    print(f"wall time {wall:.1f} s")
    print(f"  rig     {folder / RIG}")
    print(f"  result  {folder / RESULT}")
    print(f"  report  {folder / REPORT}")
