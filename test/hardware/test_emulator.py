"""The rig emulator: a process on a real socket compared with the simulator; its watchdog, faults and network impairments."""

import contextlib
import itertools
import json
import select
import signal
import socket
import subprocess
import sys
import time
import types
from pathlib import Path

import numpy as np
import pytest
import yaml
from patience import PATIENCE
from udp_link import UDP

from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import sampled, simulator_of
from ehls_ros.experiments.spec import load_rig, load_spec
from ehls_ros.hardware import wire
from ehls_ros.hardware.bridge_file import bridge_from_mapping
from ehls_ros.hardware.calibration import Input
from ehls_ros.hardware.emulator import converted
from ehls_ros.hardware.faults import Faults
from ehls_ros.hardware.packet import Status
from ehls_ros.physics.rig import SENSED

CONFIG = Path(__file__).resolve().parents[2] / "config"
SPEC = CONFIG / "experiments" / "servo_sine.yaml"
RIG = CONFIG / "rig_paper_measured.yaml"
BRIDGE = bridge_from_mapping(yaml.safe_load((CONFIG / "bridge_udp.yaml").read_text()), "bridge_udp.yaml")
FORCE, PRESSURE = SENSED.index("force"), SENSED.index("load_pressure")
PERIOD = 1e-3


class Process:
    """An `ehls rig-emulator` and a device connected to it."""

    def __init__(self, *arguments):
        command = [sys.executable, "-m", "ehls_ros.cli.main", "rig-emulator", "--port", "0", "--json", *map(str, arguments)]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        self.port = int(self.line().rsplit(" ", 1)[1])
        self.device = UDP.open(BRIDGE.parameters._replace(port=self.port), BRIDGE.calibration.wiring, PERIOD)

    def line(self):
        ready, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
        assert ready, "the emulator says nothing"
        return self.process.stdout.readline().strip()

    def fault(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def finish(self, number=None):
        """Return exit code, the figures on the last line, and stderr."""
        if number is not None:
            self.process.send_signal(number)
        out, err = self.process.communicate(timeout=PATIENCE)
        self.device.close()
        return self.process.returncode, json.loads(out.splitlines()[-1]) if out else None, err

    def close(self):
        self.device.close()
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture
def start():
    with contextlib.ExitStack() as stack:
        yield lambda *arguments: stack.enter_context(contextlib.closing(Process(*arguments)))


def read_log(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def law(force, cycle):
    """An arbitrary feedback law, so that any difference spreads to all signals."""
    wanted = 2000.0 + 50.0 * cycle
    return max(-2e-3, min(2e-3, 4e-7 * (wanted - force)))


def rounded(value, step, low):
    return low + step * np.round((value - low) / step)


def in_process(cycles):
    """Run the same loop with the bare simulator: one cycle of delay, 16 bits over +-10 V in and +-5 V out."""
    spec = load_spec(SPEC)._replace(rig=load_rig(RIG))
    simulator, random = simulator_of(spec), np.random.default_rng(5)
    signal_of = sampled(spec.disturbance.signal, PERIOD)
    kind = DISTURBANCES.load(spec.disturbance.name)
    disturbance = kind.build(spec.disturbance.parameters, signal_of, spec.rig, PERIOD)
    rows, volts, states = disturbance.rows(0, cycles), 0.0, []
    for cycle in range(cycles):
        measured = simulator.measure(random.standard_normal(len(SENSED)))
        force = 8e3 * rounded(measured[FORCE] / 8e3, 20.0 / 2**16, -10.0)
        states.append((2e-3 * volts, *simulator.truth[[0, 2, 3]], *simulator.servo[:2]))
        simulator.advance(2e-3 * volts, *rows[cycle])
        volts = rounded(law(force, cycle) / 2e-3, 10.0 / 2**16, -5.0)
    return np.array(states)


def test_lockstep_is_the_simulator_with_a_cycle_of_delay(start, tmp_path):
    cycles, log = 300, tmp_path / "truth.csv"
    arguments = ("--spec", SPEC, "--rig", RIG, "--lockstep", "--disturb-at-once", "--seed", 5, "--duration", 0.3, "--log", log)
    emulator = start(*arguments)
    for cycle in range(cycles):
        reading = emulator.device.read(PATIENCE)
        assert (reading.sequence, reading.time_ns) == (cycle, 1_000_000 * cycle)
        signals = BRIDGE.calibration.signals(reading.values)
        assert np.isnan(signals[SENSED.index("velocity")])
        emulator.device.write(BRIDGE.calibration.command(law(signals[FORCE], cycle)), reading.sequence)
    code, figures, _ = emulator.finish()
    assert (code, figures["cycles"], figures["commands"]) == (0, cycles, cycles)
    truth, expected = read_log(log), in_process(cycles)
    servo = ("disturbance_displacement_m", "disturbance_velocity_m_s")
    names = ("valve_command_m", "position_m", "load_pressure_pa", "spool_m", *servo)
    for name, column in zip(names, expected.T, strict=True):
        np.testing.assert_allclose(truth[name], column, rtol=1e-9, atol=1e-12 * np.abs(column).max(), err_msg=name)
    assert np.ptp(truth["disturbance_displacement_m"]) > 0.01


def test_the_valve_closes_when_commands_stop(start, tmp_path):
    log = tmp_path / "truth.csv"
    emulator = start("--rig", RIG, "--log", log)
    for _ in range(100):
        reading = emulator.device.read(PATIENCE)
        emulator.device.write(1.25, reading.sequence)
    silent = time.monotonic()
    while time.monotonic() < silent + 2.0 * BRIDGE.parameters.watchdog or not reading.at_null:
        reading = emulator.device.read(1.0) or reading
    code, figures, err = emulator.finish(signal.SIGINT)
    # If this machine stalls for longer than the watchdog time, it trips more than once.
    assert code == 0, err
    assert figures["watchdog"] >= 1
    truth = read_log(log)
    commanded = truth["output_status"] == Status.COMMANDED
    assert set(np.unique(truth["output_raw"][commanded])) == {1.25}
    assert not truth["output_raw"][~commanded].any()
    # The first cycle after the last command has certainly received it; the watchdog counts from there.
    taken = truth["monotonic_s"][truth["monotonic_s"] >= silent][0]
    assert truth["monotonic_s"][commanded][-1] <= taken + BRIDGE.parameters.watchdog
    assert len(truth) == figures["cycles"]


@pytest.mark.parametrize("wait", [0, 7])
def test_disturbance_starts_the_given_time_after_the_first_command_that_opens_the_valve(start, tmp_path, wait):
    log = tmp_path / "truth.csv"
    arguments = ("--lockstep", "--duration", 0.04, "--disturb-after", wait * PERIOD, "--log", log)
    emulator = start("--spec", CONFIG / "experiments" / "sine_fd2.yaml", *arguments)
    for cycle in range(40):
        emulator.device.read(PATIENCE)
        emulator.device.write(0.5 if cycle >= 20 else 0.0, cycle)
    assert emulator.finish()[0] == 0
    force = read_log(log)["disturbance_force_n"]
    # The command that answers cycle 20 acts in cycle 21, which is cycle 0 of the disturbance.
    first = 21 + wait
    expected = 5e3 * np.sin(2.0 * np.pi * 1.0 * PERIOD * np.arange(40 - first))
    assert not force[:first].any()
    np.testing.assert_allclose(force[first:], expected, atol=1e-6)


def test_losses_are_survived_and_counted(start):
    emulator = start("--rig", RIG, "--loss", 0.2, "--duplicate", 0.2, "--corrupt", 0.1, "--seed", 3)
    numbers = []
    while len(numbers) < 300:
        reading = emulator.device.read(PATIENCE)
        numbers.append(reading.sequence)
        emulator.device.write(0.1, reading.sequence)
    seen = emulator.device.figures()
    code, figures, _ = emulator.finish(signal.SIGTERM)
    assert code == 0
    assert all(after > before for before, after in itertools.pairwise(numbers))
    assert seen["lost"] > 30
    assert seen["refused_tag"] > 0
    assert figures["order"] > 0
    # About 0.8 * 0.9 of the commands get through, more with duplicates; some too late if this machine is slow.
    assert figures["commands"] < 0.95 * seen["sent"]
    assert figures["commands"] + figures["late"] > 0.6 * seen["sent"]


def test_faults_from_stdin(start):
    emulator = start("--rig", RIG, "--lockstep", "--duration", 0.02, "--faults-from-stdin")
    signals = {}
    for cycle in range(20):
        reading = emulator.device.read(PATIENCE)
        signals[cycle] = BRIDGE.calibration.signals(reading.values)
        for line in {5: ["bias force 800"], 10: ["clear", "jump position 0.1"], 15: ["frob"]}.get(cycle, []):
            emulator.fault(line)
            assert line in emulator.line()
        emulator.device.write(0.0, cycle)
    assert emulator.finish()[0] == 0
    assert abs(signals[6][FORCE] - signals[5][FORCE]) > 700.0
    assert abs(signals[11][FORCE] - signals[10][FORCE]) > 700.0
    position = [signals[cycle][0] for cycle in (10, 11, 12)]
    assert position[1] - position[0] == pytest.approx(0.1, abs=1e-3)
    assert position[2] - position[0] == pytest.approx(0.0, abs=1e-3)


def test_lockstep_gives_up_without_an_answer(start):
    emulator = start("--rig", RIG, "--lockstep", "--patience", 0.05)
    while emulator.process.poll() is None:
        emulator.device.read(0.01)
    code, _, err = emulator.finish()
    assert code == 1
    assert "no command answered cycle 0 within 0.05 s" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--lockstep", "--loss", "0.1"), "--lockstep"),
        (("--loss", "1.5"), "loss"),
        (("--duration", "-1"), "--duration"),
        (("--bridge", CONFIG / "bridge_comedi.yaml"), "udp"),
        (("--bridge", "missing.yaml"), "missing.yaml"),
        (("--rig", "missing.yaml"), "missing.yaml"),
        (("--log", "/proc/no/log.csv"), "/proc/no"),
    ],
)
def test_wrong_arguments(arguments, words, capsys):
    from ehls_ros.cli.main import main

    assert main(["rig-emulator", *map(str, arguments)]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert words in line


# --- parts ------------------------------------------------------------------------------------------------------------


def test_converter_rounds_and_saturates():
    channel = Input(channel=0, scale=1.0, range=(-10.0, 10.0), bits=12)
    step = 20.0 / 4096
    assert converted(0.0, channel) == 0.0
    assert converted(0.6 * step, channel) == pytest.approx(step)
    assert converted(-0.4 * step, channel) == 0.0
    assert converted(50.0, channel) == pytest.approx(10.0 - step)
    assert converted(-50.0, channel) == -10.0


def test_faults_change_the_signals_they_name():
    faults = Faults(("position", "force"))
    seen = []
    for line, signals in [
        ("stick position", [0.1, 1.0]),
        ("bias force 500", [0.2, 2.0]),
        ("jump force -7", [0.3, 3.0]),
        ("nan force", [0.4, 4.0]),
        ("clear", [0.5, 5.0]),
    ]:
        faults.apply(line)
        faults.spoil(signals)
        seen.append(signals)
    assert seen[:3] == [[0.1, 1.0], [0.1, 502.0], [0.1, 496.0]]
    assert seen[3][0] == 0.1
    assert np.isnan(seen[3][1])
    assert seen[4] == [0.5, 5.0]
    for switch in ("silent", "deaf"):
        faults.apply(switch)
        assert getattr(faults, switch)
    faults.apply("clock -2.5")
    assert faults.clock_ns == -2_500_000_000


@pytest.mark.parametrize("line", ["", "stick", "stick velocity", "bias force", "bias force x", "jump force inf", "frob force"])
def test_wrong_fault(line):
    with pytest.raises(BadInput):
        Faults(("position", "force")).apply(line)


@pytest.fixture
def clock(monkeypatch):
    """Return the wire's clock, which the test advances [s]."""
    shown = types.SimpleNamespace(now=0.0)
    monkeypatch.setattr(wire, "time", types.SimpleNamespace(monotonic=lambda: shown.now))
    return shown


@pytest.fixture
def bad_wire():
    """Return a function that makes an impaired wire and a plain socket at its far end."""
    with contextlib.ExitStack() as stack:

        def make(**impairments):
            near, far = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
            for end in (near, far):
                end.bind(("127.0.0.1", 0))
                end.setblocking(False)
            return wire.BadWire(near, wire.Impairments(**impairments), PERIOD, seed=2), near, far

        yield make


def arrived(end):
    """Wait until a packet has arrived; the system may deliver it only after it returns to the sender."""
    assert select.select([end], [], [], PATIENCE)[0]


def received(bad):
    return [data for data, _ in bad.received()]


def bits_apart(one, other):
    return sum((a ^ b).bit_count() for a, b in zip(one, other, strict=True))


SENT = [bytes([number]) * 20 for number in range(100)]


@pytest.mark.parametrize(
    ("impairments", "holds"),
    [
        ({"loss": 1.0}, lambda got: got == []),
        ({"loss": 0.3}, lambda got: 50 < len(got) < 90 and got == sorted(got)),
        ({"duplicate": 1.0}, lambda got: got == sorted(2 * SENT)),
        ({"reorder": 0.3}, lambda got: sorted(got) == SENT and got != SENT),
        ({"jitter": 5e-3}, lambda got: sorted(got) == SENT and got != SENT),
        ({"corrupt": 1.0}, lambda got: [bits_apart(*pair) for pair in zip(got, SENT, strict=True)] == [1] * len(SENT)),
    ],
)
def test_bad_net(bad_wire, clock, impairments, holds):
    bad, near, far = bad_wire(latency=1e-6, **impairments)
    got = []
    for number, data in enumerate([*SENT, *10 * [None]]):
        clock.now = number * PERIOD
        if data is not None:
            far.sendto(data, near.getsockname())
            arrived(near)
        got += received(bad)
    assert holds(got)


def test_latency_acts_both_ways(bad_wire, clock):
    bad, near, far = bad_wire(latency=0.03)
    far.sendto(b"in", near.getsockname())
    arrived(near)
    bad.send(b"out", far.getsockname())
    for clock.now in (0.0, 0.029):
        assert received(bad) == []
        with pytest.raises(BlockingIOError):
            far.recv(10)
    clock.now = 0.031
    assert received(bad) == [b"in"]
    arrived(far)
    assert far.recv(10) == b"out"


def test_packets_due_while_waiting_are_sent(bad_wire):
    bad, _, far = bad_wire(latency=0.03)
    bad.send(b"out", far.getsockname())
    begin = time.monotonic()
    assert bad.wait(begin + 0.1) >= begin + 0.1
    arrived(far)
    assert far.recv(10) == b"out"
