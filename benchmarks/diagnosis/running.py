"""One case, from its draw to the row of results."""

import time
import traceback
from collections.abc import Mapping
from typing import Any

from benchmarks.diagnosis.cases import Case, healthy_of, recording_of, rig, sources, trajectory_of
from benchmarks.diagnosis.exams import EXAMS
from benchmarks.diagnosis.raw import KINDS
from benchmarks.diagnosis.single_rod import SIGNALS
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.errors import BadInput
from ehls_ros.report.diagnosis_term import phrase


def diagnose_case(case: Case) -> Diagnosis:
    """Diagnose a case with the inputs of its exam: the rig file, and the healthy recordings if any."""
    recording = recording_of(case)
    if case.data in KINDS:
        new = KINDS[case.data].given(recording)
    else:
        new = trajectory_of(SIGNALS[case.data](recording) if case.data else recording)
    if not case.healthy:
        return diagnose(new, rig(case.rig), "case", seed=case.number, threads=1)
    # The other exams run without this module.
    from ehls_ros.experiments.baseline import diagnose_against  # noqa: PLC0415

    baselines = [trajectory_of(recording) for recording in healthy_of(case)]
    return diagnose_against(new, baselines, rig(case.rig), "case", seed=case.number, threads=1)


def run(exam: str, seed: int, number: int, duration: float, with_peers: bool) -> dict[str, Any]:
    """Draw a case and diagnose it, by the peers as well if requested.

    Returns:
        The quantities to be judged, JSON-compatible.
    """
    kind = EXAMS[exam].kind_of(number)
    row: dict[str, Any] = {"exam": exam, "seed": seed, "number": number, "kind": kind, "sources": sources()}
    try:
        case = EXAMS[exam].make(seed, number, duration)
        row |= case.told()
        recording = recording_of(case)
        row |= {key: recording.truth[key] for key in ("natural", "stages", "appears_in", "near", "outside")}
        try:
            row["ours"] = told(diagnose_case(case))
        except BadInput as refusal:
            row["refused"] = str(refusal)
            return row
        if with_peers:
            # Imported only here, as they use internals of the package.
            from benchmarks.diagnosis.peers import PEERS, problem_of  # noqa: PLC0415

            problem = problem_of(trajectory_of(recording), rig())
            for name, peer in PEERS.items():
                began = time.perf_counter()
                named = peer(problem)
                row.setdefault("peers", {})[name] = {"named": named, "wall_s": time.perf_counter() - began + problem.wall_s}
    except Exception:  # noqa: BLE001
        # An exception in one case is a result, and must not end a long run.
        row["error"] = traceback.format_exc(limit=-6)
    return row


def told(d: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis in JSON-compatible form."""
    return {
        "verdict": d.verdict,
        "missing": d.missing,
        "unknown_stage": d.unknown_stage,
        "depends_on": d.depends_on,
        "partial": d.partial,
        "stages": {
            stage: {k: v for k, v in s._asdict().items() if k not in ("why_not", "depends_on")} for stage, s in d.stages.items()
        },
        "causes": [
            {
                "name": c.name,
                "probability": c.probability,
                "equivalent_to": c.equivalent_to,
                "stage": c.stage,
                "side": c.side,
                "parameters": _values(c.parameters),
                "fixed": dict(c.fixed),
                "gain": c.gain,
                "sigmas": c.sigmas,
                "rivals": [
                    {"name": r.name, "behind": r.behind, "closed": r.closed_fraction, "parameters": _values(r.parameters)}
                    for r in c.rivals
                ],
            }
            for c in d.causes
        ],
        "term": None if d.term is None else phrase(d.term),
        "gain": None if d.gain is None else d.gain._asdict(),
        "sensitivities": [[s.name, s.parameter, s.smallest] for s in d.sensitivities],
        "wall_s": d.wall_s,
    }


def _values(parameters: Mapping[str, Any]) -> dict[str, list[float]]:
    return {name: [e.value, e.std] for name, e in parameters.items()}
