"""`ehls verify`: verify how well a recording's force follows its reference, block by block, with uncertainties."""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros import __version__
from ehls_ros.cli.arguments import add_columns, add_results, add_rig, columns_of
from ehls_ros.cli.results import all_or_nothing, print_files, writable, write_json
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.verification.results import CERTIFIES_NOTHING, verification_document
from ehls_ros.experiments.verification.verify import Given, verify_recording
from ehls_ros.recording.events import read_pauses
from ehls_ros.recording.load import holds_tables, load
from ehls_ros.report.verification import answer, write_verification_report

HELP = "Verify the force of a cyclic test, block by block: verification.json and a report. It certifies nothing."

RESULT, REPORT = "verification.json", "report.html"
"""Files in the folder of the results."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("data", type=Path, help="a bag, a run folder, or a recording in any format of `ehls diagnose`")
    about = "rig file, for resolution, noise and lag of the sensors (default: the one in the recording, if any)"
    add_rig(parser, about, required=False)
    add_columns(parser)
    parser.add_argument(
        "--inertia-mass",
        type=float,
        metavar="KG",
        help="mass between load cell and specimen [kg], to correct its inertia; needs the position",
    )
    parser.add_argument(
        "--cell-uncertainty",
        type=float,
        metavar="PERCENT",
        help="expanded uncertainty (k = 2) of the load cell's calibration, in percent of the reading",
    )
    parser.add_argument(
        "--settling",
        type=int,
        metavar="CYCLES",
        help="cycles to leave out at the start of each stretch (default: until it has settled, half of them at most)",
    )
    about = "time to begin and to end, since the start of the recording [s] (default: all of it)"
    parser.add_argument("--from", dest="begin", type=float, metavar="S", help=about)
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="likewise")
    add_results(parser, "runs/verify", RESULT)


def run(options: Namespace) -> int:
    """Run it."""
    data: Path = options.data
    recording, columns = recording_in(data), columns_of(options)
    trajectory = load(recording, columns)
    given = Given(
        rig=load_rig(options.rig) if options.rig else None,
        inertia_mass=options.inertia_mass,
        cell_uncertainty=options.cell_uncertainty,
        settling=options.settling,
        begin=options.begin,
        end=options.end,
        pauses=read_pauses(recording) if columns is None and not holds_tables(recording) else (),
    )
    name = data.resolve().name
    found = verify_recording(trajectory, given, str(data))
    document = verification_document(found, name, __version__)
    folder = writable(options.out, RESULT)
    with all_or_nothing(folder) as scratch:
        write_json(scratch / RESULT, document)
        seconds = float(trajectory.time_s[-1] - trajectory.time_s[0])
        write_verification_report(found, scratch / REPORT, f"{name}, {seconds:.4g} s")
    print(answer(found)[0])
    for remark in found.remarks:
        print(f"  {remark}")
    print(f"  {CERTIFIES_NOTHING}")
    print_files([("result", folder / RESULT), ("report", folder / REPORT)])
    if options.json:
        print(json.dumps(document))
    return 0
