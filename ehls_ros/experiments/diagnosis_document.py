"""``diagnosis.json``: its schema as frozen records, and their creation from a diagnosis and its consequences.

The field names are the keys. A record of :mod:`ehls_ros.diagnosis.result` that is written unchanged appears under its own name.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

from ehls_ros import __version__
from ehls_ros.diagnosis.causes import advice
from ehls_ros.diagnosis.free_run import FreeRun
from ehls_ros.diagnosis.result import (
    Cause,
    ChannelGain,
    Coverage,
    Diagnosis,
    Fitted,
    Healthy,
    Sensitivity,
    StageResult,
    Term,
    Verdict,
)
from ehls_ros.diagnosis.stages import Channel, Stage
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.consequences import Consequences
from ehls_ros.experiments.controller_benefit import ControllerBenefit
from ehls_ros.experiments.next_experiment import NextExperiment
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Side
from ehls_ros.physics.rig import Rig

NORMAL_95 = 1.959964
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""


class RivalEntry(NamedTuple):
    """An alternative effect in place of a cause.

    Attributes:
        name: name of the effect.
        behind_nats: deficit against the cause on held-out data [nats].
        closed_fraction: fraction of the removable error that it explains.
        parameters: its best fit.
    """

    name: str
    behind_nats: float
    closed_fraction: float
    parameters: Mapping[str, Estimate]


class Evidence(NamedTuple):
    """Evidence for a cause.

    Attributes:
        gain_nats: gain on held-out data [nats].
        standard_errors_from_neutral: distance from neutral of its most significant parameter, in standard errors.
        equation: change of the model equation by the effect.
        rivals: other effects in its place, best first.
    """

    gain_nats: float
    standard_errors_from_neutral: float
    equation: str
    rivals: tuple[RivalEntry, ...]


class ParameterEntry(NamedTuple):
    """A parameter of a cause.

    Attributes:
        value: fitted value.
        std: standard error.
        unit: unit of both.
        ci95: 95 % interval, of a normal distribution.
    """

    value: float
    std: float
    unit: str
    ci95: tuple[float, float]


class Advice(NamedTuple):
    """Recommended actions for a cause; attributes as in :class:`ehls_ros.physics.effects.base.Words`."""

    inspect: str
    measure: str
    change: str


class CauseEntry(NamedTuple):
    """A named cause; attributes as in :class:`ehls_ros.diagnosis.result.Cause`."""

    name: str
    probability: float
    share: float | None
    channel: Channel
    equivalent_to: tuple[str, ...]
    stage: Stage
    group: str
    parameters: Mapping[str, ParameterEntry]
    fixed: Mapping[str, float]
    evidence: Evidence
    advice: Advice
    side: Side | None


class UnknownEvidence(NamedTuple):
    """Evidence on an error that no effect explains.

    Attributes:
        depends_on: signals that predict it, strongest first.
        partial: effects that explain a fraction of it.
        nrmse: residual with those effects in the model.
        noise_floor: residual of noise alone.
    """

    depends_on: tuple[str, ...]
    partial: tuple[str, ...]
    nrmse: float | None
    noise_floor: float | None


class UnknownEntry(NamedTuple):
    """Entry in the list of causes for an error that no effect describes."""

    name: Literal["unknown"]
    probability: float
    equivalent_to: tuple[str, ...]
    stage: Stage
    parameters: Mapping[str, Estimate]
    evidence: UnknownEvidence


class RemainderEntry(NamedTuple):
    """Remaining residual of a stage with all named causes in the model.

    Attributes:
        nrmse: rms on held-out data, as a fraction of the stage's largest term.
        noise_floor: the same for noise alone.
        depends_on: signals that predict it, strongest first.
    """

    nrmse: float | None
    noise_floor: float | None
    depends_on: tuple[str, ...]


class GainEntry(NamedTuple):
    """Gain of the extension on held-out data; without an extension, zero gain for the stage with the largest residual.

    Attributes:
        channel: channel with the largest gain; None without an extension.
        heldout_nrmse_before: residual of the given model.
        heldout_nrmse_after: residual of the extended model.
        noise_floor: residual of noise alone.
        closed_fraction: fraction of the removable error power that is explained.
        ci95: its 95 % interval.
        channels: explained fraction in each channel with a removable error.
    """

    channel: Channel | None
    heldout_nrmse_before: float | None
    heldout_nrmse_after: float | None
    noise_floor: float | None
    closed_fraction: float | None
    ci95: tuple[float | None, float | None]
    channels: Mapping[Channel, ChannelGain]


class BeforeAfter(NamedTuple):
    """A residual of the given and of the extended model."""

    before: float | None
    after: float | None


class FreeRunEntry(NamedTuple):
    """Both models simulated along the recording.

    Attributes:
        seconds: simulated time [s].
        nrmse: errors by signal, as fractions of its standard deviation.
        remarks: remarks on the interpretation.
    """

    seconds: float
    nrmse: Mapping[str, BeforeAfter]
    remarks: tuple[str, ...]


class BaselineEntry(NamedTuple):
    """Baselines of the judgement; attributes as in :class:`ehls_ros.diagnosis.result.BaselineSummary`."""

    recordings: tuple[str, ...]
    coefficients: Mapping[str, Fitted]
    channels: Mapping[Channel, Healthy]
    coverage: tuple[Coverage, ...]
    not_compared: tuple[Channel, ...]


class DiagnosisDocument(NamedTuple):
    """Content of ``diagnosis.json``.

    Attributes:
        verdict: the verdict in one word.
        summary: the verdict in one or two sentences.
        stages: every stage of the model.
        causes: best first; empty when the model agrees with the recording.
        remainder: remaining residual of each judged stage.
        depends_on: for ``unknown`` and ``partial``, signals that predict the unexplained residual.
        gain: gain of the extension.
        next_experiment: experiment to separate the open causes; None if no causes are open or none separates them.
        extended_rig: file name of the extended rig.
        seed: seed of noise and resampling.
        version: version of this package.
        unknown_stage: for ``unknown``, the stage where the error is.
        partial: effects that explain a fraction of an unknown error.
        missing: for ``insufficient``, the missing data.
        not_judged: effects that could not be evaluated, with the reason.
        sensitivities: smallest effects detectable in these data.
        controller_gain: benefit of the extended model to the controller.
        free_run: both models simulated along the recording.
        remarks: remarks on the data and on missing results.
        diagnosis_s: wall time of the diagnosis alone [s].
        wall_s: wall time of everything [s].
        baseline: baselines of the judgement; None without baselines.
        corrected: wrong numbers of the rig file that were corrected first, by dotted section and name.
        term: for ``unknown`` and ``partial``, the term that describes what causes leave; None if none does.
        checks: gain of the extended model on other recordings, by their names and by channel.
    """

    verdict: Verdict | Literal["unchanged", "changed"]
    summary: str
    stages: Mapping[Stage, StageResult]
    causes: tuple[CauseEntry | UnknownEntry, ...]
    remainder: Mapping[Stage, RemainderEntry]
    depends_on: tuple[str, ...]
    gain: GainEntry
    next_experiment: NextExperiment | None
    extended_rig: str
    seed: int
    version: str
    unknown_stage: Stage | None
    partial: tuple[str, ...]
    missing: tuple[str, ...]
    not_judged: Mapping[str, str]
    sensitivities: Sequence[Sensitivity]
    controller_gain: ControllerBenefit | None
    free_run: FreeRunEntry | None
    remarks: tuple[str, ...]
    diagnosis_s: float
    wall_s: float
    baseline: BaselineEntry | None
    corrected: Mapping[str, Fitted]
    term: Term | None
    checks: Mapping[str, Mapping[Channel, ChannelGain]]


def diagnosis_document(
    diagnosis: Diagnosis, follows: Consequences, summary: str, extended_rig: str, wall_s: float
) -> DiagnosisDocument:
    """Return the content of ``diagnosis.json``.

    Args:
        diagnosis: the diagnosis.
        follows: its consequences.
        summary: the verdict in a sentence.
        extended_rig: file name of the extended rig.
        wall_s: wall time of everything [s].
    """
    unknown = _unknown(diagnosis)
    return DiagnosisDocument(
        verdict=_verdict(diagnosis),
        summary=summary,
        stages=diagnosis.stages,
        causes=tuple(_cause(cause, diagnosis.rig) for cause in diagnosis.causes) or (() if unknown is None else (unknown,)),
        remainder={
            stage: RemainderEntry(result.nrmse_after, result.noise_floor, result.depends_on)
            for stage, result in diagnosis.stages.items()
            if result.judged
        },
        depends_on=diagnosis.depends_on,
        gain=_gain(diagnosis),
        next_experiment=follows.next_experiment,
        extended_rig=extended_rig,
        seed=diagnosis.seed,
        version=__version__,
        unknown_stage=diagnosis.unknown_stage,
        partial=diagnosis.partial,
        missing=diagnosis.missing,
        not_judged=diagnosis.not_judged,
        sensitivities=diagnosis.sensitivities,
        controller_gain=follows.controller,
        free_run=None if follows.free_run is None else _free_run(follows.free_run),
        remarks=(*diagnosis.remarks, *follows.all_remarks),
        diagnosis_s=diagnosis.wall_s,
        wall_s=wall_s,
        baseline=None if diagnosis.baseline is None else BaselineEntry(*diagnosis.baseline[:5]),
        corrected=diagnosis.corrected,
        term=diagnosis.term,
        checks=follows.checks,
    )


def _verdict(diagnosis: Diagnosis) -> Verdict | Literal["unchanged", "changed"]:
    """Return the verdict in one word; with baselines, whether the rig has changed."""
    if diagnosis.baseline is None:
        return diagnosis.verdict
    if diagnosis.verdict == "consistent":
        return "unchanged"
    return "changed" if diagnosis.names_causes else diagnosis.verdict


def _cause(cause: Cause, rig: Rig) -> CauseEntry:
    effect, words = EFFECTS.load(cause.name), advice(rig, cause)
    rivals = tuple(RivalEntry(r.name, r.behind, r.closed_fraction, r.parameters) for r in cause.rivals)
    return CauseEntry(
        cause.name,
        cause.probability,
        cause.share,
        cause.channel,
        cause.equivalent_to,
        cause.stage,
        cause.group,
        {name: _parameter(e) for name, e in cause.parameters.items()},
        cause.fixed,
        Evidence(cause.gain, cause.sigmas, effect.EQUATION, rivals),
        Advice(words.inspect, words.measure, words.change),
        cause.side,
    )


def _parameter(e: Estimate) -> ParameterEntry:
    half = NORMAL_95 * e.std
    return ParameterEntry(e.value, e.std, e.unit, (e.value - half, e.value + half))


def _unknown(diagnosis: Diagnosis) -> UnknownEntry | None:
    stage = diagnosis.unknown_stage
    if diagnosis.verdict != "unknown" or stage is None:
        return None
    result = diagnosis.stages[stage]
    evidence = UnknownEvidence(diagnosis.depends_on, diagnosis.partial, result.nrmse_after, result.noise_floor)
    return UnknownEntry("unknown", 1.0, (), stage, {}, evidence)


def _gain(diagnosis: Diagnosis) -> GainEntry:
    if diagnosis.gain is not None:
        return GainEntry(*diagnosis.gain)
    judged = [result for result in diagnosis.stages.values() if result.judged and result.nrmse_before is not None]
    if diagnosis.unknown_stage is not None:
        judged = [diagnosis.stages[diagnosis.unknown_stage]]
    worst = max(judged, key=lambda r: (r.nrmse_before or 0.0) / max(r.noise_floor or 0.0, 1e-300), default=None)
    before, floor = (None, None) if worst is None else (worst.nrmse_before, worst.noise_floor)
    closed = 0.0 if diagnosis.verdict == "unknown" else None
    return GainEntry(None, before, before, floor, closed, (closed, closed), {})


def _free_run(run: FreeRun) -> FreeRunEntry:
    nrmse = {signal.name: BeforeAfter(signal.nrmse_before, signal.nrmse_after) for signal in run.signals}
    return FreeRunEntry(float(run.time[-1]), nrmse, run.remarks)
