"""Processor time of a graph's processes, and the response times reported by its plant: for the benchmarks of the graph."""

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from rosbags.rosbag2 import Reader

from ehls_ros.recording.typestore import typestore

LOOK = 0.2
"""Sampling interval of the processes [s]."""

APART, COMPOSED = WAYS = ("apart", "composed")
"""Each node in a separate process, or those of the cycle in one."""

PARTS = ("p50", "p99", "p99.9", "max")
"""Parts of the answers in the plant's diagnostics, as ``response_<part>_us``."""


def processor_times(parent: int) -> dict[str, float]:
    """Return the processor time of each child of a process so far, all threads together [s], by the module it runs."""
    times: dict[str, float] = {}
    for task in Path(f"/proc/{parent}/task").iterdir():
        for child in (task / "children").read_text(encoding="utf-8").split():
            words = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
            name = words[2].decode().rpartition(".")[2] if len(words) > 2 else child
            times[name] = times.get(name, 0.0) + processor_time(int(child))
    return times


def processor_time(process: int) -> float:
    """Return the processor time of a process so far, all threads together [s]."""
    tasks = Path(f"/proc/{process}/task").iterdir()
    return 1e-9 * sum(int((task / "schedstat").read_text(encoding="utf-8").split()[0]) for task in tasks)


class Meter:
    """Measures the processes that this one has started, from the first report of progress to the last."""

    def __init__(self) -> None:
        """Start without a report."""
        self._looks: list[tuple[float, dict[str, float]]] = []

    def __call__(self, cycle: int, total: int) -> None:
        """Take a report of progress, as :func:`ehls_ros.nodes.graph.run_graph` gives it."""
        if not self._looks or time.perf_counter() - self._looks[-1][0] > LOOK:
            look = time.perf_counter(), processor_times(os.getpid())
            self._looks = [*self._looks[:1], look]

    def per_cycle(self, rate: float) -> dict[str, float]:
        """Return the processor time of a cycle, by process [s].

        Args:
            rate: cycles per second of wall time.
        """
        (start, before), (end, after) = self._looks
        cycles = rate * (end - start)
        return {name: (after[name] - before[name]) / cycles for name in after if name in before}


class Told(NamedTuple):
    """Contents of the plant's last diagnostics.

    Attributes:
        response: from snapshot to command taken [s], by :data:`PARTS`.
        missed: cycles without an answer.
        late: cycles of a simulated rig that ended more than a period late; 0 for another.
        slipped: lag of a simulated rig behind the wall clock [s].
    """

    response: Mapping[str, float]
    missed: int
    late: int
    slipped: float


def told_by_plant(bag: Path) -> Told:
    """Return the last diagnostics of the plant node of a recorded run."""
    values: dict[str, str] = {}
    with Reader(bag) as reader:
        connections = [connection for connection in reader.connections if connection.topic == "/diagnostics"]
        for connection, _, raw in reader.messages(connections=connections):
            for status in typestore().deserialize_cdr(raw, connection.msgtype).status:  # type: ignore[attr-defined]
                if status.name in {"plant_sim_node", "hardware_bridge_node"}:
                    values = {pair.key: pair.value for pair in status.values}
    response = {part: 1e-6 * float(values.get(f"response_{part}_us", "nan")) for part in PARTS}
    return Told(response, int(values.get("missed", 0)), int(values.get("late", 0)), float(values.get("slipped_s", 0.0)))
