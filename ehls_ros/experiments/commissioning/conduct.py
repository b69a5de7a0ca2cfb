"""Carry out the steps of a commissioning in order, each released by the operator; resumable after each."""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.experiments.commissioning.session import Session, Stopped
from ehls_ros.experiments.commissioning.steps import STEPS, Outcome, Step
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.progress import Update
from ehls_ros.recording.csv_file import write_csv
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.trajectory import Trajectory

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
    session_for: Callable[[Rig], Session], rig: Rig, folder: Path, release: Release, progress: Callable[[Step], Update]
) -> Iterator[Done]:
    """Carry out the steps that the folder does not hold yet.

    Args:
        session_for: returns a session for the rig as known so far.
        rig: the rig of the file.
        folder: folder of the results; it must exist.
        release: asks the operator.
        progress: returns the progress of a step.

    Yields:
        Each step when it is done or skipped, and its results are written.

    Raises:
        BadInput: rig and files contradict each other; the message has the remedy.
        Stopped: the gate closed the valve, or the device was lost.
    """
    log = read_log(folder)
    known = load_rig(folder / RIG) if log else rig
    for step in STEPS:
        if step.name in log:
            continue
        if not release(step):
            outcome = None
            log[step.name] = {"done": False}
        else:
            outcome = _done(step, session_for(known), known, folder, progress(step))
            known = outcome.rig
            log[step.name] = _entry(outcome)
        text = f"# Commissioned by `ehls commission`.\n{rig_text(rig_to_mapping(known))}"
        (folder / RIG).write_text(text, encoding="utf-8")
        (folder / LOG).write_text(json.dumps(json_document(log), indent=2) + "\n", encoding="utf-8")
        yield Done(step, outcome)


def _done(step: Step, session: Session, rig: Rig, folder: Path, progress: Update) -> Outcome:
    try:
        outcome = step.run(session, rig, progress)
    except Stopped as stopped:
        _keep({f"{step.name}_stopped": stopped.recording}, folder)
        raise
    _keep(outcome.recordings, folder)
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
