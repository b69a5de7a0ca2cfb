"""The rig's health in words and as a level that does not flap."""

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
"""Group of the effects that are a sensor's fault; all others are the rig's."""

HOLD = 60.0
"""Time for which a level holds, unless it worsens [s]."""

GOOD, WARNING = range(2)
"""Levels, as those of diagnostics."""

OFTEN_OUTSIDE = 0.1
"""Fraction of blocks outside what the baseline covers from which that is said."""

UNIX_TIME_NS = 10**18
"""Later stamps are of the wall clock; earlier ones count from the beginning of a run in lockstep."""

WEEK_NS = 6 * 86400 * 10**9
"""Time for which a weekday tells the day [ns]."""

INTERVAL = 1.96
"""Standard errors from the middle to the end of a 95 % interval."""

Wall = Callable[[float], int]
"""The stamp of an instant on the monitor's axis [ns]; 0: unknown."""


def today() -> date:
    """Return the day in the local time zone."""
    return datetime.now().astimezone().date()


class Word(NamedTuple):
    """Level and sentence."""

    level: int
    sentence: str


class HeldLevel:
    """A level that holds a while before it improves, with the sentence that belongs to it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without a level; ``clock`` returns the time [s]."""
        self._clock = clock
        self._held: Word | None = None
        self._since = 0.0

    def release(self) -> None:
        """Let the next word count whatever it is: an operator has acted."""
        self._held = None

    def take(self, word: Word) -> Word:
        """Return what to tell where this is so now."""
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
    """Say what changed, by how much, and since when.

    Args:
        change: the change.
        rig: the rig as its file describes it, which a size is measured by.
        wall: the stamps along the monitor's axis.
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
    """Return a size: as a factor on its right value where it has one."""
    known = _tracked(effect, parameter)
    name = known.words if known else parameter.replace("_", " ")
    given = known.given(rig) if known and known.coefficient and not known.relative else 0.0
    if known and (known.relative or given):
        factor, deviation = (1.0 + value.value / given, value.std / abs(given)) if given else (value.value, value.std)
        return f"{name} {factor:.3g} × ± {INTERVAL * deviation:.1g}"
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{name} {value.value:.3g} ± {INTERVAL * value.std:.1g}{unit}"


def moment(stamp_ns: int, now_ns: int) -> str:
    """Return an instant as an operator would write it: weekday and time, or the date where that is long ago.

    Args:
        stamp_ns: the instant [ns].
        now_ns: the present [ns].
    """
    if stamp_ns < UNIX_TIME_NS:
        return f"{stamp_ns * 1e-9:.1f} s" if stamp_ns else "before the watch"
    wall = datetime.fromtimestamp(stamp_ns * 1e-9).astimezone()
    return wall.strftime("%Y-%m-%d %H:%M" if now_ns - stamp_ns > WEEK_NS else "%a %H:%M")


def word(health: Health, rig: Rig, wall: Wall) -> Word:
    """Return level and sentence of the rig's health: a warning while a change shows that no operator has seen.

    Args:
        health: as the monitor knows it.
        rig: the rig as its file describes it.
        wall: the stamps along the monitor's axis.
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
