"""`ehls report`: show recorded data."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros.errors import BadInput
from ehls_ros.experiments.causal_limit import evaluate_recording
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.events import read_events
from ehls_ros.recording.load import holds_tables, load
from ehls_ros.report.experiment import write_experiment_report

HELP = "Write the HTML report of a bag, a run folder or a table."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("data", type=Path, help="a bag, a run folder, or a recording in any format of `ehls diagnose`")
    parser.add_argument("--columns", type=Path, help="YAML that maps the data's own column names and units")
    parser.add_argument("--out", type=Path, help="HTML file (default: report.html beside the data)")


def run(options: Namespace) -> int:
    """Write it."""
    data: Path = options.data
    recording = recording_in(data)
    trajectory = load(recording, read_columns(options.columns) if options.columns else None)
    events = [] if options.columns or holds_tables(recording) else read_events(recording)
    out: Path = options.out or (data.parent if recording == data else data) / "report.html"
    try:
        write_experiment_report(trajectory, evaluate_recording(trajectory), out, events, name=data.resolve().name)
    except OSError as error:
        raise BadInput(f"the report cannot be written ({error.strerror})", str(out), "a writable place (--out)") from None
    print(out)
    return 0
