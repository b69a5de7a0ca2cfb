"""Report of one run."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ehls_ros.experiments.metrics import Metrics
from ehls_ros.hardware.pace import ADVICE
from ehls_ros.progress import duration_text
from ehls_ros.recording.events import Event
from ehls_ros.report import page
from ehls_ros.report import run_figures as drawn
from ehls_ros.report import run_planes as planes
from ehls_ros.report.decimation import BUCKETS
from ehls_ros.report.page import limit_text, number, with_unit
from ehls_ros.report.run_signals import error_of, known
from ehls_ros.report.run_statistics import sampling_sentence, statistics
from ehls_ros.trajectory import Trajectory, steady_error

LONG = 600.0
"""Time from which it is written in minutes, or in hours and minutes [s]."""

MAX_EVENTS = 200
"""Maximum number of events listed."""


def write_experiment_report(
    trajectory: Trajectory, metrics: Metrics | None, path: Path, events: Sequence[Event] = (), name: str = "Experiment"
) -> None:
    """Write one self-contained HTML file that shows a run.

    Args:
        trajectory: the run, with any subset of the signals; a figure with missing signals is listed as left out. The
            controlled quantity comes first: the position if the run has a position reference, else the force. Of the
            metadata the report shows ``title``, ``timing``, ``wall_s``, ``rig``, ``spec`` and ``versions``.
        metrics: metrics of the run; None for a recording without a reference.
        path: file to write; its folder must exist.
        events: events during the run.
        name: heading of a recording without a title, such as its file's name.
    """
    sentence, good = summary(trajectory, metrics)
    motion, position_error = drawn.motion(trajectory), drawn.position_error(trajectory)
    converged = None if metrics is None else metrics.convergence_s
    force = [drawn.force_tracking(trajectory), drawn.force_error(trajectory, converged)]
    follows_position = known(trajectory, "position_reference_m")
    follows_force = known(trajectory, "force_reference_n") or not follows_position
    over_time = [
        *([motion, position_error] if follows_position else []),
        *(force if follows_force else []),
        drawn.valve(trajectory),
        drawn.load_pressure(trajectory),
        *([] if follows_position else [motion]),
        drawn.friction(trajectory),
        drawn.adaptation(trajectory),
        drawn.sliding_variable(trajectory),
        drawn.response_time(trajectory),
    ]
    beside = [
        planes.response_histogram(trajectory),
        planes.sliding_plane(trajectory),
        planes.friction_against_velocity(trajectory),
        planes.force_against_position(trajectory),
    ]
    metadata = trajectory.metadata
    configuration = {key: metadata[key] for key in ("rig", "spec", "versions") if key in metadata}
    page.write_page(
        path,
        title=str(metadata.get("title") or name),
        subtitle=_subtitle(trajectory),
        blocks=[
            page.verdict(sentence, good=good),
            *(page.paragraph(f"Warning: {warning}.") for warning in (() if metrics is None else metrics.warnings)),
            _pace(metrics),
            page.facts(_facts(trajectory, metrics)),
            page.table(*statistics(trajectory)) if metrics is None else "",
            _resolution(trajectory),
            page.figures(over_time),
            page.figures(beside, columns=2),
            page.left_out([*over_time, *beside]),
            *_event_table(events, trajectory),
            page.collapsed("Configuration", page.as_yaml(configuration)) if configuration else "",
        ],
    )


def _event_table(events: Sequence[Event], trajectory: Trajectory) -> list[str]:
    """Return the table of the run's events, with times since its start, as in the figures."""
    if not events:
        return []
    start = trajectory.time_s[0] if len(trajectory) else 0.0
    rows = [("before" if event.time_s is None else f"{event.time_s - start:.3f}", event.node, event.what) for event in events]
    more = page.paragraph(f"{len(rows) - MAX_EVENTS} more are in the bag.") if len(rows) > MAX_EVENTS else ""
    return [page.heading("Events"), page.table(("time [s]", "node", "event"), rows[:MAX_EVENTS]), more]


COUNTED = {
    "saturated": "Command at its limit",
    "at_bound": "Estimate at its bound",
    "friction_fallback": "Steady friction in use",
}
"""Conditions whose cycles are counted, by signal."""


def summary(trajectory: Trajectory, metrics: Metrics | None) -> tuple[str, bool | None]:
    """Summarise a run in one sentence.

    Args:
        trajectory: the run.
        metrics: metrics of the run; None for a recording without a reference.

    Returns:
        The sentence, and whether the error converged and stayed inside its bound without a missed cycle or a warning, and in
        real time if required; None if there is no bound to compare with.
    """
    if metrics is None:
        return f"{sampling_sentence(trajectory)} There is no reference, so no tracking error can be evaluated.", None
    loop = f"{number(metrics.missed_cycles)} of {number(metrics.cycles)} cycles were missed"
    if not math.isfinite(metrics.max_error_n):
        position_error = steady_error(trajectory, "position_m", "position_reference_m")
        good = None if metrics.missed_cycles == 0 else False
        if position_error.size:
            largest = number(1e3 * float(position_error.max()))
            return f"In the last half the piston stayed within {largest} mm of the reference; {loop}.", good
        return f"The tracking error of the force cannot be evaluated; {loop}.", None
    outside = _cycles_outside_bound(trajectory)
    bound = f" and left its bound (44) in {number(outside)} cycles" if outside else ""
    accuracy = f"In the last half the force stayed within {number(metrics.max_error_n)} N of the reference"
    share = _share_of_reference(trajectory, metrics.max_error_n)
    slow = metrics.in_real_time is False
    flawless = metrics.convergence_s is not None and not (metrics.missed_cycles or outside or slow or metrics.warnings)
    return f"{accuracy}{share}{bound}; {_convergence(metrics)}; {loop}.", None if flawless and outside is None else flawless


def _convergence(metrics: Metrics) -> str:
    band, oscillation = with_unit(metrics.convergence_band_n, "N", ""), with_unit(metrics.oscillation_n, "N", "")
    if metrics.convergence_s is None:
        swings = f": it oscillates by ±{oscillation} in the last half, with a band of ±{band}" if band and oscillation else ""
        return f"the error did not converge{swings}"
    if metrics.convergence_s == 0:
        return f"the error was inside its band{f' of ±{band}' if band else ''} from the start"
    return f"the error converged after {number(metrics.convergence_s)} s{f', to within ±{band}' if band else ''}"


def _facts(trajectory: Trajectory, metrics: Metrics | None) -> list[tuple[str, str]]:
    position_error = 1e3 * steady_error(trajectory, "position_m", "position_reference_m")
    items = []
    if position_error.size:
        items += [
            ("Largest position error, last half", f"{number(float(position_error.max()))} mm"),
            ("RMS position error, last half", f"{number(float(np.sqrt(np.mean(position_error**2))))} mm"),
        ]
    outside = _cycles_outside_bound(trajectory)
    if metrics is not None:
        band, followed = with_unit(metrics.convergence_band_n, "N", ""), math.isfinite(metrics.max_error_n)
        items += [
            ("Largest error, last half", with_unit(metrics.max_error_n, "N", "")),
            ("Causal limit of it", "" if math.isnan(metrics.causal_limit_n) else limit_text(metrics.causal_limit_n)),
            ("RMS error, last half", with_unit(metrics.rms_error_n, "N", "")),
            ("Outside bound (44), last half", "" if outside is None else f"{number(outside)} cycles"),
            ("Convergence", with_unit(metrics.convergence_s, "s", "") or ("not converged" if followed else "")),
            ("Convergence band", f"±{band}" if band else ""),
            ("Cycles", number(metrics.cycles)),
            ("Missed cycles", number(metrics.missed_cycles)),
        ]
    done = trajectory.signals.get("programme_load_cycles", np.empty(0))
    if (done := done[np.isfinite(done)]).size:
        items.append(("Load cycles", number(int(done.max()))))
    for name, label in COUNTED.items():
        if known(trajectory, name):
            items.append((label, f"{number(int(np.sum(trajectory[name] > 0.5)))} cycles"))
    response = trajectory.signals.get("response_s", np.empty(0))
    response = response[np.isfinite(response)]
    if response.size:
        median, late, largest = (number(1e6 * float(np.quantile(response, share))) for share in (0.5, 0.99, 1.0))
        items.append(("Response median, 99 %, max", f"{median} / {late} / {largest} µs"))
    if metrics is not None:
        items += [
            ("Duration", _time(metrics.duration_s)),
            ("In real time", {None: "", True: "yes", False: "no"}[metrics.in_real_time]),
        ]
    wall = trajectory.metadata.get("wall_s", None if metrics is None else metrics.wall_s)
    recording = (metrics.bag if metrics is not None else None) or ""
    return [*items, ("Wall time", _time(wall)), ("Recording", recording)]


def _time(seconds: object) -> str:
    """Write a time in seconds, a long one in hours and minutes."""
    if isinstance(seconds, int | float) and LONG <= seconds < math.inf:
        return duration_text(seconds)
    return with_unit(seconds, "s", "")


def _pace(metrics: Metrics | None) -> str:
    if metrics is None or metrics.in_real_time is not False:
        return ""
    reached, asked = number(metrics.cycles_per_second_reached), number(metrics.cycles_per_second_asked)
    return page.paragraph(f"Not in real time: {reached} of {asked} cycles per second were answered. To be in time: {ADVICE}.")


def _resolution(trajectory: Trajectory) -> str:
    if len(trajectory) <= 3 * BUCKETS:
        return ""
    interval = float(trajectory.time_s[-1] - trajectory.time_s[0]) / BUCKETS
    return page.paragraph(f"Lines over time show the lowest and the highest sample of every {number(interval)} s.")


def _subtitle(trajectory: Trajectory) -> str:
    def name(*keys: str) -> str:
        found: object = trajectory.metadata
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
    error = error_of(trajectory)
    if error is None or not known(trajectory, "force_bound_n"):
        return None
    half = len(trajectory) // 2
    return int(np.sum(np.abs(error[half:]) > trajectory["force_bound_n"][half:]))
