"""`ehls fmu`: export a rig, or a controller for it, as a Functional Mock-up Unit."""

import json
import time
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import get_args

from rich.console import Console

from ehls_ros.cli.arguments import add_json, check_range
from ehls_ros.cli.results import DIAGNOSIS, EXTENDED_RIG, print_files
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.observers import OBSERVERS, default_observer
from ehls_ros.control.observers.base import check_friction_support
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.fmu.archive import SYSTEMS, fmu, identifier, write_fmu
from ehls_ros.fmu.control_model import law_model, observer_model
from ehls_ros.fmu.description import Version
from ehls_ros.fmu.library import check_toolchain
from ehls_ros.fmu.model import Model
from ehls_ros.fmu.plant_model import plant_model
from ehls_ros.physics.integration_step import check_step, steps_per_period
from ehls_ros.physics.rig import Rig, check_known, rig_to_mapping

HELP = "Export a rig or a controller as an FMU (FMI 2.0 or 3.0) that other simulators run without Python."

WHERE = "ehls fmu"


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("rig", type=Path, help="rig file, name of one of the package, or folder of a diagnosis")
    about = "export this control law, tuned for the rig, with its friction observer, in place of the rig"
    parser.add_argument("--controller", choices=CONTROLLERS.names(), metavar="LAW", help=about)
    about = "friction observer of the control law; without --controller, export the observer"
    parser.add_argument("--observer", choices=OBSERVERS.names(), metavar="OBSERVER", help=about)
    parser.add_argument("--out", type=Path, help="FMU to write (default: <rig>.fmu, or <rig>_<law>.fmu)")
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
    out = options.out or Path("_".join(filter(None, [stem, options.controller or options.observer])) + ".fmu")
    if out.exists() and not options.overwrite:
        raise BadInput("the file is there already", str(out), "another name, or --overwrite")
    rig = load_rig(source)
    check_known(rig, str(source))
    step = options.period / steps_per_period(rig, options.period, options.integration_step)
    check_step(rig, step, str(source))
    resources["rig.yaml"] = rig_text(rig_to_mapping(rig)).encode()
    began = time.perf_counter()
    console = Console(stderr=True)
    with console.status("compiling") as status:
        model = _model(rig, identifier(out.stem, str(out)), options)
        content = fmu(model, options.fmi, resources, WHERE, options.system, status.update)
    write_fmu(out, content)
    took = time.perf_counter() - began
    interfaces = ["Co-Simulation", *(["Model Exchange"] if model.event is not None else [])]
    print(f"FMI {options.fmi}, {' and '.join(interfaces)}, for {' and '.join(options.system)}")
    if model.event is None:
        reason = (
            "a sampled law has no differential equations" if _is_law(options) else "command_delay keeps commands in transit"
        )
        print(f"  without Model Exchange: {reason}")
    print_files([("fmu", out)])
    if options.json:
        document = {"fmu": str(out), "bytes": len(content), "wall_s": round(took, 2), "interfaces": interfaces}
        print(json.dumps(document | {"fmi": options.fmi, "systems": options.system}))
    return 0


def _is_law(options: Namespace) -> bool:
    return bool(options.controller or options.observer)


def _model(rig: Rig, name: str, options: Namespace) -> Model:
    """Return the model that the options select.

    Raises:
        BadInput: law or observer does not support the rig's friction model.
    """
    if not _is_law(options):
        return plant_model(rig, name, options.period, options.integration_step)
    observer = options.observer or default_observer(rig)
    check_friction_support(OBSERVERS, observer, rig, WHERE)
    parameters = tuned_for(OBSERVERS.load(observer).Parameters, rig)
    if not options.controller:
        return observer_model(rig, name, options.period, observer, parameters)
    check_friction_support(CONTROLLERS, options.controller, rig, WHERE)
    tuning = tuned_for(CONTROLLERS.load(options.controller).Parameters, rig)
    return law_model(rig, name, options.period, options.controller, tuning, observer, parameters)


def _of_diagnosis(folder: Path) -> tuple[Path, dict[str, bytes]]:
    """Return the extended rig file of a diagnosis, and the diagnosis as a resource.

    Raises:
        BadInput: the folder has none.
    """
    rig, result = folder / EXTENDED_RIG, folder / DIAGNOSIS
    if not rig.is_file():
        raise BadInput(f"there is no {EXTENDED_RIG}", str(folder), "a rig file, or the folder of a diagnosis that extended one")
    return rig, {DIAGNOSIS: result.read_bytes()} if result.is_file() else {}
