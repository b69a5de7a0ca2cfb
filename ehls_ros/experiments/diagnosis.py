"""What follows from a diagnosis: the models let go, what the controller gains, which experiment tells the open causes apart.

Nothing here changes a verdict, and nothing that fails here takes one away: what could not be had is a remark.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

from ehls_ros.diagnosis.free_run import FreeRun, free_run
from ehls_ros.diagnosis.result import Cause, Diagnosis, Rival
from ehls_ros.diagnosis.stages import SENSED as RECORDED_AS
from ehls_ros.errors import BadInput
from ehls_ros.experiments.controller_gain import ControllerGains, controller_gain
from ehls_ros.experiments.next_experiment import Proposal, next_experiment
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.trajectory import Trajectory

SURE = 0.9
"""Probability of a cause from which on its rivals are no longer open."""

CLOSE = 10.0
"""How far behind a rival may be to be open beside a cause that is not sure [nats]."""

MOST_RIVALS = 2
"""Most rivals that an experiment is looked for to tell from a cause."""

LEAST_STD, MOST_STD = 0.01, 0.3
"""Limits of how well the candidates' parameters are taken to be known, as a part of their values."""

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it all is done."""

Made = TypeVar("Made")


class Consequences(NamedTuple):
    """What follows from a diagnosis.

    Attributes:
        free_run: both models let go along the recording; None where that cannot be.
        controller: what the extended model gives the controller; None unless an effect was named.
        proposal: the next experiment; None where no two causes are open.
        remarks: why something is missing.
    """

    free_run: FreeRun | None
    controller: ControllerGains | None
    proposal: Proposal | None
    remarks: tuple[str, ...]


def consequences(
    found: Diagnosis, trajectory: Trajectory, name: str, *, progress: Progress = lambda doing, part: None
) -> Consequences:
    """Work out what follows from a diagnosis.

    Args:
        found: the diagnosis.
        trajectory: the recording it was made of.
        name: what the recording is called in errors.
        progress: called with what is being done, and the part of it that is done.

    Returns:
        What could be worked out, and why the rest could not.
    """
    remarks: list[str] = []
    run = controller = proposal = None
    if found.verdict != "insufficient":
        progress("letting the models run freely", 0.0)
        run = _tried("free run", remarks, lambda: free_run(trajectory, found.rig, found.extended, name))
    if found.verdict == "effect":
        progress("running the controller on the extended plant", 0.3)
        controller = _tried("run of the controller", remarks, lambda: controller_gain(found.rig, found.extended))
        candidates = _tried("next experiment", remarks, lambda: open_candidates(found)) or {}
        if len(candidates) > 1:
            progress("looking for the next experiment", 0.5)
            signals = tuple(sensor for sensor, signal in RECORDED_AS.items() if signal in trajectory)
            std = parameter_std(found)

            def looked_for(done: int, total: int) -> None:
                progress("looking for the next experiment", 0.5 + 0.5 * done / total)

            proposal = _tried(
                "next experiment",
                remarks,
                lambda: next_experiment(candidates, nominal=found.rig, signals=signals, parameter_std=std, progress=looked_for),
            )
    return Consequences(run, controller, proposal, tuple(remarks))


def _tried(what: str, remarks: list[str], make: Callable[[], Made]) -> Made | None:
    try:
        return make()
    except BadInput as error:
        remarks.append(f"no {what}: {error.what}")
        return None
    except Exception as error:  # noqa: BLE001 - whatever happens here, the diagnosis stands
        remarks.append(f"no {what}: it failed ({type(error).__name__}: {error})")
        return None


def open_rivals(cause: Cause) -> tuple[Rival, ...]:
    """Return the rivals that the data leave open beside a cause, closest first."""
    close = CLOSE if cause.probability < SURE else 0.0
    rivals = [rival for rival in cause.rivals if rival.name in cause.equivalent_to or rival.behind < close]
    return tuple(rivals[:MOST_RIVALS])


def open_candidates(found: Diagnosis) -> dict[str, Rig]:
    """Return the rigs of the causes that one experiment more has to tell apart, by the causes' names.

    Of several causes with open rivals, the least probable is looked at.
    """
    for cause in sorted(found.causes, key=lambda cause: cause.probability):
        rivals = open_rivals(cause)
        if rivals:
            others = [use for use in found.extended.effects if use.name != cause.name]
            return {cause.name: found.extended} | {
                rival.name: found.extended._replace(effects=(*others, _use(rival, found.rig))) for rival in rivals
            }
    return {}


def _use(rival: Rival, rig: Rig) -> EffectUse:
    """Return a rival switched on as it was fitted, what its form fixes included."""
    effect = EFFECTS.load(rival.name)
    fixed: Mapping[str, float] = next((form.fixed for form in effect.forms(rig) if set(form.free) == set(rival.parameters)), {})
    return EffectUse(rival.name, effect.Parameters(**fixed, **{n: e.value for n, e in rival.parameters.items()}))


def parameter_std(found: Diagnosis) -> float:
    """Return how well the data tell the parameters of the causes named, the worst: standard error as a part of the value."""
    parts = [e.std / abs(e.value) for cause in found.causes for e in cause.parameters.values() if e.value != 0.0]
    worst = max((part for part in parts if math.isfinite(part)), default=MOST_STD)
    return min(max(worst, LEAST_STD), MOST_STD)
