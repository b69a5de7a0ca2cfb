"""`plant_sim_node`: the simulated rig. It opens each cycle with a loader_state and integrates with the answer."""

import time
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, NoReturn

import numpy as np

from ehls_msgs.msg import Disturbance
from ehls_ros.arrays import Array
from ehls_ros.experiments.fmu_plant import fmu_plant
from ehls_ros.experiments.loop import simulator_of
from ehls_ros.fmu.foreign_plant import ForeignPlant
from ehls_ros.hardware.gate_bounds import Bound
from ehls_ros.hardware.gate_parameters import SIMULATED
from ehls_ros.hardware.pace import ADVICE
from ehls_ros.hardware.simulated_clock import SimulatedClock
from ehls_ros.nodes.diagnostics import ERROR, WARN
from ehls_ros.nodes.loop import WAIT
from ehls_ros.nodes.parameters import declare
from ehls_ros.nodes.plant import PlantNode
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter
from ehls_ros.physics.plant import V, X
from ehls_ros.physics.simulator import Simulator
from ehls_ros.recording.topics import DISTURBANCE, SERVO_REFERENCE
from ehls_ros.schema import quantity, text

BURST = 0.005
"""Simulated time by which a lockstep run may lead its speed [s]: waking up in every cycle would slow down a slow machine."""

LATE = 0.1
"""Simulated time by which a lockstep run may lag its speed and still catch up [s]."""


NOISE_CYCLES = 100
"""Cycles whose noise is drawn at once."""


class Parameters(NamedTuple):
    """Parameters of the simulated rig besides those of every plant."""

    speed: Annotated[
        float,
        quantity("1", "in lockstep, largest speed relative to the wall clock; 0: as fast as the machine goes", minimum=0.0),
    ] = 0.0
    plant_fmu: Annotated[str, text("FMU in place of the simulator; empty: none")] = ""
    plant_map: Annotated[str, text("map of the FMU's variables; empty: they have the names of the signals")] = ""


class PlantSimNode(PlantNode):
    """Steps the simulator, cycle by cycle."""

    gate_defaults = SIMULATED
    gate_bounds: Mapping[str, Bound] | None = MappingProxyType({})

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("plant_sim_node")
        declare(self, Parameters, live=False)
        self.speed = float(self.get_parameter("speed").value)
        self.cycle = 0
        self.enabled = False
        self.dense_steps = 0
        self.on_schedule = 0.0
        # Made by `prepare`:
        self.simulator: Simulator | ForeignPlant
        self.noise: Iterator[Array]
        self.time: SimulatedClock
        self.disturbances: dict[int, tuple[float, ...]]
        self.last_disturbance: tuple[float, ...]
        self.disturbance: Inbox
        self.motion: Outbox | None
        self.anything: Waiter

    def measured(self) -> Collection[str]:
        """Return all signals."""
        return self.spec.rig.sensed

    def prepare(self) -> None:
        """Compile the plant and open the topics."""
        fmu, plant_map = self.text_parameter("plant_fmu"), self.text_parameter("plant_map")
        self.simulator = (
            fmu_plant(self.spec, Path(fmu), Path(plant_map) if plant_map else None) if fmu else simulator_of(self.spec)
        )
        self.noise = _noise(self.spec.settings.seed, self.simulator.truth.size)
        self.cycle = self.dense_steps = 0
        self.enabled = False
        self.time = SimulatedClock(self.period, time.perf_counter())
        self.disturbances = {}
        self.open_topics()
        # A servo's motion is simulated with the loader's, and published here.
        moves = self.simulator.servo.size > 0
        self.last_disturbance = (0.0, 0.0, float(self.simulator.servo[X]) if moves else 0.0, 0.0)
        self.motion = Outbox(self, Disturbance, DISTURBANCE.name) if moves else None
        self.disturbance = Inbox(self, Disturbance, (SERVO_REFERENCE if moves else DISTURBANCE).name)
        self.anything = Waiter([self.commands, self.disturbance])

    def release(self) -> None:
        """Close the topics."""
        self.anything.destroy()
        self.disturbance.destroy()
        if self.motion is not None:
            self.motion.destroy()
        if isinstance(self.simulator, ForeignPlant):
            self.simulator.close()
        super().release()

    def start(self) -> None:
        """Publish the first snapshot."""
        self.begin_stamps(self.cycle)
        self.time = SimulatedClock(self.period, time.perf_counter())
        self.on_schedule = time.perf_counter()
        self.gate.begin()
        self._publish_driving()
        self._snapshot()

    def stop(self) -> None:
        """Leave the valve at null."""
        self.gate.leave()

    def once(self) -> None:
        """Wait for the inputs of this cycle and finish it."""
        if self.lockstep:
            self._once_lockstep()
        else:
            self._once_realtime()

    def _once_lockstep(self) -> None:
        ahead = self.on_schedule - time.perf_counter()
        if ahead > BURST:
            time.sleep(min(ahead, WAIT))
            return
        complete = self.answered == self.cycle
        if not complete or self.cycle not in self.disturbances:
            (self.anything if complete else self.answer).wait(WAIT)
            self._take()
        if self.answered == self.cycle and self.cycle in self.disturbances:
            if self.standby_answered():
                self._advance()
        else:
            self.repeat_snapshot(self.cycle)

    def _once_realtime(self) -> None:
        self._await_inputs()
        if self._remaining() > 0.0:
            return
        # Answers from another process take time.
        prompt = self.links is not None and not self.links.apart
        complete = self._is_complete()
        changed = self.time.end(time.perf_counter(), answered=complete, expected=self.answered >= 0, prompt=prompt)
        self.statistics.missed = self.time.missed
        self._advance()
        if self.is_active:
            # The remaining work of a turn has time once the answer has arrived.
            self._await_inputs()
        if changed:
            self.report_change()

    def _await_inputs(self) -> None:
        """Wait for the missing inputs of this cycle, or else for its end, and read the messages that have arrived."""
        remaining, complete = self._remaining(), self._is_complete()
        # A cycle that begins after its due end because the process was delayed can still be answered within the process.
        if remaining > 0.0 or not complete:
            lacks_disturbance = self.answered == self.cycle and not complete
            (self.anything if lacks_disturbance else self.answer).wait(min(remaining, WAIT))
        self._take()

    def _remaining(self) -> float:
        """Return the longest time the cycle may still last [s]; 0: end it now."""
        present = not self.time.waiting or self.commands.publishers() > 0
        return self.time.remaining(time.perf_counter(), answered=self._is_complete(), present=present)

    def _is_complete(self) -> bool:
        """Return whether the cycle has its command, and its disturbance if any: a held one would drive the rig away."""
        if self.answered != self.cycle:
            return False
        return self.cycle in self.disturbances or self.disturbance.publishers() == 0

    def _take(self) -> None:
        if self.cycle not in self.disturbances:
            while (message := self.disturbance.take()) is not None:
                self.disturbances[message[1]] = message[2:-1]
        self.take_commands(self.cycle)

    def _advance(self) -> None:
        row = self.disturbances.pop(self.cycle, self.last_disturbance)
        self.last_disturbance = row
        if len(self.disturbances) > 10_000:
            self.disturbances = {k: v for k, v in self.disturbances.items() if k > self.cycle}
        self.dense_steps += self.simulator.advance(self._gated(), *row)
        self.publish_telemetry()
        self.cycle += 1
        # A tripped rig waits for an operator: no faster than real time.
        speed = self.speed or (1.0 if self.gate.causes else 0.0)
        if speed > 0.0:
            self.on_schedule = max(self.on_schedule, time.perf_counter() - LATE) + self.period / speed
        if self.have_all_run(self.cycle):
            self.end_cycles()
            return
        self._snapshot()

    def _gated(self) -> float:
        """Return the command the gate passes; the first command enables a simulated rig."""
        if not self.enabled and self.answered >= 0:
            self.enabled = self.gate.enable() is None
        command = self.gate.step(self.cycle * self.period)
        self._publish_driving()
        return command

    def _publish_driving(self) -> None:
        """Publish whether the controllers drive the valve; before the first command they do, unless a trip holds the gate."""
        before = not (self.enabled or self.gate.causes)
        self.announcements.publish_driving(driving=self.gate.driving or before, in_full=self.gate.in_full or before)

    def _snapshot(self) -> None:
        self.publish(self.cycle, self.simulator.measure(next(self.noise)).tolist())
        if self.motion is not None:
            self.motion.send(self.snapshot.stamp_ns, self.cycle, 0.0, 0.0, *self.simulator.servo[[X, V]].tolist())

    def figures(self) -> dict[str, Any]:
        """Return values for diagnostics."""
        own = {"cycle": self.cycle, "dense_event_steps": self.dense_steps}
        return {**super().figures(), **own, **self.time.figures()}

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report simulator faults, the state of the gate, or a machine too slow for the simulation."""
        level, message, figures = super().health()
        if trouble := self.simulator.trouble():
            return ERROR, trouble, figures
        if level != ERROR and self.is_active and self.time.pace.complaint:
            return WARN, f"{self.time.pace.complaint}, the simulated time runs slower than the wall's: {ADVICE}", figures
        return level, message, figures


def _noise(seed: int, signals: int) -> Iterator[Array]:
    """Yield standard normal numbers for one cycle after another, shape (signals,)."""
    random = np.random.default_rng(seed)
    while True:
        # The same numbers as from one draw per cycle, in far fewer calls.
        yield from random.standard_normal((NOISE_CYCLES, signals))


def main() -> NoReturn:
    """Run the node."""
    run_node(PlantSimNode)


if __name__ == "__main__":
    main()
