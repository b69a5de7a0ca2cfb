"""`ehls fmu`: export a rig, or a controller for it, as a Functional Mock-up Unit."""

import json
import time
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import get_args

from rich.console import Console

from ehls_ros.cli.arguments import add_json, check_range
from ehls_ros.cli.results import print_files
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.fmu.archive import SYSTEMS, fmu, identifier, write_fmu
from ehls_ros.fmu.description import Version
from ehls_ros.fmu.library import check_toolchain
from ehls_ros.fmu.plant_model import plant_model
from ehls_ros.physics.integration_step import check_step, steps_per_period
from ehls_ros.physics.rig import check_known, rig_to_mapping

HELP = "Export a rig as an FMU (FMI 2.0 or 3.0) that other simulators run without Python."

WHERE = "ehls fmu"

RESULT, EXTENDED = "diagnosis.json", "rig_extended.yaml"
"""Files in the folder of a diagnosis."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("rig", type=Path, help="rig file, name of one of the package, or folder of a diagnosis")
    parser.add_argument("--out", type=Path, help="FMU to write (default: <rig>.fmu)")
    parser.add_argument("--fmi", choices=get_args(Version), default="3.0", help="version of FMI (default: %(default)s)")
    about = "systems to link it for (default: both); the first link for a system takes minutes"
    parser.add_argument("--system", choices=SYSTEMS, nargs="+", default=list(SYSTEMS), help=about)
    parser.add_argument("--period", type=float, default=1e-3, help="sample period of command and sensors [s] (default: 0.001)")
    about = "largest integration step [s] (default: 0.25 ms, or less if the rig needs it)"
    parser.add_argument("--integration-step", type=float, help=about)
    parser.add_argument("--overwrite", action="store_true", help="replace a file that is there already")
    add_json(parser, "file, size, time and interfaces")


def run(options: Namespace) -> int:
    """Run it."""
    check_range(options, "period", 1e-6, 0.1)
    check_range(options, "integration-step", 1e-7, 1e-2)
    check_toolchain(WHERE)
    given, source = options.rig, configured(options.rig)
    resources = dict[str, bytes]()
    if source.is_dir():
        source, resources = _of_diagnosis(source)
        stem = given.resolve().name
    else:
        stem = source.stem
    out = options.out or Path(f"{stem}.fmu")
    if out.exists() and not options.overwrite:
        raise BadInput("the file is there already", str(out), "another name, or --overwrite")
    rig = load_rig(source)
    check_known(rig, str(source))
    check_step(rig, options.period / steps_per_period(rig, options.period, options.integration_step), str(source))
    resources["rig.yaml"] = rig_text(rig_to_mapping(rig)).encode()
    began = time.perf_counter()
    console = Console(stderr=True)
    with console.status("compiling") as status:
        model = plant_model(rig, identifier(out.stem, str(out)), options.period, options.integration_step)
        content = fmu(model, options.fmi, resources, WHERE, options.system, status.update)
    write_fmu(out, content)
    took = time.perf_counter() - began
    interfaces = ["Co-Simulation", *(["Model Exchange"] if model.event is not None else [])]
    print(f"FMI {options.fmi}, {' and '.join(interfaces)}, for {' and '.join(options.system)}")
    if model.event is None:
        print("  without Model Exchange, as the effect command_delay keeps commands in transit")
    print_files([("fmu", out)])
    if options.json:
        document = {"fmu": str(out), "bytes": len(content), "wall_s": round(took, 2), "interfaces": interfaces}
        print(json.dumps(document | {"fmi": options.fmi, "systems": options.system}))
    return 0


def _of_diagnosis(folder: Path) -> tuple[Path, dict[str, bytes]]:
    """Return the extended rig file of a diagnosis, and the diagnosis as a resource.

    Raises:
        BadInput: the folder has none.
    """
    rig, result = folder / EXTENDED, folder / RESULT
    if not rig.is_file():
        raise BadInput(f"there is no {EXTENDED}", str(folder), "a rig file, or the folder of a diagnosis that extended one")
    return rig, {RESULT: result.read_bytes()} if result.is_file() else {}
