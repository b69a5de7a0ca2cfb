"""The emulator's loop: paced by its clock, or waiting for the answer to each cycle."""

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.hardware.emulator import Emulator
from ehls_ros.hardware.packet import Status
from ehls_ros.hardware.target import Target
from ehls_ros.hardware.wire import Wire

MAX_LAG = 1.0
"""Lag behind the clock beyond which the schedule is shifted instead of caught up [s]."""

STOP_CHECK = 0.05
"""Interval at which a stop is checked for while waiting for packets [s]."""

MAX_DELAY_US = 10_000
"""Largest wake-up delay resolved by the histogram [us]."""


class Run(NamedTuple):
    """Number of cycles to run, and the links to the caller.

    Attributes:
        cycles: number of cycles to run.
        stopped: returns whether to stop.
        lines: faults to inject, appended by another thread.
        report: called with each injected fault, or the error in its line, and the time [s].
    """

    cycles: int
    stopped: Callable[[], bool]
    lines: deque[str]
    report: Callable[[str, float], None]


class Delays:
    """Histogram of the wake-up delays, in steps of a microsecond."""

    def __init__(self) -> None:
        """Start empty."""
        self._counts = [0] * (MAX_DELAY_US + 1)
        self.largest = 0.0

    def add(self, delay: float) -> None:
        """Count a delay [s]."""
        self._counts[min(int(1e6 * delay), MAX_DELAY_US)] += 1
        self.largest = max(self.largest, delay)

    def quantile(self, fraction: float) -> float:
        """Return the delay not exceeded by a fraction of all wake-ups [s], to a microsecond."""
        rank, seen = fraction * sum(self._counts), 0
        for delay, count in enumerate(self._counts):
            seen += count
            if seen >= rank:
                return 1e-6 * delay
        return 1e-6 * MAX_DELAY_US


def run_realtime(emulator: Emulator, target: Target, wire: Wire, run: Run, delays: Delays) -> None:
    """Run on this computer's clock; a command acts from the cycle after its arrival.

    Args:
        emulator: the rig.
        target: the target's side of the protocol.
        wire: the target's socket.
        run: number of cycles, and the links to the caller.
        delays: collects the wake-up delays.
    """
    period = emulator.period
    values = emulator.sense()
    start = time.monotonic() + period
    paused = 0.0
    for cycle in range(run.cycles):
        if run.stopped():
            return
        deadline = start + cycle * period
        now = wire.wait(deadline)
        delays.add(now - deadline)
        given_up = max(now - deadline - MAX_LAG, 0.0)
        start += given_up
        paused += given_up
        _put_faults(emulator, run, now)
        wire.delay = emulator.faults.delay
        for data, sender in wire.received():
            if not emulator.faults.deaf:
                target.receive(data, sender, now, cycle - 1)
        raw, status = target.output(now)
        stamp = cycle * period + paused
        _send(emulator, target, wire, status, values, stamp, now)
        emulator.advance(raw, status, target.commanded, target.answered, now)
        values = emulator.sense()


def run_lockstep(emulator: Emulator, target: Target, wire: Wire, run: Run, patience: float) -> None:
    """Wait in each cycle for its answer, which acts in the next one.

    Args:
        emulator: the rig.
        target: the target's side of the protocol.
        wire: the target's socket.
        run: number of cycles, and the links to the caller.
        patience: longest wait for an answer [s].

    Raises:
        WorkFailed: no answer in time.
    """
    raw, status = target.output(0.0)
    commanded, answered = target.commanded, target.answered
    for cycle in range(run.cycles):
        values = emulator.sense()
        target.greeted = True
        give_up = time.monotonic() + patience
        while target.answered != cycle:
            if target.greeted and target.address is not None:
                _send(emulator, target, wire, status, values, emulator.cycle * emulator.period)
            target.greeted = False
            now = time.monotonic()
            if run.stopped():
                return
            if now > give_up:
                raise WorkFailed(f"lockstep: no command answered cycle {cycle} within {patience:g} s")
            wire.await_packet(STOP_CHECK)
            now = time.monotonic()
            _put_faults(emulator, run, now)
            for data, sender in wire.received():
                target.receive(data, sender, now, cycle)
        emulator.advance(raw, status, commanded, answered, now)
        raw, status = target.output(now)
        commanded, answered = target.commanded, target.answered


def _send(
    emulator: Emulator,
    target: Target,
    wire: Wire,
    status: Status,
    values: tuple[float, ...],
    stamp: float,
    now: float | None = None,
) -> None:
    if target.address is None or emulator.faults.silent:
        return
    time_ns = round(1e9 * stamp) + emulator.faults.clock_ns
    wire.send(target.measurement(emulator.cycle, time_ns, status, values, now), target.address)


def _put_faults(emulator: Emulator, run: Run, now: float) -> None:
    while run.lines:
        line = run.lines.popleft()
        try:
            emulator.faults.apply(line)
        except BadInput as error:
            run.report(str(error), now)
        else:
            run.report(line, now)
