"""Hidden cases: the experiment, the hidden effects, and the diagnosis of the recording.

A case depends only on the run's seed and its own number, not on how many cases are run.
"""

import hashlib
import time
import traceback
from collections.abc import Mapping
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import LISTED, OUTSIDE, Recording, draw_effect, record
from truth_generator.visibility import against, background

ROOT = Path(__file__).resolve().parents[2]
RIG = ROOT / "config" / "rig_paper_measured.yaml"
KINDS = ("singles", "pairs", "nothing", "outside")
ORDER = "sopsnsosnspsosnspsop"
"""Kinds of twenty consecutive cases by their first letters: 45 % singles, 20 % pairs, 15 % nothing, 20 % outside the list."""

EXPERIMENTS = {"rich": 0.45, "random": 0.3, "steps": 0.1, "paper_sine": 0.1, "servo": 0.05}
"""Probability of each experiment."""

SHOWS = 1.3
"""Least visibility of an effect in the experiment drawn; below it, size and experiment are drawn again."""

MOST_DRAWS = 40
"""Most draws of size and experiment for one case."""

ONE_BODY = {"hinge_backlash", "flexible_mode"}
"""Effects that the truth generator cannot combine."""


class Case(NamedTuple):
    """One recording to be diagnosed.

    Attributes:
        seed: seed of the run.
        number: number of the case in the run.
        kind: one of :data:`KINDS`.
        experiment: name of the experiment.
        record_seed: seed of the recording.
        duration: duration of the recording [s].
        hidden: sizes by effect.
        visibility: visibility of each effect alone, by stage.
        redrawn: draws that were rejected because an effect would not have shown.
    """

    seed: int
    number: int
    kind: str
    experiment: str
    record_seed: int
    duration: float
    hidden: dict[str, dict[str, Any]]
    visibility: dict[str, dict[str, float]]
    redrawn: int


@cache
def rig_file() -> dict[str, Any]:
    """Return the content of the rig file."""
    content: dict[str, Any] = yaml.safe_load(RIG.read_text(encoding="utf-8"))
    return content


@cache
def rig() -> Rig:
    """Return the rig that the diagnosis is given."""
    return rig_from_mapping(rig_file(), str(RIG))


@cache
def sources() -> str:
    """Return a fingerprint of the sources that diagnose."""
    digest = hashlib.sha256()
    for folder in ("diagnosis", "physics"):
        for path in sorted((ROOT / "ehls_ros" / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def kind_of(number: int) -> str:
    """Return the kind of a case."""
    return {kind[0]: kind for kind in KINDS}[ORDER[number % len(ORDER)]]


def numbers(count: int, only: str | None) -> list[int]:
    """Return the numbers of the first cases, optionally of one kind only."""
    found, number = [], 0
    while len(found) < count:
        if only is None or kind_of(number) == only:
            found.append(number)
        number += 1
    return found


def names_of(seed: int, number: int) -> tuple[str, ...]:
    """Return the effects a case hides: all equally often, in an order given by the seed."""
    kind = kind_of(number)
    if kind == "nothing":
        return ()
    before = sum(kind_of(n) == kind for n in range(number))
    if kind == "pairs":
        fair = [pair for pair in combinations(sorted(LISTED), 2) if set(pair) != ONE_BODY]
        return fair[int(np.random.default_rng([seed, number, 7]).integers(len(fair)))]
    pool = sorted(LISTED if kind == "singles" else OUTSIDE)
    turn, place = divmod(before, len(pool))
    order = np.random.default_rng([seed, turn, KINDS.index(kind)]).permutation(len(pool))
    return (pool[int(order[place])],)


def make(seed: int, number: int, duration: float) -> Case:
    """Draw a case."""
    rng = np.random.default_rng([seed, number])
    names = names_of(seed, number)
    redrawn = 0
    while True:
        experiment = str(rng.choice(list(EXPERIMENTS), p=list(EXPERIMENTS.values())))
        if "coupling_stiffness" in names:
            experiment = "servo"
        record_seed = int(rng.integers(2**31))
        hidden = {name: draw_effect(name, rng, rig_file()) for name in names}
        seen: dict[str, dict[str, float]] = {}
        if hidden:
            without = background(rig_file(), experiment, seed=record_seed, duration=duration)
        for name, sizes in hidden.items():
            alone = record(rig_file(), {name: sizes}, experiment, seed=record_seed, duration=duration, noise=0.0)
            seen[name] = {stage: round(value, 3) for stage, value in against(without, rig_file(), alone).items()}
        if all(max(stages.values()) >= SHOWS for stages in seen.values()) or redrawn >= MOST_DRAWS:
            return Case(seed, number, kind_of(number), experiment, record_seed, duration, hidden, seen, redrawn)
        redrawn += 1


def recording_of(case: Case) -> Recording:
    """Return a case's recording."""
    return record(rig_file(), case.hidden, case.experiment, seed=case.record_seed, duration=case.duration)


def run(seed: int, number: int, duration: float, with_peers: bool) -> dict[str, Any]:
    """Draw a case and diagnose it, by the peers as well if requested.

    Returns:
        What is judged, ready for JSON.
    """
    row: dict[str, Any] = {"seed": seed, "number": number, "kind": kind_of(number), "sources": sources()}
    try:
        case = make(seed, number, duration)
        row |= case._asdict()
        recording = recording_of(case)
        row |= {key: recording.truth[key] for key in ("natural", "stages", "appears_in", "near", "outside")}
        trajectory = Trajectory(recording.time, recording.columns)
        row["ours"] = told(diagnose(trajectory, rig(), "case", seed=number, threads=1))
        if with_peers:
            # Imported only here, as they use internals of the package.
            from benchmarks.diagnosis.peers import PEERS, problem_of  # noqa: PLC0415

            problem = problem_of(trajectory, rig())
            for name, peer in PEERS.items():
                began = time.perf_counter()
                named = peer(problem)
                row.setdefault("peers", {})[name] = {"named": named, "wall_s": time.perf_counter() - began + problem.wall_s}
    except Exception:  # noqa: BLE001
        # An exception in one case is a result, and must not end a long run.
        row["error"] = traceback.format_exc(limit=-6)
    return row


def told(d: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis ready for JSON."""
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
        "gain": None if d.gain is None else d.gain._asdict(),
        "wall_s": d.wall_s,
    }


def _values(parameters: Mapping[str, Any]) -> dict[str, list[float]]:
    return {name: [e.value, e.std] for name, e in parameters.items()}
