"""Records of a rig's health as determined by the monitor, for topic, file and page."""

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.examination import FoundCause


class State(IntEnum):
    """State of the monitor; the values are those of ``ehls_msgs/ModelHealth``."""

    LEARNING = 0
    WATCHING = 1
    EXAMINING = 2
    IDLE = 3
    """No samples arrive that can be judged."""


class FoundChange(NamedTuple):
    """A change of the rig detected by the monitor.

    Attributes:
        number: consecutive number.
        causes: its causes, best first; none if no effect of the list explains it.
        stage: affected stage.
        depends_on: signals on which an unexplained change depends.
        since: most likely time of its onset [s].
        earliest, latest: bounds of the time of onset [s].
        noticed: time when the test exceeded its bound [s].
        named: time of the diagnosis result, in the samples' time [s].
        cleared: time since which it is inactive [s]; NaN while it is active.
        acknowledged: whether an operator has seen it.
        before: whether it belongs to the baseline: the rig differed from its file when the monitor started, or an operator has
            accepted the change.
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
        """Whether it is active."""
        return math.isnan(self.cleared)

    @property
    def name(self) -> str:
        """Name of its first cause, or else of its stage."""
        return self.causes[0].name if self.causes else f"unknown change of the {self.stage.replace('_', ' ')}"

    def may_be(self, cause: FoundCause) -> bool:
        """Return whether a cause equals its first cause or is equivalent to it."""
        own = self.causes[0]
        return cause.name == own.name or cause.name in own.equivalent_to or own.name in cause.equivalent_to

    def sentence(self) -> str:
        """Describe the change."""
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
    """An event.

    Attributes:
        time: time [s].
        kind: kind of event.
        text: description in a sentence.
    """

    time: float
    kind: str
    text: str


class Health(NamedTuple):
    """Current health of the rig.

    Attributes:
        time: end of the newest block [s].
        state: state of the monitor.
        reason: reason why nothing is judged, or progress of learning; otherwise empty.
        changes: detected changes, oldest first.
        readings: the coefficients.
        watched: time for which blocks were judged [s].
        baseline: description of the baseline.
        outside: fraction of the last minute's blocks outside the range of the baseline.
        rates: change per hour of each determined coefficient.
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
        """The active changes."""
        return tuple(change for change in self.changes if change.active)
