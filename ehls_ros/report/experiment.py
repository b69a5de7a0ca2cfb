"""The report of one run."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros.hardware.pace import ADVICE
from ehls_ros.report import figures
from ehls_ros.report.decimation import BUCKETS
from ehls_ros.report.page import (
    MISSING_NUMBER,
    as_yaml,
    collapsed,
    facts,
    left_out,
    number,
    paragraph,
    verdict,
    write_page,
)
from ehls_ros.report.page import figures as figure_blocks
from ehls_ros.trajectory import Trajectory, steady_error


def write_experiment_report(trajectory: Trajectory, metrics: Mapping[str, Any], path: Path) -> None:
    """Write one HTML file that shows a run and needs nothing else.

    Args:
        trajectory: the run, with any subset of the signals; a figure whose signals are missing is left
            out and named. What was followed comes first: a position where the run has a reference of one,
            else the force. Of its metadata the report shows ``title``, ``timing``, ``wall_s``, ``rig``,
            ``spec`` and ``versions``.
        metrics: what ``metrics.json`` holds.
        path: file to write; its folder must exist.
    """
    sentence, good = summary(trajectory, metrics)
    motion, position_error = figures.motion(trajectory), figures.position_error(trajectory)
    force = [figures.force_tracking(trajectory), figures.force_error(trajectory, metrics.get("convergence_s"))]
    follows_position = figures.known(trajectory, "position_reference_m")
    follows_force = figures.known(trajectory, "force_reference_n") or not follows_position
    over_time = [
        *([motion, position_error] if follows_position else []),
        *(force if follows_force else []),
        figures.valve(trajectory),
        figures.load_pressure(trajectory),
        *([] if follows_position else [motion]),
        figures.friction(trajectory),
        figures.adaptation(trajectory),
        figures.sliding_variable(trajectory),
        figures.response_time(trajectory),
    ]
    planes = [
        figures.response_histogram(trajectory),
        figures.sliding_plane(trajectory),
        figures.friction_against_velocity(trajectory),
        figures.force_against_position(trajectory),
    ]
    metadata = trajectory.metadata
    configuration = {key: metadata[key] for key in ("rig", "spec", "versions") if key in metadata}
    write_page(
        path,
        title=str(metadata.get("title") or "Experiment"),
        subtitle=_subtitle(trajectory),
        blocks=[
            verdict(sentence, good=good),
            *(paragraph(f"Warning: {warning}.") for warning in metrics.get("warnings") or ()),
            _pace(metrics),
            facts(_facts(trajectory, metrics)),
            _resolution(trajectory),
            figure_blocks(over_time),
            figure_blocks(planes, columns=2),
            left_out([*over_time, *planes]),
            collapsed("Configuration", as_yaml(configuration)),
        ],
    )


def summary(trajectory: Trajectory, metrics: Mapping[str, Any]) -> tuple[str, bool | None]:
    """Sum a run up in one sentence.

    Args:
        trajectory: the run.
        metrics: what ``metrics.json`` holds.

    Returns:
        The sentence, and whether the error converged and stayed inside its bound without a missed cycle or a warning, and in
        real time where that was asked for; None if there is no bound to judge it by.
    """
    max_error, converged = metrics.get("max_error_n"), metrics.get("convergence_s")
    missed, cycles = metrics.get("missed_cycles"), metrics.get("cycles")
    loop = f"{number(missed)} of {number(cycles)} cycles were missed"
    if max_error is None or not math.isfinite(max_error):
        position_error = steady_error(trajectory, "position_m", "position_reference_m")
        if position_error.size:
            largest = number(1e3 * float(position_error.max()))
            sentence = f"Over the last half the piston stayed within {largest} mm of the reference; {loop}."
            return sentence, None if missed == 0 else False
        return f"How well the force follows a reference cannot be told; {loop}.", None
    band, oscillation = _with_unit(metrics.get("convergence_band_n"), "N"), _with_unit(metrics.get("oscillation_n"), "N")
    if converged is None:
        swings = f": it swings by ±{oscillation} in the last half, with a band of ±{band}" if band and oscillation else ""
        convergence = f"the error had not converged{swings}"
    elif converged == 0:
        convergence = f"the error was inside its band{f' of ±{band}' if band else ''} from the start"
    else:
        convergence = f"the error converged after {number(converged)} s{f', to within ±{band}' if band else ''}"
    accuracy = f"Over the last half the force stayed within {number(max_error)} N of the reference"
    share = _share_of_reference(trajectory, float(max_error))
    outside = _cycles_outside_bound(trajectory)
    bound = f" and left its bound (44) in {number(outside)} cycles" if outside else ""
    slow = metrics.get("in_real_time") is False
    flawless = converged is not None and missed == 0 and not (outside or slow or metrics.get("warnings"))
    return f"{accuracy}{share}{bound}; {convergence}; {loop}.", None if flawless and outside is None else flawless


def _facts(trajectory: Trajectory, metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    max_error = _with_unit(metrics.get("max_error_n"), "N")
    position_error = 1e3 * steady_error(trajectory, "position_m", "position_reference_m")
    items = []
    if position_error.size:
        items += [
            ("Largest position error, last half", f"{number(float(position_error.max()))} mm"),
            ("RMS position error, last half", f"{number(float(np.sqrt(np.mean(position_error**2))))} mm"),
        ]
    items += [
        ("Largest error, last half", max_error),
        ("RMS error, last half", _with_unit(metrics.get("rms_error_n"), "N")),
    ]
    outside = _cycles_outside_bound(trajectory)
    if outside is not None:
        items.append(("Outside bound (44), last half", f"{number(outside)} cycles"))
    items += [
        ("Convergence", _with_unit(metrics.get("convergence_s"), "s") or ("not reached" if max_error else "")),
        ("Convergence band", f"±{band}" if (band := _with_unit(metrics.get("convergence_band_n"), "N")) else ""),
        ("Cycles", number(metrics.get("cycles"))),
        ("Missed cycles", number(metrics.get("missed_cycles"))),
    ]
    for name, label in (("saturated", "Command at its limit"), ("friction_fallback", "Static friction stood in")):
        if figures.known(trajectory, name):
            items.append((label, f"{number(int(np.sum(trajectory[name] > 0.5)))} cycles"))
    response = trajectory.signals.get("response_s", np.empty(0))
    response = response[np.isfinite(response)]
    if response.size:
        median, late, largest = (number(1e6 * float(np.quantile(response, part))) for part in (0.5, 0.99, 1.0))
        items.append(("Response median, 99 %, max", f"{median} / {late} / {largest} µs"))
    items += [
        ("Duration", _with_unit(metrics.get("duration_s"), "s")),
        ("In real time", {None: "", True: "yes", False: "no"}[metrics.get("in_real_time")]),
        ("Wall time", _with_unit(trajectory.metadata.get("wall_s", metrics.get("wall_s")), "s")),
        ("Recording", str(metrics.get("bag") or "")),
    ]
    return [(label, value) for label, value in items if value]


def _pace(metrics: Mapping[str, Any]) -> str:
    if metrics.get("in_real_time") is not False:
        return ""
    reached, asked = metrics["cycles_per_second_reached"], metrics["cycles_per_second_asked"]
    return paragraph(
        f"Not in real time: {number(reached)} of {number(asked)} cycles a second were answered. To be in time: {ADVICE}."
    )


def _resolution(trajectory: Trajectory) -> str:
    if len(trajectory) <= 3 * BUCKETS:
        return ""
    part = (trajectory.time_s[-1] - trajectory.time_s[0]) / BUCKETS
    return paragraph(f"Lines over time show the lowest and the highest sample of every {number(float(part))} s.")


def _subtitle(trajectory: Trajectory) -> str:
    def name(*keys: str) -> str:
        found: Any = trajectory.metadata
        for key in keys:
            found = found.get(key) if isinstance(found, Mapping) else None
        return str(found or "")

    parts = {
        "controller": name("spec", "controller", "name"),
        "friction compensation": name("spec", "compensation", "name"),
        "reference": name("spec", "reference", "name"),
        "disturbance": f"{name('spec', 'disturbance', 'name')} {name('spec', 'disturbance', 'signal', 'name')}".strip(),
        "timing": name("timing"),
        "ehls_ros": name("versions", "ehls_ros"),
    }
    return " · ".join(f"{label} {value}" for label, value in parts.items() if value)


def _share_of_reference(trajectory: Trajectory, error_n: float) -> str:
    reference = trajectory.signals.get("force_reference_n", np.empty(0))
    largest = float(np.max(np.abs(reference), where=np.isfinite(reference), initial=0.0))
    if largest == 0:
        return ""
    return f" ({number(100 * error_n / largest)} % of its largest value, {number(1e-3 * largest)} kN)"


def _cycles_outside_bound(trajectory: Trajectory) -> int | None:
    error = figures.error_of(trajectory)
    if error is None or not figures.known(trajectory, "force_bound_n"):
        return None
    half = len(trajectory) // 2
    return int(np.sum(np.abs(error[half:]) > trajectory["force_bound_n"][half:]))


def _with_unit(value: object, unit: str) -> str:
    text = number(value)
    return "" if text == MISSING_NUMBER else f"{text} {unit}"
