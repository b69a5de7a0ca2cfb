"""Report of a commissioning: the numbers found in each step beside those of the rig file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ehls_ros.experiments.commissioning.conduct import STEPS
from ehls_ros.experiments.commissioning.step import Step
from ehls_ros.report import page
from ehls_ros.report.page import MISSING_NUMBER, Entry, number, signed
from ehls_ros.report.quantities import unit_text, written

CERTAIN = 3.0
"""Standard errors by which a number differs from the file's to be marked."""


def write_commissioning_report(log: Mapping[str, Any], rig: str, path: Path) -> None:
    """Write a self-contained HTML file that shows the steps of a commissioning so far.

    Args:
        log: the log by step, see :func:`ehls_ros.experiments.commissioning.conduct.read_log`.
        rig: name of the rig file that it started from.
        path: file to write; its folder must exist.
    """
    parts = [(step.title, _part(step, log.get(step.name))) for step in STEPS]
    left = [step.title for step in STEPS if not log.get(step.name, {}).get("done")]
    sentence = f"Not done yet: {page.listed(left)}." if left else "All steps are done."
    blocks = [page.verdict(sentence, good=None if left else True), *page.sections(parts)]
    page.write_page(path, title="Rig commissioned", subtitle=f"from {rig}", blocks=blocks)


def _part(step: Step, entry: Mapping[str, Any] | None) -> list[str]:
    if entry is None:
        return [page.paragraph("Not done yet.")]
    if not entry["done"]:
        return [page.paragraph("Skipped.")]
    columns: dict[str, Callable[[Mapping[str, Any]], str | Entry]] = {
        "number": lambda found: found["name"],
        "rig file": lambda found: MISSING_NUMBER if found["given"] is None else number(found["given"], 4),
        "found": lambda found: written(found["value"], found["std"]).value,
        "standard error": lambda found: written(found["value"], found["std"]).error,
        "difference": _difference,
        "unit": lambda found: unit_text(found["unit"]),
    }
    return [page.paragraph(step.moves), page.table_of(entry["findings"], columns), page.bullets(entry["sentences"])]


def _difference(found: Mapping[str, Any]) -> str | Entry:
    given = found["given"]
    if not given:
        return MISSING_NUMBER
    off = abs(found["value"] - given) > CERTAIN * found["std"]
    return Entry(f"{signed(100.0 * (found['value'] / given - 1.0))} %", heat=0.4 if off else 0.0)
