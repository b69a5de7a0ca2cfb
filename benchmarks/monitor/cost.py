"""Cost of the monitor: replay speed, and the time of the parts of a block."""

import time
from collections import defaultdict

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.diagnosis.cases import rig
from benchmarks.monitor.streams import Onset, part, recording_of
from benchmarks.monitor.watching import Timed, feed
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.monitoring.blocks import scores
from ehls_ros.diagnosis.monitoring.change_test import BlockStatistics, ChangeTest, block_statistics
from ehls_ros.diagnosis.monitoring.directions import directions
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.experiments.monitoring.monitor import Monitor, Parameters
from ehls_ros.trajectory import Trajectory

PROGRAMMES, LEARNT, DURATION = "rich+random+steps", 70.0, 300.0
"""Experiment that is replayed, its untimed initial part that is learnt from, and its whole duration [s]."""


def show(console: Console) -> None:
    """Print the replay speed of a recording and the time of the parts of a block."""
    recording = recording_of(Onset(PROGRAMMES, 1, DURATION, ()))
    monitor = Monitor(rig(), Parameters(), Timed())
    feed(monitor, part(recording, 0.0, LEARNT))
    later = part(recording, LEARNT, DURATION)
    rest = Trajectory(later.time_s + LEARNT, later.signals)
    began, used = time.perf_counter(), time.process_time()
    feed(monitor, rest)
    wall, used = time.perf_counter() - began, time.process_time() - used
    seconds = DURATION - LEARNT
    console.print(f"{seconds / wall:.0f} × real time; {100 * used / seconds:.1f} % of a core at the rig's own pace")
    parts, count = _parts(recording)
    table = Table(title=f"a block of {rules.BLOCK:g} s, {count} directions, median", title_justify="left")
    table.add_column("part")
    table.add_column("ms")
    for name, took in parts.items():
        table.add_row(name, f"{1e3 * float(np.median(took)):.1f}")
    console.print(table)


def _parts(recording: Trajectory) -> tuple[dict[str, list[float]], int]:
    """Return the times of the parts of each block [s], and the number of directions."""
    first = prepare(part(recording, 0.0, 20.0), rig(), "the rig")
    followed = directions(gather(first, rig(), setup(first, rig()), 0))
    test: ChangeTest | None = None
    out: dict[str, list[float]] = defaultdict(list)
    begins = (rules.MONITOR_LEAD + rules.BLOCK * np.arange(rules.MONITOR_AT_ONCE)).tolist()
    length = rules.MONITOR_AT_ONCE * rules.BLOCK
    for begin in np.arange(LEARNT, DURATION - length, length):
        own = part(recording, begin - rules.MONITOR_LEAD, begin + length)
        times = [time.perf_counter()]
        record = prepare(own, rig(), "the rig")
        times.append(time.perf_counter())
        compared = setup(record, rig())
        times.append(time.perf_counter())
        evidence = gather(record, rig(), compared, 0, rules.MONITOR_REALISATIONS)
        times.append(time.perf_counter())
        blocks = scores(evidence, followed, (), begins)
        times.append(time.perf_counter())
        test = ChangeTest(_any(len(blocks[0].score)), 1000.0) if test is None else test
        for found in blocks:
            test.add(found.score, found.information, found.share)
            test.change()
        times.append(time.perf_counter())
        names = ("record prepared", "channels found", "residuals and noise floor", "scores of the directions", "test")
        for name, took in zip(names, np.diff(times), strict=True):
            out[name].append(float(took) / rules.MONITOR_AT_ONCE)
    return out, len(followed)


def _any(count: int) -> BlockStatistics:
    """Return a dummy scatter of one block: no time depends on it."""
    return block_statistics(np.zeros((1, count)), np.ones((1, count)), np.zeros(1, dtype=np.intp))
