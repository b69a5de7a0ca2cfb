"""Count load cycles from the rig's measurements, and check them against the programme's limits.

A limit is also violated if its quantity cannot be judged. This is so if the measured value or the position is not finite for
:data:`UNMEASURED` consecutive control cycles, or throughout a shorter load cycle. It is also so if one of them is constant in a
load cycle whose stiffness is limited. A load cycle without received samples, as during an outage of the counting program, is
not judged.
"""

import math
from typing import NamedTuple

from ehls_ros.control.programme.declaration import Limits
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import State

UNMEASURED = 10
"""Consecutive control cycles without a finite measurement after which each limit on that measurement is violated."""

VALUE, POSITION = "measured value", "position of the piston"
"""Names of the measurements: the force or position that the programme prescribes, and the position of the piston."""


class LoadCycle(NamedTuple):
    """Measurements of a load cycle; NaN if missing.

    Attributes:
        load_cycle: number since the programme's beginning, from 1.
        block: number of its block in the order of the file.
        cycle: number in the present pass of the block, from 1.
        peak: largest value.
        valley: smallest value.
        mean: mean over the samples.
        reference_peak: largest value of the reference.
        reference_valley: smallest value of the reference.
        error: largest difference from the reference.
        lowest_position: smallest position of the piston [m].
        highest_position: largest position of the piston [m].
        stiffness: range of the values over the range of the positions [N/m].
        samples: number of its control cycles that were received.
        first: first control cycle received.
        last: last control cycle received.
    """

    load_cycle: int
    block: int
    cycle: int
    peak: float
    valley: float
    mean: float
    reference_peak: float
    reference_valley: float
    error: float
    lowest_position: float
    highest_position: float
    stiffness: float
    samples: int
    first: int
    last: int


class Sample(NamedTuple):
    """Control cycle of a programme, with its measurements.

    Attributes:
        cycle: number of the control cycle.
        block: number of the block.
        repetition: load cycles completed in the block's pass.
        load_cycles: load cycles completed since the beginning.
        phase: 0 to 1 within the load cycle, NaN if nothing repeats.
        state: state of the programme.
        reference: wanted value.
        measured: measured value.
        position: position of the piston [m].
    """

    cycle: int
    block: int
    repetition: int
    load_cycles: int
    phase: float
    state: int
    reference: float
    measured: float
    position: float


class Stiffness(NamedTuple):
    """Mean stiffness of a block's first load cycles: the block, the sum [N/m], and the number of cycles in it."""

    block: int
    total: float
    cycles: int


class Counter:
    """Counts load cycles; each is completed by the first sample after it.

    Attributes:
        complaint: first violated limit since it was cleared; empty if none.
        since: first control cycle of the present load cycle; None if there is none.
    """

    def __init__(self, programme: Programme, done: int = 0, known: tuple[Stiffness, ...] = ()) -> None:
        """Start counting.

        Args:
            programme: the programme.
            done: load cycles counted before, which are not counted again.
            known: stiffness of blocks that ran before.
        """
        self._leaves = programme.leaves
        self.done = done
        self.complaint = ""
        self._without_value = self._without_position = 0
        self._stiffness = {entry.block: entry for entry in known}
        self._open: _Open | None = None

    @property
    def since(self) -> int | None:
        """First control cycle of the present load cycle; None if there is none."""
        return self._open.first if self._open else None

    @property
    def stiffness(self) -> tuple[Stiffness, ...]:
        """Stiffness of the blocks run so far."""
        return tuple(self._stiffness.values())

    def add(self, sample: Sample) -> list[LoadCycle]:
        """Process the next control cycle, and return the load cycles that it completes: more than one after a gap."""
        finished: list[LoadCycle] = []
        if sample.load_cycles > self.done:
            finished = self._finish(sample)
        if self._open is not None and self._open.block != sample.block:
            # The remainder of the block was skipped.
            self._open = None
        if sample.load_cycles == self.done:
            if self._open is None and not math.isnan(sample.phase):
                self._open = _Open(sample)
            # A wait belongs to the load cycle in which it occurs.
            if self._open is not None and (sample.state == State.WAITING or not math.isnan(sample.phase)):
                self._open.add(sample)
        if sample.state in {State.RUNNING, State.WAITING}:
            self._watch(sample)
        return finished

    def _finish(self, sample: Sample) -> list[LoadCycle]:
        made = []
        while self.done < sample.load_cycles:
            self.done += 1
            cycle = self._open.closed(self.done) if self._open else _unseen(self.done, sample)
            self._open = None
            made.append(cycle)
            self._judge(cycle)
        return made

    def _watch(self, sample: Sample) -> None:
        """Check the limits that apply at any time."""
        limits = self._leaves[sample.block].limits
        self._without_value = 0 if math.isfinite(sample.measured) else self._without_value + 1
        self._without_position = 0 if math.isfinite(sample.position) else self._without_position + 1
        if not math.isnan(sample.phase) and sample.repetition < limits.settling:
            return
        where = f"control cycle {sample.cycle}"
        for missing, limited, what in (
            (self._without_value, limits.of_value, VALUE),
            (self._without_position, limits.of_position, POSITION),
        ):
            if limited and missing >= UNMEASURED:
                self._complain(f"the {what} has been missing for {missing} control cycles", sample.block, where)
        away = abs(sample.measured - sample.reference)
        if limits.error is not None and away > limits.error:
            self._complain(f"the error is {away:g}, its limit {limits.error:g}", sample.block, where)
        if limits.position is not None and _outside(sample.position, limits.position):
            what = f"the position is {sample.position:g} m, out of {limits.position[0]:g} to {limits.position[1]:g} m"
            self._complain(what, sample.block, where)

    def _judge(self, cycle: LoadCycle) -> None:
        limits = self._leaves[cycle.block].limits
        if cycle.cycle <= limits.settling or not cycle.samples:
            return
        where = f"load cycle {cycle.load_cycle}"
        for value, limited, what in (
            (cycle.peak, limits.of_value, VALUE),
            (cycle.highest_position, limits.of_position, POSITION),
        ):
            if limited and math.isnan(value):
                self._complain(f"the {what} is missing", cycle.block, where)
        for name, value, window in (("peak", cycle.peak, limits.peak), ("valley", cycle.valley, limits.valley)):
            if window is not None and _outside(value, window):
                self._complain(f"the {name} is {value:g}, out of {window[0]:g} to {window[1]:g}", cycle.block, where)
        for name, away, limit in (
            ("peak", abs(cycle.peak - cycle.reference_peak), limits.peak_error),
            ("valley", abs(cycle.valley - cycle.reference_valley), limits.valley_error),
        ):
            if limit is not None and away > limit:
                self._complain(f"the {name} is {away:g} off, its limit {limit:g}", cycle.block, where)
        self._compare(cycle, limits, where)

    def _compare(self, cycle: LoadCycle, limits: Limits, where: str) -> None:
        """Compare the stiffness with that of the block's first load cycles, or include it in these."""
        known = self._stiffness.get(cycle.block, Stiffness(cycle.block, 0.0, 0))
        comparable = known.cycles >= limits.stiffness_cycles
        if math.isnan(cycle.stiffness) or (cycle.stiffness <= 0.0 and not comparable):
            # No valid stiffness for later load cycles to be compared with.
            if limits.stiffness_change is not None:
                constant = POSITION if math.isnan(cycle.stiffness) else VALUE
                self._complain(f"the stiffness cannot be judged: the {constant} does not change", cycle.block, where)
            return
        if not comparable:
            self._stiffness[cycle.block] = Stiffness(cycle.block, known.total + cycle.stiffness, known.cycles + 1)
            return
        change = 100.0 * (cycle.stiffness * known.cycles / known.total - 1.0)
        if limits.stiffness_change is not None and abs(change) > limits.stiffness_change:
            what = f"the stiffness has changed by {change:+.3g} %, its limit {limits.stiffness_change:g} %"
            self._complain(what, cycle.block, where)

    def _complain(self, what: str, block: int, where: str) -> None:
        self.complaint = self.complaint or f"{what} ({self._leaves[block].name}, {where})"


class _Open:
    """Load cycle in progress."""

    def __init__(self, sample: Sample) -> None:
        self.block = sample.block
        self.first = self.last = sample.cycle
        self._cycle = sample.repetition + 1
        self._samples = self._measured = 0
        self._sum = 0.0
        self._peak = self._reference_peak = self._highest = -math.inf
        self._valley = self._reference_valley = self._lowest = math.inf
        self._error = 0.0

    def add(self, sample: Sample) -> None:
        self.last = sample.cycle
        self._samples += 1
        self._reference_peak = max(self._reference_peak, sample.reference)
        self._reference_valley = min(self._reference_valley, sample.reference)
        if math.isfinite(sample.measured):
            self._measured += 1
            self._sum += sample.measured
            self._peak, self._valley = max(self._peak, sample.measured), min(self._valley, sample.measured)
            self._error = max(self._error, abs(sample.measured - sample.reference))
        if math.isfinite(sample.position):
            self._highest, self._lowest = max(self._highest, sample.position), min(self._lowest, sample.position)

    def closed(self, number: int) -> LoadCycle:
        nan = math.nan
        seen, placed = self._measured > 0, self._highest >= self._lowest
        moved = self._highest - self._lowest
        stiffness = (self._peak - self._valley) / moved if seen and placed and moved > 0.0 else nan
        return LoadCycle(
            number,
            self.block,
            self._cycle,
            *((self._peak, self._valley, self._sum / self._measured) if seen else (nan, nan, nan)),
            self._reference_peak,
            self._reference_valley,
            self._error if seen else nan,
            *((self._lowest, self._highest) if placed else (nan, nan)),
            stiffness if math.isfinite(stiffness) else nan,
            self._samples,
            self.first,
            self.last,
        )


def _unseen(number: int, sample: Sample) -> LoadCycle:
    """Return a load cycle without received samples."""
    return LoadCycle(number, sample.block, 0, *(math.nan,) * 9, 0, sample.cycle, sample.cycle)


def _outside(value: float, window: tuple[float, float]) -> bool:
    return value < window[0] or value > window[1]
