"""`ehls monitor`: replay recordings through the monitor: changes, their onset, and the history of each coefficient."""

import csv
import json
import os
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

from ehls_ros.cli.arguments import add_columns, add_json, add_rig, columns_of
from ehls_ros.cli.results import all_or_nothing, print_table, writable, write_json
from ehls_ros.diagnosis.record import USED
from ehls_ros.errors import BadInput
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.monitoring.document import monitor_document
from ehls_ros.experiments.monitoring.health import Event
from ehls_ros.experiments.monitoring.monitor import Parameters
from ehls_ros.experiments.monitoring.replay import MonitoredRecording, MonitoringResult, replay
from ehls_ros.experiments.monitoring.trends import check_limits
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.yaml_files import spec_text
from ehls_ros.progress import progress_bar
from ehls_ros.recording.columns import ColumnMap
from ehls_ros.recording.events import read_pauses
from ehls_ros.recording.load import holds_tables, load, recordings
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.report.monitor import write_monitor_report
from ehls_ros.report.monitor_findings import HEADER, answer, duration, known, offered, table_row
from ehls_ros.schema import declarations, parse

HELP = "Watch recordings of a rig for changes, with a stated rate of false alarms: monitor.json, coefficients.csv, a report."

RESULT, TABLE, REPORT, OFFER = "monitor.json", "coefficients.csv", "report.html", "offered_experiment.yaml"
"""Files in the folder of the results; the last only where an experiment is offered."""

MIN_READING_TIME, MAX_READING_TIME = 10.0, 60.0
"""Shortest and longest time over which coefficients are averaged unless one is given [s]."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    declared = {entry.name: entry for entry in declarations(Parameters)}
    parser.add_argument(
        "data",
        type=Path,
        nargs="+",
        metavar="DATA",
        help="recordings in order of time: bags, run folders or tables (text, Excel, MAT, TDMS, MDF, RPC III, Parquet)",
    )
    add_rig(parser, "rig file of the healthy rig")
    parser.add_argument(
        "--baseline",
        type=Path,
        nargs="+",
        default=[],
        metavar="OLD",
        help="recordings of the healthy rig; without any, the monitor learns from the first samples",
    )
    add_columns(parser)
    for name, metavar in (("mean_time_between_false_alarms", "H"), ("learning_time", "S")):
        entry = declared[name]
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=float,
            default=entry.default,
            metavar=metavar,
            help=f"{entry.description} [{entry.unit}] (%(default)g)",
        )
    averaged = f"{declared['reading_time'].description} [s]"
    parser.add_argument(
        "--reading-time",
        type=float,
        metavar="S",
        help=f"{averaged} (default: a twentieth of the recordings, {MIN_READING_TIME:g} to {MAX_READING_TIME:g})",
    )
    parser.add_argument(
        "--limit",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="limit of a coefficient, in its SI unit, such as leakage_coefficient=1.2e-11; or a YAML file of several",
    )
    parser.add_argument("--out", type=Path, help="folder of the results (default: none are written)")
    add_json(parser, RESULT)


def run(options: Namespace) -> int:
    """Run it."""
    began = time.perf_counter()
    columns = columns_of(options)
    rig = load_rig(options.rig)
    limits = _limits(options.limit)
    check_limits(limits, rig, "--limit")
    asked = {name: getattr(options, name) for name in ("mean_time_between_false_alarms", "learning_time")}
    parse(Parameters, asked, "command line")
    folder = writable(options.out, RESULT) if options.out else None
    with progress_bar("watching") as bar:
        bar(0, 1, "reading")
        parts = [_recording(data, columns) for data in recordings(options.data, columns)]
        baselines = {str(path): load(recording_in(path), columns, USED) for path in options.baseline}
        seconds = sum(float(part.trajectory.time_s[-1] - part.trajectory.time_s[0]) for part in parts)
        asked["reading_time"] = options.reading_time or min(max(seconds / 20.0, MIN_READING_TIME), MAX_READING_TIME)
        parameters = parse(Parameters, asked, "command line")
        loaded = time.perf_counter()
        watched = replay(parts, rig, parameters, baselines=baselines, limits=limits, progress=bar, on_event=_print_event)
    wall = time.perf_counter() - began
    sentence, healthy = answer(watched)
    document = json_document(monitor_document(watched, sentence, healthy, wall))
    print(sentence)
    _print_coefficients(watched)
    if folder is not None:
        _write(folder, watched, document, f"{', '.join(part.name for part in parts)} against {options.rig.name}", options.rig)
        for name in (RESULT, TABLE, REPORT, *([OFFER] if watched.offer else [])):
            print(f"  {folder / name}")
    print(f"{duration(seconds)} watched in {wall:.1f} s, {seconds / (time.perf_counter() - loaded):.0f} times real time")
    if options.json:
        print(json.dumps(document))
    return 0


def _recording(data: Path, columns: ColumnMap | None) -> MonitoredRecording:
    """Read a recording and, from a bag of this package, the pauses in which no command reached the valve."""
    place = recording_in(data)
    ours = columns is None and not holds_tables(place)
    return MonitoredRecording(data.name or str(data), load(place, columns, USED), tuple(read_pauses(place)) if ours else ())


def _limits(texts: Sequence[str]) -> dict[str, float]:
    """Read limits: NAME=VALUE each, or a file of them."""
    found = dict[str, float]()
    for text in texts:
        if text.endswith((".yaml", ".yml")):
            content = read_yaml(Path(text), "limits")
            pairs = list(content.items()) if isinstance(content, Mapping) else [(text, "")]
        else:
            name, _, size = text.partition("=")
            pairs = [(name, size)]
        for key, value in pairs:
            try:
                found[str(key)] = float(value)
            except (TypeError, ValueError):
                raise BadInput(f"--limit has {key}: {value!r}", "command line", "NAME=VALUE, VALUE a number") from None
    return found


# --- results -----------------------------------------------------------------------------------


def _write(folder: Path, watched: MonitoringResult, document: object, source: str, rig: Path) -> None:
    """Write all results."""
    with all_or_nothing(folder) as scratch:
        write_json(scratch / RESULT, document)
        _write_table(scratch / TABLE, watched)
        write_monitor_report(watched, scratch / REPORT, source)
        if watched.offer is not None:
            spec = {**watched.offer.spec, "rig": os.path.relpath(rig, folder)}
            (scratch / OFFER).write_text(f"# Offered by `ehls monitor`: {watched.offer.purpose}.\n{spec_text(spec)}")
        else:
            (folder / OFFER).unlink(missing_ok=True)


def _write_table(path: Path, watched: MonitoringResult) -> None:
    """Write the coefficients over time, one row per value; undetermined values are empty, with the reason."""
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", "coefficient", "value", "std", "unit", "why_not"])
        for past in watched.history:
            for reading in past.readings:
                sizes = [repr(reading.value), repr(reading.deviation)] if reading.identified else ["", ""]
                rows.writerow([f"{past.time:.3f}", reading.name, *sizes, reading.unit, reading.why_not])


# --- terminal ----------------------------------------------------------------------------------


def _print_event(event: Event) -> None:
    print(f"{event.time:10.1f} s  {event.text}", flush=True)


def _print_coefficients(watched: MonitoringResult) -> None:
    print_table("Coefficients", HEADER, [table_row(reading, watched) for reading in known(watched)], unbroken=HEADER[:1])
    text = offered(watched)
    if text:
        print(text.replace("`", ""))
