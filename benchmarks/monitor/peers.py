"""Simpler detectors on the same streams: the drift detectors of river, a plain CUSUM and an EWMA.

Each watches the power of the whitened residual in each channel, block by block, relative to its mean and scatter in the first
minute. They name no causes; at best, the stage of the channel that alarms first. Each is tuned to the most sensitive of its
settings that raises no false alarm in the healthy hours.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.monitor.judge import judge
from benchmarks.monitor.tables import quartiles
from benchmarks.rows import Row
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.stages import CHANNELS
from truth_generator.effects import EFFECTS

try:
    from river import drift
except ImportError:
    drift = None

LEARNT = 24
"""Blocks of a stream from which mean and scatter are learnt."""

LEAST_SCATTER = 0.05
"""Smallest scatter of a power's logarithm."""

REFERENCE, SMOOTHING = 0.5, 0.2
"""Reference value of the CUSUM, in standard deviations, and weight of the newest block in the EWMA."""

MISSING = "river is not there: its detectors are left out (pip install river, into an environment of your own)"


class Detector(Protocol):
    """Watches one channel."""

    def alarms(self, value: float) -> bool:
        """Take a block's value, in standard deviations of the healthy ones, and return whether it raises an alarm."""


class Cusum:
    """A two-sided CUSUM that restarts after an alarm."""

    def __init__(self, threshold: float) -> None:
        """Start at zero.

        Args:
            threshold: in standard deviations.
        """
        self._threshold, self._up, self._down = threshold, 0.0, 0.0

    def alarms(self, value: float) -> bool:
        """Take a block's value."""
        self._up, self._down = max(0.0, self._up + value - REFERENCE), max(0.0, self._down - value - REFERENCE)
        found = max(self._up, self._down) > self._threshold
        if found:
            self._up = self._down = 0.0
        return found


class Ewma:
    """An exponentially weighted mean that restarts after an alarm."""

    def __init__(self, threshold: float) -> None:
        """Start at zero.

        Args:
            threshold: in standard deviations of the mean.
        """
        self._limit, self._mean = threshold * math.sqrt(SMOOTHING / (2.0 - SMOOTHING)), 0.0

    def alarms(self, value: float) -> bool:
        """Take a block's value."""
        self._mean += SMOOTHING * (value - self._mean)
        found = abs(self._mean) > self._limit
        if found:
            self._mean = 0.0
        return found


class River:
    """A drift detector of river."""

    def __init__(self, detector: Any) -> None:
        """Wrap the detector."""
        self._detector = detector

    def alarms(self, value: float) -> bool:
        """Take a block's value."""
        self._detector.update(value)
        return bool(self._detector.drift_detected)


class Peer(NamedTuple):
    """A method.

    Attributes:
        settings: its settings, the most sensitive first.
        make: returns a detector for a channel.
    """

    settings: Sequence[float]
    make: Callable[[float], Detector]


def peers() -> dict[str, Peer]:
    """Return the available methods."""
    out = {
        "CUSUM": Peer(np.geomspace(4.0, 4000.0, 31).tolist(), Cusum),
        "EWMA": Peer(np.geomspace(3.0, 300.0, 31).tolist(), Ewma),
    }
    if drift is not None:
        out |= {
            "ADWIN": Peer(
                np.geomspace(0.3, 1e-12, 24).tolist(), lambda d: River(drift.ADWIN(delta=d, clock=1, grace_period=5))
            ),
            "PageHinkley": Peer(
                np.geomspace(4.0, 4000.0, 31).tolist(),
                lambda t: River(drift.PageHinkley(min_instances=5, delta=REFERENCE, threshold=t, alpha=1.0)),
            ),
            "KSWIN": Peer(
                np.geomspace(0.05, 1e-12, 24).tolist(),
                lambda a: River(drift.KSWIN(alpha=a, window_size=LEARNT, stat_size=LEARNT // 3, seed=1)),
            ),
        }
    return out


def standardised(powers: Sequence[Sequence[float]]) -> np.ndarray:
    """Return the powers of the later blocks, normalised by mean and scatter of the first ones, shape (blocks, channels)."""
    values = np.array(powers, dtype=np.float64).reshape(-1, len(CHANNELS))
    with np.errstate(all="ignore"):
        first = values[:LEARNT]
        count = np.maximum(np.sum(np.isfinite(first), axis=0), 1)
        mean = np.nansum(first, axis=0) / count
        scatter = np.sqrt(np.nansum((first - mean) ** 2, axis=0) / count)
    rest: np.ndarray = (values[LEARNT:] - mean) / np.maximum(scatter, LEAST_SCATTER)
    return rest


def alarms_of(values: np.ndarray, peer: Peer, setting: float) -> list[tuple[int, int]]:
    """Return block and channel of the alarms that a method raises."""
    detectors = [peer.make(setting) for _ in CHANNELS]
    out = list[tuple[int, int]]()
    for block, row in enumerate(values):
        for channel, value in enumerate(row):
            if math.isfinite(value) and detectors[channel].alarms(float(value)):
                out.append((block, channel))
    return out


def tuned(peer: Peer, streams: Sequence[np.ndarray]) -> tuple[float, int]:
    """Return the most sensitive setting without a false alarm, or the least sensitive, and its false alarms."""
    count = 0
    for setting in peer.settings:
        count = 0
        for values in streams:
            count += len(alarms_of(values, peer, setting))
            if count and setting != peer.settings[-1]:
                break
        if not count:
            return setting, 0
    return peer.settings[-1], count


def show(healthy: Sequence[Row], hidden: Sequence[Row], console: Console) -> None:
    """Print the comparison."""
    if drift is None:
        console.print(MISSING)
    streams = [standardised(row["powers"]) for row in healthy if row.get("powers")]
    hours = sum(len(values) for values in streams) * rules.BLOCK / 3600.0
    cases = [row for row in hidden if "error" not in row and row.get("powers") and judge(row).counts]
    title = f"{len(cases)} effects that begin while the rig runs, and {hours:.1f} h of healthy rigs"
    table = Table(title=title, title_justify="left")
    for column in ("", "setting", "false alarms", "noticed", "right stage", "right name", "onset to noticed: median"):
        table.add_column(column)
    judged = [judge(row) for row in cases]
    false = sum(event["kind"] == "noticed" for row in healthy for event in row.get("events", ()))
    noticed = [j.noticed for j in judged if j.noticed is not None]
    right = sum(j.right for j in judged)
    table.add_row("the monitor", "", str(false), f"{len(noticed)}", "–", f"{right}", quartiles(noticed))
    for name, peer in peers().items():
        setting, count = tuned(peer, streams)
        delays, stages = list[float](), 0
        for row in cases:
            found = _first(row, peer, setting)
            if found is not None:
                delays.append(found[0])
                stages += list(CHANNELS.values())[found[1]] == EFFECTS[row["effect"]].stage
        table.add_row(name, f"{setting:.3g}", str(count), f"{len(delays)}", f"{stages}", "–", quartiles(delays))
    console.print(table)


def _first(row: Row, peer: Peer, setting: float) -> tuple[float, int] | None:
    """Return delay [s] and channel of the first alarm after the onset."""
    for block, channel in alarms_of(standardised(row["powers"]), peer, setting):
        end = rules.MONITOR_LEAD + (LEARNT + block + 1) * rules.BLOCK
        if end > row["onset"]:
            return end - row["onset"], channel
    return None
