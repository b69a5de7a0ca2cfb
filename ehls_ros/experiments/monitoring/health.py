"""Rig health as determined by the monitor: records for topic, file and page, and their description in sentences."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import date, datetime
from enum import IntEnum
from typing import NamedTuple

from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Reading, Tracked
from ehls_ros.diagnosis.result import Fitted
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.examination import FoundCause
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import Rig

SENSORS = "sensors"
"""Group of the effects that are sensor faults; all others are faults of the rig."""

MIN_LEVEL_TIME = 60.0
"""Minimum duration of a level, unless it worsens [s]."""

GOOD, WARNING = range(2)
"""Levels, as in diagnostics."""

MIN_REPORTED_OUTSIDE = 0.1
"""Fraction of blocks outside the range of the baseline from which it is reported."""

MIN_UNIX_TIME_NS = 10**18
"""Stamp from which times are of the wall clock; earlier ones count from the beginning of a run in lockstep."""

WEEK_NS = 6 * 86400 * 10**9
"""Time for which a weekday identifies the day [ns]."""

INTERVAL = 1.96
"""Half width of a 95 % interval in standard errors."""

Wall = Callable[[float], int]
"""Function that returns the stamp of an instant on the monitor's axis [ns]; 0: unknown."""


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

    def with_times(self, convert: Callable[[float], float]) -> "FoundChange":
        """Return the change with all times converted to another axis."""
        return self._replace(
            since=convert(self.since),
            earliest=convert(self.earliest),
            latest=convert(self.latest),
            noticed=convert(self.noticed),
            named=convert(self.named),
            cleared=convert(self.cleared),
        )

    @property
    def group(self) -> str:
        """Group of its first cause; empty if it has none."""
        return EFFECTS.load(self.causes[0].name).GROUP if self.causes else ""

    def sentence(self) -> str:
        """Describe the change."""
        if not self.causes:
            depends = f", depends on {', '.join(self.depends_on)}" if self.depends_on else ""
            return f"{self.name}{depends}"
        cause = self.causes[0]
        sizes = ", ".join(f"{name} {_size(value)}" for name, value in cause.parameters.items())
        equivalent = f" (or {', '.join(cause.equivalent_to)})" if cause.equivalent_to else ""
        return f"{cause.name}{equivalent}: {sizes}, {100.0 * cause.probability:.0f} %"

    def describe(self, rig: Rig, wall: Wall, now_ns: int) -> str:
        """Describe the change to an operator: cause, size and time of onset.

        Args:
            rig: the rig to whose values sizes are relative.
            wall: returns the stamps along the monitor's axis.
            now_ns: the newest stamp [ns].
        """
        since = f" since {format_instant(wall(self.since), now_ns)}"
        if not self.causes:
            depends = f", depends on {', '.join(self.depends_on)}" if self.depends_on else ""
            return f"{self.name}{since}{depends}"
        cause = self.causes[0]
        origin = "sensor" if self.group == SENSORS else "rig"
        sizes = ", ".join(_relative_size(cause.name, parameter, value, rig) for parameter, value in cause.parameters.items())
        label = "" if _tracked(cause.name, next(iter(cause.parameters), "")) else f"{cause.name.replace('_', ' ')}: "
        equivalent = f" (or {', '.join(cause.equivalent_to)})" if cause.equivalent_to else ""
        return f"{origin}: {label}{sizes}{since}, {100.0 * cause.probability:.0f} %{equivalent}"


def _size(value: Estimate) -> str:
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{value.value:.3g} ± {INTERVAL * value.std:.2g}{unit}"


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


class Summary(NamedTuple):
    """Rig health in brief.

    Attributes:
        level: :data:`GOOD` or :data:`WARNING`.
        sentence: description.
    """

    level: int
    sentence: str


class Health(NamedTuple):
    """Current health of the rig.

    Attributes:
        time: end of the newest block [s].
        state: state of the monitor.
        reason: reason why samples are not judged; empty if they are.
        changes: detected changes, oldest first.
        readings: the coefficients.
        watched: time for which blocks were judged [s].
        baseline: description of the baseline.
        outside: fraction of the last minute's blocks outside the range of the baseline.
        rates: change per hour of each determined coefficient.
        rig_values: numbers of the rig file that the recordings of the healthy rig contradict, by dotted section and name.
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
    rig_values: Mapping[str, Fitted] = {}

    @property
    def active(self) -> tuple[FoundChange, ...]:
        """The active changes."""
        return tuple(change for change in self.changes if change.active)

    def summary(self, rig: Rig, wall: Wall) -> Summary:
        """Return level and sentence; a warning while a change is active and not acknowledged.

        Args:
            rig: the rig to whose values changes are relative.
            wall: returns the stamps along the monitor's axis.
        """
        now_ns = wall(self.time)
        new = [change for change in self.active if not change.acknowledged]
        seen = [change for change in self.active if change.acknowledged]
        parts = [change.describe(rig, wall, now_ns) for change in new]
        parts += [f"acknowledged: {change.describe(rig, wall, now_ns)}" for change in seen]
        if self.state == State.IDLE:
            parts.append(f"nothing is judged: {self.reason or 'no samples'}")
        elif self.state == State.LEARNING:
            parts.append("learning the scatter of the healthy rig")
        elif self.outside > MIN_REPORTED_OUTSIDE:
            parts.append(f"{100.0 * self.outside:.0f} % of the last minute is outside the range of the baseline")
        quiet = f"no change against {self.baseline} in {self.watched / 3600.0:.3g} h"
        if self.rig_values:
            quiet += f"; the rig file is wrong in {', '.join(path.partition('.')[2] for path in self.rig_values)}"
        return Summary(WARNING if new else GOOD, "; ".join(parts) if parts else quiet)


def agreed(
    changes: Sequence[FoundChange],
    found: Sequence[Reading],
    healthy: Rig,
    read_anew: bool,
    errors: Mapping[str, float],
) -> tuple[tuple[FoundChange, ...], tuple[Reading, ...]]:
    """Return changes and readings with the same number for the same quantity.

    Args:
        changes: the changes, with the sizes at their diagnosis.
        found: the readings.
        healthy: the healthy rig, from which a diagnosis starts.
        read_anew: whether the readings are of samples since the last diagnosis. If so, the size of a change follows the
            reading, which is fitted jointly with all other coefficients; otherwise, the reading follows the diagnosis.
        errors: standard errors of the healthy rig's coefficients, by name.
    """
    current, out = {reading.name: reading for reading in found}, list[FoundChange]()
    names = {(t.effect, t.parameter): name for name, t in COEFFICIENTS.items()}
    for change in changes:
        if not change.active or change.before or not change.causes:
            out.append(change)
            continue
        cause = change.causes[0]
        sizes = dict(cause.parameters)
        for parameter, size in cause.parameters.items():
            name = names.get((cause.name, parameter), "")
            tracked, reading = COEFFICIENTS.get(name), current.get(name)
            if tracked is None or reading is None:
                continue
            before = tracked.given(healthy)
            if read_anew and reading.identified and (before or not tracked.relative):
                now = Estimate(reading.value, reading.deviation, size.unit)
                sizes[parameter] = tracked.change(before, now, errors.get(name, 0.0))
            elif not read_anew and math.isfinite(size.std):
                total = tracked.changed(before, size)
                current[name] = Reading(name, total.value, total.std, reading.unit)
        out.append(change._replace(causes=(cause._replace(parameters=sizes), *change.causes[1:])))
    return tuple(out), tuple(current[reading.name] for reading in found)


def today() -> date:
    """Return the day in the local time zone."""
    return datetime.now().astimezone().date()


class DebouncedSummary:
    """Summary whose level improves only after a minimum time."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without a summary; ``clock`` returns the time [s]."""
        self._clock = clock
        self._held: Summary | None = None
        self._since = 0.0

    def release(self) -> None:
        """Let the level improve at once, after an action of the operator."""
        self._held = None

    def update(self, summary: Summary) -> Summary:
        """Update with the present summary, and return the one to be reported."""
        now = self._clock()
        held = self._held
        if held is not None and summary.level < held.level and now - self._since < MIN_LEVEL_TIME:
            return held
        if held is None or summary.level != held.level:
            self._since = now
        self._held = summary
        return summary


def _tracked(effect: str, parameter: str) -> Tracked | None:
    return next((t for t in COEFFICIENTS.values() if (t.effect, t.parameter) == (effect, parameter)), None)


def _relative_size(effect: str, parameter: str, value: Estimate, rig: Rig) -> str:
    """Format the size of a parameter, as a factor on its nominal value if it has one."""
    known = _tracked(effect, parameter)
    name = known.words if known else parameter.replace("_", " ")
    given = known.given(rig) if known and known.coefficient and not known.relative else 0.0
    if known and (known.relative or given):
        factor, deviation = (1.0 + value.value / given, value.std / abs(given)) if given else (value.value, value.std)
        return f"{name} {factor:.3g} × ± {INTERVAL * deviation:.1g}"
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{name} {value.value:.3g} ± {INTERVAL * value.std:.1g}{unit}"


def format_instant(stamp_ns: int, now_ns: int) -> str:
    """Format an instant for an operator: weekday and time, or date and time if over a week ago.

    Args:
        stamp_ns: the instant [ns].
        now_ns: the present [ns].
    """
    if stamp_ns < MIN_UNIX_TIME_NS:
        return f"{stamp_ns * 1e-9:.1f} s" if stamp_ns else "before monitoring"
    wall = datetime.fromtimestamp(stamp_ns * 1e-9).astimezone()
    return wall.strftime("%Y-%m-%d %H:%M" if now_ns - stamp_ns > WEEK_NS else "%a %H:%M")
