"""Result of a diagnosis."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.reading import Reading, Shape
from ehls_ros.diagnosis.stages import KINDS, REQUIRED, Channel, Stage
from ehls_ros.estimate import Estimate
from ehls_ros.physics.effects.base import Side
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import SIGNALS

Verdict = Literal["consistent", "effect", "partial", "unknown", "insufficient"]

NAMING: tuple[Verdict, ...] = ("effect", "partial")
"""Verdicts that name causes."""


class StageResult(NamedTuple):
    """Result for one stage of the model.

    Attributes:
        judged: whether the data are sufficient to judge it.
        why_not: reason if they are not.
        nrmse_before: rms residual of the given model, as a fraction of the stage's largest term; None if not judged.
        nrmse_after: the same with the causes named, on held-out data.
        noise_floor: the same of a correct model, due to sensor noise, loss between samples and the accuracy no model exceeds;
            the rms of :attr:`ChannelTrace.floor`.
        exceeds: whether the given model's residual exceeds the noise by a relevant amount.
        unexplained: whether there is a remainder that no cause explains.
        leaves_much: whether more remains than correct causes usually leave.
        incident: the only interval in which more than noise remains, if there is just one [s].
        depends_on: the signals on which the remainder depends, strongest first.
    """

    judged: bool
    why_not: str
    nrmse_before: float | None = None
    nrmse_after: float | None = None
    noise_floor: float | None = None
    exceeds: bool = False
    unexplained: bool = False
    leaves_much: bool = False
    incident: tuple[float, float] | None = None
    depends_on: tuple[str, ...] = ()


class Rival(NamedTuple):
    """Another effect in the place of a named cause.

    Attributes:
        name: name of the effect.
        behind: shortfall of its gain on held-out data [nats].
        closed_fraction: fraction of the removable error that it closes.
        parameters: its fitted parameters with standard errors.
    """

    name: str
    behind: float
    closed_fraction: float
    parameters: Mapping[str, Estimate]


class Cause(NamedTuple):
    """One cause of the model's error.

    Attributes:
        name: name of the effect.
        probability: probability that this effect is the cause, not another in its place nor one outside the list.
        equivalent_to: effects that the data cannot distinguish from it.
        stage: the stage of the model it belongs to.
        group: the group given in the effect's file.
        parameters: the fitted parameters with standard errors.
        fixed: the other non-neutral parameters.
        gain: decrease of the loss on held-out data due to it [nats].
        sigmas: standard errors between its best-determined parameter and the neutral value.
        rivals: other effects in its place, best first.
        channel: the channel where it explains most.
        share: fraction of the removable error there that returns without it. Shares add up to less than all causes together
            close if causes can replace each other, and to more if they depend on each other.
        deciding: unrecorded signals that would distinguish it from some of the equivalent effects.
        side: chamber on which it acts; None if it has no side.
    """

    name: str
    probability: float
    equivalent_to: tuple[str, ...]
    stage: Stage
    group: str
    parameters: Mapping[str, Estimate]
    fixed: Mapping[str, float]
    gain: float
    sigmas: float
    rivals: tuple[Rival, ...]
    channel: Channel
    share: float | None = None
    deciding: tuple[str, ...] = ()
    side: Side | None = None


class ChannelGain(NamedTuple):
    """Gain of the extended model in one channel.

    Attributes:
        closed: fraction of the removable error power that was removed.
        noise: power of the noise, in the same unit.
    """

    closed: float
    noise: float


class Gain(NamedTuple):
    """Gain of the extended model on held-out data, over the channels it changes.

    Attributes:
        channel: the channel that gains most.
        heldout_nrmse_before: rms residual there of the given model, as a fraction of the largest term.
        heldout_nrmse_after: the same of the extended model.
        noise_floor: the same of noise alone.
        closed_fraction: fraction of the removable error power that was removed, over all channels it changes.
        ci95: its 95 % interval, from resampling the blocks.
        channels: the same for each channel with an error to remove.
    """

    channel: Channel
    heldout_nrmse_before: float
    heldout_nrmse_after: float
    noise_floor: float
    closed_fraction: float
    ci95: tuple[float, float]
    channels: Mapping[Channel, ChannelGain]


class ChannelTrace(NamedTuple):
    """A channel's residual for plots, one value a window, shape (n,).

    Attributes:
        channel: name of the channel.
        unit: unit of the residuals.
        size: rms of the largest term in the channel's balance, in that unit.
        time: middle of the windows [s].
        measured: the measured quantity to which the residuals refer.
        before: residual of the given model.
        after: residual with the causes, on held-out data.
        floor: noise floor, the standard deviation of a correct model's residual.
        noise: change of the residual by added noise of the sensors' level, for spectra.
        against: means over the same windows of the signals it may depend on, by the names of the data contract.
    """

    channel: Channel
    unit: str
    size: float
    time: Array
    measured: Array
    before: Array
    after: Array
    floor: Array
    noise: Array
    against: Mapping[str, Array]

    def simulated(self, residual: Array) -> Array:
        """Return the simulated value of the measured quantity for a residual, shape (n,)."""
        return self.measured + residual if self.channel in REQUIRED else self.measured - residual


class Sensitivity(NamedTuple):
    """The smallest size of an effect that these data would have shown.

    Attributes:
        name: name of the effect.
        parameter: name of its parameter.
        smallest: smallest size that would have been named.
        unit: unit of the parameter.
    """

    name: str
    parameter: str
    smallest: float
    unit: str


class Coverage(NamedTuple):
    """Coverage of a signal of the new recording by the baselines.

    Attributes:
        signal: name of the signal.
        baseline: its range in the baselines.
        new: its range in the new recording.
        beyond: fraction of the new recording outside the baselines' range.
    """

    signal: str
    baseline: tuple[float, float]
    new: tuple[float, float]
    beyond: float


class Healthy(NamedTuple):
    """Remainder of a healthy rig in a channel, as fractions of the largest term of its balance.

    Attributes:
        stage: the stage the channel belongs to.
        fitted: rms residual of the model fitted to the baselines.
        left: the same less the rig's learnt remainder, on held-out blocks.
        noise_floor: the same of the sensors' noise alone.
        allowed: rms uncertainty of the expected remainder of the new recording; None if it lacks the channel.
        together: number of windows with correlated errors.
    """

    stage: Stage
    fitted: float
    left: float
    noise_floor: float
    allowed: float | None
    together: float


class Fitted(NamedTuple):
    """A coefficient of the rig file and its value fitted to recordings.

    Attributes:
        given: its value in the rig file.
        fitted: its value for the recordings, with its standard error.
        spread: relative standard deviation from baseline to baseline that counts as no change; None for a bias, whose spread
            is that of its channel's offset, and without baselines.
    """

    given: float
    fitted: Estimate
    spread: float | None


class BaselineSummary(NamedTuple):
    """Summary of the baselines against which a recording was judged.

    Attributes:
        recordings: names of the baselines.
        coefficients: coefficients identified by the baselines.
        channels: remainder of a healthy rig in each channel.
        coverage: coverage of the operating points, by signal.
        not_compared: channels of the new recording that no baseline has.
        old: residuals of the fitted model in the first baseline, without and with correction for the learnt remainder.
        new: the same in the new recording.
    """

    recordings: tuple[str, ...]
    coefficients: Mapping[str, Fitted]
    channels: Mapping[Channel, Healthy]
    coverage: tuple[Coverage, ...]
    not_compared: tuple[Channel, ...]
    old: Mapping[Channel, ChannelTrace]
    new: Mapping[Channel, ChannelTrace]


def argument_unit(argument: str) -> str:
    """Return the unit of a term's argument, by its name in the data contract."""
    return "s" if argument == "time_s" else SIGNALS[argument].unit


class Term(NamedTuple):
    """A term found in the data, as a formula or a table over one signal.

    Attributes:
        effect: name of the effect that has it.
        argument: the signal, by its name in the data contract.
        magnitude: whether the argument is the signal's magnitude.
        unit: unit of the values.
        at: places of the table's knots, or of points on the formula, in the argument's unit, shape (k,).
        values: there, shape (k,).
        std: their standard errors, shape (k,).
        period: period in the argument with which the table repeats; None: it does not, and keeps its edge values.
        closed: fraction of the removable error that it closes on held-out data.
        direction: speed within which its sign follows the direction of motion [m/s]; 0: it does not.
        reading: its shape.
        formula: the shapes whose sum it is; empty for a table.
        factor: the signal to which it is proportional, by its name in the data contract; empty if there is none.
        factor_reach: magnitude of that signal at which the values hold.
        error, factor_error: whether the argument, or the factor, is the command less the signal.
        lag: time constant of a first-order lag that is subtracted from the argument; None: there is none.
        play: width of the play in whose gap the argument is taken; None: there is none.
    """

    effect: str
    argument: str
    magnitude: bool
    unit: str
    at: Array
    values: Array
    std: Array
    period: Estimate | None
    closed: float
    direction: float
    reading: Reading
    formula: tuple[Shape, ...] = ()
    factor: str = ""
    factor_reach: float = 1.0
    error: bool = False
    factor_error: bool = False
    lag: Estimate | None = None
    play: Estimate | None = None


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Result of a diagnosis: errors of a rig's model, their causes, and the gain from correcting them.

    Attributes:
        verdict: in one word.
        missing: data missing for a stage's judgement, one sentence for each stage not judged.
        stages: result for each stage of the model.
        causes: for ``effect`` and ``partial``, the causes, largest gain first.
        unknown_stage: the stage with the largest unexplained remainder, if there is one.
        depends_on: the signals on which that remainder depends.
        partial: for ``unknown``, names of the effects that explain a part of it.
        gain: gain of the extended model, if causes are named or a term is found.
        term: for ``unknown`` and ``partial``, the term that describes what causes leave; None if none does.
        term_rivals: models with another term that explains the error as well, by that term's name.
        rig: the given model.
        extended: the model with the causes or the term; the given model if there are none.
        traces: residuals, by channel.
        sensitivities: the sizes that would have been detected.
        not_judged: effects that could not be tried, with the reason.
        remarks: remarks about the data, one sentence each.
        seed: seed of the noise added to find the noise floor, and of resampling.
        wall_s: wall time [s].
        baseline: the baselines against which the recording was judged; None if it was judged by itself.
        corrected: wrong numbers of the rig file that were corrected before, by dotted section and name; the given
            model has the right ones.
    """

    verdict: Verdict
    missing: tuple[str, ...]
    stages: Mapping[Stage, StageResult]
    causes: tuple[Cause, ...] = ()
    unknown_stage: Stage | None = None
    depends_on: tuple[str, ...] = ()
    partial: tuple[str, ...] = ()
    gain: Gain | None = None
    term: Term | None = None
    term_rivals: Mapping[str, Rig] = field(default_factory=dict)
    rig: Rig
    extended: Rig
    traces: Mapping[Channel, ChannelTrace] = field(default_factory=dict)
    sensitivities: tuple[Sensitivity, ...] = ()
    not_judged: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...]
    seed: int
    wall_s: float
    baseline: BaselineSummary | None = None
    corrected: Mapping[str, Fitted] = field(default_factory=dict)

    @property
    def names_causes(self) -> bool:
        """Whether causes are named, with or without an unexplained remainder."""
        return self.verdict in NAMING


def trace(evidence: Evidence, channel: Channel, after: Array, signals: Mapping[str, Array]) -> ChannelTrace:
    """Return a channel's residual for plots.

    Args:
        evidence: the recording compared with the given model.
        channel: the channel.
        after: residual with the causes, of the usable windows, in the channel's unit, shape (n,).
        signals: signals it may depend on, by name, one value per sample.
    """
    floor = evidence.floor[channel]
    return ChannelTrace(
        channel=channel,
        unit=KINDS[channel].unit,
        size=evidence.sizes[channel],
        time=evidence.times[channel],
        measured=evidence.comparison().measured(evidence.rig, channel)[evidence.masks[channel]],
        before=evidence.base.values[channel] * floor,
        after=after,
        floor=floor,
        noise=evidence.noise[channel] * floor,
        against={name: evidence.means(channel, values) for name, values in signals.items() if name != "time_s"},
    )
