"""Check motions read from a file against the programme and the rig that they are to move.

Every motion made by a :class:`~ehls_ros.control.programme.motion.Runner` passes. Any other motion is rejected if the reference
leaves the rig's range, rests at a value that the programme does not hold, or follows the programme faster than when resumed.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import CLOSE, Programme
from ehls_ros.control.programme.motion import Leg, Motion, Runner, along
from ehls_ros.schema import notes

Holds = Sequence[float | None]
"""Values held after a stop; None for the programme's value at the stop."""

MAX_LEGS = 3
"""Most legs of a motion: along the programme to a standstill, to another value, and along the programme again; or along it
faster, evenly and slower to the next reversal."""

MAX_MOTIONS = 100
"""Most motions: one for each request or decision of pacing within the control cycles whose snapshots the rig keeps."""

MAX_SKIPS = 10_000
"""Most skipped blocks."""

SHORTEST_LEG, LONGEST_LEG = 1e-9, 1e6
"""Shortest leg with a finite second derivative, and longest, which leads to the programme's start [s]."""

LONGEST_STOP = notes(Parameters)["stop_time"].maximum or math.inf
"""Largest distance of a stop beyond the programme's end [s]."""

SAMPLES = 65
"""Number of points at which a leg is checked."""

SLOWEST, FASTEST = -0.5, 1.5
"""Bounds of the programme's speed within legs: a stop that is resumed at once slightly exceeds 0 to 1."""

SAME = 1e-6
"""Relative difference below which two values are equal."""

OVERSHOOT = 2.0
"""Range of a leg that begins at the rig's value, relative to the rig's range: the rig may have exceeded its limits."""


def check_motions(
    motions: Sequence[Motion], programme: Programme, period: float, holds: Holds, low: float, high: float
) -> None:
    """Check motions.

    Args:
        motions: motions in the order of their control cycles.
        programme: the programme that they move.
        period: control period [s].
        holds: values held after a stop by the programme's settings when the motions were made; None for the value at the stop.
        low: smallest value of the rig [N] or [m].
        high: largest value of the rig.

    Raises:
        ValueError: a value is impossible; the first is named.
    """
    if not motions:
        raise ValueError("no motion holds")
    if len(motions) > MAX_MOTIONS:
        raise ValueError(f"{len(motions)} motions hold, at most {MAX_MOTIONS} can")
    firsts = [motion.first for motion in motions]
    if firsts[0] < 0 or any(later <= earlier for earlier, later in pairwise(firsts)):
        raise ValueError(f"the motions begin in the control cycles {firsts}, not one after the other")
    for motion in motions:
        _check_motion(motion, programme, holds, low, high)
    for before, after in pairwise(motions):
        was, becomes = (_value(programme, period, motion, after.first) for motion in (before, after))
        _check_step(was, becomes, f"in control cycle {after.first}")


def _value(programme: Programme, period: float, motion: Motion, cycle: int) -> float:
    return float(Runner(programme, period, (motion,)).rows(cycle, 1).reference[0, 0])


def _check_step(was: float, becomes: float, where: str) -> None:
    if not _same(was, becomes):
        raise ValueError(f"the reference jumps {where} from {was:g} to {becomes:g}")


def _same(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=SAME, abs_tol=SAME)


def _check_motion(motion: Motion, programme: Programme, holds: Holds, low: float, high: float) -> None:
    # A stop near the end comes to rest beyond it, where the programme holds its value.
    latest = programme.duration + LONGEST_STOP
    if len(motion.legs) > MAX_LEGS:
        raise ValueError(f"a motion has {len(motion.legs)} legs, at most {MAX_LEGS}")
    for name, since in (("motion", motion.since), *(("leg", leg.since) for leg in motion.legs)):
        if not 0.0 <= since <= latest:
            raise ValueError(f"a {name} is {since:g} s along the programme, which takes {programme.duration:g} s")
    if len(motion.skipped) > MAX_SKIPS or sum(skip.load_cycles for skip in motion.skipped) > programme.load_cycles:
        raise ValueError("more is skipped than the programme holds")
    if any(not 0.0 <= skip.to <= latest or skip.load_cycles < 0 for skip in motion.skipped):
        raise ValueError("a skipped block is not in the programme")
    if not 0.0 <= motion.speed <= 1.0:
        raise ValueError(f"a motion follows the programme at {motion.speed:g} times its speed")
    if (motion.rests is None) == (motion.kind == "stop"):
        raise ValueError(f"a motion of the kind {motion.kind!r} rests at {motion.rests}")
    ends = [_ends(leg, programme, low, high) for leg in motion.legs]
    last = programme.value(motion.since)
    if motion.rests is not None:
        last = motion.rests
        _check_rest(motion.rests, motion.since, programme, holds, low, high)
    for (_, end), (begin, _) in pairwise([*ends, (_Place(motion.since, last),) * 2]):
        _check_step(end.value, begin.value, "between two legs")
        if begin.since < end.since - CLOSE:
            raise ValueError(f"a leg goes back along the programme, from {end.since:g} s to {begin.since:g} s")


def _check_rest(rests: float, since: float, programme: Programme, holds: Holds, low: float, high: float) -> None:
    if not low <= rests <= high:
        raise ValueError(f"it rests at {rests:g}, the rig's range is {low:g} to {high:g}")
    possible = [programme.value(since), *(hold for hold in holds if hold is not None)]
    if since >= programme.duration - CLOSE:
        possible.append(programme.end)
    if not any(_same(rests, value) for value in possible):
        known = " or ".join(f"{value:g}" for value in possible)
        raise ValueError(f"it rests at {rests:g}, where the programme holds {known}")


class _Place(NamedTuple):
    """Programme time [s] and value at the beginning or the end of a leg."""

    since: float
    value: float


def _ends(leg: Leg, programme: Programme, low: float, high: float) -> tuple[_Place, _Place]:
    """Check a leg, and return its beginning and end."""
    if not SHORTEST_LEG <= leg.duration <= LONGEST_LEG:
        raise ValueError(f"a leg takes {leg.duration:g} s")
    path = along(leg, np.linspace(0.0, leg.duration, SAMPLES))
    if leg.row is None:
        if not (np.all(path.speed >= SLOWEST) and np.all(path.speed <= FASTEST)):
            raise ValueError(f"a leg goes along the programme at up to {np.max(np.abs(path.speed)):g} times its speed")
        begin, end = (_Place(since, programme.value(since)) for since in (float(path.since[0]), float(path.since[-1])))
        return begin, end
    middle, half = 0.5 * (low + high), 0.5 * OVERSHOOT * (high - low)
    furthest = float(np.max(np.abs(path.off[:, 0] - middle)))
    if not furthest <= half:
        raise ValueError(f"a leg leads {furthest:g} from the middle of the rig's range, {low:g} to {high:g}")
    return _Place(leg.since, float(path.off[0, 0])), _Place(leg.since, float(path.off[-1, 0]))
