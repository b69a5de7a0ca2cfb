"""Back-and-forth strokes at a series of constant velocities, to identify static friction.

A stroke accelerates and decelerates at a constant rate and holds its velocity in between. Each stroke begins and ends at rest;
the strokes of one velocity are centred, and the move to the start of the next ones uses the larger of the two velocities. The
sweep ends where it began and then holds its position.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.schema import quantity, text

PAPER_VELOCITIES = (
    *(0.002, 0.003, 0.004, 0.006, 0.008, 0.010, 0.012, 0.014, 0.016, 0.020),
    *(0.025, 0.030, 0.045, 0.060, 0.075, 0.090, 0.105, 0.120, 0.135, 0.150),
)
"""The paper's velocities, each in both directions [m/s]."""


class Parameters(NamedTuple):
    """The velocities and the strokes; the defaults are the paper's 40 velocities, six times."""

    velocities: Annotated[tuple[float, ...], text("velocities, each used in both directions [m/s]")] = PAPER_VELOCITIES
    repeats: Annotated[int, quantity("1", "number of passes through all velocities", minimum=1, maximum=1000)] = 6
    travel: Annotated[float, quantity("m", "longest stroke", above=0.0, maximum=10.0)] = 0.5
    longest: Annotated[float, quantity("s", "longest time of a stroke at its velocity", above=0.0, maximum=1e4)] = 6.0
    acceleration: Annotated[float, quantity("m/s^2", "acceleration at the ends of a stroke", above=0.0, maximum=100.0)] = 0.25
    rest: Annotated[float, quantity("s", "rest before every stroke", minimum=0.0, maximum=1e3)] = 0.5
    centre: Annotated[float, quantity("m", "position the strokes are centred on", minimum=-10.0, maximum=10.0)] = 0.0


class _Moves(NamedTuple):
    """Moves in sequence, shape (n,) each; ``end`` is the end time of the last [s]."""

    start: Array
    origin: Array
    way: Array
    velocity: Array
    end: float


def duration(p: Parameters) -> float:
    """Return the duration of the sweep [s].

    Raises:
        BadInput: as :func:`sample`.
    """
    return _moves(p).end


def sample(t: Array, p: Parameters) -> Array:
    """Return position, velocity and acceleration.

    Raises:
        BadInput: there are no velocities, one is not above 0, or one cannot be reached within its stroke.
    """
    moves = _moves(p)
    index = np.maximum(np.searchsorted(moves.start, t, side="right") - 1, 0)
    way, velocity = moves.way[index], moves.velocity[index]
    distance, direction = np.abs(way), np.sign(way)
    rising = velocity / p.acceleration
    whole = rising + distance / velocity
    since = np.clip(t - moves.start[index], 0.0, whole)
    left = whole - since
    gone = np.where(
        since < rising,
        0.5 * p.acceleration * since**2,
        np.where(left < rising, distance - 0.5 * p.acceleration * left**2, velocity * (since - 0.5 * rising)),
    )
    rate = np.minimum(velocity, p.acceleration * np.minimum(since, left))
    moving = (since > 0.0) & (left > 0.0)
    acceleration = np.where(moving, p.acceleration * (1.0 * (since < rising) - 1.0 * (left < rising)), 0.0)
    return np.column_stack([moves.origin[index] + direction * gone, direction * rate, direction * acceleration])


def _stroke(velocity: float, p: Parameters) -> float:
    return min(p.travel, velocity * p.longest)


@lru_cache(maxsize=4)
def _moves(p: Parameters) -> _Moves:
    """Return the moves in sequence; cached, as they are needed for every block of cycles."""
    if not p.velocities:
        raise BadInput("velocities is empty", "velocity_sweep", "one velocity or more")
    for index, velocity in enumerate(p.velocities):
        if not (math.isfinite(velocity) and velocity > 0.0):
            raise BadInput(f"velocities[{index}] is {velocity:g}", "velocity_sweep", "a finite number above 0 [m/s]")
        if velocity**2 >= p.acceleration * _stroke(velocity, p):
            what = f"velocities[{index}] is {velocity:g}, which a stroke of {_stroke(velocity, p):g} m is too short for"
            raise BadInput(what, "velocity_sweep", "more travel, longest or acceleration")
    starts, origins, ways, velocities = [], [], [], []
    time, position = 0.0, p.centre
    for target, velocity in _targets(p):
        way = target - position
        if way == 0.0:
            continue
        # A move too short for its velocity uses the highest velocity that it can reach.
        reached = min(velocity, math.sqrt(p.acceleration * abs(way)))
        time += p.rest
        starts.append(time)
        origins.append(position)
        ways.append(way)
        velocities.append(reached)
        time += reached / p.acceleration + abs(way) / reached
        position = target
    return _Moves(np.array(starts), np.array(origins), np.array(ways), np.array(velocities), time)


def _targets(p: Parameters) -> Iterator[tuple[float, float]]:
    """Yield the end position of each move, and its velocity."""
    last = 0.0
    for velocity in p.velocities * p.repeats:
        half = 0.5 * _stroke(velocity, p)
        yield p.centre - half, max(velocity, last)
        yield p.centre + half, velocity
        yield p.centre - half, velocity
        last = velocity
    yield p.centre, last
