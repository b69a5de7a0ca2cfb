"""The bridge on an emulated rig in real time, with a controller the test commands; the valve's motion is read back from a log.

These tests concern timing, so they run in real time, but at a pace that a slow computer can keep. By default a cycle takes
10 ms, and all of the gate's times are longer in proportion.
"""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from emulated_rig import ROOT, acknowledged, columns_of, own_port, trace_of
from heard import Ear
from patience import PATIENCE
from policies.monitor import Verdict, check
from policies.trace import Setup, Trace
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.msg import LoaderState
from ehls_ros.hardware.gate_bounds import bounds_of, within
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from ehls_ros.hardware.safety_gate import STOP_TIME
from ehls_ros.physics.rig import rig_from_mapping

BRIDGE = "hardware_bridge_node"

LATE = ("command_stale", "sensor_stale", "gap", "device_null")
"""Trips of a gate whose computer was delayed for longer than the gate waits."""


class Pace(NamedTuple):
    """Pace of a rig and the corresponding times of its gate [s]; the velocity limit in m/s."""

    period: float
    velocity: float
    timeout: float
    watchdog: float
    ramp: float
    enable: float


SLOW = Pace(period=0.01, velocity=0.2, timeout=0.3, watchdog=0.15, ramp=0.1, enable=0.6)
"""A computer held back to a third of its speed by pauses of 70 ms still keeps up."""

FAST = Pace(period=0.001, velocity=2.0, timeout=0.03, watchdog=0.01, ramp=0.02, enable=0.1)
"""The pace of a real rig."""

AMPLITUDE, FREQUENCY = 1e-4, 0.7
"""Commanded sine, too small to trip the gate [m, Hz]."""

COMMANDED = 2.0 * AMPLITUDE
"""Largest command: the commander adds a little towards mid-stroke [m]."""


class CommandedRig:
    """Emulator, bridge and commander; the test itself is a further participant."""

    def __init__(
        self,
        graph: Any,
        participant: Any,
        folder: Path,
        pace: Pace = SLOW,
        bridge: str = "",
        net: Sequence[str] = (),
        **gate: Any,
    ) -> None:
        self.graph, self.participant, self.folder, self.pace = graph, participant, folder, pace
        rig = yaml.safe_load((ROOT / "config" / "rig_paper_measured.yaml").read_text(encoding="utf-8"))
        rig["limits"]["velocity"] = pace.velocity
        self._write("measured.yaml", rig)
        reference = {"name": "constant", "value": 0.0}
        spec = {"title": "attacked", "rig": "measured.yaml", "control_period": pace.period, "reference": reference}
        self.spec = self._write("attacked.yaml", {**spec, "controller": "fasmc_output_feedback"})
        wiring = yaml.safe_load((ROOT / "config" / "bridge_udp.yaml").read_text(encoding="utf-8"))
        self.port = wiring["backend"]["port"] = own_port()
        wiring["backend"]["watchdog"] = pace.watchdog
        self.wiring = self._write("wiring.yaml", wiring)
        times = {"command_timeout": pace.timeout, "sensor_timeout": pace.timeout, "hold_time": pace.ramp}
        self.gate = {
            **times,
            "ramp_time": pace.ramp,
            "limit_time": 2.0 * pace.period,
            "enable_time": pace.enable,
            # Once too slow, a computer would have to keep up nearly fully.
            "least_answered": 0.0,
            **gate,
        }
        self.bridge_script, self.net = bridge, net
        limits = within(Gate(), bounds_of(known := rig_from_mapping(rig, "measured.yaml"), pace.period))
        self.setup = Setup(
            pace.period,
            known,
            limits._replace(**{name: value for name, value in self.gate.items() if name in Gate._fields}),
            pace.watchdog,
        )
        self.stop = ""
        self.ear = Ear(participant.node)
        self.states: list[Any] = participant.collect(LoaderState, "loader_state")
        self.diagnostics: list[Any] = participant.collect(DiagnosticArray, "/diagnostics")
        # The emulator last: the others start while it is awaited.
        self.start_bridge()
        self.start_commander("commander")
        self.start_emulator()
        participant.until(lambda: "up" in graph.log("commander"), PATIENCE)
        self.command(f"sine {AMPLITUDE} {FREQUENCY}")

    def _write(self, name: str, content: Any) -> Path:
        path = self.folder / name
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path

    def start_emulator(self) -> None:
        self.log = self.folder / "truth.csv"
        words = ["--spec", self.spec, "--bridge", self.wiring, "--log", self.log, "--json", "--faults-from-stdin"]
        command = [sys.executable, "-m", "ehls_ros.cli.main", "rig-emulator", *map(str, words), *self.net]
        with (self.folder / "emulator.err").open("ab") as errors:
            self.emulator = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors)
        assert b"listening" in self.emulator.stdout.readline(), (self.folder / "emulator.err").read_text()

    def start_commander(self, name: str) -> None:
        self.graph.run(name, [str(Path(__file__).with_name("commander.py")), name, str(self.pace.period)])

    @property
    def bridge_parameters(self) -> dict[str, Any]:
        """Parameters that a bridge is started with."""
        return {"spec": self.spec, "bridge": self.wiring, "timing": "realtime", **self.gate}

    def start_bridge(self) -> None:
        if not self.bridge_script:
            self.bridge = self.graph.start(BRIDGE, **self.bridge_parameters)
            return
        words = [word for key, value in self.bridge_parameters.items() for word in ("-p", f"{key}:={value}")]
        self.bridge = self.graph.run(BRIDGE, [self.bridge_script, "--ros-args", *words])

    def restart_bridge(self) -> None:
        """Start a new bridge and wait until it is up; services of the dead one may seem to persist for a while."""
        times_up = self.graph.log(BRIDGE).count(": up")
        self.start_bridge()
        self.participant.until(lambda: self.graph.log(BRIDGE).count(": up") > times_up)

    def command(self, line: str, commander: str = "commander") -> None:
        """Send a commander its instruction."""
        self.graph.tell(commander, line)

    def fault(self, line: str) -> float:
        """Inject a fault into the emulated rig and return the time from which it acts [s]."""
        self.emulator.stdin.write(f"{line}\n".encode())
        self.emulator.stdin.flush()
        return self.participant.journal.note("fault", line, float(self.emulator.stdout.readline().split()[1]))

    def live(self, seconds: float) -> None:
        """Let the rig run for a while by its clock, without faults."""
        end = time.monotonic() + seconds
        while self.fault("clear") < end:
            self.participant.rest(self.pace.period)

    def ask(self, kind: Any, service: str, **fields: Any) -> Any:
        """Call a service of the graph."""
        return self.participant.call(kind, service, kind.Request(**fields))

    def enable(self) -> Any:
        """Enable the gate and return its answer."""
        return self.ask(SetBool, "enable", data=True)

    def emergency_stop(self) -> float:
        """Stop, and return the time of the answer [s]."""
        answer = self.ask(Trigger, "emergency_stop")
        assert answer.success
        self.stop = answer.message.partition(";")[0]
        return time.monotonic()

    def acknowledge(self) -> None:
        """Acknowledge the last stop; right after the stop this is refused."""
        self.stop = acknowledged(self.participant, self.stop)

    def transition(self, label: str) -> bool:
        """Request a transition of the bridge and return whether it succeeded."""
        return bool(self.participant.change(BRIDGE, label))

    def state(self) -> str:
        """Return the bridge's lifecycle state."""
        return str(self.participant.state_of(BRIDGE))

    def said(self) -> dict[str, str]:
        """Return the values and the message of the diagnostics that the bridge publishes after this call."""
        called = time.time_ns()
        self.diagnostics.clear()

        def told() -> list[Any]:
            return [status for array in self.diagnostics.after(called) for status in array.status if status.name == BRIDGE]

        self.participant.until(told)
        newest = told()[-1]
        return {pair.key: pair.value for pair in newest.values} | {"message": newest.message}

    def open(self) -> None:
        """Acknowledge, reset and enable, and wait until the valve follows the commands."""
        deadline = time.monotonic() + PATIENCE
        while True:
            if self.stop:
                self.acknowledge()
            reset, answer = self.ask(Trigger, "reset_trips"), self.enable()
            if answer.success:
                self.participant.rest(self.pace.enable)
                said = self.said()
                if said["state"] == "active":
                    return
            assert time.monotonic() < deadline, f"reset: {reset.message}; enable: {answer.message}; {self.said()['message']}"
            self.participant.rest(0.2 * STOP_TIME)

    def was_late(self) -> bool:
        """Return whether the gate has tripped since this computer was late; if it follows the commands, it has not."""
        said = self.said()
        assert said["state"] == "active" or said.get("cause_1", "").startswith(LATE), said["message"]
        return said["state"] != "active"

    def bears(self, attack: Callable[[], None]) -> None:
        """Check that the valve follows the commands after an attack, repeated if the computer itself was late."""
        deadline = time.monotonic() + PATIENCE
        attack()
        while self.was_late():
            assert time.monotonic() < deadline, "the gate trips each time"
            self.open()
            attack()

    def tripped(self) -> str:
        """Wait until the gate has tripped and return its message."""
        deadline = time.monotonic() + PATIENCE
        while (said := self.said())["state"] not in {"cut", "ramping", "stopped"}:
            assert time.monotonic() < deadline, said["message"]
        return said["message"]

    def finish(self) -> "Truth":
        """Stop the emulator, check all policies, and return the valve's motion."""
        trace = self.trace()
        return Truth(trace.moments, trace.command, self.pace.period, check(trace))

    def trace(self) -> Trace:
        """Stop the emulator and return its trace."""
        self.emulator.send_signal(signal.SIGINT)
        output, _ = self.emulator.communicate(timeout=PATIENCE)
        self.counts = json.loads(output.splitlines()[-1])
        self.ear.listen()
        return trace_of(self.setup, columns_of(self.log), self.ear, self.graph, self.participant)

    def close(self) -> None:
        self.ear.close()
        if self.emulator.poll() is None:
            self.emulator.kill()
            self.emulator.communicate()


class Truth(NamedTuple):
    """The valve's true motion.

    Attributes:
        time: monotonic time of each of the rig's cycles [s].
        command: command that acted on the valve in that cycle [m].
        period: time of a cycle [s].
        verdicts: of the policies, by name.
    """

    time: np.ndarray
    command: np.ndarray
    period: float
    verdicts: Mapping[str, Verdict]

    def between(self, since: float, until: float = np.inf) -> np.ndarray:
        """Return the commands of a period."""
        return self.command[(self.time >= since) & (self.time < until)]

    def time_to_null(self, since: float, until: float = np.inf) -> float:
        """Return the time for which the valve stayed open after ``since``, looking up to ``until`` [s]."""
        rows = (self.time >= since) & (self.time < until)
        moving = self.time[rows][self.command[rows] != 0.0]
        return float(moving[-1] - since) + self.period if moving.size else 0.0

    def said_of(self, policy: str, since: float, until: float = np.inf) -> bool:
        """Return whether a policy was evaluated in a period."""
        times = self.verdicts[policy].margins.time
        return bool(np.any((times >= since) & (times < until)))
