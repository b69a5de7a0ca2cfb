"""`ehls identify`: identify a rig from recordings; write a rig file with uncertainties."""

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ehls_ros.cli.arguments import add_columns, add_results, add_rig, add_span, check_range, columns_of
from ehls_ros.cli.results import print_files, print_table, writable, write_json
from ehls_ros.errors import BadInput
from ehls_ros.experiments.analysis import identify_whole_rig
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.stroke_experiments import stroke_experiments
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.identification.identify import DEFAULT_OPTIMISER, MissingStrokes, identify
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.result import Identification, to_json
from ehls_ros.identification.rig_result import RigIdentification, rig_to_json
from ehls_ros.identification.strokes import Missing
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.progress import duration_text, progress_bar
from ehls_ros.recording.columns import ColumnMap
from ehls_ros.recording.load import load, recordings
from ehls_ros.report.identification import write_identification_report
from ehls_ros.report.rig_identification import write_rig_report
from ehls_ros.trajectory import Trajectory

HELP = "Identify a rig, or its friction alone, from recordings: a rig file, identification.json and a report."

RIG, RESULT, REPORT = "rig_identified.yaml", "identification.json", "report.html"
"""Files in the folder of the results."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "data", type=Path, nargs="+", help="recordings: bags, or tables (text, Excel, MAT, TDMS, MDF, RPC III, Parquet)"
    )
    add_rig(parser, "rig file as starting point of the search, with friction model, piston area and volume")
    parser.add_argument(
        "--whole-rig",
        action="store_true",
        help="identify not only friction but also valve, flow, mass, spring and sensors, as far as they are recorded",
    )
    add_columns(parser)
    add_span(parser)
    parser.add_argument(
        "--optimiser", choices=OPTIMISERS.names(), default=DEFAULT_OPTIMISER, help="optimiser of the static fit (%(default)s)"
    )
    about = "number of friction elements, if the model has elements (default: as many as the data support)"
    parser.add_argument("--elements", type=int, help=about)
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (%(default)s)")
    add_results(parser, "runs/identify", RESULT)


def run(options: Namespace) -> int:
    """Identify the rig and write the results."""
    check_range(options, "elements", 1, 20)
    check_range(options, "seed", 0)
    rig = load_rig(options.rig)
    columns = columns_of(options)
    folder = writable(options.out, RESULT)
    read = _recordings(recordings(options.data, columns), columns)
    given = {name: recording.between(options.begin, options.end, name) for name, recording in read.items()}
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
        print(f"  missing strokes: no experiment provides them on this rig ({error})")


def _whole_rig(recordings: Mapping[str, Trajectory], rig: Rig, options: Namespace, folder: Path) -> dict[str, Any]:
    if options.elements is not None:
        expected = "one of them: the whole rig keeps the rig file's number of friction elements"
        raise BadInput("--elements and --whole-rig are given", "command line", expected)
    with progress_bar("identifying") as bar:
        found = identify_whole_rig(recordings, rig, seed=options.seed, progress=bar)
    result = rig_to_json(found)
    errors = {path: estimate.std for path, estimate in found.estimates.items()}
    _write(folder, found.rig._replace(standard_errors=errors), result, options.data)
    write_rig_report(found, folder / REPORT, before=rig)
    _print(found, folder)
    return result


def _write(folder: Path, rig: Rig, result: Mapping[str, Any], data: Sequence[Path]) -> None:
    heading = f"# Identified by `ehls identify` from {', '.join(path.name for path in data)}.\n"
    (folder / RIG).write_text(heading + rig_text(rig_to_mapping(rig)), encoding="utf-8")
    write_json(folder / RESULT, result)


def _recordings(paths: Sequence[Path], columns: ColumnMap | None) -> dict[str, Trajectory]:
    names = [path.name or str(path) for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    return {name: load(recording_in(path), columns) for name, path in zip(names, paths, strict=True)}


def _print(found: Identification | RigIdentification, folder: Path) -> None:
    rows = [(name, f"{e.value:.5g}", f"{e.std:.2g}", e.unit) for name, e in found.estimates.items()]
    header = ("coefficient", "value", "standard error", "unit")
    print_table("Identified", header, rows, right=("value", "standard error"))
    if isinstance(found, RigIdentification):
        if found.not_identifiable:
            print("not identifiable from these data:")
        for path, reason in found.not_identifiable.items():
            print(f"  {path}: {reason}")
        if found.absent:
            print(f"not distinguishable from zero: {', '.join(found.absent)}")
    elif found.not_identifiable:
        print(f"not identifiable from these data: {', '.join(found.not_identifiable)}")
    for remark in found.remarks:
        print(f"  {remark}")
    print(f"wall time {duration_text(found.wall_s)}")
    print_files([("rig", folder / RIG), ("result", folder / RESULT), ("report", folder / REPORT)])
