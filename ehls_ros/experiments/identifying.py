"""Identification of a whole rig from recordings: the work of `ehls identify --whole-rig`, without files."""

from collections.abc import Mapping

from ehls_ros.diagnosis.contradictions import check_suits
from ehls_ros.errors import BadInput
from ehls_ros.experiments.compiling import COMPILING, compile_in_parallel, identification_jobs
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.parallel import Workers
from ehls_ros.physics.rig import Rig
from ehls_ros.progress import Update
from ehls_ros.trajectory import Trajectory


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
