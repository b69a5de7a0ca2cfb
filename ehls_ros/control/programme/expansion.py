"""Evaluate a programme as a function of time, without unrolling its repeats.

Each repeat consists of its first pass, entered from the value before it, and the later passes, which are identical as all are
entered from the repeat's final value. A time is located by bisection in each enclosing repeat.

Blocks begin and end at rest. If a block begins at another value than the programme's present one, a ramp of the programme's
``transition`` time comes first: it belongs to that block but to none of its load cycles. Thus value and rate are continuous;
the second derivative may jump where load cycles begin and end.
"""

import math
import pickle
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks import BLOCKS
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.control.programme.declaration import Leaf, Parameters, Repeat, tree_of
from ehls_ros.control.references import ramp
from ehls_ros.errors import BadInput

CLOSE = 1e-7
"""Tolerance within which a sample is assigned to a boundary of a block or load cycle, to allow for rounding [s]."""

SHORT = 1e-6
"""Time before a reversal at which static pacing waits, so that the wait is part of the load cycle that ends there [s]."""

MIN_STEPS, MAX_STEPS = 20, 200_000
"""Fewest and most samples of a load cycle, or of a block without load cycles, in which reversals are searched."""

SLOWEST_RATE = 1e-6
"""Rate that counts as zero, as a fraction of the largest."""

MAX_PASSED = 100
"""Most reversals within the tolerance, or blocks without any, such as dwells, that static pacing passes without a wait."""

LONGEST = 1e8
"""Longest programme, up to which times are exact to 15 ns [s]."""


class Segment(NamedTuple):
    """A block, or the ramp that leads to it.

    Attributes:
        leaf: the block.
        start: value before it.
        course: course of the block or of the ramp.
        leads: whether it is the ramp.
    """

    leaf: Leaf
    start: float
    course: Course
    leads: bool

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.course.duration

    @property
    def load_cycles(self) -> int:
        """Number of load cycles."""
        return self.course.count

    def sample(self, t: Array) -> Array:
        """Return value, first and second derivative at times since its beginning [s], shape (n, 3)."""
        if self.leads:
            return ramp.sample(t, ramp.Parameters(self.start, self.course.end, self.course.duration))
        return BLOCKS.load(self.leaf.kind).sample(t, self.leaf.parameters, self.start)


class Sequence(NamedTuple):
    """Consecutive parts, each run several times.

    Attributes:
        parts: the parts.
        counts: passes of each part.
        starts: start time of each part [s], shape (parts,).
        before: load cycles before each part.
        duration: total duration [s].
        load_cycles: total number of load cycles.
    """

    parts: tuple["Segment | Sequence", ...]
    counts: tuple[int, ...]
    starts: Array
    before: tuple[int, ...]
    duration: float
    load_cycles: int


class Spot(NamedTuple):
    """Position in a programme at a time.

    Attributes:
        segment: block or ramp at that time.
        since: start time of its present pass [s].
        before: load cycles of the programme before this pass.
    """

    segment: Segment
    since: float
    before: int

    @property
    def end(self) -> float:
        """End time of the pass [s]."""
        return self.since + self.segment.duration


class Points(NamedTuple):
    """Positions in a programme at some times, one entry each.

    Attributes:
        block: number of the block in the order of the file.
        repetition: load cycles completed in the present pass of the block.
        load_cycles: load cycles completed since the programme's beginning.
        phase: 0 to 1 within the load cycle, NaN if nothing repeats.
    """

    block: NDArray[np.int64]
    repetition: NDArray[np.int64]
    load_cycles: NDArray[np.int64]
    phase: Array

    @classmethod
    def empty(cls, count: int) -> "Points":
        """Return points to be filled in: block 0, no cycles completed, NaN phase."""
        block, repetition, load_cycles = (np.zeros(count, np.int64) for _ in range(3))
        return cls(block, repetition, load_cycles, np.full(count, np.nan))


class Programme:
    """Expanded programme.

    Attributes:
        parameters: the declaration.
        leaves: its blocks in the order of the file.
        whole: its parts.
        duration: total duration [s].
        load_cycles: total number of load cycles.
        end: final value, which is held.
    """

    def __init__(self, parameters: Parameters, where: str = "programme") -> None:
        """Expand a declaration.

        Args:
            parameters: the programme.
            where: the file, for error messages.

        Raises:
            BadInput: a block is wrong, or the programme is too long.
        """
        self.parameters = parameters
        tree = tree_of(parameters, where)
        self.leaves = tuple(_leaves(tree))
        self._known: dict[tuple[int, float], tuple[Sequence, float]] = {}
        self._reversals: dict[tuple[int, float, bool], Array] = {}
        self._where = where
        self.whole, self.end = self._sequence(tree, parameters.start)
        self.duration, self.load_cycles = self.whole.duration, self.whole.load_cycles
        if not self.duration <= LONGEST:
            raise BadInput(f"the programme takes {self.duration:.3g} s", where, f"at most {LONGEST:g} s")

    @property
    def is_paced(self) -> bool:
        """Whether any block has pacing."""
        return any(leaf.pacing.mode != "none" for leaf in self.leaves)

    def spot(self, time: float) -> Spot:
        """Return the position at a time [s]: before the start in the first block, after the end in the last."""
        part: Segment | Sequence = self.whole
        since, before = 0.0, 0
        while isinstance(part, Sequence):
            i = max(int(np.searchsorted(part.starts, time - since + CLOSE, side="right")) - 1, 0)
            since, before = since + float(part.starts[i]), before + part.before[i]
            count, part = part.counts[i], part.parts[i]
            passes = min(max(int((time - since + CLOSE) / part.duration), 0), count - 1)
            since, before = since + passes * part.duration, before + passes * part.load_cycles
        return Spot(part, since, before)

    def leaf(self, time: float) -> Leaf:
        """Return the block at a time [s]."""
        return self.spot(time).segment.leaf

    def sample(self, t: Array) -> Array:
        """Return value, first and second derivative at times [s], shape (n,), as shape (n, 3); the end values are held."""
        rows = np.zeros((t.size, 3))
        for chosen, spot in self._walk(t):
            local = t[chosen] - spot.since
            rows[chosen] = spot.segment.sample(np.clip(local, 0.0, spot.segment.duration))
        rows[t >= self.duration] = (self.end, 0.0, 0.0)
        rows[t < 0.0] = (self.parameters.start, 0.0, 0.0)
        return rows

    def value(self, time: float) -> float:
        """Return the value at a time [s]."""
        return float(self.sample(np.array([time]))[0, 0])

    def points(self, t: Array) -> Points:
        """Return the positions at times [s], shape (n,)."""
        points = Points.empty(t.size)
        for chosen, spot in self._walk(t):
            course = spot.segment.course
            points.block[chosen] = spot.segment.leaf.number
            points.load_cycles[chosen] = spot.before
            if course.cycle == 0.0:
                continue
            cycles = np.clip((t[chosen] - spot.since) / course.cycle, 0.0, course.count)
            done = np.floor(cycles + CLOSE / course.cycle).astype(np.int64)
            points.repetition[chosen] = done
            points.load_cycles[chosen] += done
            # At the very end of the programme nothing repeats.
            points.phase[chosen] = np.where(done < course.count, np.maximum(cycles - done, 0.0), np.nan)
        return points

    def reversal(self, after: float) -> float | None:
        """Return the first time after another at which static pacing waits [s]; None if there is none before other pacing.

        These are the times at which the value turns back or comes to rest, by more than the tolerance from the present value.
        """
        value, time = self.value(after), self._turning_after(after)
        for _ in range(MAX_PASSED):
            if time is None or abs(self.value(time) - value) > (self.leaf(time - SHORT).pacing.tolerance or 0.0):
                break
            time = self._turning_after(time)
        return time

    def _turning_after(self, after: float) -> float | None:
        for _ in range(MAX_PASSED):
            spot = self.spot(after)
            if spot.segment.leaf.pacing.mode == "dynamic":
                return None
            course, times = spot.segment.course, self._turning(spot.segment)
            if times.size:
                local, period = after - spot.since, course.cycle or course.duration
                first = math.floor(max(local, 0.0) / period)
                found = np.append(np.add.outer([first * period, (first + 1) * period], times), course.duration)
                found = np.minimum(found, course.duration)
                if (later := found[found > local + CLOSE]).size:
                    return spot.since + float(later.min())
            if spot.end >= self.duration - CLOSE:
                return None
            after = spot.end
        return after

    def _turning(self, segment: Segment) -> Array:
        """Return the times of the reversals within a load cycle, or within a block without load cycles [s]."""
        key = segment.leaf.number, segment.start, segment.leads
        if key not in self._reversals:
            paced = segment.leaf.pacing.mode == "static"
            self._reversals[key] = reversals(segment) if paced else np.empty(0)
        return self._reversals[key]

    def _walk(self, t: Array) -> Iterator[tuple[NDArray[np.intp], Spot]]:
        """Yield each visited pass of a block or ramp with the indices of its times, in order of time."""
        order = np.argsort(t, kind="stable")
        ordered = t[order]
        at = 0
        while at < t.size:
            spot = self.spot(float(ordered[at]))
            # The last block also includes all later times.
            last = spot.end >= self.duration - CLOSE
            end = t.size if last else max(int(np.searchsorted(ordered, spot.end - CLOSE)), at + 1)
            yield order[at:end], spot
            at = end

    def _sequence(self, repeat: Repeat, start: float) -> tuple[Sequence, float]:
        """Return one pass of a repeat that is entered at a value, and its final value."""
        key = id(repeat), start
        if key not in self._known:
            parts: list[tuple[Segment | Sequence, int]] = []
            value = start
            for part in repeat.parts:
                if isinstance(part, Leaf):
                    made, value = self._segments(part, value)
                    parts += [(segment, 1) for segment in made]
                    continue
                first, value = self._sequence(part, value)
                parts.append((first, 1))
                if part.count > 1:
                    later, value = self._sequence(part, value)
                    parts.append((later, part.count - 1))
            self._known[key] = _joined(parts), value
        return self._known[key]

    def _segments(self, leaf: Leaf, value: float) -> tuple[list[Segment], float]:
        """Return a block, with a ramp before it if it begins at another value, and its final value."""
        try:
            course = BLOCKS.load(leaf.kind).course(leaf.parameters, value)
        except BadInput as error:
            raise BadInput(
                error.what, f"{self._where}: block {leaf.number} ({leaf.name}): {error.where}", error.expected
            ) from None
        segments = [Segment(leaf, value, course, leads=False)]
        if course.begin != value:
            time = self.parameters.transition
            lead = Course(value, course.begin, time, 0.0, 0, 0.1 * time)
            segments.insert(0, Segment(leaf, value, lead, leads=True))
            segments[1] = segments[1]._replace(start=course.begin)
        return segments, course.end


def reversals(segment: Segment) -> Array:
    """Return the times at which the value turns back or comes to rest, within a load cycle or without any in the segment [s].

    Of several load cycles it is the middle one: noise is faded at the ends of its block.
    """
    course = segment.course
    period = course.cycle or course.duration
    steps = int(np.clip(period / course.step, MIN_STEPS, MAX_STEPS))
    t = np.linspace(0.0, period, steps + 1)
    rate = segment.sample(course.count // 2 * course.cycle + t)[:, 1]
    rate[np.abs(rate) <= SLOWEST_RATE * np.abs(rate).max()] = 0.0
    sign = np.sign(rate)
    # A single zero between equal signs is a point of inflection.
    sign[1:-1] = np.where(sign[:-2] == sign[2:], sign[2:], sign[1:-1])
    before = np.flatnonzero((sign[:-1] != 0.0) & (sign[1:] != sign[:-1]))
    share = rate[before] / (rate[before] - rate[before + 1])
    found: Array = t[before] + share * period / steps
    return found


def _joined(parts: list[tuple[Segment | Sequence, int]]) -> Sequence:
    times = np.cumsum([0.0, *(part.duration * count for part, count in parts)])
    before = [0]
    for part, count in parts:
        before.append(before[-1] + part.load_cycles * count)
    made, counts = zip(*parts, strict=True)
    return Sequence(made, counts, times[:-1], tuple(before[:-1]), float(times[-1]), before[-1])


def _leaves(repeat: Repeat) -> Iterator[Leaf]:
    for part in repeat.parts:
        if isinstance(part, Leaf):
            yield part
        else:
            yield from _leaves(part)


class _Declared:
    """A programme's parameters, hashed and compared by content."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self._content = (
            pickle.dumps(parameters._replace(blocks=(), limits=None)),
            pickle.dumps((parameters.blocks, parameters.limits)),
        )

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Declared) and self._content == other._content


@lru_cache(maxsize=8)
def _expanded(declared: _Declared) -> Programme:
    return Programme(declared.parameters)


def programme_of(parameters: Any) -> Programme:
    """Return the expanded programme of some parameters; cached, as it is needed for every block of cycles.

    Raises:
        BadInput: a block is wrong.
    """
    return _expanded(_Declared(parameters))
