"""Diagnosis of a recording, and identification of a whole rig, with the kernels compiled first; without files."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from ehls_ros.diagnosis.carried_over import carried_over
from ehls_ros.diagnosis.contradictions import check_suits
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.record import successive
from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.errors import BadInput
from ehls_ros.experiments.baseline import diagnose_against
from ehls_ros.experiments.compiling import COMPILING, compile_in_parallel, diagnosis_jobs, identification_jobs
from ehls_ros.experiments.consequences import Consequences, consequences
from ehls_ros.experiments.first_draft import is_first_draft, wrong_numbers
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.parallel import Workers
from ehls_ros.physics.rig import Rig
from ehls_ros.progress import Update
from ehls_ros.trajectory import Trajectory

CORE, STEPS = 0.8, 1000
"""Fraction of the time taken by the diagnosis itself; number of progress steps of the whole work."""


class Diagnosed(NamedTuple):
    """A diagnosis and its consequences."""

    found: Diagnosis
    follows: Consequences


def diagnose_recordings(
    recordings: Mapping[str, Trajectory],
    rig: Rig,
    *,
    baselines: Mapping[str, Trajectory],
    seed: int,
    threads: int | None,
    progress: Update,
    checks: Mapping[str, Trajectory] = MappingProxyType({}),
) -> Diagnosed:
    """Find the errors of a rig's model, or the changes since its baselines, and their consequences.

    Args:
        recordings: one recording, or several of the rig in one condition, which are judged together; by name.
        rig: the rig as described in its file.
        baselines: recordings of the healthy rig, by name; none: the recording is judged against the rig file alone.
        seed: seed of the noise added to find the noise floor, and of resampling.
        threads: number of hypotheses tried in parallel; None: one per processor.
        progress: called with the steps done, their total and the current activity.
        checks: other recordings of the rig, to which nothing is fitted: the gain of the extended model on them is found.

    Raises:
        BadInput: a recording does not match the rig, or contradicts the rig file.
    """

    def report(doing: str, part: float) -> None:
        progress(round(CORE * STEPS * part), STEPS, doing)

    trajectory, name = successive(recordings), ", ".join(recordings)
    for called, recording in (dict(recordings) | dict(baselines) | dict(checks)).items():
        check_suits(recording, rig, called)  # before the time-consuming compilation
    with Workers() as workers:
        compile_in_parallel(diagnosis_jobs(rig), workers, lambda done, total: progress(done, total, COMPILING))
        if baselines:
            known = list(baselines.values())
            found = diagnose_against(
                trajectory, known, rig, name, seed=seed, threads=threads, progress=report, names=list(baselines)
            )
        else:
            report("comparing the rig file", 0.0)
            identified = identify_rig(recordings, rig, seed=seed)
            wrong = wrong_numbers(rig, identified)
            draft = is_first_draft(wrong)
            found = diagnose(trajectory, identified.rig if draft else rig, name, seed=seed, threads=threads, progress=report)
            found = replace(found, corrected=wrong) if draft else found
        follows = consequences(
            found,
            trajectory,
            name,
            workers=workers,
            progress=lambda doing, part: progress(round(STEPS * (CORE + (1.0 - CORE) * part)), STEPS, doing),
        )
    changed = checks if found.extended != found.rig else {}
    carried = {called: carried_over(found, recording, called, seed=seed) for called, recording in changed.items()}
    return Diagnosed(found, follows._replace(checks=carried))


def identify_whole_rig(recordings: Mapping[str, Trajectory], rig: Rig, *, seed: int, progress: Update) -> RigIdentification:
    """Identify all identifiable coefficients of a rig, with kernels compiled on all processors.

    Args:
        recordings: recordings by their names in messages.
        rig: the rig as known so far.
        seed: seed of the noise added to find the noise floor.
        progress: called with the steps done, their total and the current activity.

    Raises:
        BadInput: there is no recording, or none of them matches the rig or agrees with its file.
    """
    _check(recordings, rig)
    with Workers() as workers:
        compile_in_parallel(identification_jobs(rig), workers, lambda done, total: progress(done, total, COMPILING))
    return identify_rig(recordings, rig, seed=seed, progress=lambda doing, done, total: progress(done, total, doing))


def _check(recordings: Mapping[str, Trajectory], rig: Rig) -> None:
    """Reject recordings before the compilation if none of them matches the rig; single ones may be left out later."""
    refused = list[BadInput]()
    for name, recording in recordings.items():
        try:
            check_suits(recording, rig, name)
        except BadInput as error:
            refused.append(error)
    if len(refused) == len(recordings):
        raise refused[0]
