"""`ehls commission`: measure a rig step by step, and correct its file."""

import json
import math
import sys
from argparse import ArgumentParser, Namespace
from contextlib import ExitStack, closing
from pathlib import Path

from ehls_ros.cli.arguments import add_configured, add_margins, add_results
from ehls_ros.cli.results import print_files, print_table, writable
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.commissioning.conduct import LOG, REPORT, RIG, STEPS, Done, commission, read_log
from ehls_ros.experiments.commissioning.session import Session
from ehls_ros.experiments.commissioning.step import Step
from ehls_ros.experiments.graph_check import bridge_at
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.tuning.files import EXPERIMENT
from ehls_ros.experiments.tuning.tune import USUAL, Wanted
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.physics.rig import Rig
from ehls_ros.progress import Update, progress_bar
from ehls_ros.report.commissioning import write_commissioning_report

HELP = "Measure a rig step by step through its gate, write its rig file, tune the law and run it with small amplitudes first."

ASKED = "Enter: go on; s: skip it; q: end here"
"""Choices of the operator before each step."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    add_configured(parser, "rig", "", "rig file with the limits, such as the draft of `ehls new-rig`")
    parser.add_argument(
        "--bridge", type=Path, help="bridge file: DAQ backend, channels, calibration (default: bridge_udp.yaml)"
    )
    parser.add_argument("--period", type=float, default=1e-3, metavar="S", help="sampling period (%(default)s)")
    about = "the device waits for the answer to each sample, as `ehls rig-emulator --lockstep` does"
    parser.add_argument("--lockstep", action="store_true", help=about)
    parser.add_argument("--yes", action="store_true", help="release all steps without asking; for emulators")
    add_margins(parser, USUAL)
    add_results(parser, "runs/commission", LOG)


def run(options: Namespace) -> int:
    """Run it."""
    if not 1e-6 <= options.period <= 0.1:
        raise BadInput(f"--period is {options.period:g}", "command line", "1e-6 to 0.1 s")
    if not options.yes and not sys.stdin.isatty():
        raise BadInput("the steps cannot be released", "standard input", "a terminal, or --yes with an emulator")
    rig = load_rig(options.rig)
    bridge = bridge_at(options.bridge)
    if options.lockstep and not getattr(BACKENDS.load(bridge.backend), "WAITS", False):
        raise BadInput(
            f"--lockstep with the backend {bridge.backend}", "command line", "no --lockstep, as its device does not wait"
        )
    folder = writable(options.out, LOG)
    if done_before := [step.title for step in STEPS if step.name in read_log(folder)]:
        print(f"{folder} goes on after: {', '.join(done_before)}. Another rig needs another --out.")
    with closing(bridge.open(options.period)) as device, ExitStack() as bars:

        def session_for(known: Rig) -> Session:
            return Session(device, bridge.calibration, known, options.period, lockstep=options.lockstep)

        def progress(step: Step) -> Update:
            bars.close()
            return bars.enter_context(progress_bar(step.title))

        def release(step: Step) -> bool:
            bars.close()
            return _released(step, asked=not options.yes)

        for done in commission(session_for, rig, folder, release, progress, Wanted(*options.margins)):
            bars.close()
            _print(done)
            write_commissioning_report(read_log(folder), str(options.rig), folder / REPORT)
    print_files([("rig", folder / RIG), ("log", folder / LOG), ("report", folder / REPORT)])
    tuned = f"ehls experiment {folder / EXPERIMENT}, or " if (folder / EXPERIMENT).exists() else ""
    print(f"  next: {tuned}ehls tune {folder / RIG} for a task of your own")
    if options.json:
        print(json.dumps(read_log(folder)))
    return 0


def _released(step: Step, *, asked: bool) -> bool:
    """Ask the operator to release a step.

    Raises:
        WorkFailed: the operator ends the commissioning.
    """
    print(f"{step.title}: {step.moves}", flush=True)
    if not asked:
        return True
    try:
        answer = input(f"  {ASKED} > ").strip().lower()
    except EOFError:
        answer = "q"
    if answer == "q":
        raise WorkFailed("ended by the operator; start again to go on with this step")
    return answer != "s"


def _print(done: Done) -> None:
    if done.outcome is None:
        print(f"{done.step.title}: skipped")
        return
    rows = [
        (
            finding.path,
            "" if math.isnan(finding.given) else f"{finding.given:.4g}",
            f"{finding.found.value:.5g}",
            f"{finding.found.std:.2g}",
            finding.found.unit,
        )
        for finding in done.outcome.findings
    ]
    header = ("number", "given", "found", "standard error", "unit")
    if rows:
        print_table(done.step.title, header, rows, right=header[1:4])
    for sentence in done.outcome.sentences:
        print(f"  {sentence}")
