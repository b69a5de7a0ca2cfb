"""Tuning of the peers' thresholds, on seeds that no benchmark uses."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.diagnosis import cases, exams
from benchmarks.diagnosis.judge import peer_right
from benchmarks.diagnosis.peers import WITH_PYSINDY, Path, Problem, bic, paths, problem_of, stlsq
from benchmarks.rows import Row
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.trajectory import Trajectory

SEED, CASES = 990_001, 60

PENALTIES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
DEVIATIONS = (0.0, 1.0, 2.0, 4.0)
LEAST = (0.0, 0.02, 0.05, 0.1, 0.2)


def tune(console: Console) -> None:
    """Print the peers' results for all thresholds, without effects outside the list, which they cannot name."""
    problems: list[tuple[Row, Problem, dict[Channel, Path]]] = []
    numbers = [n for n in exams.numbers("clean", 2 * CASES, None) if cases.kind_of(n) != "outside"][:CASES]
    for number in track(numbers, "recordings", console=console):
        case = cases.make(SEED, number, 60.0)
        recording = cases.recording_of(case)
        problem = problem_of(Trajectory(recording.time, recording.columns), cases.rig())
        problems.append((case._asdict(), problem, paths(problem) if WITH_PYSINDY else {}))
    settings: list[tuple[str, Any]] = [
        (f"BIC, penalty {p:g} log n", lambda problem, _, p=p: bic(problem, p)) for p in PENALTIES
    ]
    if WITH_PYSINDY:
        settings += [
            (f"STLSQ, {d:g} deviations, {le:g} explained", lambda problem, tried, d=d, le=le: stlsq(problem, tried, d, le))
            for d in DEVIATIONS
            for le in LEAST
        ]
    table = Table(title=f"seed {SEED}, {len(problems)} cases")
    for column in ("", "singles", "pairs", "nothing: consistent", "mean of the three"):
        table.add_column(column)
    for label, peer in settings:
        right = {
            kind: [peer_right(row, peer(p, tried)) for row, p, tried in problems if row["kind"] == kind]
            for kind in cases.KINDS[:3]
        }
        shares = [float(np.mean(values)) for values in right.values()]
        table.add_row(label, *(f"{100 * s:.0f} %" for s in shares), f"{100 * np.mean(shares):.1f} %")
    console.print(table)
