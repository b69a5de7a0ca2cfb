"""What a worker does: specs in, rows of metrics out."""

import hashlib
import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros import __version__
from ehls_ros.errors import WorkFailed
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.recording.reason import reason
from ehls_ros.sources import sources_digest

METRICS = ("max_error_n", "rms_error_n", "convergence_s", "cycles", "missed_cycles", "duration_s", "wall_s")
"""Columns of a row, as ``metrics.json`` names them; ``error`` follows."""

Row = dict[str, Any]

_ONE_AT_A_TIME = threading.Lock()
"""Threads of one worker must not import the same new kernel at once; kernels hold the interpreter lock anyway."""


def code_version() -> str:
    """Return the package's version with a digest of the sources that determine a run's numbers."""
    digest = sources_digest("physics", "control", "experiments", "arrays.py", "duals", "inlining.py")
    return f"{__version__}+{digest[:12]}"


def run_digest(spec: str) -> str:
    """Return the key of a run: equal for equal specs under equal code, in any campaign.

    Args:
        spec: the spec as JSON, everything it names written out.
    """
    return hashlib.sha256(f"{code_version()} {spec}".encode()).hexdigest()[:32]


def run_chunk(specs: Sequence[str], version: str) -> list[Row]:
    """Run experiments one after another.

    Args:
        specs: the specs as JSON.
        version: code version of the caller.

    Returns:
        One row per spec.

    Raises:
        WorkFailed: this process has other code than the caller.
    """
    if code_version() != version:
        raise WorkFailed(
            f"a worker has ehls_ros {code_version()} where {version} is asked for: install the same on every worker"
        )
    with _ONE_AT_A_TIME:
        return [run_one(spec) for spec in specs]


def run_one(spec: str) -> Row:
    """Run one experiment.

    Args:
        spec: the spec as JSON.

    Returns:
        Its metrics, and ``error``: the reason why the run failed, or None.
    """
    start = time.perf_counter()
    try:
        run = run_in_process(spec_from_mapping(json.loads(spec), "run", Path()))
        row = {name: value for name, value in json_document(evaluate(run)).items() if name in METRICS}
        lost = np.flatnonzero(~np.isfinite(run["force_n"]))
        error = f"the force is not finite after {run.time_s[lost[0]]:g} s" if lost.size else None
    except Exception as failure:  # noqa: BLE001 - a failure is the result of this run, and the others continue
        row, error = dict.fromkeys(METRICS), f"{type(failure).__name__}: {reason(failure)}"
    return row | {"wall_s": time.perf_counter() - start, "error": error}
