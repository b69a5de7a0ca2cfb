"""What changed since a rig was well: a recording judged against earlier ones of the same rig."""

import time
from collections.abc import Sequence
from dataclasses import replace

from ehls_ros.diagnosis.coefficients import refit
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.natural import learn_natural
from ehls_ros.diagnosis.pool import Progress
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.diagnosis.stages import setup
from ehls_ros.errors import BadInput
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

LEARNING = 0.35
"""Fraction of the work that learning the baselines takes."""


def diagnose_against(
    new: Trajectory,
    baselines: Sequence[Trajectory],
    rig: Rig,
    name: str,
    *,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = lambda doing, part: None,
) -> Diagnosis:
    """Find what changed on a rig since its baselines were recorded.

    Args:
        new: the recording to be judged.
        baselines: recordings from when the rig was well.
        rig: the rig as its file describes it.
        name: name of the new recording in errors.
        seed: of the noise added to find the noise floor, and of resampling.
        threads: hypotheses tried at once; by default one for each processor.
        progress: called with what is being done and the fraction of the work that is done.

    Returns:
        The diagnosis; ``consistent`` means that nothing has changed.

    Raises:
        BadInput: there is no baseline, or a recording cannot be read as one of such a rig.
    """
    began = time.perf_counter()
    if not baselines:
        raise BadInput("no baseline is given", name, "at least one recording of the rig from when it was well")
    names = tuple(f"baseline {i}" for i in range(1, len(baselines) + 1))
    progress("learning the baselines", 0.0)
    healthy = tuple(_evidence(recording, rig, called, seed) for recording, called in zip(baselines, names, strict=True))
    rig = refit(healthy)
    healthy = tuple(_evidence(recording, rig, called, seed) for recording, called in zip(baselines, names, strict=True))
    natural = learn_natural(healthy)
    found = diagnose(
        new,
        rig,
        name,
        seed=seed,
        threads=threads,
        progress=lambda doing, part: progress(doing, LEARNING + (1.0 - LEARNING) * part),
        judge=natural.judged,
    )
    return replace(found, wall_s=time.perf_counter() - began)


def _evidence(recording: Trajectory, rig: Rig, name: str, seed: int) -> Evidence:
    record = prepare(recording, rig, name)
    return gather(record, rig, setup(record, rig), seed)
