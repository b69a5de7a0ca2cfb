"""The bridge's graph on an emulated rig in lockstep, with injected faults; the valve's motion is read back from a log."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from heard import Ear
from patience import PATIENCE
from policies.monitor import Verdict, check
from policies.trace import Setup, Trace
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.srv import AcknowledgeStop
from ehls_ros.experiments.spec import load_spec
from ehls_ros.hardware.gate_bounds import bounds_of, within
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from ehls_ros.physics.rig import SENSED

ROOT = Path(__file__).resolve().parents[2]
PERIOD = 1e-3

BLEND_IN = 0.1
"""Time over which the gate blends the commands in after enabling, short because a test enables it many times [s]."""

SPEC = {
    "title": "a rig to put faults into",
    "rig": str(ROOT / "config" / "rig_paper_measured.yaml"),
    "duration": 1000.0,
    "reference": {"name": "sine", "amplitude": 4e3, "frequency": 1.0},
    "disturbance": {"name": "force", "signal": {"name": "sine", "amplitude": 1e3, "frequency": 0.5}},
}


def own_port() -> int:
    """Return an unused UDP port: one of the test's ROS domain, beyond those of 100 participants."""
    return 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"]) + 249


def acknowledged(participant: Any, stop: str) -> str:
    """Acknowledge a stop, and return the stop that is still engaged, if any."""
    answer = participant.call(AcknowledgeStop, "acknowledge_stop", AcknowledgeStop.Request(stop=stop))
    # The stop request may have been repeated, for lack of an answer.
    engaged = re.match(r"the engaged stop is ([\w-]+)", answer.message)
    return "" if answer.success else engaged[1] if engaged else stop


def columns_of(log: Path) -> dict[str, np.ndarray]:
    """Return an emulator's log by column."""
    with log.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    table = np.array(rows, dtype=float).reshape(-1, len(header))
    return dict(zip(header, table.T, strict=True))


def trace_of(setup: Setup, log: dict[str, np.ndarray], ear: Ear, graph: Any, participant: Any) -> Trace:
    """Return a run's trace, from the notes and the messages received."""
    graph.note_ended()
    journals = graph.journal, participant.journal
    calls = [call for journal in journals for call in journal.calls]
    happenings = [happening for journal in journals for happening in journal.happenings]
    return Trace(
        setup,
        log,
        tuple(sorted(calls, key=lambda call: call.answered)),
        tuple(sorted(happenings, key=lambda happening: happening.time)),
        ear.messages,
        tuple(ear.reports),
    )


class EmulatedRig:
    """Emulator, bridge, reference and controller; the test itself is a further participant."""

    def __init__(self, graph: Any, participant: Any, folder: Path, law: str, spoil: bool) -> None:
        self.graph, self.participant, self.folder, self.law = graph, participant, folder, law
        self.spec = folder / "rig.yaml"
        self.spec.write_text(yaml.safe_dump({**SPEC, "controller": {"name": law}}), encoding="utf-8")
        bridge = yaml.safe_load((ROOT / "config" / "bridge_udp.yaml").read_text(encoding="utf-8"))
        self.port = bridge["backend"]["port"] = own_port()
        self.bridge = folder / "bridge.yaml"
        self.bridge.write_text(yaml.safe_dump(bridge), encoding="utf-8")
        self.wired = [signal for signal in SENSED if signal in bridge["channels"]]
        rig, watchdog = load_spec(self.spec).rig, bridge["backend"]["watchdog"]
        gate = within(Gate(), bounds_of(rig, PERIOD))._replace(enable_time=BLEND_IN)
        self.setup = Setup(PERIOD, rig, gate, watchdog, lockstep=True)
        self.ear = Ear(participant.node)
        self.emulators = 0
        self.stop = ""
        self.start("reference_node")
        self.start(f"{law}_node", remap="valve_command:=valve_command_unspoilt" if spoil else "")
        if spoil:
            graph.run("spoil_commands", [str(Path(__file__).with_name("spoil_commands.py")), "1"])
        self.start("hardware_bridge_node")
        # The emulator last: the others start while it is awaited.
        self.start_emulator()

    def start(self, name: str, **options: Any) -> subprocess.Popen[bytes]:
        """Start a node, or restart it."""
        own = {"bridge": self.bridge, "enable_time": BLEND_IN} if name == "hardware_bridge_node" else {}
        return self.graph.start(name, spec=self.spec, timing="lockstep", **own, **options)

    def start_emulator(self) -> None:
        self.emulators += 1
        self.log = self.folder / f"truth{self.emulators}.csv"
        command = [
            sys.executable,
            "-m",
            "ehls_ros.cli.main",
            "rig-emulator",
            "--spec",
            str(self.spec),
            "--bridge",
            str(self.bridge),
        ]
        command += ["--log", str(self.log), "--json", "--faults-from-stdin", "--lockstep", "--patience", str(PATIENCE)]
        with (self.folder / "emulator.err").open("ab") as errors:
            self.emulator = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors)
        assert b"listening" in self.emulator.stdout.readline(), (self.folder / "emulator.err").read_text()

    def enable(self) -> None:
        """Enable the gate as soon as it permits."""
        deadline = time.monotonic() + PATIENCE
        while True:
            if self.stop:
                self.acknowledge()
            reset = self.participant.call(Trigger, "reset_trips", Trigger.Request())
            answer = self.participant.call(SetBool, "enable", SetBool.Request(data=True))
            if answer.success:
                return
            assert time.monotonic() < deadline, f"reset: {reset.message}; enable: {answer.message}"
            self.participant.rest(0.02)

    def emergency_stop(self) -> float:
        """Stop, and return the monotonic time of the answer [s]."""
        answer = self.participant.call(Trigger, "emergency_stop", Trigger.Request())
        assert answer.success
        self.stop = answer.message.partition(";")[0]
        return time.monotonic()

    def acknowledge(self) -> None:
        """Acknowledge the last stop; right after the stop this is refused."""
        self.stop = acknowledged(self.participant, self.stop)

    def fault(self, line: str) -> float:
        """Inject a fault into the emulated rig and return the monotonic time from which it acts [s]."""
        self.emulator.stdin.write(f"{line}\n".encode())
        self.emulator.stdin.flush()
        told = self.emulator.stdout.readline().decode()
        word, when, what = told.split(maxsplit=2)
        assert (word, what.strip()) == ("fault:", line), told
        return self.participant.journal.note("fault", line, float(when))

    def spoil_commands(self, mode: str) -> float:
        """Change how the node between controller and bridge spoils the commands; return the time from which it does [s]."""
        before = len(self._spoilt())
        self.graph.tell("spoil_commands", mode)
        self.participant.until(lambda: len(self._spoilt()) > before)
        when, told = self._spoilt()[before]
        assert told == mode
        return float(when)

    def _spoilt(self) -> list[list[str]]:
        """Return that node's output: times and modes, without an incomplete line."""
        return [line.split() for line in self.graph.log("spoil_commands").split("\n")[:-1]]

    def stop_emulator(self, number: int = signal.SIGINT) -> dict[str, Any]:
        """Stop the emulator and return its counts."""
        self.emulator.send_signal(number)
        output, _ = self.emulator.communicate(timeout=PATIENCE)
        return json.loads(output.splitlines()[-1]) if number == signal.SIGINT else {}

    def trace(self) -> Trace:
        """Return the run's trace, once the emulator has stopped."""
        self.ear.listen()
        return trace_of(self.setup, columns_of(self.log), self.ear, self.graph, self.participant)

    def judged(self) -> tuple[dict[str, np.ndarray], dict[str, Verdict]]:
        """Check all policies, and return the emulator's log by column with their verdicts, once the emulator has stopped."""
        trace = self.trace()
        return dict(trace.log), check(trace)

    def close(self) -> None:
        """Kill its remaining processes."""
        self.ear.close()
        if self.emulator.poll() is None:
            self.emulator.kill()
            self.emulator.communicate()
