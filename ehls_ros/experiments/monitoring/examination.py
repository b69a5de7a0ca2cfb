"""Examination of a change: diagnosis of the samples since its onset, in this process or in a separate one."""

import multiprocessing
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from typing import NamedTuple, Protocol

from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.result import NAMING, Cause, Diagnosis, Rival, Verdict
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.baseline import diagnose_against
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Form
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.process import end_with, give_way
from ehls_ros.trajectory import Trajectory

MIN_CERTAIN_PROBABILITY = 0.9
"""Minimum probability of the first cause, with its equivalents, for naming it at once, however few the samples."""


class Task(NamedTuple):
    """A diagnosis task.

    Attributes:
        recording: the samples.
        rig: the model for comparison.
        baselines: recordings of the healthy rig; none: the samples are judged against the rig file.
        preferred: effects to be preferred to equivalent ones, in order of preference.
    """

    recording: Trajectory
    rig: Rig
    baselines: tuple[Trajectory, ...] = ()
    preferred: tuple[str, ...] = ()


class FoundCause(NamedTuple):
    """A cause named by a diagnosis; attributes as in :class:`ehls_ros.diagnosis.result.Cause`."""

    name: str
    stage: str
    probability: float
    equivalent_to: tuple[str, ...]
    parameters: Mapping[str, Estimate]


class Finding(NamedTuple):
    """Result of a diagnosis.

    Attributes:
        verdict: verdict of the diagnosis.
        causes: the causes, best first.
        rig: the model with these causes.
        unknown_stage: stage of an error that no effect of the list explains.
        depends_on: signals on which that error depends.
        reason: reason if the verdict is ``insufficient``; otherwise empty.
        wall_s: wall time [s].
    """

    verdict: Verdict
    causes: tuple[FoundCause, ...]
    rig: Rig
    unknown_stage: str = ""
    depends_on: tuple[str, ...] = ()
    reason: str = ""
    wall_s: float = 0.0

    @property
    def is_certain(self) -> bool:
        """Whether the first cause, or an equivalent one, is practically certain."""
        return (
            self.names_causes
            and self.causes[0].probability * (1 + len(self.causes[0].equivalent_to)) >= MIN_CERTAIN_PROBABILITY
        )

    @property
    def names_causes(self) -> bool:
        """Whether the verdict names causes."""
        return self.verdict in NAMING and bool(self.causes)


def examine(task: Task) -> Finding:
    """Diagnose a recording; return the verdict ``insufficient``, with the reason, if it cannot be judged."""
    try:
        if task.baselines:
            found = diagnose_against(task.recording, task.baselines, task.rig, "the latest samples", threads=1)
        else:
            found = diagnose(task.recording, task.rig, "the latest samples", threads=1)
    except BadInput as error:
        return Finding("insufficient", (), task.rig, reason=str(error))
    return _finding(found, task.preferred)


def _finding(found: Diagnosis, preferred: Sequence[str]) -> Finding:
    causes, rig = list[FoundCause](), found.extended
    for cause in found.causes:
        named = FoundCause(cause.name, cause.stage, cause.probability, cause.equivalent_to, dict(cause.parameters))
        other = _preferred(cause, preferred, found.rig)
        if other is not None:
            equivalent = tuple(name for name in (cause.name, *cause.equivalent_to) if name != other.name)
            named = named._replace(name=other.name, equivalent_to=equivalent, parameters=dict(other.parameters))
            rig = _with_effect_replaced(rig, cause.name, other)
        causes.append(named)
    return Finding(
        found.verdict,
        tuple(causes),
        rig,
        found.unknown_stage or "",
        found.depends_on,
        "; ".join(found.missing) if found.verdict == "insufficient" else "",
        found.wall_s,
    )


def _preferred(cause: Cause, preferred: Sequence[str], rig: Rig) -> Rival | None:
    """Return the most preferred effect equivalent to a cause; None if it is the cause itself or there is none.

    This keeps the name of a change from alternating between diagnoses.
    """
    rivals = {rival.name: rival for rival in cause.rivals if rival.name in cause.equivalent_to}
    for name in preferred:
        if name == cause.name:
            return None
        if name in rivals and any(set(form.free) == set(rivals[name].parameters) for form in _plain_forms(name, rig)):
            return rivals[name]
    return None


def _plain_forms(name: str, rig: Rig) -> list[Form]:
    """Return the forms of an effect without fixed parameters, so that all are fitted or neutral."""
    return [form for form in EFFECTS.load(name).forms(rig) if not form.fixed]


def _with_effect_replaced(rig: Rig, name: str, other: Rival) -> Rig:
    """Return a rig with one effect replaced by another."""
    values = {parameter: value.value for parameter, value in other.parameters.items()}
    use = EffectUse(other.name, EFFECTS.load(other.name).Parameters(**values))
    return rig._replace(effects=tuple(use if old.name == name else old for old in rig.effects))


class Examiner(Protocol):
    """Interface of an executor of diagnoses."""

    def begin(self, task: Task) -> None:
        """Start a diagnosis; only one runs at a time."""

    def finding(self) -> Finding | None:
        """Return an available result, once; otherwise None."""

    def close(self) -> None:
        """Abort a running diagnosis."""


class SynchronousExaminer:
    """Synchronous examiner in this process."""

    def __init__(self) -> None:
        """Start without a result."""
        self._found: Finding | None = None

    def begin(self, task: Task) -> None:
        """Diagnose synchronously."""
        self._found = examine(task)

    def finding(self) -> Finding | None:
        """Return the result, once."""
        found, self._found = self._found, None
        return found

    def close(self) -> None:
        """Do nothing, as no diagnosis is running."""


def _initialise_worker(parent: int) -> None:
    """Initialise the diagnosing process: low priority, and end together with the monitor."""
    end_with(parent)
    give_way()


class ProcessExaminer:
    """Examiner in a separate process of low priority."""

    def __init__(self) -> None:
        """Start no process before the first diagnosis."""
        self._workers: ProcessPoolExecutor | None = None
        self._future: Future[Finding] | None = None

    def begin(self, task: Task) -> None:
        """Start a diagnosis."""
        if self._workers is None:
            self._workers = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _initialise_worker, (os.getpid(),))
        self._future = self._workers.submit(examine, task)

    def finding(self) -> Finding | None:
        """Return an available result, once; otherwise None.

        Raises:
            RuntimeError: the diagnosis failed, for example by a kill of its process; the next one starts another process.
        """
        if self._future is None or not self._future.done():
            return None
        done, self._future = self._future, None
        failure = done.exception()
        if failure is None:
            return done.result()
        self.close()
        raise RuntimeError(f"the diagnosis failed: {failure}") from failure

    def close(self) -> None:
        """End the process."""
        if self._workers is not None:
            self._workers.shutdown(wait=False, cancel_futures=True)
            for process in list((self._workers._processes or {}).values()):  # noqa: SLF001
                process.terminate()
        self._workers, self._future = None, None
