"""Texts of the page on a tuning: its progress, and why it or the application of its result is not possible."""

from collections.abc import Callable

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.dashboard.graph import GraphSnapshot, Tuning
from ehls_ros.errors import BadInput

COMPILING_TEXT = "compiling, about half a minute the first time"

CANCELLED = "cancelled"
"""Failure of a tuning that was cancelled."""


def law_to_tune(snapshot: GraphSnapshot, chosen: Callable[[], str]) -> tuple[str, str]:
    """Return the law that a tuning would tune, and why it cannot; either is empty.

    Args:
        snapshot: of the graph.
        chosen: returns the law of the experiment chosen on the page, or raises BadInput; called only without a running graph.
    """
    if snapshot.starting is not None:
        return "", "The graph is starting."
    if snapshot.rate and not snapshot.laws:
        return "", "No controller of the running graph has reported yet."
    try:
        law = snapshot.laws[0] if snapshot.rate else chosen()
        tuned = getattr(CONTROLLERS.load(law), "TUNED", ())
    except BadInput as error:
        return "", f"The experiment cannot be read: {error}"
    return (law, "") if tuned else ("", f"The law {law} has no numbers to tune: its file names none (TUNED).")


def progress_text(tuning: Tuning) -> str:
    """Return progress or outcome of a tuning as a sentence; empty once there is a result."""
    what = f"{tuning.law} for {tuning.experiment}"
    if tuning.running:
        tried = f"{tuning.done} of at most {tuning.most} sets of numbers tried" if tuning.most else COMPILING_TEXT
        return f"Tuning {what}: {tried}, {tuning.seconds:.0f} s."
    if tuning.failure == CANCELLED:
        return f"The tuning of {what} was cancelled."
    return f"The tuning of {what} failed: {tuning.failure}" if tuning.failure else ""


def why_not_applicable(snapshot: GraphSnapshot, tuning: Tuning) -> str:
    """Return why the result of a tuning cannot be applied; empty if it can.

    Args:
        snapshot: of the graph.
        tuning: a tuning with a result.
    """
    if tuning.result is not None and tuning.result.lost:
        return "These numbers do not hold the force."
    if not snapshot.rate:
        return "No graph is running."
    if tuning.law not in snapshot.laws:
        return f"No node of {tuning.law} is running."
    return ""
