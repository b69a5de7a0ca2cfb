"""`plant_sim_node`: the simulated rig. It opens each cycle with a loader_state and steps on with the answer."""

import math
import time
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, NoReturn

import numpy as np
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64

from ehls_msgs.msg import Disturbance, LoaderState, ValveCommand
from ehls_ros.experiments.loop import simulator_of
from ehls_ros.nodes.codec import NANOSECONDS
from ehls_ros.nodes.control import ERROR, OK, WAIT, WARN, ControlNode, run_node
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.parameters import declare
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, control_qos
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import SENSED
from ehls_ros.schema import quantity

CLOCK_CYCLES = 10
"""In lockstep /clock tells the plant's time every so many cycles; what runs ahead of the cycles goes by it."""

PATIENCE = 1.0
"""Time without an answer after which lockstep says that it waits [s]."""


class Parameters(NamedTuple):
    """How the simulated rig is run."""

    cycles: Annotated[int, quantity("1", "cycles to run; 0: until told to stop", minimum=0)] = 0
    telemetry_rate: Annotated[
        float, quantity("Hz", "rate of force, load_pressure and joint_states", minimum=0.0, maximum=1e3)
    ] = 50.0


class PlantSimNode(ControlNode):
    """Steps the simulator, cycle by cycle."""

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("plant_sim_node")
        declare(self, Parameters, live=False)
        self.cycles = int(self.get_parameter("cycles").value)
        self.period = self.spec.settings.control_period

    def prepare(self) -> None:
        """Compile the plant and open the topics."""
        settings = self.spec.settings
        self.simulator = simulator_of(self.spec)
        self.random = np.random.default_rng(settings.seed)
        self.cycle = 0
        self.command = 0.0
        self.answered = -1
        self.missed = 0
        self.late = 0
        self.dense = 0
        self.disturbances: dict[int, tuple[float, float, float, float]] = {}
        self.last_disturbance = (0.0, 0.0, 0.0, 0.0)
        self.latency = Latency()
        self.state = Outbox(self, LoaderState, "loader_state", frame_id="loader")
        self.commands = Inbox(self, ValveCommand, "valve_command")
        self.disturbance = Inbox(self, Disturbance, "disturbance")
        self.answer = Waiter([self.commands])
        self.anything = Waiter([self.commands, self.disturbance])
        self.clock = self.create_publisher(Clock, "/clock", control_qos(1)) if self.lockstep else None
        self.telemetry = Telemetry(self)

    def release(self) -> None:
        """Close the topics."""
        if not hasattr(self, "state"):
            return
        for part in (self.answer, self.anything, self.commands, self.disturbance, self.state):
            part.destroy()
        self.telemetry.destroy()
        if self.clock is not None:
            self.destroy_publisher(self.clock)
        del self.state

    def start(self) -> None:
        """Publish the first snapshot."""
        period_ns = round(self.period * NANOSECONDS)
        self.epoch_ns = 0 if self.lockstep else time.time_ns() - self.cycle * period_ns
        self.epoch = time.perf_counter() - self.cycle * self.period
        self._publish()

    def once(self) -> None:
        """Wait for what this cycle needs and finish it."""
        if self.lockstep:
            self._once_lockstep()
        else:
            self._once_realtime()

    def _once_lockstep(self) -> None:
        complete = self.answered == self.cycle
        (self.anything if complete else self.answer).wait(WAIT)
        self._take()
        if self.answered == self.cycle and self.cycle in self.disturbances:
            self._advance()

    def _once_realtime(self) -> None:
        deadline = self.epoch + (self.cycle + 1) * self.period
        remaining = deadline - time.perf_counter()
        if remaining > 0.0:
            self.answer.wait(min(remaining, WAIT))
            self._take()
            return
        self._take()
        if self.answered != self.cycle and self.answered >= 0:
            self.missed += 1
        self._advance()
        # A machine that was away for long goes on from now, rather than hurry after.
        behind = time.perf_counter() - (deadline + self.period)
        if behind > 0.0:
            self.late += 1
            if behind > PATIENCE:
                self.epoch += behind

    def _take(self) -> None:
        if self.cycle not in self.disturbances:
            while (message := self.disturbance.take()) is not None:
                self.disturbances[message[1]] = message[2:]
        while self.answered < self.cycle and (message := self.commands.take()) is not None:
            _, cycle, spool = message
            if cycle > self.answered and cycle <= self.cycle and math.isfinite(spool):
                self.command, self.answered = spool, cycle
                if cycle == self.cycle:
                    self.latency.add(time.perf_counter() - self.published)

    def _advance(self) -> None:
        row = self.disturbances.pop(self.cycle, self.last_disturbance)
        self.last_disturbance = row
        if len(self.disturbances) > 10_000:
            self.disturbances = {k: v for k, v in self.disturbances.items() if k > self.cycle}
        self.dense += self.simulator.advance(self.command, *row)
        self.cycle += 1
        if self.cycles and self.cycle >= self.cycles:
            self.finish()
            self.trigger_later_deactivate()
            return
        self._publish()

    def trigger_later_deactivate(self) -> None:
        """Leave the active state from the service thread once the last cycle is done."""
        timer = self.create_timer(0.0, lambda: (timer.cancel(), self.trigger_deactivate()))

    def _publish(self) -> None:
        measured = self.simulator.measure(self.random.standard_normal(len(SENSED)))
        stamp = self.epoch_ns + round(self.cycle * self.period * NANOSECONDS)
        values = measured.tolist()
        self.published = time.perf_counter()
        self.state.send(stamp, self.cycle, *values)
        if self.clock is not None and self.cycle % CLOCK_CYCLES == 0:
            self.clock.publish(Clock(clock=_time(stamp)))
        self.telemetry.tell(self.cycle * self.period, stamp, values)

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Say how the cycles go."""
        if not hasattr(self, "state"):
            return OK, "unconfigured", {}
        level, message = OK, "cycles under way" if self._active.is_set() else "inactive"
        if self._active.is_set() and self.lockstep and time.perf_counter() - self.published > PATIENCE:
            level, message = WARN, "waiting for the controller's answer or the disturbance"
        elif self._active.is_set() and self.answered < 0:
            level, message = WARN, "no controller has answered yet"
        elif self.missed:
            level, message = WARN, "cycles without an answer: the last command was held"
        if not np.all(np.isfinite(self.simulator.y)):
            level, message = ERROR, "the plant's state is no longer finite: a smaller integration_step may help"
        figures = {
            "cycle": self.cycle,
            "cycles": self.cycles,
            "missed": self.missed,
            "late": self.late,
            "dense_event_steps": self.dense,
            **self.latency.figures(),
        }
        return level, message, figures


class Telemetry:
    """The same signals, now and then, for the tools everybody has."""

    def __init__(self, node: PlantSimNode) -> None:
        """Create the publishers; the rate is the node's parameter."""
        self._node = node
        self._force = node.create_publisher(Float64, "force", 10)
        self._pressure = node.create_publisher(FluidPressure, "load_pressure", 10)
        self._joints = node.create_publisher(JointState, "joint_states", 10)
        rate = float(node.get_parameter("telemetry_rate").value)
        self._period = 1.0 / rate if rate > 0.0 else float("inf")
        self._next = 0.0 if rate > 0.0 else float("inf")

    def tell(self, time_s: float, stamp_ns: int, measured: list[float]) -> None:
        """Publish what is due.

        Args:
            time_s: plant time [s].
            stamp_ns: its stamp [ns].
            measured: readings in the order of ``SENSED``.
        """
        if time_s < self._next:
            return
        self._next += self._period
        stamp = _time(stamp_ns)
        self._force.publish(Float64(data=measured[sensors.FORCE]))
        pressure = FluidPressure(fluid_pressure=measured[sensors.LOAD_PRESSURE])
        joints = JointState(
            name=["loader"],
            position=[measured[sensors.POSITION]],
            velocity=[measured[sensors.VELOCITY]],
            effort=[measured[sensors.FORCE]],
        )
        pressure.header.stamp = joints.header.stamp = stamp
        pressure.header.frame_id = joints.header.frame_id = "loader"
        self._pressure.publish(pressure)
        self._joints.publish(joints)

    def destroy(self) -> None:
        """Take the publishers off the graph."""
        for publisher in (self._force, self._pressure, self._joints):
            self._node.destroy_publisher(publisher)


def _time(stamp_ns: int) -> Time:
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)


def main() -> NoReturn:
    """Run the node."""
    run_node(PlantSimNode)


if __name__ == "__main__":
    main()
