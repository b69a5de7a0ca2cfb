"""`ehls verify`: verify how well a recording's force follows its reference, block by block, with uncertainties."""

import json
import shutil
import tempfile
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from ehls_ros import __version__
from ehls_ros.cli.configured import Configured
from ehls_ros.cli.folder import writable
from ehls_ros.errors import BadInput
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.verification.results import CERTIFIES_NOTHING, Verification, verification_document
from ehls_ros.experiments.verification.verify import Given, verify_recording
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.load import load
from ehls_ros.report.verification import answer, write_verification_report

HELP = "Verify the force of a cyclic test, block by block: verification.json and a report. It certifies nothing."

RESULT, REPORT = "verification.json", "report.html"
"""Files in the folder of the results."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("data", type=Path, help="a bag, a run folder, or a recording in any format of `ehls diagnose`")
    parser.add_argument(
        "--rig",
        type=Path,
        action=Configured,
        help="rig file, for resolution, noise and lag of the sensors (default: the one in the recording, if any)",
    )
    parser.add_argument("--columns", type=Path, help="YAML that maps the data's own column names and units")
    parser.add_argument(
        "--inertia-mass",
        type=float,
        metavar="KG",
        help="mass between load cell and specimen [kg], whose inertia the cell shows; needs the position",
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
    parser.add_argument("--out", type=Path, default=Path("runs/verify"), help="folder of the results (%(default)s)")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON: verification.json")


def run(options: Namespace) -> int:
    """Run it."""
    data: Path = options.data
    given = Given(
        rig=load_rig(options.rig) if options.rig else None,
        inertia_mass=options.inertia_mass,
        cell_uncertainty=options.cell_uncertainty,
        settling=options.settling,
    )
    trajectory = load(recording_in(data), read_columns(options.columns) if options.columns else None)
    name = data.resolve().name
    found = verify_recording(trajectory, given, str(data))
    document = verification_document(found, name, __version__)
    folder = writable(options.out, RESULT)
    _write(folder, found, document, f"{name}, {float(trajectory.time_s[-1] - trajectory.time_s[0]):.4g} s")
    print(answer(found)[0])
    for remark in found.remarks:
        print(f"  {remark}")
    print(f"  {CERTIFIES_NOTHING}")
    print(f"  result  {folder / RESULT}")
    print(f"  report  {folder / REPORT}")
    if options.json:
        print(json.dumps(document))
    return 0


def _write(folder: Path, found: Verification, document: Any, source: str) -> None:
    """Write both results into a scratch folder, then move them into place; an interruption leaves no partial results."""
    try:
        scratch = Path(tempfile.mkdtemp(prefix=".verify-", dir=folder))
        try:
            (scratch / RESULT).write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
            write_verification_report(found, scratch / REPORT, source)
            for file in sorted(scratch.iterdir()):
                file.replace(folder / file.name)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise BadInput(f"the results cannot be written ({error.strerror})", str(folder), "a writable folder") from None
