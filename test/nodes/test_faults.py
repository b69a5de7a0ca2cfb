"""The fault table: the valve's reaction to faults, in running processes over DDS and UDP.

In lockstep the rig's time stands still while a process is slow, so the times to the safe state are those of the design, not
of the machine. Faults that concern timing are in test_attacks.py. Starting a graph takes longer than most faults, so a
test starts one and injects several in turn, resetting and enabling the gate in between.

``pytest -s test/nodes/test_faults.py | grep '^|'`` prints the table.
"""

import random
import signal
import socket
import time
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from emulated_rig import BLEND_IN, PERIOD, EmulatedRig
from rosbags.rosbag2 import Reader

from ehls_msgs.msg import LoaderState
from ehls_ros.cli.main import main
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from ehls_ros.nodes.recorder_node import FLUSH
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.recording_note import NOTE, Flushed, read_note

LAW = "fasmc_output_feedback"
CONTROLLER, BRIDGE, REFERENCE, RECORDER = f"{LAW}_node", "hardware_bridge_node", "reference_node", "recorder_node"
SPOOL_LIMIT = 1e-2
GATE = Gate()
MARGIN = 5e-3
"""Tolerance of a limit [s]."""

SEEN_AFTER = 3
"""Cycles after which a sensor fault certainly affects the gate's comparisons."""

UNTIL_NULL = round((GATE.hold_time + GATE.ramp_time) / PERIOD) + 10
"""Cycles after a trip in which the gate has certainly closed."""

BLENDED_IN = round(2.0 * BLEND_IN / PERIOD)
"""Cycles after which the commands act fully on a gate that was enabled."""

AFTER_CUT = 15
"""The same when the gate cuts at once for lack of answers; then each cycle takes the bridge's patience."""

PARAMETERS_TRIED = 80

COMPARED = 500
"""Minimum number of cycles compared in a recovered bag."""


def longest_rest(command):
    """Return the largest number of consecutive rows in which the command is null; it also crosses null."""
    moving = np.flatnonzero(np.concatenate([[1.0], command, [1.0]]))
    return int(np.max(np.diff(moving))) - 1


class Trip(NamedTuple):
    """A fault that must lead to the safe state.

    Attributes:
        fault: its name.
        since: monotonic time from which the fault certainly acts [s].
        until: time at which the gate was reset [s].
        limit: time in which the command must be null [s].
        span: span of the command above which a constant reading is a fault [m]. The limit counts from frozen_time before
            the gate has seen that span.
    """

    fault: str
    since: float
    until: float
    limit: float
    span: float = 0.0

    def allowed(self, command):
        """Return the time in which these commands, from the injection on, must have become null [s]."""
        if not self.span:
            return self.limit
        # Until then the gate may see a change of the reading, and forget the span.
        seen = command[SEEN_AFTER:]
        wide = np.maximum.accumulate(seen) - np.minimum.accumulate(seen) >= self.span
        seen_after = SEEN_AFTER + (int(np.argmax(wide)) if wide.any() else len(seen))
        return self.limit + max(0.0, seen_after * PERIOD - GATE.frozen_time)


class Trial:
    """A running rig and the faults injected."""

    def __init__(self, rig):
        self.rig = rig
        self.trips = []
        self.borne = []
        rig.states = rig.participant.collect(LoaderState, "loader_state")
        rig.diagnostics = rig.participant.collect(DiagnosticArray, "/diagnostics")
        self.enable()

    def enable(self):
        """Reset and enable the gate, and wait for the blend-in."""
        self.rig.enable()
        self.run(BLENDED_IN)
        self.rig.diagnostics.clear()

    def run(self, cycles):
        """Let the rig run for some cycles that begin after this call."""
        states, known, called = self.rig.states, len(self.rig.states), time.time_ns()
        self.rig.ear.listen()
        self.rig.participant.until(lambda: len(states.after(called, known)) >= cycles)

    def told(self, words):
        """Wait until a node's diagnostics, published after this call, contain some words."""
        heard, called = self.rig.diagnostics, time.time_ns()
        self.rig.participant.until(
            lambda: any(words in status.message for array in heard.after(called) for status in array.status)
        )

    def trips_it(self, fault, put_in, limit, end=lambda: None, span=0.0, cycles=UNTIL_NULL):
        """Inject a fault, wait for the trip, end the fault, and continue; ``put_in`` returns its starting time [s]."""
        since = put_in()
        self.told("tripped by")
        self.run(cycles)
        end()
        until = time.monotonic()
        self.enable()
        self.trips.append(Trip(fault, since, until, limit, span))

    def bears_it(self, fault, put_in=lambda: None, end=lambda: None, cycles=300):
        """Inject a fault that the rig must tolerate."""
        since = time.monotonic()
        put_in()
        self.run(cycles)
        self.borne.append((fault, since, time.monotonic()))
        end()

    def finish(self):
        """Stop the rig and check the valve's motion; return the emulator's counts."""
        counts = self.rig.stop_emulator()
        seen, _ = self.rig.judged()
        command, clock = seen["valve_command_m"], seen["monotonic_s"]
        assert len(command) >= BLENDED_IN
        assert np.all(np.isfinite(command))
        assert np.max(np.abs(command)) <= SPOOL_LIMIT * (1.0 + 1e-9)
        for trip in self.trips:
            first, last = np.searchsorted(clock, [trip.since, trip.until])
            assert not command[last - 1], f"{trip.fault}: the valve never came to rest"
            moving = np.flatnonzero(command[first:last])
            took = (int(moving[-1]) + 1 if moving.size else 0) * PERIOD
            allowed = trip.allowed(command[first:last])
            self.tell(trip.fault, "null", allowed, took)
            assert took <= allowed + MARGIN, trip.fault
        for fault, since, until in self.borne:
            first, last = np.searchsorted(clock, [since, until])
            assert longest_rest(command[first:last]) < 10, fault
            self.tell(fault, "goes on")
        assert np.any(command)
        return counts

    def tell(self, fault, outcome, limit=None, took=None):
        """Print a line of the table."""
        figures = "" if took is None else f"{1e3 * took:.0f} ms of {1e3 * limit:.0f} ms"
        print(f"| {fault} | {outcome} | {figures} |")


@pytest.fixture
def trial(graph, participant, tmp_path):
    started = []

    def start(*, spoil=False):
        rig = EmulatedRig(graph, participant, tmp_path, LAW, spoil)
        started.append(rig)
        return Trial(rig)

    yield start
    for rig in started:
        rig.close()


@pytest.mark.long
def test_controller_and_reference_freeze_die_and_return(trial, graph):
    running = trial()
    controller = graph.processes[CONTROLLER]
    # While it is frozen, time stands still until the bridge abandons the present cycle.
    running.trips_it(
        "controller frozen",
        lambda: graph.freeze(controller),
        GATE.command_timeout,
        lambda: graph.wake(controller),
        cycles=AFTER_CUT,
    )
    running.trips_it(
        "controller killed",
        lambda: graph.kill(CONTROLLER),
        GATE.command_timeout,
        lambda: running.rig.start(CONTROLLER),
        cycles=AFTER_CUT,
    )
    ahead = 0.2
    running.trips_it(
        "reference killed",
        lambda: graph.kill(REFERENCE),
        ahead + GATE.command_timeout,
        lambda: running.rig.start(REFERENCE),
        cycles=AFTER_CUT,
    )
    running.trips_it("emergency stop", running.rig.emergency_stop, 0.0)
    running.finish()


@pytest.mark.long
def test_commands_lost_late_duplicated_and_not_finite(trial):
    running = trial(spoil=True)

    def spoil(mode):
        return lambda: running.rig.spoil_commands(mode)

    for mode in ("lost", "duplicated", "reordered"):
        running.bears_it(f"commands {mode}", spoil(mode), spoil("none"), cycles=50)
    running.trips_it("commands 20 ms late", spoil("delayed"), 0.02 + GATE.command_timeout, spoil("none"), cycles=AFTER_CUT)
    for mode in ("nan", "inf", "minus_inf", "1e30"):
        running.trips_it(f"commands {mode}", spoil(mode), 0.02 + GATE.hold_time + GATE.ramp_time, spoil("none"))
    running.finish()


@pytest.mark.long
def test_sensors_that_lie(trial):
    running = trial()
    # A law that is lied to opens the valve far within one reaction time.
    running.rig.setup = running.rig.setup._replace(gentle=False)

    def fault(line):
        return lambda: running.rig.fault(line)

    for line, limit in (
        ("stick force", GATE.frozen_time),
        ("stick position", GATE.frozen_time),
        ("stick load_pressure", GATE.frozen_time),
        ("bias force 3000", 0.0),
        ("bias load_pressure 1.5e6", 0.0),
        ("bias position 0.05", 0.0),
        ("jump force 2e4", 0.0),
        ("jump position 0.1", 0.0),
    ):
        span = GATE.frozen_command if line.startswith("stick") else 0.0
        running.trips_it(f"sensor: {line}", fault(line), limit + GATE.mismatch_time + GATE.ramp_time, fault("clear"), span)
    for step in (-3600.0, 3600.0):
        running.bears_it(f"rig's clock steps by {step:g} s", fault(f"clock {step}"), fault("clear"))
    running.finish()


@pytest.mark.long
def test_the_rig_gone_and_back(trial, graph):
    running = trial()
    running.rig.stop_emulator(signal.SIGKILL)
    running.told("tripped by")
    running.rig.start_emulator()
    running.run(UNTIL_NULL)
    back = time.monotonic()
    running.enable()
    running.finish()
    seen, _ = running.rig.judged()
    assert not np.any(seen["valve_command_m"][seen["monotonic_s"] < back])
    assert all(graph.processes[name].poll() is None for name in (CONTROLLER, BRIDGE, REFERENCE))
    running.tell("rig gone and back", "null until reset and enabled")


@pytest.mark.long
def test_foreign_packets_second_controllers_and_random_parameters(trial, graph):
    running = trial()
    chance = random.Random(1)

    def flood():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for _ in range(50):
                for size in (0, 1, 56, 64, 1400):
                    stranger.sendto(b"EHLS\x01\x03\x01\x00" + chance.randbytes(size), ("127.0.0.1", running.rig.port))
                # By the second cycle the rig has read them: none is lost because of a full buffer.
                running.run(2)

    def second():
        # It sends nothing to the valve, and is not offered for a switch: this rig lacks a reading that it needs.
        running.rig.start("sic_node")
        running.told("needed but not measured: velocity")

    running.bears_it("foreign packets", flood)
    running.bears_it("a second controller", second, lambda: graph.stop("sic_node"))

    names = {CONTROLLER: ("k", "g", "h", "b", "xi"), BRIDGE: Gate._fields}
    values = (float("nan"), float("inf"), -1.0, 0.0, 1e-9, 1.0, 12.0, 1e3, 1e30, "cut", "warn", "", True, 7, -(2**63))
    accepted = 0
    for _ in range(PARAMETERS_TRIED):
        node = chance.choice(list(names))
        answer = running.rig.participant.set_parameter(node, chance.choice(names[node]), chance.choice(values))
        accepted += answer.successful
        assert answer.successful or answer.reason
    counts = running.finish()
    assert sum(count for name, count in counts.items() if name.startswith("refused")) > 200
    assert 0 < accepted < PARAMETERS_TRIED
    assert all(graph.processes[name].poll() is None for name in names)
    running.tell(
        "parameters fuzzed", f"{accepted} of {PARAMETERS_TRIED} accepted, the others refused with a reason; within limits"
    )


@pytest.mark.long
def test_a_killed_recorder_and_a_full_disk(trial, graph, tmp_path):
    running = trial()
    died, full = tmp_path / "died", tmp_path / "full"
    running.rig.start(RECORDER, bag=died)

    def flushed(bag):
        return read_note(bag).get("/ehls/loader_state", Flushed(0, 0)) if (bag / NOTE).exists() else Flushed(0, 0)

    # The recorder joined a running graph and may miss any earlier message. From the first flush on it is complete.
    running.rig.participant.until(lambda: flushed(died).messages > 0)
    joined = flushed(died).messages
    running.rig.participant.until(lambda: flushed(died).messages > joined + COMPARED)
    last_ns = flushed(died).newest_ns
    killed_ns = time.time_ns()
    running.bears_it("recorder killed", lambda: graph.kill(RECORDER))
    # After a kill, the next recorder may discover a node only 3 s later, when Fast DDS announces it again.
    running.rig.start(RECORDER, bag=full)
    running.rig.participant.until(lambda: flushed(full).messages > 600)
    graph.limit_files(RECORDER, max(file.stat().st_size for file in full.iterdir()))
    running.told("not recording")
    running.bears_it("disk full")
    running.finish()

    for bag in (died, full):
        assert main(["recover", str(bag), "--out", str(bag.with_suffix(".whole"))]) == 0
    with Reader(died.with_suffix(".whole")) as reader:
        assert reader.end_time >= last_ns
        lost = (killed_ns - reader.end_time) * 1e-9
    running.tell("recorder killed", "bag recovered up to its last flush", FLUSH, lost)
    recovered = read_bag(died.with_suffix(".whole"))
    cycles = np.round(recovered.time_s / PERIOD)[joined:]
    assert np.array_equal(np.diff(cycles), np.ones(len(cycles) - 1))
    force = {state.cycle: state.force for state in running.rig.states}
    known = [
        (force[cycle], value) for cycle, value in zip(cycles, recovered["force_n"][joined:], strict=True) if cycle in force
    ]
    assert len(known) >= COMPARED
    assert all(seen == value for seen, value in known)
    assert len(read_bag(full.with_suffix(".whole"))) > 500
