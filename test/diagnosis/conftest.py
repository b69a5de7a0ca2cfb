"""Shared fixtures of the diagnosis tests: the truth's rig, and a diagnosis of its recordings."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from ehls_ros.diagnosis import stages
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.fit import Worker
from ehls_ros.diagnosis.hypotheses import Candidate, candidates
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import Recording, record

RIG_FILE = Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml"


@pytest.fixture(scope="session")
def rig_file() -> dict[str, Any]:
    """Content of the rig file, in the form that the truth takes."""
    return yaml.safe_load(RIG_FILE.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def rig(rig_file: dict[str, Any]) -> Rig:
    """The rig, in the form that the diagnosis takes."""
    return rig_from_mapping(rig_file, RIG_FILE.name)


@pytest.fixture(scope="session")
def recorded(rig_file: dict[str, Any]) -> Callable[..., Recording]:
    """Record an experiment: hidden effects, its name, then `truth.record`'s keywords."""
    return partial(record, rig_file)


@pytest.fixture(scope="session")
def diagnosed(rig: Rig) -> Callable[..., Diagnosis]:
    """Diagnose a recording, optionally with a model other than the rig file's."""

    def diagnosed(r: Recording, model: Rig = rig) -> Diagnosis:
        return diagnose(Trajectory(r.time, r.columns), model, "case", threads=1)

    return diagnosed


@pytest.fixture(scope="session")
def worker_of(recorded: Callable[..., Recording], rig: Rig) -> Callable[..., tuple[Worker, dict[tuple[str, int], Candidate]]]:
    """Gather the evidence of a recording with hidden effects; return its worker, and the candidates by name and number."""

    def worker_of(
        hidden: dict[str, Any], seed: int = 12, duration: float = 12.0
    ) -> tuple[Worker, dict[tuple[str, int], Candidate]]:
        r = recorded(hidden, "rich", seed=seed, duration=duration)
        kept = prepare(Trajectory(r.time, r.columns), rig, "it")
        found, _ = candidates(kept, rig, [])
        return Worker(gather(kept, rig, stages.setup(kept, rig), 0)), {(c.name, c.number): c for c in found}

    return worker_of
