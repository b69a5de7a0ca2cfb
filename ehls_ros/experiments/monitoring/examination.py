"""Identification of the rig, and diagnosis of the samples since the onset of a change, in this process or in a separate one."""

import multiprocessing
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from typing import NamedTuple, Protocol

from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.hypotheses import grown
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Tracked
from ehls_ros.diagnosis.result import NAMING, Cause, Diagnosis, Rival, Verdict
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.baseline import diagnose_against
from ehls_ros.experiments.monitoring.identified import Identification, identify
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Form
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.process import end_with, give_way
from ehls_ros.trajectory import Trajectory

MIN_CERTAIN_PROBABILITY = 0.9
"""Minimum probability of the first cause, with its equivalents, for naming it at once, however few the samples."""


MAX_CHANGED = 2
"""Number of wrong numbers of a rig file up to which the rig, not the file, is rather taken to have changed."""


class Task(NamedTuple):
    """A task: an identification, a diagnosis, or both.

    Attributes:
        recording: the samples to diagnose; None: no diagnosis.
        rig: the model for comparison, and the first guess of an identification.
        baselines: recordings of the healthy rig; none: the samples are judged against the rig file.
        preferred: effects to be preferred to equivalent ones, in order of preference.
        identify: recordings from which the rig is identified, by name; none: no identification.
        identified: the rig identified from the baselines, if that is known.
    """

    recording: Trajectory | None
    rig: Rig
    baselines: tuple[Trajectory, ...] = ()
    preferred: tuple[str, ...] = ()
    identify: Mapping[str, Trajectory] = {}
    identified: Identification | None = None

    @property
    def length(self) -> float:
        """Length of the recording or recordings [s]."""
        parts = [*self.identify.values()] if self.recording is None else [self.recording]
        return sum(float(part.time_s[-1] - part.time_s[0]) for part in parts)


class FoundCause(NamedTuple):
    """A cause named by a diagnosis; attributes as in :class:`ehls_ros.diagnosis.result.Cause`."""

    name: str
    stage: str
    probability: float
    equivalent_to: tuple[str, ...]
    parameters: Mapping[str, Estimate]


class Finding(NamedTuple):
    """Result of a task.

    Attributes:
        verdict: verdict of the diagnosis; ``insufficient`` without one.
        causes: the causes, best first.
        rig: the model with these causes.
        unknown_stage: stage of an error that no effect of the list explains.
        depends_on: signals on which that error depends.
        reason: reason if the verdict is ``insufficient``; otherwise empty.
        wall_s: wall time [s].
        identification: the identified rig; None without an identification, or if the recordings allow none.
    """

    verdict: Verdict
    causes: tuple[FoundCause, ...]
    rig: Rig
    unknown_stage: str = ""
    depends_on: tuple[str, ...] = ()
    reason: str = ""
    wall_s: float = 0.0
    identification: Identification | None = None

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
    """Carry out a task; return the verdict ``insufficient``, with the reason, if a recording cannot be judged.

    If numbers of the rig file are wrong, the identified rig is diagnosed. If it leaves an error, its numbers may have been
    fitted to an effect; the rig file is right if it explains the recording with effects alone. One or two wrong numbers are
    rather changes of the rig than a draft of its file.

    A diagnosis without a previous identification is followed by one with its causes, which gives their sizes.
    """
    if not task.identify and task.recording is not None:
        return _sized(_diagnosed(task, task.recording), task, task.recording)
    identification = identify(task.identify, task.rig)
    if task.recording is None:
        return Finding("insufficient", (), task.rig, identification=identification)
    if identification is not None and identification.wrong:
        identified = _diagnosed(task._replace(rig=identification.rig), task.recording)
        if len(identification.wrong) <= MAX_CHANGED or identified.verdict not in ("consistent", "insufficient"):
            given = _diagnosed(task, task.recording)
            if given.verdict == "effect" and given.names_causes:
                return given._replace(identification=identification._replace(wrong={}))
        return identified._replace(identification=identification)
    return _diagnosed(task, task.recording)._replace(identification=identification)


def _sized(found: Finding, task: Task, recording: Trajectory) -> Finding:
    """Return a result with the sizes of its causes identified jointly with all coefficients of the rig.

    Args:
        found: the result of a diagnosis.
        task: the task, with the rig without the causes.
        recording: the diagnosed samples.
    """
    identification = identify({"the latest samples": recording}, found.rig) if found.names_causes else None
    if identification is None:
        return found
    errors = {} if task.identified is None else task.identified.errors()
    known, rig, causes = identification.readings(), found.rig, list[FoundCause]()
    names = {(t.effect, t.parameter): name for name, t in COEFFICIENTS.items()}
    for cause in found.causes:
        sizes = dict(cause.parameters)
        for parameter in sizes:
            name = names.get((cause.name, parameter), "")
            if name in known:
                tracked = COEFFICIENTS[name]
                sizes[parameter] = tracked.change(tracked.given(task.rig), known[name], errors.get(name, 0.0))
                rig = _with_total(rig, tracked, known[name].value)
        causes.append(cause._replace(parameters=sizes))
    return found._replace(causes=tuple(causes), rig=rig, identification=identification)


def _with_total(rig: Rig, tracked: Tracked, value: float) -> Rig:
    """Return a rig with the value of a coefficient set by the last use of its effect."""
    moved = tracked.change(tracked.given(rig), Estimate(value, 0.0, "")).value
    effects = list(rig.effects)
    place = max(i for i, use in enumerate(effects) if use.name == tracked.effect)
    now = getattr(effects[place].parameters, tracked.parameter)
    total = now * moved if tracked.relative else now + moved
    effects[place] = EffectUse(tracked.effect, effects[place].parameters._replace(**{tracked.parameter: total}))
    return rig._replace(effects=tuple(effects))


def _diagnosed(task: Task, recording: Trajectory) -> Finding:
    try:
        if task.baselines:
            identified = None if task.identified is None else task.identified.whole
            found = diagnose_against(
                recording, task.baselines, task.rig, "the latest samples", threads=1, identified=identified
            )
        else:
            found = diagnose(recording, task.rig, "the latest samples", threads=1)
    except BadInput as error:
        return Finding("insufficient", (), task.rig, reason=str(error))
    return _finding(found, task)


def _finding(found: Diagnosis, task: Task) -> Finding:
    """Return the result of a diagnosis, with its causes in the task's rig."""
    causes, rig = list[FoundCause](), task.rig
    for cause in found.causes:
        named = FoundCause(cause.name, cause.stage, cause.probability, cause.equivalent_to, dict(cause.parameters))
        other, fixed = _preferred(cause, task.preferred, found.rig), cause.fixed
        if other is not None:
            equivalent = tuple(name for name in (cause.name, *cause.equivalent_to) if name != other.name)
            named = named._replace(name=other.name, equivalent_to=equivalent, parameters=dict(other.parameters))
            fixed = {}
        causes.append(named)
        values = {parameter: size.value for parameter, size in named.parameters.items()}
        rig = grown(rig, EffectUse(named.name, EFFECTS.load(named.name).Parameters(**fixed, **values)))
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


class Examiner(Protocol):
    """Interface of an executor of tasks."""

    def begin(self, task: Task) -> None:
        """Start a task; only one runs at a time."""

    def finding(self) -> Finding | None:
        """Return an available result, once; otherwise None."""

    def close(self) -> None:
        """Abort a running task."""


class SynchronousExaminer:
    """Synchronous examiner in this process."""

    def __init__(self) -> None:
        """Start without a result."""
        self._found: Finding | None = None

    def begin(self, task: Task) -> None:
        """Carry out a task synchronously."""
        self._found = examine(task)

    def finding(self) -> Finding | None:
        """Return the result, once."""
        found, self._found = self._found, None
        return found

    def close(self) -> None:
        """Do nothing, as no task is running."""


def _initialise_worker(parent: int) -> None:
    """Initialise the diagnosing process: low priority, and end together with the monitor."""
    end_with(parent)
    give_way()


class ProcessExaminer:
    """Examiner in a separate process of low priority."""

    def __init__(self) -> None:
        """Start no process before the first task."""
        self._workers: ProcessPoolExecutor | None = None
        self._future: Future[Finding] | None = None

    def begin(self, task: Task) -> None:
        """Start a task."""
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
