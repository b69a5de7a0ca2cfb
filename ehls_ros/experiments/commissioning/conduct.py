"""Carry out the steps of a commissioning in order, each released by the operator; resumable after each."""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.experiments.commissioning.first_run import first_run, law_tuned
from ehls_ros.experiments.commissioning.measuring import at_rest, coupling, motion, nudge
from ehls_ros.experiments.commissioning.session import Session, Stopped
from ehls_ros.experiments.commissioning.step import Known, Outcome, Step, after
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.tuning.tune import USUAL, Wanted, check_margins
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.progress import Update
from ehls_ros.recording.csv_file import write_csv
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.trajectory import Trajectory

TUNE = "tune"
"""Name of the step that finds the law's numbers."""

STEPS = (
    Step("at_rest", "Sensors at rest", "The valve stays closed for 3 s.", at_rest),
    Step(
        "nudge",
        "Signs",
        "The valve opens by 2 to 30 % to either side for 0.3 s, until the piston moves by a thousandth of the stroke.",
        nudge,
    ),
    Step(
        "motion",
        "The rig identified",
        "The piston moves about mid-stroke for 20 s, by up to 40 % of the room to either end, at up to 40 % of its speed,"
        " and for 20 s slowly. Disconnect the rod from the actuator under test first.",
        motion,
    ),
    Step(
        "coupling",
        "Coupling",
        "The force follows a slow sine of 40 % of the largest for 20 s, up to three times. Connect the rod first to the"
        " actuator under test, and let that hold its position.",
        coupling,
    ),
    Step(TUNE, "Law tuned", "Nothing moves: the law is tuned in simulation, which takes about a minute.", law_tuned),
    Step(
        "first_run",
        "First run",
        "The force follows a sine for 6 s, with 5, 15 and 40 % of the largest force in turn. The rod is connected, and the"
        " actuator under test holds its position.",
        first_run,
    ),
)
"""The steps, in order."""

RIG, LOG, REPORT = "rig.yaml", "commission.json", "report.html"
"""Files in the folder: the rig as found so far, the log of the steps, and its report."""

Release = Callable[[Step], bool]
"""Asks the operator to release a step; returns whether to do it (False: skip it). An exception ends the commissioning."""


class Done(NamedTuple):
    """A step that was done or skipped.

    Attributes:
        step: the step.
        outcome: its result; None if it was skipped.
    """

    step: Step
    outcome: Outcome | None


def commission(
    session_for: Callable[[Rig], Session],
    rig: Rig,
    folder: Path,
    release: Release,
    progress: Callable[[Step], Update],
    wanted: Wanted = USUAL,
) -> Iterator[Done]:
    """Carry out the steps that the folder does not hold yet.

    Args:
        session_for: returns a session for the rig as known so far.
        rig: the rig of the file.
        folder: folder of the results; it must exist.
        release: asks the operator.
        progress: returns the progress of a step.
        wanted: margins that the tuning is asked for.

    Yields:
        Each step when it is done or skipped, and its results are written.

    Raises:
        BadInput: a margin is negative or not finite, or rig and files contradict each other; the message has the remedy.
        Stopped: the gate closed the valve, or the device was lost.
    """
    check_margins(wanted)
    log = read_log(folder)
    known = Known(load_rig(folder / RIG) if log else rig, log.get(TUNE, {}).get("numbers", {}), wanted)
    for step in STEPS:
        if step.name in log:
            continue
        if not release(step):
            outcome = None
            log[step.name] = {"done": False}
        else:
            outcome = _done(step, session_for(known.rig), known, folder, progress(step))
            known = after(known, outcome)
            log[step.name] = _entry(outcome)
        text = f"# Commissioned by `ehls commission`.\n{rig_text(rig_to_mapping(known.rig))}"
        (folder / RIG).write_text(text, encoding="utf-8")
        (folder / LOG).write_text(json.dumps(json_document(log), indent=2) + "\n", encoding="utf-8")
        yield Done(step, outcome)


def _done(step: Step, session: Session, known: Known, folder: Path, progress: Update) -> Outcome:
    try:
        outcome = step.run(session, known, progress)
    except Stopped as stopped:
        _keep({f"{step.name}_stopped": stopped.recording}, folder)
        raise
    _keep(outcome.recordings, folder)
    for name, text in outcome.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return outcome


def _keep(recordings: Mapping[str, Trajectory], folder: Path) -> None:
    for name, recording in recordings.items():
        if len(recording):
            write_csv(folder / f"{name}.csv", recording)


def _entry(outcome: Outcome) -> dict[str, Any]:
    return {
        "done": True,
        "findings": [{"name": finding.path, "given": finding.given, **finding.found._asdict()} for finding in outcome.findings],
        "sentences": list(outcome.sentences),
        **({"numbers": dict(outcome.numbers)} if outcome.numbers else {}),
    }


def read_log(folder: Path) -> dict[str, Any]:
    """Return the log of a folder by step; empty if there is none.

    Raises:
        BadInput: it is no log of this version's steps.
    """
    path = folder / LOG
    if not path.exists():
        return {}
    log = read_yaml(path, "log")
    names = {step.name for step in STEPS}
    if not isinstance(log, dict) or not set(log) <= names:
        raise BadInput("it is no log of a commissioning", str(path), f"steps of {', '.join(sorted(names))}, or another folder")
    return log
