"""`ehls diagnose`: find the model errors of the simulation, from a recording of the rig."""

import json
import os
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

from ehls_ros.cli.arguments import add_columns, add_results, add_rig, add_span, check_range, columns_of
from ehls_ros.cli.results import DIAGNOSIS, EXTENDED_RIG, all_or_nothing, print_files, print_table, writable, write_json
from ehls_ros.diagnosis.causes import advice
from ehls_ros.diagnosis.record import USED
from ehls_ros.diagnosis.result import Cause, Diagnosis
from ehls_ros.errors import BadInput
from ehls_ros.experiments.analysis import STEPS, diagnose_recordings
from ehls_ros.experiments.consequences import Consequences
from ehls_ros.experiments.diagnosis_document import diagnosis_document
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import load_rig
from ehls_ros.experiments.yaml_files import rig_text, spec_text
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.progress import duration_text, progress_bar
from ehls_ros.recording.columns import ColumnMap
from ehls_ros.recording.load import load, recordings
from ehls_ros.report.diagnosis import answer, write_diagnosis_report
from ehls_ros.report.diagnosis_findings import check_sentences, fitted, gain_sentence, next_steps
from ehls_ros.report.diagnosis_term import phrase
from ehls_ros.report.quantities import likely, percent
from ehls_ros.trajectory import Trajectory

HELP = "Find the errors of the simulation of a rig, from a recording: diagnosis.json, a report, an extended rig file."

REPORT, NEXT = "report.html", "next_experiment.yaml"
"""Files in the folder of the results; the last only where an experiment is proposed."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "data",
        type=Path,
        nargs="+",
        metavar="DATA",
        help="recording: bag, run folder, table (text, Excel, MAT, TDMS, MDF, RPC III, Parquet), or the tables of the map;"
        " several of the rig in one condition, such as short strokes, are judged together",
    )
    add_rig(parser, "rig file of the simulation")
    about = "recordings of the healthy rig: find the changes since then, whatever errors the rig file has"
    parser.add_argument("--baseline", type=Path, nargs="+", default=[], metavar="OLD", help=about)
    about = "other recordings of the rig, best with other motion: the part of their error that the extended model closes"
    parser.add_argument("--check", type=Path, nargs="+", default=[], metavar="OTHER", help=about)
    add_columns(parser)
    add_span(parser)
    parser.add_argument("--seed", type=int, default=0, help="seed of noise and resampling (%(default)s)")
    parser.add_argument("--threads", type=int, help="hypotheses fitted in parallel (default: one per processor)")
    add_results(parser, "runs/diagnose", DIAGNOSIS)


def run(options: Namespace) -> int:
    """Run it."""
    check_range(options, "threads", 1)
    check_range(options, "seed", 0)
    began = time.perf_counter()
    columns = columns_of(options)
    given = recordings(options.data, columns)
    twice = [str(data) for number, data in enumerate(given) if data in given[:number]]
    if twice:
        raise BadInput(f"{twice[0]} is given twice", "command line", "each recording once")
    rig = load_rig(options.rig)
    folder = writable(options.out, DIAGNOSIS)
    short = len({data.name for data in given}) == len(given)
    names = {(data.name if short else "") or str(data): data for data in given}
    with progress_bar("diagnosing") as bar:
        bar(0, STEPS, "reading")
        new = {called: _load(data, columns).between(options.begin, options.end, called) for called, data in names.items()}
        baselines, checks = ({str(path): _load(path, columns) for path in paths} for paths in (options.baseline, options.check))
        found, follows = diagnose_recordings(
            new, rig, baselines=baselines, seed=options.seed, threads=options.threads, progress=bar, checks=checks
        )
        wall = time.perf_counter() - began
        document = json_document(diagnosis_document(found, follows, answer(found)[0], EXTENDED_RIG, wall))
        _write(folder, found, follows, document, options.rig, _source(new, options))
    _print(found, follows, folder, time.perf_counter() - began)
    if options.json:
        print(json.dumps(document))
    return 0


def _load(data: Path, columns: ColumnMap | None) -> Trajectory:
    return load(recording_in(data), columns, USED)


def _source(new: Mapping[str, Trajectory], options: Namespace) -> str:
    seconds = sum(float(recording.time_s[-1] - recording.time_s[0]) for recording in new.values())
    samples = sum(map(len, new.values()))
    fitted = f" fitted to {', '.join(path.name for path in options.baseline)}" if options.baseline else ""
    return f"{', '.join(new)}, {seconds:.4g} s, {samples} samples, against {options.rig.name}{fitted}"


# --- results -----------------------------------------------------------------------------------


def _write(folder: Path, found: Diagnosis, follows: Consequences, document: object, rig: Path, source: str) -> None:
    """Write all results."""
    experiment = follows.next_experiment
    with all_or_nothing(folder) as scratch:
        write_json(scratch / DIAGNOSIS, document)
        (scratch / EXTENDED_RIG).write_text(_rig_file(found, rig, source), encoding="utf-8")
        write_diagnosis_report(found, scratch / REPORT, follows, source)
        if experiment is not None:
            spec = {**experiment.spec, "rig": EXTENDED_RIG, "controller_rig": os.path.relpath(rig, folder)}
            heading = f"# Proposed by `ehls diagnose` to separate the causes it left open: {experiment.purpose}.\n"
            (scratch / NEXT).write_text(heading + spec_text(spec), encoding="utf-8")
        else:
            (folder / NEXT).unlink(missing_ok=True)


def _rig_file(found: Diagnosis, rig: Path, source: str) -> str:
    """Return the extended rig file; without an extension, the given file with its comments."""
    heading = f"# Written by `ehls diagnose` from {source}.\n"
    if found.extended == found.rig and found.baseline is None:
        return f"{heading}# Nothing was added: the verdict is '{found.verdict}'.\n{rig.read_text(encoding='utf-8')}"
    added = "".join(
        f"#   {cause.name}: {', '.join(f'{name} {fitted(cause.name, name, e)}' for name, e in cause.parameters.items())};"
        f" probability {likely(cause.probability)}"
        f"{', or ' + ' or '.join(cause.equivalent_to) if cause.equivalent_to else ''}\n"
        for cause in found.causes
    )
    if found.term is not None:
        added = f"#   {found.term.effect}: {phrase(found.term)}\n"
    learnt = "" if found.baseline is None else f"# Coefficients fitted to {', '.join(found.baseline.recordings)}.\n"
    end = f"# Added at the end of `effects`:\n{added}" if added else f"# Nothing was added: the verdict is '{found.verdict}'.\n"
    return f"{heading}{learnt}{end}{rig_text(rig_to_mapping(found.extended))}"


# --- terminal ----------------------------------------------------------------------------------


def _print(found: Diagnosis, follows: Consequences, folder: Path, wall: float) -> None:
    print(answer(found)[0])
    if found.causes:
        _print_causes(found.causes)
    for cause in found.causes:
        print(f"  to confirm {cause.name}: {advice(found.rig, cause).measure}")
    for step in next_steps(found):
        print(f"  {step}")
    for sentence in found.missing if found.verdict == "insufficient" else ():
        print(f"  {sentence}")
    if found.gain is not None:
        print(gain_sentence(found))
    for sentence in check_sentences(follows.checks):
        print(sentence)
    proposed = follows.next_experiment
    if proposed is not None:
        print(f"next experiment: {proposed.name}, {proposed.purpose}")
    for remark in (*found.remarks, *follows.all_remarks):
        print(f"  {remark}")
    print(f"wall time {duration_text(wall)}, diagnosis {duration_text(found.wall_s)} of it")
    files = {"result": DIAGNOSIS, "report": REPORT, "rig": EXTENDED_RIG, **({} if proposed is None else {"next": NEXT})}
    print_files((name, folder / file) for name, file in files.items())


def _print_causes(causes: Sequence[Cause]) -> None:
    header = ["cause", "probability", "share", "parameter", "value ± error"]
    header += ["or"] if any(cause.equivalent_to for cause in causes) else []
    rows: list[list[str]] = []
    for cause in causes:
        first, others = [cause.name, likely(cause.probability), percent(cause.share)], ", ".join(cause.equivalent_to)
        for name, e in cause.parameters.items():
            rows.append([*first, name, fitted(cause.name, name, e), others][: len(header)])
            first, others = [""] * len(first), ""
    right, unbroken = ("probability", "share", "value ± error"), ("cause", "value ± error")
    print_table("Causes", header, rows, right=right, unbroken=unbroken)
