"""Attacks on a running bridge and its emulated rig, at the gate and its surroundings.

A sequence opens the valve and takes some actions: services, transitions, parameters, signals to processes, faults of network
and sensors, and commands of every kind. A second controller stands by or intrudes, and a second plant appears. The policies
state the requirements meanwhile.
"""

import math
import signal
import time
from collections import Counter
from random import Random
from typing import Any

from commanded_rig import BRIDGE, CommandedRig, Pace
from guided import Attack, Kind
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from patience import PATIENCE
from policies.trace import Trace
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.srv import AcknowledgeStop, SwitchController
from ehls_ros.hardware.gate_parameters import REACTIONS, Parameters
from ehls_ros.schema import declarations

LARGEST = 5e-4
"""Largest sound command of the commanders [m]."""

RIVAL = "rival"
"""The second controller."""

SECOND_PLANT = "bridge again"
"""A second bridge on the same rig, which must have a different name."""

FOLLOWING = {
    "active": [("deactivate", "inactive")],
    "inactive": [("activate", "active"), ("cleanup", "unconfigured")],
    "unconfigured": [("configure", "inactive")],
}

DECLARED = {declared.name: declared for declared in declarations(Parameters)}

TIMES = ("ramp_time", "command_timeout", "sensor_timeout", "hold_time", "enable_time", "command_rate", "limit_time")
"""Times of the gate that policies depend on."""

TIGHT = {
    "trip_level": (0.005, 0.3),
    "position_margin": (0.2, 0.31),
    "frozen_time": (0.005, 0.1),
    "frozen_command": (1e-5, 2e-4),
}
"""Parameters that trip the gate in normal use if set tightly, with ranges of such values."""


def _parameter(random: Random) -> tuple[str, Any]:
    if random.random() < 0.3:
        name = random.choice(list(TIGHT))
        return name, _spread(random, *TIGHT[name])
    declared = DECLARED[random.choice([*TIMES, random.choice(list(DECLARED))])]
    if declared.kind is str:
        return declared.name, random.choice([*REACTIONS, "", "off"])
    low, high = declared.minimum or 0.0, declared.maximum or 1.0
    return declared.name, random.choice([low, high, random.uniform(low, high), math.nan, -1.0, 1e30, 1, True])


def _spread(random: Random, low: float, high: float) -> float:
    """Draw a log-uniform number."""
    return low * (high / low) ** random.random()


def _command(random: Random) -> tuple[str]:
    sine = f"sine {random.uniform(0.0, LARGEST / 2)} {random.uniform(0.5, 3.0)}"
    constant = f"constant {random.uniform(-LARGEST / 5, LARGEST / 5)}"
    return (random.choice([sine, constant, "mute", "constant nan", "constant inf", "constant 1e30", "constant 0.011"]),)


def _misanswer(random: Random) -> tuple[str]:
    value = random.choice([random.uniform(-LARGEST, LARGEST), math.nan])
    cycles = random.choice([1, 2, 10, 1000])
    slow = _spread(random, 1e-4, 0.05)
    return (random.choice([f"duplicate {value}", f"early {cycles} {value}", f"late {cycles} {value}", f"slow {slow}"]),)


def _sensor(random: Random) -> tuple[str]:
    lines = ("stick force", "stick position", "stick load_pressure", "jump force 2e4", "nan force", "nan position")
    biases = f"bias force {_spread(random, 100.0, 5000.0)}", "bias load_pressure 1.5e6", "bias position 0.05"
    return (random.choice([*lines, *biases, "clock 3600", "clock -3600"]),)


KINDS = {
    "reopen": Kind(5),
    "enable": Kind(3),
    "reset": Kind(2),
    "disable": Kind(2),
    "unload": Kind(1),
    "emergency_stop": Kind(1),
    "acknowledge": Kind(1),
    "acknowledge_wrongly": Kind(1, lambda random: (random.choice(["", "stop", "stop-0", "stop-999", "emergency_stop"]),)),
    "transition": Kind(3, lambda random: (random.randrange(2),)),
    "invalid_transition": Kind(1),
    "parameter": Kind(5, _parameter),
    "freeze_bridge": Kind(3, lambda random: (_spread(random, 0.002, 0.4),)),
    "freeze_emulator": Kind(1, lambda random: (_spread(random, 0.002, 0.15),)),
    "freeze_commander": Kind(1, lambda random: (_spread(random, 0.002, 0.15),)),
    "lose_packets": Kind(2, lambda random: (random.choice(["deaf", "silent"]), _spread(random, 0.002, 0.15))),
    "delay_packets": Kind(1, lambda random: (_spread(random, 0.01, 2.0), _spread(random, 0.005, 0.3))),
    "spoil_sensor": Kind(4, lambda random: (*_sensor(random), _spread(random, 1.0, 100.0))),
    "command": Kind(4, _command),
    "answer_wrongly": Kind(2, _misanswer),
    "rival": Kind(2, lambda random: (random.choice([*_command(random), f"intrude {random.uniform(-LARGEST, LARGEST)}"]),)),
    "switch": Kind(3, lambda random: (random.choice(["commander", RIVAL, RIVAL, "nobody"]),)),
    "second_plant": Kind(0.15, lambda random: (random.uniform(0.2, 1.0),)),
    "rest": Kind(3),
    "kill_bridge": Kind(0.2, lambda random: (random.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]),)),
}
"""All actions; each is a method of :class:`BridgeAttacks`."""


class BridgeAttacks:
    """Attacks on a rig.

    Attributes:
        done: number of times each action was taken.
        spans: beginning and end of each sequence [s].
    """

    def __init__(self, rig: CommandedRig) -> None:
        """Take a rig with an open gate, and start a second controller, which stands by."""
        self.rig = rig
        self.done: Counter[str] = Counter()
        self.spans: list[tuple[float, float]] = []
        self._lifecycle = "active"
        self._changed: set[str] = set()
        rig.start_commander(RIVAL)
        rig.participant.until(lambda: "up" in rig.graph.log(RIVAL), PATIENCE)

    def run(self, attack: Attack) -> None:
        """Open the valve, then take the actions."""
        begin = time.monotonic()
        self.come_back()
        self.rig.participant.rest(1.5 * self.rig.pace.enable)
        for action in attack:
            self.done[action.name] += 1
            getattr(self, action.name)(*action.arguments)
            self.rig.participant.rest(action.pause * self.rig.pace.period)
        self.rig.fault("clear")
        self.rig.ear.listen()
        self.spans.append((begin, time.monotonic()))

    def come_back(self) -> None:
        """Reopen the gate from any state."""
        self.rig.fault("clear")
        self.rig.command(f"sine {LARGEST / 4} 0.9", RIVAL)
        self.rig.command(f"sine {LARGEST / 2} 1.3")
        for label in {"unconfigured": ("configure", "activate"), "inactive": ("activate",)}.get(self._lifecycle, ()):
            assert self.rig.transition(label)
        self._lifecycle = "active"
        self.disable()
        for name in sorted(self._changed):
            self.rig.participant.set_parameter(BRIDGE, name, self.rig.gate.get(name, getattr(self.rig.setup.gate, name)))
        self._changed.clear()
        deadline = time.monotonic() + PATIENCE
        while True:
            self.acknowledge()
            self.reset()
            if self.enable():
                return
            assert time.monotonic() < deadline, self.rig.said()["message"]
            self.rig.participant.rest(0.05)

    # Actions

    def reopen(self) -> None:
        """Acknowledge, reset and enable, once, and wait until the commands are blended in."""
        self.acknowledge()
        self.reset()
        if self.enable():
            self.rig.participant.rest(self.rig.pace.enable)

    def enable(self) -> bool:
        return bool(self.rig.enable().success)

    def reset(self) -> None:
        self.rig.ask(Trigger, "reset_trips")

    def disable(self) -> None:
        assert self.rig.ask(SetBool, "enable", data=False).success

    def unload(self) -> None:
        self.rig.ask(Trigger, "unload")

    def emergency_stop(self) -> None:
        self.rig.emergency_stop()

    def acknowledge(self) -> None:
        if self.rig.stop:
            self.rig.acknowledge()

    def acknowledge_wrongly(self, stop: str) -> None:
        self.rig.ask(AcknowledgeStop, "acknowledge_stop", stop=stop)

    def transition(self, choice: int) -> None:
        options = FOLLOWING[self._lifecycle]
        label, state = options[choice % len(options)]
        assert self.rig.transition(label)
        self._lifecycle = state

    def invalid_transition(self) -> None:
        wrong = {"active": "configure", "inactive": "configure", "unconfigured": "activate"}
        transition = Transition(label=wrong[self._lifecycle])
        assert not self.rig.ask(ChangeState, f"{BRIDGE}/change_state", transition=transition).success

    def parameter(self, name: str, value: Any) -> None:
        self._changed.add(name)
        self.rig.participant.set_parameter(BRIDGE, name, value)

    def freeze_bridge(self, seconds: float) -> None:
        self._freeze(self.rig.bridge, seconds)

    def freeze_emulator(self, seconds: float) -> None:
        self._freeze(self.rig.emulator, seconds)

    def freeze_commander(self, seconds: float) -> None:
        self._freeze(self.rig.graph.processes["commander"], seconds)

    def lose_packets(self, line: str, seconds: float) -> None:
        self.rig.fault(line)
        self.rig.participant.rest(seconds)
        self.rig.fault("clear")

    def delay_packets(self, rate: float, most: float) -> None:
        """Increase the transport delay at a rate [s/s] to a value [s]."""
        begin = time.monotonic()
        while (grown := rate * (time.monotonic() - begin)) < most:
            self.rig.fault(f"delay {grown:.6f}")
            self.rig.participant.rest(2.0 * self.rig.pace.period)
        self.rig.fault("clear")

    def spoil_sensor(self, line: str, periods: float) -> None:
        self.rig.fault(line)
        self.rig.participant.rest(periods * self.rig.pace.period)
        self.rig.fault("clear")

    def command(self, line: str) -> None:
        self.rig.command(line)

    answer_wrongly = command

    def rival(self, line: str) -> None:
        self.rig.command(line, RIVAL)

    def switch(self, controller: str) -> None:
        # A controller without a process number in its name is identified by the whole name.
        self.rig.ask(SwitchController, "switch_controller", controller=controller)

    def second_plant(self, seconds: float) -> None:
        """Start a second bridge, which finds the target busy, and stop it."""
        graph = self.rig.graph
        words = [word for key, value in self.rig.bridge_parameters.items() for word in ("-p", f"{key}:={value}")]
        graph.run(SECOND_PLANT, ["-m", f"ehls_ros.nodes.{BRIDGE}", "--ros-args", *words, "-r", "__node:=second_bridge"])
        self.rig.participant.until(lambda: ": up" in graph.log(SECOND_PLANT))
        self.rig.participant.rest(seconds)
        graph.stop(SECOND_PLANT)
        (graph.folder / f"{SECOND_PLANT}.log").unlink()

    def rest(self) -> None:
        """Do nothing but wait for the pause."""

    def kill_bridge(self, number: signal.Signals) -> None:
        if number == signal.SIGKILL:
            self.rig.graph.kill(BRIDGE)
        else:
            assert self.rig.graph.stop(BRIDGE, number) == 0
        self.rig.restart_bridge()
        self._lifecycle, self.rig.stop = "active", ""

    def _freeze(self, process: Any, seconds: float) -> None:
        """Freeze a process for some time [s]."""
        self.rig.graph.freeze(process)
        time.sleep(seconds)
        self.rig.graph.wake(process)

    def trace(self) -> Trace:
        """Stop the rig, and return its trace."""
        self.emergency_stop()
        self.rig.live(0.2)
        return self.rig.trace()

    def close(self) -> None:
        """End the emulator."""
        self.rig.close()


PATIENT_WATCHDOG = 10.0
"""Watchdog time of every third batch, as a multiple of the pace's: then the gate has to detect lateness."""


def paced(pace: Pace, number: int) -> Pace:
    """Return the pace of a batch by its number."""
    return pace._replace(watchdog=PATIENT_WATCHDOG * pace.watchdog) if number % 3 == 2 else pace


def batch(graph: Any, participant: Any, folder: Any, pace: Pace, **options: Any) -> BridgeAttacks:
    """Return a rig to attack, with an open gate."""
    rig = CommandedRig(graph, participant, folder, pace, **options)
    try:
        rig.open()
        return BridgeAttacks(rig)
    except BaseException:
        rig.close()
        raise
