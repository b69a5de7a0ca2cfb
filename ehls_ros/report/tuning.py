"""Report of a tuning: the numbers found, error against margin, and the limitations of the rig."""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ehls_ros.experiments.spec import spec_to_mapping
from ehls_ros.experiments.tuning.files import EXPERIMENT, document, experiment_text, parameters_text
from ehls_ros.experiments.tuning.task import held
from ehls_ros.experiments.tuning.tune import Limit, Trial, Tuned
from ehls_ros.report import page, plot
from ehls_ros.report.page import Panel, limit_text, number, plane, with_unit
from ehls_ros.report.plot import NEWTON, Axis, Trace, Unit
from ehls_ros.schema import notes

RESULT = "tuning.json"
"""File with the result for programs."""

DECIBEL = Unit("dB")

LOST = "lost"
"""Text for the error of a run in which the force was lost."""

HELD = "small force, actuator held"
"""Title of the error's swing with a small force against an actuator under test that holds."""

WORTH = 0.95
"""Ratio of the errors without and with a limitation below which it limits the result."""


class TuningFiles(NamedTuple):
    """Files of a tuning.

    Attributes:
        numbers: parameter file of the controller's node.
        spec: experiment with the numbers found.
        result: JSON document.
        report: HTML file.
    """

    numbers: Path
    spec: Path
    result: Path
    report: Path


def tuning_files(folder: Path, law: str) -> TuningFiles:
    """Return the files of a tuning in a folder."""
    return TuningFiles(folder / f"{law}.yaml", folder / EXPERIMENT, folder / RESULT, folder / "report.html")


def write_tuning_files(found: Tuned, folder: Path) -> TuningFiles:
    """Write all files of a tuning into an existing folder."""
    files = tuning_files(folder, found.spec.controller.name)
    files.numbers.write_text(parameters_text(found), encoding="utf-8")
    files.spec.write_text(experiment_text(found), encoding="utf-8")
    files.result.write_text(json.dumps(document(found), indent=2) + "\n", encoding="utf-8")
    write_tuning_report(found, files.report)
    return files


def write_tuning_report(found: Tuned, path: Path) -> None:
    """Write a self-contained HTML file that shows a tuning.

    Args:
        found: the result.
        path: file to write; its folder must exist.
    """
    parts = [
        ("Numbers", [_numbers(found)]),
        ("Error and margin", [_results(found), page.figures([trade_off(found)])]),
        ("Limitations", [_limitations(found)]),
        ("Remarks", [page.bullets(found.remarks)] if found.remarks else []),
        ("How it was made", [_making(found), page.collapsed("Experiment", page.as_yaml(spec_to_mapping(found.spec)))]),
    ]
    law = found.spec.controller.name
    blocks = [page.verdict(sentence(found), good=found.holds), *page.sections(parts)]
    page.write_page(path, title=f"{law} tuned", subtitle=str(found.spec.settings.title), blocks=blocks)


def sentence(found: Tuned) -> str:
    """Return the result in a sentence."""
    chosen = found.chosen
    if found.lost:
        return f"No numbers of {found.spec.controller.name} hold the force of this experiment."
    limit = found.causal_limit
    beside = f", {chosen.error / limit:.1f} times the causal limit" if limit >= page.MIN_LIMIT else ""
    margins = f"{chosen.gain_db:.1f} dB and {chosen.margins.phase_deg:.0f}°"
    return f"Largest error {number(chosen.error)} N{beside}; margins {margins}."


def trade_off(found: Tuned) -> Panel:
    """Draw the error over the gain margin, all numbers made slower and faster together."""
    # In the order of speed: a loop that is made slower may lose gain margin, too.
    curve = [trial for trial in found.curve if math.isfinite(trial.error) and trial.gain_db > 0.0]
    points = [*curve, found.chosen, found.default]
    errors = np.asarray([trial.error for trial in points if 0.0 < trial.error < math.inf])
    traces: list[Trace] = []
    if curve:
        traces.append(_line(curve, "all numbers slower or faster", plot.BLUE))
    for trial, name, color, symbol in (
        (found.chosen, "chosen", plot.VERMILION, "circle"),
        (found.default, "defaults", plot.GREY, "diamond"),
    ):
        if math.isfinite(trial.error):
            at = np.asarray([trial.gain_db])
            traces.append(plot.dots(at, np.asarray([trial.error]), name, NEWTON, color, symbol=symbol))
    ends = np.asarray([0.0, max((trial.gain_db for trial in points), default=1.0) * 1.05])
    if found.causal_limit > 0.0:
        errors = np.append(errors, found.causal_limit)
        level = np.full(2, found.causal_limit)
        traces.append(plot.line(ends, level, "causal limit", NEWTON, plot.GREEN, dash="dash"))
    span = plot.decades(errors) if errors.size else (1.0, 10.0)
    wanted = np.full(2, found.wanted.gain_db)
    traces.append(plot.line(wanted, np.asarray(span), "margin asked for", NEWTON, plot.LIGHT_GREY, dash="dot"))
    note = (
        "Largest error on the rig of the file. A margin costs accuracy: choose the point that your knowledge of the rig allows."
    )
    x = Axis("gain margin", DECIBEL, (0.0, float(ends[1])))
    return plane("Error over gain margin", traces, x, Axis("largest error", NEWTON, span, logarithmic=True), note)


def _line(trials: Sequence[Trial], name: str, color: str) -> Trace:
    gains, errors = (np.asarray(values) for values in zip(*((t.gain_db, t.error) for t in trials), strict=True))
    return plot.line(gains, errors, name, NEWTON, color) | {"mode": "lines+markers"}


def _numbers(found: Tuned) -> str:
    declared = notes(type(found.spec.controller.parameters))
    columns: dict[str, Callable[[str], str]] = {
        "number": str,
        "default": lambda name: number(found.default.numbers[name], 4),
        "found": lambda name: number(found.chosen.numbers[name], 4),
        "unit": lambda name: declared[name].unit,
        "meaning": lambda name: declared[name].description,
    }
    return page.table_of(tuple(found.chosen.numbers), columns)


def _results(found: Tuned) -> str:
    columns: dict[str, Callable[[tuple[str, Trial]], str]] = {
        "": lambda item: item[0],
        "largest error": lambda item: with_unit(item[1].error, "N", LOST),
        "within the uncertainty": lambda item: with_unit(item[1].typical, "N", LOST),
        "largest of all runs": lambda item: with_unit(item[1].worst, "N", LOST),
        HELD: lambda item: with_unit(100.0 * item[1].held, "%", LOST),
        "gain margin": lambda item: with_unit(item[1].gain_db, "dB"),
        "phase margin": lambda item: with_unit(item[1].margins.phase_deg, "°"),
        "further delay": lambda item: with_unit(1e3 * item[1].margins.delay, "ms"),
    }
    if held(found.spec) is None:
        del columns[HELD]
    limit = page.facts([("Causal limit", limit_text(found.causal_limit))]) if found.causal_limit > 0.0 else ""
    return page.table_of((("defaults", found.default), ("found", found.chosen)), columns) + limit


def _limitations(found: Tuned) -> str:
    def effect(limit: Limit) -> str:
        if not math.isfinite(limit.error) or limit.error > WORTH * found.chosen.error:
            return "no gain with these numbers"
        return f"−{100.0 * (1.0 - limit.error / found.chosen.error):.0f} %"

    columns: dict[str, Callable[[Limit], str]] = {
        "without": lambda limit: limit.removed,
        "largest error": lambda limit: with_unit(limit.error, "N", LOST),
        "change": effect,
    }
    return page.table_of(sorted(found.limits, key=lambda limit: limit.error), columns)


def _making(found: Tuned) -> str:
    return page.facts(
        [
            ("Sets of numbers tried", number(found.tried)),
            ("Margins asked for", f"{found.wanted.gain_db:g} dB, {found.wanted.phase_deg:g}°"),
        ]
    )
