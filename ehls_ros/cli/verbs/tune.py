"""`ehls tune`: find the numbers of a control law for a rig."""

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ehls_ros.cli.arguments import add_configured, add_margins, add_results, check_range
from ehls_ros.cli.results import print_files, print_table, writable
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.tuning.files import document
from ehls_ros.experiments.tuning.task import task_of
from ehls_ros.experiments.tuning.tune import USUAL, Trial, Tuned, Wanted, tune
from ehls_ros.progress import progress_bar
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.report.page import limit_text, with_unit
from ehls_ros.report.tuning import LOST, RESULT, sentence, write_tuning_files

HELP = "Find the numbers of a control law for a rig: the least error with the margins asked for."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    add_configured(parser, "rig", "", "rig file, or the name of one of the package")
    add_configured(parser, "--spec", "experiments", "experiment whose reference and disturbance count (default: sines)")
    laws = [name for name, law in CONTROLLERS.usable().items() if getattr(law, "TUNED", ())]
    parser.add_argument("--law", choices=laws, default="fasmc_predictive", help="control law (%(default)s)")
    add_margins(parser, USUAL)
    about = "factor on the standard errors of the rig file, assumed where it has none; 0: it is exact (%(default)s)"
    parser.add_argument("--uncertainty", type=float, default=1.0, metavar="FACTOR", help=about)
    parser.add_argument("--seed", type=int, default=0, help="seed of the rigs drawn within the uncertainty (%(default)s)")
    parser.add_argument("--jobs", type=int, help="number of processes (default: one per processor)")
    add_results(parser, "runs/tune", RESULT)


def run(options: Namespace) -> int:
    """Run it."""
    check_range(options, "jobs", 1)
    check_range(options, "seed", 0)
    check_range(options, "uncertainty", 0.0, 10.0)
    rig = load_rig(options.rig)
    given, where, folder = _experiment(options.spec)
    task = task_of(rig, options.law, given, where, folder)
    out = writable(options.out, RESULT)
    with progress_bar("tuning") as bar:
        found = tune(
            task,
            wanted=Wanted(*options.margins),
            uncertainty=options.uncertainty,
            seed=options.seed,
            jobs=options.jobs,
            progress=bar,
        )
    files = write_tuning_files(found, out)
    _print(found)
    print_files(files._asdict().items())
    if options.json:
        print(json.dumps(document(found)))
    return 1 if found.lost else 0


def _experiment(path: Path | None) -> tuple[Mapping[str, Any] | None, str, Path]:
    if path is None:
        return None, "tune", Path()
    content = read_yaml(path, "spec")
    if not isinstance(content, Mapping):
        raise BadInput(f"it contains {type(content).__name__}", str(path), "an experiment")
    return content, str(path), path.parent


def _print(found: Tuned) -> None:
    print(sentence(found))
    rows = [(name, f"{found.default.numbers[name]:.4g}", f"{value:.4g}") for name, value in found.chosen.numbers.items()]
    print_table(found.spec.controller.name, ("number", "default", "found"), rows, right=("default", "found"))
    header = ("", "largest error", "within uncertainty", "gain margin", "phase margin")
    results = [_row("defaults", found.default), _row("found", found.chosen)]
    if found.causal_limit > 0.0:
        results.append(("causal limit", limit_text(found.causal_limit), "", "", ""))
    print_table("Results", header, results, right=header[1:])
    without = [(limit.removed, with_unit(limit.error, "N", LOST)) for limit in found.limits]
    print_table("Error with these numbers, without", ("limitation", "largest error"), without, right=("largest error",))
    for remark in found.remarks:
        print(f"  {remark}")


def _row(name: str, trial: Trial) -> tuple[str, str, str, str, str]:
    errors = with_unit(trial.error, "N", LOST), with_unit(trial.typical, "N", LOST)
    return (name, *errors, with_unit(trial.gain_db, "dB"), with_unit(trial.margins.phase_deg, "°"))
