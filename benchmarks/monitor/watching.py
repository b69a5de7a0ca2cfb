"""The benchmark's monitor, which times its diagnoses and keeps the sums of its blocks."""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.monitor.streams import in_chunks
from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.monitoring.change_test import ChangeTest
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import CHANNELS, setup
from ehls_ros.errors import BadInput
from ehls_ros.experiments.monitoring.examination import Finding, Task, examine
from ehls_ros.experiments.monitoring.health import Event
from ehls_ros.experiments.monitoring.modes import Comparing, Learning
from ehls_ros.experiments.monitoring.monitor import Monitor
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory


class Examined(NamedTuple):
    """A diagnosis requested by the monitor.

    Attributes:
        length: of the recording [s].
        wall_s: time it took [s].
        verdict: its verdict.
    """

    length: float
    wall_s: float
    verdict: str


class Timed:
    """Diagnoses synchronously, and stores the duration of each diagnosis."""

    def __init__(self) -> None:
        """Start without a task."""
        self.done = list[Examined]()
        self._found: Finding | None = None

    def begin(self, task: Task) -> None:
        """Diagnose."""
        began = time.perf_counter()
        self._found = examine(task)
        took = time.perf_counter() - began
        self.done.append(Examined(task.length, took, self._found.verdict))

    def finding(self) -> Finding | None:
        """Return the result, once."""
        found, self._found = self._found, None
        return found

    def close(self) -> None:
        """Do nothing: no diagnosis is under way."""


def test_of(monitor: Monitor) -> ChangeTest | None:
    """Return the test of a monitor; None while it learns."""
    return None if isinstance(monitor.mode, Learning | Comparing) else monitor.mode.blocks.test


def bounds(monitor: Monitor, hours: Sequence[float]) -> list[float]:
    """Return the thresholds of a sum for mean times between false alarms [h], in standard deviations."""
    test = test_of(monitor)
    return [] if test is None else [ChangeTest(test.healthy, h).bound for h in hours]


def feed(monitor: Monitor, recording: Trajectory, largest: list[float] | None = None) -> list[Event]:
    """Feed a recording to a monitor.

    Args:
        monitor: the monitor.
        recording: the recording, on its axis.
        largest: receives the largest sum each time that blocks are judged, in standard deviations.
    """
    events = list[Event]()
    for times, signals in in_chunks(recording):
        before = monitor.health().watched if largest is not None else 0.0
        events += monitor.add(times, signals)
        if largest is not None and monitor.health().watched > before:
            test = test_of(monitor)
            largest.append(0.0 if test is None else round(test.largest, 2))
    return events


def powers(recording: Trajectory, rig: Rig) -> list[list[float]]:
    """Return the logarithm of the mean square of each channel's whitened residual in each block; NaN if there is none."""
    time_s, lead, block = recording.time_s, rules.MONITOR_LEAD, rules.BLOCK
    out = list[list[float]]()
    for begin in np.arange(time_s[0] + lead, time_s[-1] - block, block):
        first, last = np.searchsorted(time_s, [begin - lead, begin + block])
        own = Trajectory(time_s[first:last] - time_s[first], {n: v[first:last] for n, v in recording.signals.items()})
        out.append([round(v, 3) for v in _power(own, rig, lead)])
    return out


def _power(recording: Trajectory, rig: Rig, lead: float) -> list[float]:
    try:
        record = prepare(recording, rig, "the rig")
        compared = setup(record, rig)
        evidence = gather(record, rig, compared, 0, rules.MONITOR_REALISATIONS)
    except BadInput:
        return [float("nan")] * len(CHANNELS)
    found = dict.fromkeys(CHANNELS, float("nan"))
    for c in evidence.channels:
        e: Array = evidence.base.values[c][evidence.times[c] >= lead]
        if len(e):
            found[c] = float(np.log(max(float(np.mean(np.minimum(e**2, rules.MONITOR_SQUARE))), 1e-6)))
    return list(found.values())


def told(event: Event) -> dict[str, Any]:
    """Return an event in JSON-compatible form."""
    return {"time": event.time, "kind": event.kind, "text": event.text}
