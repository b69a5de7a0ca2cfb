"""The fault table: what the actuator sees when something breaks, in running processes over DDS and UDP.

In lockstep the rig's time stands still while a process is slow, so that times to the safe state are those of the design and
not of the machine; where a part of the rig itself is gone, real time goes on.
"""

import random
import signal
import socket
import time

import numpy as np
import pytest

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from emulated_rig import PERIOD, EmulatedRig
from rosbags.rosbag2 import Reader
from std_srvs.srv import Trigger

from ehls_msgs.msg import LoaderState
from ehls_ros.cli.main import main
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from ehls_ros.recording.bag_reader import read_bag

LAW = "fasmc_output_feedback"
SPOOL_LIMIT = 1e-2
GATE = Gate()
TARGET_WATCHDOG = 0.01
MARGIN = 5e-3
"""What may come on top of a watchdog's limit [s]."""

SEED = random.SystemRandom().randrange(2**32)


@pytest.fixture
def rig(graph, participant, tmp_path):
    started = []

    def start(timing="lockstep", *emulator, spoil=""):
        rig = EmulatedRig(graph, participant, tmp_path, LAW, timing, emulator, spoil)
        started.append(rig)
        rig.states = participant.collect(LoaderState, "loader_state")
        rig.diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
        rig.enable()
        run(rig, 700)
        return rig

    yield start
    for rig in started:
        if rig.emulator.poll() is None:
            rig.emulator.kill()
            rig.emulator.communicate()


def run(rig, cycles, seconds=60.0):
    """Let the rig run on for some cycles."""
    seen = rig.states[-1].cycle if rig.states else 0
    rig.participant.until(lambda: bool(rig.states) and rig.states[-1].cycle >= seen + cycles, seconds)


def told(rig, words, seconds=20.0):
    """Wait until diagnostics say something."""

    def found():
        return any(words in text for array in rig.diagnostics for status in array.status
                   for text in (status.message, *(pair.value for pair in status.values)))  # fmt: skip

    rig.participant.until(found, seconds)


def tripped(rig):
    told(rig, "tripped by")


def within_limits(seen):
    """Check what holds whatever happens, and return the commands the actuator saw."""
    command = seen["valve_command_m"]
    assert len(command) > 500
    assert np.all(np.isfinite(command))
    assert np.max(np.abs(command)) <= SPOOL_LIMIT * (1.0 + 1e-9)
    assert np.max(np.abs(np.diff(command))) <= GATE.command_rate * PERIOD * 1.02 or np.any(command == 0.0)
    return command


def time_to_null(seen, since):
    """Return the time from a row on until the command is null for good [s]."""
    command = seen["valve_command_m"]
    moving = np.flatnonzero(command != 0.0)
    last = moving[-1] if moving.size else since
    assert last < len(command) - 1, "the actuator never came to rest"
    return (max(last + 1, since) - since) * PERIOD


def last_change(seen):
    """Return the row of the last command that was not the one before, null aside: the last fresh one."""
    command = seen["valve_command_m"]
    moving = np.flatnonzero((np.diff(command) != 0.0) & (command[1:] != 0.0))
    return int(moving[-1]) + 1


def report(record_property, **figures):
    for name, value in figures.items():
        record_property(name, value)


def row_at(seen, monotonic):
    return int(np.searchsorted(seen["monotonic_s"], monotonic))


def test_the_controller_killed(rig, graph, record_property):
    running = rig()
    graph.kill(f"{LAW}_node")
    tripped(running)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    took = time_to_null(seen, last_change(seen))
    report(record_property, fault="controller killed", reaction="cut", limit_s=GATE.command_timeout, took_s=took)
    assert took <= GATE.command_timeout + MARGIN

    # It comes back, and nothing else has to.
    running.start_emulator()
    running.start(f"{LAW}_node")
    running.enable()
    run(running, 300)
    running.stop_emulator()
    assert np.any(running.seen()["valve_command_m"][-100:] != 0.0)


def test_the_controller_frozen(rig, graph, record_property):
    running = rig()
    graph.processes[f"{LAW}_node"].send_signal(signal.SIGSTOP)
    tripped(running)
    graph.processes[f"{LAW}_node"].send_signal(signal.SIGCONT)
    # What it has to say when it wakes up, the latch does not hear.
    run(running, 200)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    took = time_to_null(seen, last_change(seen))
    report(record_property, fault="controller frozen, then awake", reaction="cut", limit_s=GATE.command_timeout, took_s=took)
    assert took <= GATE.command_timeout + MARGIN


def test_the_reference_killed(rig, graph, record_property):
    running = rig()
    graph.kill("reference_node")
    tripped(running)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    took = time_to_null(seen, last_change(seen))
    report(record_property, fault="reference killed", reaction="cut", limit_s=GATE.command_timeout, took_s=took)
    assert took <= GATE.command_timeout + MARGIN


def test_the_bridge_killed(rig, graph, record_property):
    running = rig("realtime")
    graph.kill("hardware_bridge_node")
    running.participant.rest(1.0)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    took = time_to_null(seen, last_change(seen))
    report(record_property, fault="bridge killed", reaction="target's watchdog", limit_s=TARGET_WATCHDOG, took_s=took)
    assert took <= TARGET_WATCHDOG + MARGIN


def test_the_rig_gone_and_back(rig, graph, record_property):
    running = rig()
    running.stop_emulator(signal.SIGKILL)
    tripped(running)
    running.start_emulator()
    running.participant.rest(0.5)
    running.enable()
    run(running, 300)
    running.stop_emulator()
    seen = running.seen()
    command = within_limits(seen)
    # The rig that came back saw nothing but null until the gate was reset and enabled.
    first = int(np.flatnonzero(command != 0.0)[0])
    assert abs(command[first]) < 1e-3
    report(record_property, fault="rig gone and back", reaction="cut; null until reset", limit_s=GATE.sensor_timeout)
    for name in (f"{LAW}_node", "hardware_bridge_node", "reference_node"):
        assert graph.processes[name].poll() is None


@pytest.mark.parametrize("mode", ["lost", "duplicated", "reordered"])
def test_commands_spoilt_but_sound(rig, graph, record_property, mode):
    running = rig(spoil=mode)
    graph.processes["spoil_commands"].send_signal(signal.SIGUSR1)
    run(running, 300)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    assert not np.any(seen["valve_command_m"][-100:] == 0.0)
    report(record_property, fault=f"commands {mode}", reaction="last command held", limit_s=0.0, took_s=0.0)


@pytest.mark.parametrize(
    ("mode", "limit"),
    [
        ("delayed", GATE.command_timeout),
        ("nan", GATE.hold_time + GATE.ramp_time),
        ("inf", GATE.hold_time + GATE.ramp_time),
        ("minus_inf", GATE.hold_time + GATE.ramp_time),
        ("1e30", GATE.hold_time + GATE.ramp_time),
    ],
)
def test_commands_not_fit_to_be_used(rig, graph, record_property, mode, limit):
    running = rig(spoil=mode)
    graph.processes["spoil_commands"].send_signal(signal.SIGUSR1)
    tripped(running)
    run(running, 60)
    running.stop_emulator()
    seen = running.seen()
    command = within_limits(seen)
    # From the first cycle in which the last sound command was merely kept.
    moving = np.flatnonzero(command != 0.0)
    kept = moving[-1]
    while kept > 0 and abs(command[kept - 1] - command[kept]) > 0.0 and command[kept - 1] / command[kept] > 1.0:
        kept -= 1
    while kept > 0 and command[kept - 1] == command[kept]:
        kept -= 1
    took = time_to_null(seen, kept)
    report(record_property, fault=f"commands {mode}", reaction="hold, then null", limit_s=limit, took_s=took)
    assert took <= limit + MARGIN


@pytest.mark.parametrize(
    ("line", "limit"),
    [
        ("stick force", GATE.frozen_time + GATE.ramp_time),
        ("stick position", GATE.frozen_time + GATE.ramp_time),
        ("stick load_pressure", GATE.frozen_time + GATE.ramp_time),
        ("bias force 3000", GATE.mismatch_time + GATE.ramp_time),
        ("bias load_pressure 1.5e6", GATE.mismatch_time + GATE.ramp_time),
        ("bias position 0.05", GATE.ramp_time),
        ("jump force 2e4", GATE.ramp_time),
        ("jump position 0.1", GATE.ramp_time),
    ],
)
def test_sensors_that_lie(rig, record_property, line, limit):
    running = rig()
    running.fault(line)
    put_in = time.monotonic()
    tripped(running)
    run(running, 100)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    took = time_to_null(seen, row_at(seen, put_in))
    report(record_property, fault=line, reaction="ramp", limit_s=limit, took_s=took)
    assert took <= limit + MARGIN


@pytest.mark.parametrize("line", ["silent", "nan force", "nan position"])
def test_sensors_that_say_nothing(rig, record_property, line):
    running = rig("realtime")
    running.fault(line)
    put_in = time.monotonic()
    tripped(running)
    running.fault("clear")
    running.participant.rest(0.3)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    took = time_to_null(seen, row_at(seen, put_in))
    report(record_property, fault=f"sensors: {line}", reaction="cut", limit_s=GATE.sensor_timeout, took_s=took)
    assert took <= GATE.sensor_timeout + TARGET_WATCHDOG + MARGIN


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_the_rigs_clock_steps(rig, record_property, step):
    running = rig()
    running.fault(f"clock {step}")
    run(running, 300)
    running.stop_emulator()
    command = within_limits(running.seen())
    assert not np.any(command[-100:] == 0.0)
    report(record_property, fault=f"rig's clock steps by {step:g} s", reaction="none: cycles are counted", took_s=0.0)


def test_packets_corrupted_lost_doubled_and_late(rig, record_property):
    net = "--corrupt", "0.05", "--loss", "0.05", "--duplicate", "0.05", "--reorder", "0.05", "--jitter-ms", "0.3"
    running = rig("realtime", *net)
    running.participant.rest(2.0)
    counts = running.stop_emulator()
    within_limits(running.seen())
    assert counts["refused_tag"] > 0
    assert counts["order"] > 0
    report(record_property, fault="packets corrupted, lost, doubled, late (5 % each)", reaction="refused and counted")


def test_packets_of_strangers(rig, record_property):
    running = rig()
    before = time.monotonic()
    chance = random.Random(SEED)
    print(f"seed {SEED}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        while running.states[-1].cycle < 1400:
            for size in (0, 1, 63, 64, 72, 120, 1400):
                stranger.sendto(b"EHLS\x01\x03\x01\x00" + chance.randbytes(size), ("127.0.0.1", running.port))
            running.participant.rest(0.01)
            assert time.monotonic() < before + 60.0
    counts = running.stop_emulator()
    command = within_limits(running.seen())
    assert not np.any(command[-100:] == 0.0)
    assert sum(count for name, count in counts.items() if name.startswith("refused")) > 50
    report(record_property, fault="packets of a stranger", reaction="refused and counted", took_s=0.0)


def test_a_second_controller_is_refused_and_reported(rig, graph, record_property):
    running = rig()
    running.start("fasmc_node")
    told(running, "second_sender")
    run(running, 300)
    running.stop_emulator()
    command = within_limits(running.seen())
    assert not np.any(command[-100:] == 0.0)
    assert np.max(np.abs(np.diff(command[-200:]))) < 2e-3
    report(record_property, fault="a second controller", reaction="ignored and reported", took_s=0.0)


def test_parameters_fuzzed(rig, graph, record_property):
    running = rig()
    chance = random.Random(SEED)
    print(f"seed {SEED}")
    names = {f"{LAW}_node": ("k", "g", "h", "b", "xi", "phi1", "phi3"), "hardware_bridge_node": Gate._fields}
    values = (float("nan"), float("inf"), -1.0, 0.0, 1e-9, 1.0, 12.0, 1e3, 1e30, "cut", "warn", "", True, 7, -(2**63))
    accepted = 0
    for _ in range(300):
        node = chance.choice(list(names))
        answer = running.participant.set_parameter(node, chance.choice(names[node]), chance.choice(values))
        accepted += answer.successful
        assert answer.successful or answer.reason
    running.stop_emulator()
    within_limits(running.seen())
    assert 0 < accepted < 300
    for name in names:
        assert graph.processes[name].poll() is None
    report(record_property, fault="parameters fuzzed (300)", reaction=f"{accepted} accepted, the rest refused with a reason")


def test_the_recorder_killed_and_its_bag_recovered(rig, graph, record_property, tmp_path):
    running = rig()
    running.start("recorder_node", bag=tmp_path / "bag")
    running.participant.until((tmp_path / "bag").exists)
    run(running, 1500)
    killed_ns = time.time_ns()
    graph.kill("recorder_node")
    run(running, 300)
    running.stop_emulator()
    assert not np.any(within_limits(running.seen())[-100:] == 0.0)
    assert main(["recover", str(tmp_path / "bag")]) == 0
    with Reader(tmp_path / "bag_recovered") as reader:
        lost = (killed_ns - reader.end_time) * 1e-9
    assert lost <= 1.0
    trajectory = read_bag(tmp_path / "bag_recovered")
    assert np.array_equal(np.diff(np.round(trajectory.time_s / PERIOD)), np.ones(len(trajectory) - 1))
    force = {state.cycle: state.force for state in running.states}
    first = round(trajectory.time_s[0] / PERIOD)
    assert all(force.get(first + k, value) == value for k, value in enumerate(trajectory["force_n"]))
    report(record_property, fault="recorder killed", reaction="bag recovered", limit_s=1.0, took_s=lost)


def test_a_full_disk(rig, graph, record_property, tmp_path):
    running = rig()
    running.start("recorder_node", bag=tmp_path / "bag", largest_file=1_500_000)
    told(running, "not recording", 60.0)
    run(running, 300)
    running.stop_emulator()
    assert not np.any(within_limits(running.seen())[-100:] == 0.0)
    assert graph.processes["recorder_node"].poll() is None
    assert main(["recover", str(tmp_path / "bag")]) == 0
    assert len(read_bag(tmp_path / "bag_recovered")) > 500
    report(record_property, fault="disk full", reaction="recording ends, reported; the graph goes on")


def test_the_emergency_stop(rig, record_property):
    running = rig()
    assert running.participant.call(Trigger, "emergency_stop", Trigger.Request()).success
    stopped = time.monotonic()
    run(running, 100)
    running.stop_emulator()
    seen = running.seen()
    within_limits(seen)
    took = time_to_null(seen, row_at(seen, stopped))
    report(record_property, fault="emergency stop", reaction="cut", limit_s=0.0, took_s=took)
    assert took <= MARGIN
