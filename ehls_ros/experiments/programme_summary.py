"""Summary of a test programme: each block's duration, load cycles, extremes and rates, and the rainflow counts."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, in_python
from ehls_ros.control.programme.expansion import Programme, Segment
from ehls_ros.control.programme.expansion import Sequence as Parts
from ehls_ros.errors import BadInput
from ehls_ros.extras import library
from ehls_ros.physics.equations import load_flow, load_pressure_rate
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

MAX_SAMPLES = 200_000
"""Maximum number of samples of a load cycle, or of a block without load cycles."""

MIN_SAMPLES = 20
"""Minimum number of these samples."""

BINS = 32
"""Number of classes of the largest range for the printed counts."""

SAME = 1e-6
"""Difference below which ranges and means count as equal, as a fraction of the programme's range."""

Counts = tuple[tuple[float, float, float], ...]
"""Range, mean and number of rainflow cycles, the largest range first."""


class Block(NamedTuple):
    """One block of the file, over all its passes.

    Attributes:
        name: name of the block.
        kind: its kind.
        passes: number of passes.
        load_cycles: number of load cycles.
        duration_s: duration, including the ramps that lead to it [s].
        peak_n: largest value.
        valley_n: smallest value.
        largest_rate_n_s: largest rate.
    """

    name: str
    kind: str
    passes: int
    load_cycles: int
    duration_s: float
    peak_n: float
    valley_n: float
    largest_rate_n_s: float


class Summary(NamedTuple):
    """Summary of a programme.

    Attributes:
        title: title of the programme.
        duration_s: duration [s].
        load_cycles: number of load cycles.
        ramps: number of automatic ramps between blocks.
        largest_rate_n_s: largest rate.
        possible_rate_n_s: rate possible with the rig's valve at the programme's largest force, with the piston at rest.
        blocks: its blocks.
        complaints: demands beyond the rig's limits.
        rainflow: cycles of the whole programme.
        recorded: cycles of a recorded force; None if not requested.
    """

    title: str
    duration_s: float
    load_cycles: int
    ramps: int
    largest_rate_n_s: float
    possible_rate_n_s: float
    blocks: tuple[Block, ...]
    complaints: tuple[str, ...]
    rainflow: Counts
    recorded: Counts | None = None


def summary_of(programme: Programme, rig: Rig) -> Summary:
    """Summarise a programme for a rig.

    Args:
        programme: the programme, of forces.
        rig: the rig.

    Raises:
        BadInput: the library for counting is not installed.
    """
    blocks = [Block(leaf.name, leaf.kind, 0, 0, 0.0, -math.inf, math.inf, 0.0) for leaf in programme.leaves]
    ramps = 0
    for segment, passes in _segments(programme.whole, 1):
        rows = _rows(segment)
        block = blocks[segment.leaf.number]
        ramps += passes * segment.leads
        blocks[segment.leaf.number] = block._replace(
            passes=block.passes + passes * (not segment.leads),
            load_cycles=block.load_cycles + passes * segment.load_cycles,
            duration_s=block.duration_s + passes * segment.duration,
            peak_n=max(block.peak_n, float(rows[:, 0].max())),
            valley_n=min(block.valley_n, float(rows[:, 0].min())),
            largest_rate_n_s=max(block.largest_rate_n_s, float(np.abs(rows[:, 1]).max())),
        )
    largest = max(max(abs(block.peak_n), abs(block.valley_n)) for block in blocks)
    rate = max(block.largest_rate_n_s for block in blocks)
    possible = possible_rate(rig, largest)
    complaints = [
        f"{block.name} reaches {max(abs(block.peak_n), abs(block.valley_n)):g} N, the rig's limit is {rig.limits.force:g} N"
        for block in blocks
        if max(abs(block.peak_n), abs(block.valley_n)) > rig.limits.force
    ]
    complaints += [
        f"{block.name} needs {block.largest_rate_n_s:.3g} N/s, the rig reaches {possible:.3g} N/s"
        for block in blocks
        if block.largest_rate_n_s > possible
    ]
    title = programme.parameters.title
    return Summary(
        title,
        programme.duration,
        programme.load_cycles,
        ramps,
        rate,
        possible,
        tuple(blocks),
        tuple(complaints),
        rainflow_of(programme),
    )


def possible_rate(rig: Rig, force: float) -> float:
    """Return the force rate possible with the rig's valve at a force, by (1) and (2) of the paper, piston at rest [N/s].

    Args:
        rig: the rig.
        force: the force [N].
    """
    p = rig.plant
    pressure = min(abs(force) / p.piston_area, p.supply_pressure)
    flow = in_python(load_flow)(p.valve_gain * rig.limits.spool, 1.0, pressure, p.supply_pressure, p)
    return p.piston_area * in_python(load_pressure_rate)(flow, 0.0, pressure, 0.0, p.bulk_modulus, p)


def _segments(part: Segment | Parts, passes: int) -> Iterator[tuple[Segment, int]]:
    """Yield the blocks and ramps with the number of their passes."""
    if isinstance(part, Segment):
        yield part, passes
        return
    for inner, count in zip(part.parts, part.counts, strict=True):
        yield from _segments(inner, passes * count)


def _rows(segment: Segment) -> Array:
    """Sample a load cycle within a block, or the whole block, without missing a turning point."""
    course = segment.course
    time = min(course.duration, 2.0 * course.cycle) if course.cycle else course.duration
    count = _samples(time, course.step)
    rows = segment.sample(np.linspace(0.0, time, count + 1))
    if course.count < 3:
        return rows
    # The beginning and the end of a block may differ from its load cycles.
    last = segment.sample(np.linspace(course.duration - course.cycle, course.duration, count // 2 + 1))
    return np.concatenate([rows, last])


def rainflow_of(programme: Programme) -> Counts:
    """Count the rainflow cycles of a programme by ASTM E1049, as implemented in the library `rainflow`.

    Repeated parts are counted once: a further pass between two others adds the cycles of a closed loop.

    Args:
        programme: the programme.

    Raises:
        BadInput: the library is not installed.
    """
    history, inner = _counted(programme.whole)
    start = [programme.parameters.start]
    return _sorted(_cycles([*start, *history]) + inner)


def counted(trajectory: Trajectory, where: str) -> Counts:
    """Count the rainflow cycles of a recorded force.

    Args:
        trajectory: the recording.
        where: its name, for errors.

    Raises:
        BadInput: there is no force, or the library is not installed.
    """
    if "force_n" not in trajectory:
        raise BadInput("the recording has no force_n", where, "a recording of a force")
    force = trajectory["force_n"]
    return _sorted(_cycles(force[np.isfinite(force)].tolist()))


def _counted(part: Segment | Parts) -> tuple[list[float], "Counter[tuple[float, float]]"]:
    """Return the turning points of a part with at most two passes each, and the cycles of the other passes."""
    if isinstance(part, Segment):
        return _of_segment(part)
    history: list[float] = []
    inner: Counter[tuple[float, float]] = Counter()
    for one, count in zip(part.parts, part.counts, strict=True):
        points, closed = _counted(one)
        history += points * min(count, 2)
        inner.update({key: number * count for key, number in closed.items()})
        if count > 2:
            inner.update({key: number * (count - 2) for key, number in _closed(points).items()})
    return _turning(history), inner


def _of_segment(segment: Segment) -> tuple[list[float], "Counter[tuple[float, float]]"]:
    course = segment.course
    if not course.cycle or course.count < 4:
        return _turning(_values(segment, 0.0, course.duration)), Counter()
    # The first and the last load cycle may differ from the others due to fades.
    ends = [_turning(_values(segment, at, at + course.cycle)) for at in (0.0, course.duration - course.cycle)]
    between = _turning(_values(segment, course.cycle, 2.0 * course.cycle))
    inner = Counter({key: number * (course.count - 4) for key, number in _closed(between).items()})
    return _turning([*ends[0], *between, *between, *ends[1]]), inner


def _values(segment: Segment, begin: float, end: float) -> list[float]:
    at = np.linspace(begin, end, _samples(end - begin, segment.course.step) + 1)
    values: list[float] = segment.sample(at)[:, 0].tolist()
    return values


def _samples(time: float, step: float) -> int:
    """Return the number of samples for a duration, one step apart if possible; both in s."""
    return int(np.clip(math.ceil(time / step), MIN_SAMPLES, MAX_SAMPLES))


def _turning(values: Sequence[float]) -> list[float]:
    """Return the first and the last value, and the turning points between them."""
    points = np.asarray(values)
    points = points[np.append(True, np.diff(points) != 0.0)]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(points))) != 0.0) + 1
    kept: list[float] = points[np.unique([0, *turns, len(points) - 1])].tolist()
    return kept


def _closed(points: list[float]) -> "Counter[tuple[float, float]]":
    """Return the cycles added by one more pass of a history."""
    more, fewer = _cycles(points * 4), _cycles(points * 3)
    more.subtract(fewer)
    return Counter({key: number for key, number in more.items() if number > 0.0})


def _cycles(values: Sequence[float]) -> "Counter[tuple[float, float]]":
    """Return the number of cycles by range and mean, both rounded to a fraction of the values' range."""
    rainflow = library("rainflow", "programme", "ehls programme")
    span = max(values) - min(values)
    step = 10.0 ** math.floor(math.log10(span * SAME)) if span > 0.0 else 1.0
    found: Counter[tuple[float, float]] = Counter()
    for size, mean, number, _, _ in rainflow.extract_cycles(_turning(values)):
        found[round(size / step) * step, round(mean / step) * step] += number
    return found


def _sorted(cycles: "Counter[tuple[float, float]]") -> Counts:
    return tuple((size, mean, number) for (size, mean), number in sorted(cycles.items(), reverse=True))


def in_bins(counts: Counts) -> Counts:
    """Group rainflow cycles in classes of range and mean, few enough for a table.

    Args:
        counts: the cycles.

    Returns:
        The mean range and the mean of each class, weighted by its cycles, and their number.
    """
    if not counts:
        return ()
    width = max(size for size, _, _ in counts) / BINS or 1.0
    classes: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
    for entry in counts:
        classes.setdefault((round(entry[0] / width), round(entry[1] / width)), []).append(entry)
    binned = []
    for entries in classes.values():
        total = sum(number for _, _, number in entries)
        binned.append((*(sum(e[i] * e[2] for e in entries) / total for i in (0, 1)), total))
    return tuple((size, mean, number) for size, mean, number in sorted(binned, reverse=True))
