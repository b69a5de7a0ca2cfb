"""Work of a campaign's worker: rows of metrics from specs."""

import hashlib
import json
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros import __version__
from ehls_ros.errors import BadInput, WorkFailed, reason
from ehls_ros.experiments.batch import run_batch
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate_errors
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.sources import sources_digest
from ehls_ros.trajectory import Trajectory

METRICS = ("max_error_n", "rms_error_n", "convergence_s", "cycles", "missed_cycles", "duration_s", "wall_s")
"""Columns of a row, named as in ``metrics.json``; ``error`` follows."""

Row = dict[str, Any]

_ONE_AT_A_TIME = threading.Lock()
"""Lock that keeps threads of one worker from importing the same new kernel simultaneously."""


def code_version() -> str:
    """Return the package's version with a digest of the sources that determine a run's numbers."""
    digest = sources_digest("physics", "control", "experiments", "arrays.py", "duals", "inlining.py", "numba_internals.py")
    return f"{__version__}+{digest[:12]}"


def run_digest(spec: str) -> str:
    """Return the key of a run: equal for equal specs under equal code, in any campaign.

    Args:
        spec: the spec as JSON, with the content of all referenced files.
    """
    return hashlib.sha256(f"{code_version()} {spec}".encode()).hexdigest()[:32]


def run_chunk(specs: Sequence[str], version: str, *, side_by_side: bool = False) -> list[Row]:
    """Run experiments.

    Args:
        specs: the specs as JSON.
        version: code version of the caller.
        side_by_side: whether to run those that can in lanes of one call, which is faster once that loop is compiled.

    Returns:
        One row per spec: its metrics, and ``error``: the reason why the run failed, or None. The wall time of runs in lanes is
        divided equally among them.

    Raises:
        WorkFailed: this process has other code than the caller.
    """
    if code_version() != version:
        raise WorkFailed(
            f"a worker has ehls_ros {code_version()} where {version} is asked for: install the same on every worker"
        )
    with _ONE_AT_A_TIME:
        return _run_side_by_side(specs) if side_by_side else [run_one(spec) for spec in specs]


def run_one(spec: str) -> Row:
    """Run one experiment.

    Args:
        spec: the spec as JSON.

    Returns:
        A row as of :func:`run_chunk`.
    """
    start = time.perf_counter()
    try:
        row = _row(run_in_process(spec_of(spec)))
    except Exception as failure:  # noqa: BLE001 - a failure is the result of this run, and the others continue
        row = _failed(failure)
    return row | {"wall_s": time.perf_counter() - start}


def _run_side_by_side(specs: Sequence[str]) -> list[Row]:
    start = time.perf_counter()
    rows: dict[int, Row] = {}
    places: list[int] = []

    def readable() -> Iterator[Spec]:
        for place, text in enumerate(specs):
            try:
                spec = spec_of(text)
            except BadInput as failure:
                rows[place] = _failed(failure)
            else:
                places.append(place)
                yield spec

    for index, result in run_batch(readable(), brief=True):
        rows[places[index]] = _failed(result) if isinstance(result, Exception) else _row(result)
    share = (time.perf_counter() - start) / max(len(specs), 1)
    return [rows[place] | {"wall_s": share} for place in range(len(specs))]


def spec_of(text: str) -> Spec:
    """Return the spec of a run from JSON."""
    return spec_from_mapping(json.loads(text), "run", Path())


def _row(run: Trajectory) -> Row:
    metrics = evaluate_errors(run)
    row = {name: json_document(getattr(metrics, name)) for name in METRICS}
    lost = np.flatnonzero(~np.isfinite(run["force_n"]))
    return row | {"error": f"the force is not finite after {run.time_s[lost[0]]:g} s" if lost.size else None}


def _failed(failure: Exception) -> Row:
    return dict.fromkeys(METRICS) | {"error": f"{type(failure).__name__}: {reason(failure)}"}
