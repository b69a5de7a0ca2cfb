"""Blocks of a recording, and the position of every sample in the load cycle.

Both follow from the signals of a programme. Without a programme, the recording is one block with the cycle of its reference.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.experiments.verification.period import cycle_of
from ehls_ros.trajectory import Trajectory

BLOCK, REPETITION, PHASE = "programme_block", "programme_repetition", "programme_phase"
"""Signals of a test programme: number of the block, load cycles completed in its present pass, phase in the cycle (0 to 1)."""


class Stretch(NamedTuple):
    """Consecutive samples of a block.

    Attributes:
        samples: slice of the recording.
        position: load cycles completed, with fraction, shape (n,) [cycles]; NaN for a non-periodic reference.
    """

    samples: slice
    position: Array


class Block(NamedTuple):
    """A part of a test with the same cycle throughout.

    Attributes:
        number: number in the programme; None for a whole recording.
        stretches: its stretches; several if it was repeated or interrupted.
    """

    number: int | None
    stretches: tuple[Stretch, ...]

    @property
    def name(self) -> str:
        """Name in reports."""
        return "whole recording" if self.number is None else f"block {self.number}"


def blocks_of(run: Trajectory) -> tuple[Block, ...]:
    """Return the blocks of a recording in the order of their first samples.

    Args:
        run: the recording, with ``force_reference_n``.
    """
    number = run.signals.get(BLOCK)
    if number is None or not np.isfinite(number).any():
        return (Block(None, (_stretch(run, slice(0, len(run)), told=False),)),)
    told = PHASE in run and REPETITION in run
    found: dict[int, list[Stretch]] = {}
    for value, samples in _runs(number):
        found.setdefault(value, []).extend(_passes(_stretch(run, samples, told=told)))
    return tuple(Block(value, tuple(stretches)) for value, stretches in found.items())


def _runs(number: Array) -> Iterator[tuple[int, slice]]:
    """Yield the parts of one number each; samples without a number within a part belong to it."""
    known = np.flatnonzero(np.isfinite(number))
    values = np.rint(number[known]).astype(np.int64)
    ends = np.flatnonzero(np.diff(values)) + 1
    for part in np.split(np.arange(len(known)), ends):
        yield int(values[part[0]]), slice(int(known[part[0]]), int(known[part[-1]]) + 1)


def _stretch(run: Trajectory, samples: slice, *, told: bool) -> Stretch:
    time, reference = run.time_s[samples], run["force_reference_n"][samples]
    if told:
        position = run[REPETITION][samples] + run[PHASE][samples]
        if np.isfinite(position).any():
            return Stretch(samples, position)
    found = cycle_of(time, reference, run.metadata)
    if found is None:
        return Stretch(samples, np.full(len(time), np.nan))
    begin = time[np.flatnonzero(np.isfinite(reference))[0]]
    # A cycle begins where the fundamental rises through the mean.
    rise = (np.angle(found.coefficient) + 0.5 * np.pi) / (2.0 * np.pi)
    return Stretch(samples, found.frequency * (time - begin) + rise % 1.0)


def _passes(stretch: Stretch) -> Iterator[Stretch]:
    """Split a stretch where the cycle count restarts."""
    known = np.flatnonzero(np.isfinite(stretch.position))
    back = known[1:][np.diff(stretch.position[known]) < -0.5]
    begin = stretch.samples.start
    edges = [0, *back.tolist(), len(stretch.position)]
    for low, high in pairwise(edges):
        yield Stretch(slice(begin + low, begin + high), stretch.position[low:high])
