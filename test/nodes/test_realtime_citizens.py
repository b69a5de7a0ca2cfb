"""Realtime nodes use no more of the machine than they need: little memory, and no processor exclusively."""

import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from patience import PATIENCE
from test_priorities import PRIORITY, needs_permission, priorities

from ehls_msgs.msg import LoaderState, ValveCommand
from ehls_ros.hardware.realtime import MIN_PRIORITY, Part, memory

OVERLOADED = Path(__file__).resolve().parents[2] / "benchmarks" / "realtime_citizens.py"

MEMORY = 200.0
"""Maximum memory that a node may lock, and have resident [MiB]."""


def memory_of(process: int, key: str) -> float:
    status = dict(line.split(":", 1) for line in Path(f"/proc/{process}/status").read_text().splitlines())
    return int(status[key].split()[0]) / 1024


@needs_permission
def test_a_background_node_locks_only_the_memory_it_uses_and_only_its_loop_has_lower_priority(graph, participant, spec_file):
    process = graph.start("reference_node", spec=spec_file(), timing="realtime", priority=PRIORITY)
    heard = participant.collect(DiagnosticArray, "/diagnostics")
    participant.until(lambda: any(status.message == "running" for array in heard for status in array.status))
    locked, resident = memory_of(process.pid, "VmLck"), memory_of(process.pid, "VmRSS")
    assert 50.0 < locked < MEMORY
    assert resident < MEMORY
    values = {value.key for array in heard for status in array.status for value in status.values}
    assert not any(key.startswith("not_permitted") for key in values)
    found = priorities(process.pid)
    assert found["middleware"] == {(os.SCHED_FIFO, PRIORITY)}
    assert found["loop"] == {(os.SCHED_FIFO, MIN_PRIORITY)}


@pytest.mark.long
@needs_permission
def test_an_overloaded_loop_gives_up_its_priority(graph, participant):
    heard = participant.collect(DiagnosticArray, "/diagnostics")
    process = graph.run("overloaded", [str(OVERLOADED), "--be-overloaded", "--ros-args", "-p", f"priority:={PRIORITY}"])
    participant.until(lambda: any("processor_share is 90 %" in s.message for array in heard for s in array.status))
    found = priorities(process.pid)
    assert set.union(*found.values()) == {(os.SCHED_OTHER, 0)}
    participant.until(lambda: "SCHED_FIFO is given back" in graph.log("overloaded"))


def test_the_memory_of_a_process_is_all_there():
    parts = memory()
    assert all(isinstance(part, Part) and part.length > 0 for part in parts)
    assert any(part.file == sys.executable or "python" in part.file for part in parts)
    assert sum(part.resident for part in parts) / 1024 == pytest.approx(memory_of(os.getpid(), "VmRSS"), rel=0.1)


def test_frugality_does_not_keep_threads_from_working():
    deep = "t = threading.Thread(target=lambda: json.loads('[' * 900 + ']' * 900)); t.start(); t.join(); print('done')"
    script = (
        f"import json, threading; from ehls_ros.hardware.realtime import limit_reserved_memory; limit_reserved_memory(); {deep}"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert done.stdout == "done\n"


class SlowController:
    """Answers the newest snapshot late, with a closed valve.

    Attributes:
        away: longest time between two turns [s].
    """

    DELAY = 0.004

    def __init__(self, participant) -> None:
        from ehls_ros.nodes.transport import Inbox, Outbox

        self.states = Inbox(participant.node, LoaderState, "loader_state")
        self.commands = Outbox(participant.node, ValveCommand, "valve_command", sender="slow")
        self.away, self.turned = 0.0, time.monotonic()

    def turn(self) -> None:
        now = time.monotonic()
        self.away, self.turned = max(self.away, now - self.turned), now
        newest = None
        while (state := self.states.take()) is not None:
            newest = state
        if newest is not None:
            time.sleep(self.DELAY)
            self.commands.send(newest[0], newest[1], 0.0)


def figures(heard) -> list[dict[str, str]]:
    return [{v.key: v.value for v in s.values} | {"message": s.message} for array in heard for s in array.status]


@pytest.mark.long
def test_a_simulated_rig_waits_for_a_controller_that_is_too_slow_and_says_so(graph, participant, spec_file):
    heard = participant.collect(DiagnosticArray, "/diagnostics")
    controller = SlowController(participant)
    graph.start("plant_sim_node", spec=spec_file(duration=1000.0), timing="realtime")

    def until(condition) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            controller.turn()
            participant.executor.spin_once(timeout_sec=0.0)
            assert time.monotonic() < deadline

    def too_slow(each):
        return 0.0 < float(each.get("cycles_per_second_reached", 0.0)) < 0.9 * float(each["cycles_per_second_asked"])

    until(lambda: any(map(too_slow, figures(heard))))
    begun = next(index for index, each in enumerate(figures(heard)) if too_slow(each))

    def hardly_misses(before, after):
        cycles, missed, slipped = (float(after[key]) - float(before[key]) for key in ("cycle", "missed", "slipped_s"))
        return cycles > 50 and missed < 0.1 * cycles and slipped > 0.0

    # From now on each cycle waits for its command; unless this process is delayed: then its commands are not awaited.
    until(lambda: any(itertools.starmap(hardly_misses, itertools.pairwise(figures(heard)[begun:]))))
    # The gate does not trip, unless this process was delayed for nearly as long as the gate waits.
    said = figures(heard)[begun]["message"], figures(heard)[-1]["message"]
    complaint = "too slow: ", "the simulated time runs slower than the wall's"
    assert all(words in said[0] for words in complaint) or controller.away > 0.4
    assert "tripped" not in said[1] or controller.away > 0.4
