"""Entrants of the public exam: `ehls diagnose` and its peers answer the cases of a folder.

    python -m truth_generator.exam make runs/exam --seed 38001 --cases 40
    python -m benchmarks.diagnosis.entrants runs/exam                # one file of answers for each entrant, beside the cases
    python -m truth_generator.exam score runs/exam runs/exam/*.answers.json

An entrant gets the recording and the rig file of a case, and nothing else. The peers have no verdict `unknown`; here they give
it where the functions of the effects that they name leave more than half of a residual well above the noise. An interrupted run
is resumed.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from benchmarks.common import parser_of
from benchmarks.diagnosis.peers import PEERS, Problem, problem_of
from ehls_ros import __version__
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.rig import Rig
from ehls_ros.recording.load import load
from ehls_ros.trajectory import Trajectory
from truth_generator.scoring import CONFIDENT, MOST_NAMES

Answer = dict[str, Any]

EXCEEDS = 2.0
"""Mean square of a residual, in units of the noise's, above which the peers see an error."""

LEFT = 0.5
"""Part of it that the named functions may leave for the peers to name their effects."""


def ehls(recording: Trajectory, rig: Rig) -> Answer:
    """Answer by `ehls diagnose`; a partial answer without a certain cause is an unknown one."""
    found = diagnose(recording, rig, "case", threads=1)
    sure = any(cause.probability > CONFIDENT for cause in found.causes)
    if found.verdict == "consistent":
        return {"verdict": "consistent"}
    if found.verdict == "effect" or (found.verdict == "partial" and sure):
        causes = [
            {"names": [cause.name, *cause.equivalent_to][:MOST_NAMES], "probability": cause.probability}
            for cause in found.causes
        ]
        return {"verdict": "effect", "causes": causes}
    return {"verdict": "unknown", "stage": found.unknown_stage}


def peer_answer(peer: Callable[[Problem], list[str]], problem: Problem) -> Answer:
    """Answer by a peer."""
    named = peer(problem)
    errors = dict[str, float]()
    for channel, e in problem.residuals.items():
        columns = [t.values[channel] for t in problem.terms if t.effect in named and channel in t.values]
        left = e
        if columns:
            basis = np.column_stack(columns)
            left = e - basis @ np.linalg.lstsq(basis, e, rcond=None)[0]
        before, after = float(np.mean(e**2)), float(np.mean(left**2))
        if before > EXCEEDS and after > max(EXCEEDS, LEFT * before):
            errors[CHANNELS[channel]] = max(errors.get(CHANNELS[channel], 0.0), after)
    if errors:
        return {"verdict": "unknown", "stage": max(errors, key=errors.__getitem__)}
    if not named:
        return {"verdict": "consistent"}
    return {"verdict": "effect", "causes": [{"names": names.split("|")[:MOST_NAMES]} for names in named]}


def main() -> None:
    """Answer all cases."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="folder of the exam")
    parser.add_argument("--entrant", choices=("ehls", "peers"), nargs="+", default=["ehls", "peers"], help="who answers (all)")
    options = parser.parse_args()
    exam = json.loads((options.folder / "exam.json").read_text(encoding="utf-8"))["exam"]
    entrants = {f"ehls diagnose {__version__}": "ehls"} if "ehls" in options.entrant else {}
    entrants |= {name: f"peer_{number}" for number, name in enumerate(PEERS)} if "peers" in options.entrant else {}
    files = {name: options.folder / f"{short}.answers.json" for name, short in entrants.items()}
    answers = {name: _answers(path) for name, path in files.items()}
    for place in track(sorted(options.folder.glob("case_*")), "cases"):
        missing = [name for name in entrants if place.name not in answers[name]]
        if not missing:
            continue
        recording, rig = load(place / "recording.csv"), load_rig(place / "rig.yaml")
        problem = problem_of(recording, rig) if set(missing) & set(PEERS) else None
        for name in missing:
            began = time.perf_counter()
            answer = ehls(recording, rig) if problem is None or name not in PEERS else peer_answer(PEERS[name], problem)
            own = problem.wall_s if problem is not None and name in PEERS else 0.0
            answers[name][place.name] = {**answer, "seconds": round(time.perf_counter() - began + own, 2)}
            content = {"entrant": name, "exam": exam, "answers": answers[name]}
            files[name].write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _answers(path: Path) -> dict[str, Answer]:
    return dict(json.loads(path.read_text(encoding="utf-8"))["answers"]) if path.exists() else {}


if __name__ == "__main__":
    main()
