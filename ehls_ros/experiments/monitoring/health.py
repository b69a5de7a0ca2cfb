"""What the monitor knows of a rig's health: plain records, for topic, file and page alike."""

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.examination import FoundCause


class State(IntEnum):
    """What the monitor is doing; the values are those of ``ehls_msgs/ModelHealth``."""

    LEARNING = 0
    WATCHING = 1
    EXAMINING = 2
    IDLE = 3
    """Nothing that could be judged comes."""


class FoundChange(NamedTuple):
    """A change of the rig that the monitor has found.

    Attributes:
        number: counts the changes.
        causes: its causes, best first; none where no effect of the list explains it.
        stage: stage in which it shows.
        depends_on: signals on which an unexplained change depends.
        since: likeliest time of its onset [s].
        earliest, latest: the times between which the onset lies [s].
        noticed: when the test exceeded its bound [s].
        named: when the diagnosis had its result, in the samples' time [s].
        cleared: since when it shows no more [s]; NaN while it does.
        acknowledged: whether an operator has seen it.
        before: whether it is part of what a change is measured from: the rig differed so from its file when the monitor began,
            or an operator has accepted it.
    """

    number: int
    causes: tuple[FoundCause, ...]
    stage: str
    depends_on: tuple[str, ...]
    since: float
    earliest: float
    latest: float
    noticed: float
    named: float
    cleared: float = math.nan
    acknowledged: bool = False
    before: bool = False

    @property
    def active(self) -> bool:
        """Whether it still shows."""
        return math.isnan(self.cleared)

    @property
    def name(self) -> str:
        """Its first cause, or where it shows."""
        return self.causes[0].name if self.causes else f"unknown change of the {self.stage.replace('_', ' ')}"

    def may_be(self, cause: FoundCause) -> bool:
        """Return whether a cause is its own, or one that the data cannot tell from it."""
        own = self.causes[0]
        return cause.name == own.name or cause.name in own.equivalent_to or own.name in cause.equivalent_to

    def sentence(self) -> str:
        """Say what it is."""
        if not self.causes:
            depends = f", depends on {', '.join(self.depends_on)}" if self.depends_on else ""
            return f"{self.name}{depends}"
        cause = self.causes[0]
        sizes = ", ".join(f"{name} {_size(value)}" for name, value in cause.parameters.items())
        alike = f" (or {', '.join(cause.equivalent_to)})" if cause.equivalent_to else ""
        return f"{cause.name}{alike}: {sizes}, {100.0 * cause.probability:.0f} %"


def _size(value: Estimate) -> str:
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{value.value:.3g} ± {1.96 * value.std:.2g}{unit}"


class Event(NamedTuple):
    """Something that happened.

    Attributes:
        time: when [s].
        kind: what.
        text: a sentence.
    """

    time: float
    kind: str
    text: str


class Health(NamedTuple):
    """The rig's health now.

    Attributes:
        time: of the newest block's end [s].
        state: what the monitor is doing.
        reason: why nothing is judged, or what is being learnt; empty where all is well.
        changes: what was found, oldest first.
        readings: the coefficients.
        watched: time for which blocks were judged [s].
        baseline: what a change is measured from.
        outside: fraction of the last minute's blocks that lie outside what the baseline covers.
        rates: change of each coefficient that is told, an hour.
    """

    time: float
    state: State
    reason: str
    changes: tuple[FoundChange, ...]
    readings: tuple[Reading, ...]
    watched: float
    baseline: str
    outside: float
    rates: Mapping[str, Estimate]

    @property
    def active(self) -> tuple[FoundChange, ...]:
        """The changes that still show."""
        return tuple(change for change in self.changes if change.active)
