"""`ehls predict`: predict a recording from its command with one or more rig files, and compare it with the measurement."""

import json
import math
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.cli.arguments import add_columns, add_results, add_span, columns_of
from ehls_ros.cli.results import print_files, print_table, writable, write_json
from ehls_ros.diagnosis.prediction import Prediction, nrmse, predict
from ehls_ros.diagnosis.record import USED
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.run_folder import recording_in
from ehls_ros.experiments.spec import load_rig
from ehls_ros.progress import progress_bar
from ehls_ros.recording.load import load

HELP = "Predict force and motion from the valve command over short windows of a recording: error of each rig file."

RESULT = "prediction.json"
"""File in the folder of the results."""

LENGTHS = (1.0, 5.0)
"""Lengths of the windows by default [s]."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("data", type=Path, help="a bag, a run folder, or a recording in any format of `ehls diagnose`")
    parser.add_argument("--rig", type=Path, nargs="+", required=True, help="rig files to compare")
    add_columns(parser)
    about = "lengths of the windows [s], each started from the measured past (default: 1 5)"
    parser.add_argument("--windows", type=float, nargs="+", metavar="S", default=list(LENGTHS), help=about)
    add_span(parser)
    add_results(parser, "runs/predict", RESULT)


def run(options: Namespace) -> int:
    """Run it."""
    if any(not 0.0 < length < math.inf for length in options.windows):
        raise BadInput(f"--windows is {options.windows}", "command line", "lengths above 0 s")
    paths = [configured(path) for path in options.rig]
    names = [path.name for path in paths]
    names = names if len(set(names)) == len(names) else [str(path) for path in paths]
    rigs = {name: load_rig(path) for name, path in zip(names, paths, strict=True)}
    data: Path = options.data
    trajectory = load(recording_in(data), columns_of(options), USED)
    folder = writable(options.out, RESULT)
    with progress_bar("predicting") as bar:
        found = predict(
            trajectory,
            rigs,
            options.windows,
            data.name or str(data),
            options.begin,
            options.end,
            lambda done, total: bar(done, total, "windows"),
        )
    document = _document(found, data.name or str(data))
    write_json(folder / RESULT, document)
    _print(found)
    print_files([("result", folder / RESULT)])
    if options.json:
        print(json.dumps(document))
    return 0


def _document(found: Prediction, name: str) -> dict[str, Any]:
    """Return the content of ``prediction.json``; an error is null where a simulated piston left the stroke."""

    def plain(errors: Array) -> list[float | None]:
        return [e if math.isfinite(e) else None for e in errors.tolist()]

    return {
        "recording": name,
        "windows": [
            {
                "length_s": windows.length,
                "starts_s": windows.starts.tolist(),
                "nrmse": {signal: {m: nrmse(e) for m, e in models.items()} for signal, models in windows.errors.items()},
                "each": {signal: {m: plain(e) for m, e in models.items()} for signal, models in windows.errors.items()},
            }
            for windows in found.windows
        ],
        "remarks": list(found.remarks),
    }


def _print(found: Prediction) -> None:
    shortest, signals = found.windows[0], found.windows[0].errors
    lengths = [f"{windows.length:g} s" for windows in found.windows]
    header = ["signal", "model", *lengths, "median window", "worst window"]
    rows = []
    for signal, models in signals.items():
        for i, (model, each) in enumerate(models.items()):
            errors = [nrmse(windows.errors[signal][model]) for windows in found.windows]
            worst = int(np.argmax(np.nan_to_num(each, nan=np.inf)))
            spread = [_percent(float(np.median(each))), f"{_percent(float(each[worst]))} at {shortest.starts[worst]:.1f} s"]
            rows.append(["" if i else signal, model, *(_percent(math.nan if e is None else e) for e in errors), *spread])
    print_table("Rms error, % of the signal's standard deviation", header, rows, right=header[2:], unbroken=header)
    counts = ", ".join(f"{len(w.starts)} windows of {length}" for w, length in zip(found.windows, lengths, strict=True))
    print(f"{counts}, started from the measured past; median and worst are those of {lengths[0]}")
    for remark in found.remarks:
        print(f"  {remark}")


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.1f}" if math.isfinite(fraction) else "left the stroke"
