"""`ehls report`: write the HTML report of recorded data."""

from argparse import ArgumentParser, Namespace
from datetime import date
from pathlib import Path

from ehls_ros.cli.arguments import add_columns, columns_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.causal_limit import evaluate_recording
from ehls_ros.experiments.metrics import stops_of
from ehls_ros.experiments.monitoring.daily import is_monitor_folder, results_of_day
from ehls_ros.experiments.monitoring.health import today
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.recording.events import read_events
from ehls_ros.recording.load import holds_tables, load
from ehls_ros.report.experiment import write_experiment_report
from ehls_ros.report.monitor import daily_report
from ehls_ros.report.monitor_findings import Clock

HELP = "Write the HTML report of a bag, a run folder, a table, or a day of a monitor."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "data", type=Path, help="a bag, a run folder, a recording in any format of `ehls diagnose`, or a monitor's folder"
    )
    add_columns(parser)
    parser.add_argument("--day", type=date.fromisoformat, help="day of a monitor's folder, as 2026-01-31 (default: today)")
    parser.add_argument("--out", type=Path, help="HTML file (default: report.html beside the data; of a day report-<day>.html)")


def run(options: Namespace) -> int:
    """Write the report."""
    data: Path = options.data
    if is_monitor_folder(data):
        return _of_day(data, options.day or today(), options.out)
    recording = recording_in(data)
    trajectory = load(recording, columns_of(options))
    is_bag = not options.columns and not holds_tables(recording)
    metrics = evaluate_recording(trajectory)
    if metrics is not None and is_bag:
        metrics = metrics._replace(warnings=(*metrics.warnings, *stops_of(recording, trajectory)))
    out: Path = options.out or (data.parent if recording == data else data) / "report.html"
    try:
        write_experiment_report(trajectory, metrics, out, read_events(recording) if is_bag else [], name=data.resolve().name)
    except OSError as error:
        raise BadInput(f"the report cannot be written ({error.strerror})", str(out), "a writable place (--out)") from None
    print(out)
    return 0


def _of_day(folder: Path, day: date, out: Path | None) -> int:
    """Write the report of a day of a monitor."""
    watched, midnight = results_of_day(folder, day)
    try:
        path = daily_report(watched, folder, day, Clock(midnight), out)
    except OSError as error:
        raise BadInput(f"the report cannot be written ({error.strerror})", str(out or folder), "a writable place") from None
    print(path)
    return 0
