"""What a diagnosis says."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.stages import Channel, Stage
from ehls_ros.estimate import Estimate
from ehls_ros.physics.rig import Rig

Verdict = Literal["consistent", "effect", "unknown", "insufficient"]


class StageResult(NamedTuple):
    """How one stage of the model does.

    Attributes:
        judged: whether the data tell anything about it.
        why_not: what is missing where they do not.
        nrmse_before: rms residual of the model as it was given, as a part of the stage's largest term; None if not judged.
        nrmse_after: the same with the causes found, on data they were not fitted to.
        noise_floor: what the sensors' noise alone makes of it.
        exceeds: whether the residual before is more than noise, surely and by enough to matter.
        unexplained: whether the residual after still is.
        leaves_much: whether the causes leave more of it than right ones do as a rule.
        incident: the stretch in which alone more than noise is left, if there is one [s].
        depends_on: the signals that the residual after depends on, strongest first.
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
    """Another cause in the place of one that was named.

    Attributes:
        name: of the effect.
        behind: by how much it explains less on held-out data [nats].
        closed_fraction: part of the removable error that it closes.
        parameters: its best fit.
    """

    name: str
    behind: float
    closed_fraction: float
    parameters: Mapping[str, Estimate]


class Cause(NamedTuple):
    """One cause of what the model gets wrong.

    Attributes:
        name: of the effect.
        probability: that it is this one rather than another single effect in its place, or one that no file describes.
        equivalent_to: effects that the data cannot tell from it.
        stage: the stage of the model it belongs to.
        group: what the effect's file calls its stage.
        parameters: the fitted ones with standard errors.
        fixed: the others that are not neutral.
        gain: decrease of the loss on held-out data through it [nats].
        sigmas: standard errors its surest parameter is from neutral.
        rivals: other effects in its place, best first.
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


class Gain(NamedTuple):
    """What the extension gains on held-out data, over the channels it changes.

    Attributes:
        channel: the channel that gained most.
        heldout_nrmse_before, heldout_nrmse_after, noise_floor: of that channel, as parts of its largest term.
        closed_fraction: part of the removable error power that is gone.
        ci95: its interval, from resampling the blocks.
    """

    channel: Channel
    heldout_nrmse_before: float
    heldout_nrmse_after: float
    noise_floor: float
    closed_fraction: float
    ci95: tuple[float, float]


class ChannelTrace(NamedTuple):
    """A channel's residual, one value a window, for pictures.

    Attributes:
        channel: its name.
        unit: of the residuals.
        time: middle of the windows [s].
        before: residual of the model as it was given.
        after: residual of the extended model.
        floor: standard deviation that noise makes.
        noise: a residual of noise alone, for spectra.
        against: window means of the signals it may depend on, by the names of the data contract.
    """

    channel: Channel
    unit: str
    time: Array
    before: Array
    after: Array
    floor: Array
    noise: Array
    against: Mapping[str, Array]


class Sensitivity(NamedTuple):
    """The smallest size of an effect that these data would have shown.

    Attributes:
        name: of the effect.
        parameter: of it.
        smallest: that would have been named.
        unit: of it.
    """

    name: str
    parameter: str
    smallest: float
    unit: str


@dataclass(frozen=True)
class Diagnosis:
    """What the simulation gets wrong, why, and what fixing it gains.

    Attributes:
        verdict: in one word.
        missing: for ``insufficient``, what the data lack, one sentence each.
        stages: every stage of the model.
        causes: best first.
        unknown_stage: for ``unknown``, the stage where something is left that no effect explains.
        depends_on: the signals it depends on.
        partial: names of the effects that explain part of it.
        gain: of the extension, where there is one.
        rig: the model as it was given.
        extended: the model with the causes switched on; the same where there are none.
        traces: residuals, by channel.
        sensitivities: what would have been noticed.
        not_judged: effects that could not be tried, with the reason.
        remarks: about the data.
        seed: of the noise that was added to find the floor.
        wall_s: time it took [s].
    """

    verdict: Verdict
    missing: tuple[str, ...]
    stages: Mapping[Stage, StageResult]
    causes: tuple[Cause, ...]
    unknown_stage: Stage | None
    depends_on: tuple[str, ...]
    partial: tuple[str, ...]
    gain: Gain | None
    rig: Rig
    extended: Rig
    traces: Mapping[Channel, ChannelTrace]
    sensitivities: tuple[Sensitivity, ...]
    not_judged: Mapping[str, str]
    remarks: tuple[str, ...]
    seed: int
    wall_s: float
