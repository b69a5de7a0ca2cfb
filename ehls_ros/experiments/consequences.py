"""Consequences of a diagnosis: a free run of both models, the benefit to the controller, the next experiment.

The verdict is not changed here. A failure becomes a remark, and the diagnosis remains valid.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import NamedTuple, TypeVar

from ehls_ros.diagnosis.free_run import FreeRun, free_run
from ehls_ros.diagnosis.hypotheses import grown
from ehls_ros.diagnosis.result import Cause, ChannelGain, Diagnosis, Rival
from ehls_ros.diagnosis.stages import SENSED as RECORDED_AS
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.errors import BadInput
from ehls_ros.experiments.compiling import COMPILING, compile_in_parallel, consequences_jobs
from ehls_ros.experiments.controller_benefit import ControllerBenefit, controller_benefit
from ehls_ros.experiments.next_experiment import NextExperiment, Proposal, next_experiment
from ehls_ros.parallel import Workers
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EffectUse, Rig, unknown_keys
from ehls_ros.trajectory import Trajectory

EXCLUSIVE_PROBABILITY = 0.9
"""Probability of a cause above which its rivals are ruled out."""

CLOSE = 10.0
"""Deficit below which a rival remains open, for a cause less probable than :data:`EXCLUSIVE_PROBABILITY` [nats]."""

MAX_RIVALS = 2
"""Largest number of rivals that the next experiment has to separate from a cause."""

MIN_STD, MAX_STD = 0.01, 0.3
"""Limits on the assumed uncertainty of the candidates' parameters, as a fraction of their values."""

Progress = Callable[[str, float], None]
"""Function called with the current step and the completed fraction of all steps."""

Made = TypeVar("Made")


class Consequences(NamedTuple):
    """Consequences of a diagnosis.

    Attributes:
        free_run: free run of both models along the recording; None if it could not be simulated.
        controller: benefit of the extended model to the controller; None unless an effect was named.
        proposal: search for the next experiment; None unless two causes are open.
        remarks: reasons for missing results.
        checks: gain of the extended model on other recordings, by their names and by channel.
    """

    free_run: FreeRun | None
    controller: ControllerBenefit | None
    proposal: Proposal | None
    remarks: tuple[str, ...] = ()
    checks: Mapping[str, Mapping[Channel, ChannelGain]] = {}

    @property
    def next_experiment(self) -> NextExperiment | None:
        """The proposed experiment; None if there is none."""
        return None if self.proposal is None else self.proposal.experiment

    @property
    def no_experiment(self) -> str:
        """Reason why no experiment is proposed although causes are open; otherwise empty."""
        return "" if self.proposal is None or self.proposal.experiment is not None else self.proposal.reason

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """The remarks, with the reason why no experiment is proposed."""
        return (*self.remarks, f"no next experiment: {self.no_experiment}") if self.no_experiment else self.remarks


NOTHING = Consequences(None, None, None)
"""No consequences, or none computed."""


def consequences(
    diagnosis: Diagnosis,
    trajectory: Trajectory,
    name: str,
    *,
    workers: Workers | None = None,
    progress: Progress = lambda step, fraction: None,
) -> Consequences:
    """Compute the consequences of a diagnosis.

    Args:
        diagnosis: the diagnosis.
        trajectory: the recording on which it is based.
        name: name of the recording in errors.
        workers: processes to compile in; by default each kernel is compiled when it is run.
        progress: called with the current step and the completed fraction.

    Returns:
        The results, with the reasons for any that are missing.
    """
    if lacking := unknown_keys(diagnosis.rig):
        return NOTHING._replace(remarks=(f"nothing is simulated: the rig file has no {', '.join(lacking)}",))
    remarks: list[str] = []
    run = controller = proposal = None
    if diagnosis.verdict != "insufficient":
        if workers is not None:
            _compiled(diagnosis, workers, progress)
        progress("simulating a free run", 0.0)
        run = _tried("free run", remarks, lambda: free_run(trajectory, diagnosis.rig, diagnosis.extended, name))
    if diagnosis.names_causes:
        progress("running the controller on the extended plant", 0.3)
        controller = _tried("run of the controller", remarks, lambda: controller_benefit(diagnosis.rig, diagnosis.extended))
    if diagnosis.names_causes or diagnosis.term is not None:
        candidates = _tried("next experiment", remarks, lambda: open_candidates(diagnosis)) or {}
        if len(candidates) > 1:
            progress("looking for the next experiment", 0.5)
            signals = tuple(sensor for sensor, signal in RECORDED_AS.items() if signal in trajectory)
            std = parameter_std(diagnosis)

            def looked_for(done: int, total: int) -> None:
                progress("looking for the next experiment", 0.5 + 0.5 * done / total)

            proposal = _tried(
                "next experiment",
                remarks,
                lambda: next_experiment(
                    candidates, nominal=diagnosis.rig, signals=signals, parameter_std=std, progress=looked_for
                ),
            )
    return Consequences(run, controller, proposal, tuple(remarks))


def _compiled(diagnosis: Diagnosis, workers: Workers, progress: Progress) -> None:
    # A kernel that cannot be compiled cannot be run either, and the run reports it.
    with suppress(Exception):
        compile_in_parallel(consequences_jobs(diagnosis), workers, lambda *_: progress(COMPILING, 0.0))


def _tried(what: str, remarks: list[str], make: Callable[[], Made]) -> Made | None:
    try:
        return make()
    except BadInput as error:
        remarks.append(f"no {what}: {error.what}")
        return None
    except Exception as error:  # noqa: BLE001 - no failure here invalidates the diagnosis
        remarks.append(f"no {what}: it failed ({type(error).__name__}: {error})")
        return None


def open_rivals(cause: Cause) -> tuple[Rival, ...]:
    """Return the rivals of a cause that the data do not rule out, closest first."""
    close = CLOSE if cause.probability < EXCLUSIVE_PROBABILITY else 0.0
    rivals = [rival for rival in cause.rivals if rival.name in cause.equivalent_to or rival.behind < close]
    return tuple(rivals[:MAX_RIVALS])


def open_candidates(diagnosis: Diagnosis) -> dict[str, Rig]:
    """Return the extended rigs that the next experiment has to separate, by the names of causes or terms.

    They are those of the least probable cause with open rivals, or of a term and of others that explain as much.
    """
    if diagnosis.term is not None:
        return {diagnosis.term.effect: diagnosis.extended, **dict(list(diagnosis.term_rivals.items())[:MAX_RIVALS])}
    for cause in sorted(diagnosis.causes, key=lambda cause: cause.probability):
        rivals = open_rivals(cause)
        if rivals:
            before = [use for use in diagnosis.rig.effects if use.name == cause.name]
            others = [use for use in diagnosis.extended.effects if use.name != cause.name]
            without = diagnosis.extended._replace(effects=(*before, *others))
            return {cause.name: diagnosis.extended} | {
                rival.name: grown(without, _use(rival, diagnosis.rig)) for rival in rivals
            }
    return {}


def _use(rival: Rival, rig: Rig) -> EffectUse:
    """Return a rival as an active effect, with its fitted values and those fixed by its form."""
    effect = EFFECTS.load(rival.name)
    fixed: Mapping[str, float] = next((form.fixed for form in effect.forms(rig) if set(form.free) == set(rival.parameters)), {})
    return EffectUse(rival.name, effect.Parameters(**fixed, **{n: e.value for n, e in rival.parameters.items()}))


def parameter_std(diagnosis: Diagnosis) -> float:
    """Return the largest relative standard error among the parameters of the named causes."""
    errors = [e.std / abs(e.value) for cause in diagnosis.causes for e in cause.parameters.values() if e.value != 0.0]
    worst = max(filter(math.isfinite, errors), default=MAX_STD)
    return min(max(worst, MIN_STD), MAX_STD)
