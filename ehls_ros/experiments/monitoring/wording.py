"""Wording of the rig's health, and a debounced warning level."""

import time
from collections.abc import Callable
from datetime import date, datetime
from typing import NamedTuple

from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Tracked
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.health import FoundChange, Health, State
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import Rig

SENSORS = "sensors"
"""Group of the effects that are sensor faults; all others are faults of the rig."""

HOLD = 60.0
"""Time for which a level is held unless it worsens [s]."""

GOOD, WARNING = range(2)
"""Levels, as in diagnostics."""

OFTEN_OUTSIDE = 0.1
"""Fraction of blocks outside the range of the baseline from which this is reported."""

UNIX_TIME_NS = 10**18
"""Stamp from which times are of the wall clock; earlier ones count from the beginning of a run in lockstep."""

WEEK_NS = 6 * 86400 * 10**9
"""Time for which a weekday identifies the day [ns]."""

INTERVAL = 1.96
"""Half width of a 95 % interval in standard errors."""

Wall = Callable[[float], int]
"""Function that returns the stamp of an instant on the monitor's axis [ns]; 0: unknown."""


def today() -> date:
    """Return the day in the local time zone."""
    return datetime.now().astimezone().date()


class Word(NamedTuple):
    """Level and sentence."""

    level: int
    sentence: str


class HeldLevel:
    """Warning level that is held for a time before it improves, with its sentence."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without a level; ``clock`` returns the time [s]."""
        self._clock = clock
        self._held: Word | None = None
        self._since = 0.0

    def release(self) -> None:
        """Release the held level after an action of the operator."""
        self._held = None

    def take(self, word: Word) -> Word:
        """Update with the present level and sentence, and return those to be reported."""
        now = self._clock()
        held = self._held
        if held is not None and word.level < held.level and now - self._since < HOLD:
            return held
        if held is None or word.level != held.level:
            self._since = now
        self._held = word
        return word


def group(change: FoundChange) -> str:
    """Return the group of a change's first cause; empty for an unknown one."""
    return EFFECTS.load(change.causes[0].name).GROUP if change.causes else ""


def sentence(change: FoundChange, rig: Rig, wall: Wall, now_ns: int) -> str:
    """Describe a change: cause, size and time of onset.

    Args:
        change: the change.
        rig: the rig as described in its file, the reference of sizes.
        wall: returns the stamps along the monitor's axis.
        now_ns: the newest stamp [ns].
    """
    since = f" since {moment(wall(change.since), now_ns)}"
    if not change.causes:
        depends = f", depends on {', '.join(change.depends_on)}" if change.depends_on else ""
        return f"{change.name}{since}{depends}"
    cause = change.causes[0]
    whose = "sensor" if group(change) == SENSORS else "rig"
    sizes = ", ".join(_size(cause.name, parameter, value, rig) for parameter, value in cause.parameters.items())
    words = "" if _tracked(cause.name, next(iter(cause.parameters), "")) else f"{cause.name.replace('_', ' ')}: "
    alike = f" (or {', '.join(cause.equivalent_to)})" if cause.equivalent_to else ""
    return f"{whose}: {words}{sizes}{since}, {100.0 * cause.probability:.0f} %{alike}"


def _tracked(effect: str, parameter: str) -> Tracked | None:
    return next((t for t in COEFFICIENTS.values() if (t.effect, t.parameter) == (effect, parameter)), None)


def _size(effect: str, parameter: str, value: Estimate, rig: Rig) -> str:
    """Format the size of a parameter, as a factor on its nominal value if it has one."""
    known = _tracked(effect, parameter)
    name = known.words if known else parameter.replace("_", " ")
    given = known.given(rig) if known and known.coefficient and not known.relative else 0.0
    if known and (known.relative or given):
        factor, deviation = (1.0 + value.value / given, value.std / abs(given)) if given else (value.value, value.std)
        return f"{name} {factor:.3g} × ± {INTERVAL * deviation:.1g}"
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{name} {value.value:.3g} ± {INTERVAL * value.std:.1g}{unit}"


def moment(stamp_ns: int, now_ns: int) -> str:
    """Format an instant for an operator: weekday and time, or date and time if over a week ago.

    Args:
        stamp_ns: the instant [ns].
        now_ns: the present [ns].
    """
    if stamp_ns < UNIX_TIME_NS:
        return f"{stamp_ns * 1e-9:.1f} s" if stamp_ns else "before the watch"
    wall = datetime.fromtimestamp(stamp_ns * 1e-9).astimezone()
    return wall.strftime("%Y-%m-%d %H:%M" if now_ns - stamp_ns > WEEK_NS else "%a %H:%M")


def word(health: Health, rig: Rig, wall: Wall) -> Word:
    """Return level and sentence of the rig's health; a warning while a change is active and not acknowledged.

    Args:
        health: health reported by the monitor.
        rig: the rig as described in its file.
        wall: returns the stamps along the monitor's axis.
    """
    now_ns = wall(health.time)
    new = [change for change in health.active if not change.acknowledged]
    seen = [change for change in health.active if change.acknowledged]
    said = [sentence(change, rig, wall, now_ns) for change in new]
    said += [f"acknowledged: {sentence(change, rig, wall, now_ns)}" for change in seen]
    if health.state == State.IDLE:
        said.append(f"nothing is judged: {health.reason or 'no samples'}")
    elif health.state == State.LEARNING:
        said.append("learns how the healthy rig scatters")
    elif health.outside > OFTEN_OUTSIDE:
        said.append(f"{100.0 * health.outside:.0f} % of the last minute lie outside what the baseline covers")
    quiet = f"no change against {health.baseline} in {health.watched / 3600.0:.3g} h"
    return Word(WARNING if new else GOOD, "; ".join(said) if said else quiet)
