"""Random sequences of attacks on a running bridge, and what must hold for the valve in all of them.

A sequence is several actions: services, transitions, parameters, signals to processes, faults of network and sensors,
commands of every kind. The periods in which the valve must be closed are noted, and compared with the rig's log at the end.
"""

import signal
import time
from collections import Counter
from collections.abc import Callable
from random import Random
from typing import Any, NamedTuple

import numpy as np
from commanded_rig import BRIDGE, CommandedRig, Pace, truth_of
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from patience import PATIENCE
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.srv import AcknowledgeStop
from ehls_ros.hardware.gate_parameters import REACTIONS, Parameters
from ehls_ros.schema import declarations

LARGEST = 5e-4
"""Largest command of the commander, and largest the gate may pass [m]."""

ACTIONS = 8
"""Actions of a sequence."""

DECLARED = {declared.name: declared for declared in declarations(Parameters)}


class Closed(NamedTuple):
    """A period in which the valve must be at null.

    Attributes:
        why: what closed it.
        since: time by which it must have closed [s].
        until: time of the first action that may open it again [s].
    """

    why: str
    since: float
    until: float


class Worst(NamedTuple):
    """Extremes of a run; lengths in m, speeds in m/s, forces in N.

    Attributes:
        command: largest command that reached the valve.
        open_when_closed: largest command in a period in which it had to be at null, as `Truth.open_when_closed` has it.
        beyond_ramp: largest excess of an opening over its ramp.
        step: largest first command after a lasting null.
        speed: largest speed of the piston.
        force: largest force of the cylinder.
        position: largest distance from mid-stroke.
        opened: fraction of the time in which the valve was open.
    """

    command: float
    open_when_closed: float
    beyond_ramp: float
    step: float
    speed: float
    force: float
    position: float
    opened: float


class RandomAttacks:
    """Attacks a rig at random.

    Attributes:
        done: number of times each action was taken.
        closed: the periods in which the valve had to be at null.
    """

    def __init__(self, rig: CommandedRig, random: Random) -> None:
        self.rig, self.random = rig, random
        self.done: Counter[str] = Counter()
        self.closed: list[Closed] = []
        self._shut: tuple[str, float] | None = None
        self._lifecycle = "active"
        self._changed: set[str] = set()
        self._actions: dict[Callable[[], Any], float] = {
            self.enable: 6,
            self.reset: 4,
            self.disable: 2,
            self.emergency_stop: 1,
            self.acknowledge: 2,
            self.acknowledge_wrongly: 1,
            self.transition: 4,
            self.invalid_transition: 1,
            self.parameter: 4,
            self.freeze_bridge: 3,
            self.freeze_emulator: 1,
            self.freeze_commander: 1,
            self.lose_packets: 2,
            self.spoil_sensor: 2,
            self.command: 4,
            self.rest: 4,
            self.kill_bridge: 0.2,
        }

    def sequence(self) -> None:
        """Open the valve, then take some actions."""
        self.come_back()
        self.rig.participant.rest(1.5 * self.rig.pace.enable)
        for _ in range(ACTIONS):
            [action] = self.random.choices(list(self._actions), list(self._actions.values()))
            self.done[action.__name__] += 1
            action()
        self.rig.fault("clear")

    def come_back(self) -> None:
        """Open the gate, whatever happened before."""
        self.rig.fault("clear")
        self.rig.command(f"sine {LARGEST / 2} 1.3")
        for label in {"unconfigured": ("configure", "activate"), "inactive": ("activate",)}.get(self._lifecycle, ()):
            assert self.rig.transition(label)
        self._lifecycle = "active"
        self.disable()
        for name in self._changed:
            self.rig.participant.set_parameter(BRIDGE, name, self.rig.gate.get(name, DECLARED[name].default))
        self._changed.clear()
        deadline = time.monotonic() + PATIENCE
        while True:
            self.acknowledge()
            self.reset()
            if self.enable():
                return
            assert time.monotonic() < deadline, self.rig.said()["message"]
            self.rig.participant.rest(0.05)

    def end_of_null(self) -> None:
        """Note that the valve may open from now on."""
        if self._shut is not None:
            self.closed.append(Closed(*self._shut, time.monotonic()))
            self._shut = None

    # Actions

    def enable(self) -> bool:
        latched = bool(self.rig.stop) or self._lifecycle != "active"
        if not latched:
            self.end_of_null()
        opened = bool(self.rig.enable().success)
        assert not (opened and latched)
        return opened

    def reset(self) -> None:
        self.rig.ask(Trigger, "reset_trips")

    def disable(self) -> None:
        ramp = self.rig.participant.get_parameter(BRIDGE, "ramp_time").double_value
        assert self.rig.ask(SetBool, "enable", data=False).success
        # The ramp begins and ends with a cycle.
        self._closed_by("disabled", ramp + 2.0 * self.rig.pace.period)

    def emergency_stop(self) -> None:
        self.rig.emergency_stop()
        self._closed_by("stopped")

    def acknowledge(self) -> None:
        if self.rig.stop:
            self.rig.acknowledge()

    def acknowledge_wrongly(self) -> None:
        name = self.random.choice(["", "stop", "stop-0", "stop-999", "emergency_stop"])
        assert not self.rig.ask(AcknowledgeStop, "acknowledge_stop", stop=name).success

    def transition(self) -> None:
        following = {
            "active": [("deactivate", "inactive")],
            "inactive": [("activate", "active"), ("cleanup", "unconfigured")],
            "unconfigured": [("configure", "inactive")],
        }
        label, state = self.random.choice(following[self._lifecycle])
        assert self.rig.transition(label)
        self._lifecycle = state
        if label == "deactivate":
            self._closed_by(label)

    def invalid_transition(self) -> None:
        wrong = {"active": "configure", "inactive": "configure", "unconfigured": "activate"}
        transition = Transition(label=wrong[self._lifecycle])
        assert not self.rig.ask(ChangeState, f"{BRIDGE}/change_state", transition=transition).success

    def parameter(self) -> None:
        declared = self.random.choice(list(DECLARED.values()))
        self._changed.add(declared.name)
        if declared.kind is str:
            value: Any = self.random.choice([*REACTIONS, "", "off"])
        else:
            low, high = declared.minimum or 0.0, declared.maximum or 1.0
            value = self.random.choice([low, high, self.random.uniform(low, high), float("nan"), -1.0, 1e30, 1, True])
        self.rig.participant.set_parameter(BRIDGE, declared.name, value)

    def freeze_bridge(self) -> None:
        asleep = self._freeze(self.rig.bridge, self.random.choice([0.005, 0.02, 0.05, 0.09, 0.3]))
        if asleep > self.rig.pace.timeout + self.rig.pace.period:
            self._closed_by("frozen")

    def freeze_emulator(self) -> None:
        self._freeze(self.rig.emulator, self.random.choice([0.005, 0.02, 0.09]))

    def freeze_commander(self) -> None:
        self._freeze(self.rig.graph.processes["commander"], self.random.choice([0.005, 0.02, 0.09]))

    def lose_packets(self) -> None:
        self.rig.fault(self.random.choice(["deaf", "silent"]))
        self.rig.participant.rest(self.random.choice([0.003, 0.012, 0.03, 0.1]))
        self.rig.fault("clear")

    def spoil_sensor(self) -> None:
        lines = ("stick force", "stick position", "bias force 3000", "bias load_pressure 1.5e6", "bias position 0.05")
        self.rig.fault(self.random.choice([*lines, "jump force 2e4", "nan force", "nan position", "clock 3600", "clock -3600"]))
        self.rest()
        self.rig.fault("clear")

    def command(self) -> None:
        constant = self.random.uniform(-LARGEST / 5, LARGEST / 5)
        sines = (f"sine {self.random.uniform(0.0, LARGEST / 2)} {self.random.uniform(0.5, 3.0)}", f"constant {constant}")
        self.rig.command(
            self.random.choice([*sines, "mute", "constant nan", "constant inf", "constant 1e30", "constant 0.011"])
        )
        self.rest()

    def rest(self) -> None:
        self.rig.participant.rest(self.random.choice([1.0, 5.0, 20.0, 60.0]) * self.rig.pace.period)

    def kill_bridge(self) -> None:
        name = self.random.choice([signal.SIGKILL, signal.SIGTERM])
        if name == signal.SIGKILL:
            self.rig.graph.kill(BRIDGE)
        else:
            assert self.rig.graph.stop(BRIDGE, name) == 0
        self._closed_by(name.name)
        self.rig.restart_bridge()
        self._lifecycle, self.rig.stop = "active", ""

    def _freeze(self, process: Any, seconds: float) -> float:
        """Freeze a process and return for how long, at least [s]."""
        begun = self.rig.graph.freeze(process)
        time.sleep(seconds)
        asleep = time.monotonic() - begun
        process.send_signal(signal.SIGCONT)
        return asleep

    def _closed_by(self, why: str, takes: float = 0.0) -> None:
        if self._shut is None:
            self._shut = why, time.monotonic() + takes


def judge(columns: dict[str, np.ndarray], pace: Pace, closed: list[Closed]) -> Worst:
    """Return the extremes in the rig's log.

    Args:
        columns: the log by column.
        pace: pace of the rig.
        closed: periods in which the valve had to be at null.
    """
    truth = truth_of(columns, pace)
    open_when_closed = 0.0
    for why, since, until in closed:
        left = truth.open_when_closed(since, until)
        if left > open_when_closed:
            open_when_closed = left
            print(f"open while {why}: {left} m, {since} to {until}")
    beyond = [excess for _, excess in truth.openings(LARGEST)]
    return Worst(
        command=float(np.max(np.abs(truth.command))),
        open_when_closed=open_when_closed,
        beyond_ramp=max([0.0, *beyond]),
        step=truth.largest_step_after_null(),
        speed=float(np.max(np.abs(columns["velocity_m_s"]))),
        force=float(np.max(np.abs(columns["force_n"]))),
        position=float(np.max(np.abs(columns["position_m"]))),
        opened=float(np.mean(truth.command != 0.0)),
    )
