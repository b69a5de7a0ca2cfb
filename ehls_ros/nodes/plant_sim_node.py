"""`plant_sim_node`: the simulated rig. It opens each cycle with a loader_state and steps on with the answer."""

import time
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from ehls_msgs.msg import Disturbance
from ehls_ros.experiments.loop import simulator_of
from ehls_ros.hardware.gate_parameters import SIMULATED
from ehls_ros.hardware.pace import ADVICE, Pace
from ehls_ros.nodes.control import ERROR, WAIT, WARN, run_node
from ehls_ros.nodes.plant import PlantNode
from ehls_ros.nodes.transport import Inbox, Waiter
from ehls_ros.physics.rig import SENSED

BEARABLE = 2
"""Cycles in a row for which the last command is held; the law stands no three (docs/measured.md)."""

HOPE = 0.1
"""How long the simulated time waits for an answer before whoever answers is taken to be gone [s]."""

SPARE = 0.25
"""Where the simulated time waits for answers: how long everybody rests after one, as part of the time it took."""


class PlantSimNode(PlantNode):
    """Steps the simulator, cycle by cycle."""

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("plant_sim_node", SIMULATED)

    def prepare(self) -> None:
        """Compile the plant and open the topics."""
        self.simulator = simulator_of(self.spec)
        self.random = np.random.default_rng(self.spec.settings.seed)
        self.cycle = 0
        self.late = 0
        self.unanswered = 0
        self.waiting = False
        self.slipped = 0.0
        self.pace = Pace()
        self.dense = 0
        self.disturbances: dict[int, tuple[float, float, float, float]] = {}
        self.last_disturbance = (0.0, 0.0, 0.0, 0.0)
        self.open_gate(SENSED)
        self.enabled = False
        self.disturbance = Inbox(self, Disturbance, "disturbance")
        self.anything = Waiter([self.commands, self.disturbance])

    def release(self) -> None:
        """Close the topics."""
        self.anything.destroy()
        self.disturbance.destroy()
        super().release()

    def start(self) -> None:
        """Publish the first snapshot."""
        self.set_epoch(self.cycle)
        self.pace = Pace()
        self.epoch = time.perf_counter() - self.cycle * self.period
        self.tell_driving(self.gate.driving or not self.enabled)
        self._snapshot()

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
        answered = self.answered == self.cycle
        if not answered and self.waiting and remaining > -HOPE:
            self.answer.wait(WAIT)
            return
        self._keep_time(deadline, answered=answered)
        self._advance()

    def _keep_time(self, deadline: float, *, answered: bool) -> None:
        """Hold a command for a cycle or two; beyond that let the simulated time wait for the answers, and not catch up.

        On a computer that is too slow the loop would otherwise be one of long dead times, and diverge.

        Args:
            deadline: when the cycle should have ended [s].
            answered: whether its answer is there.
        """
        now = time.perf_counter()
        if self.waiting and answered and now > deadline:
            # Nodes that take turns without a rest would leave the machine nothing.
            time.sleep(SPARE * (now - self.published))
            now = time.perf_counter()
        if answered:
            self.unanswered = 0
        elif self.answered >= 0:
            self.missed += 1
            self.unanswered += 1
        behind = now - deadline
        self.late += behind > self.period
        long_ago = behind > BEARABLE * self.period
        self.waiting = answered if self.waiting else self.unanswered == BEARABLE or (answered and long_ago)
        if self.waiting or long_ago:
            self.epoch += behind
            self.slipped += behind
        if self.answered >= 0:
            self._judge_pace(now)

    def _judge_pace(self, now: float) -> None:
        """See twice a second whether this computer keeps up; the simulated time waits for as long as it does not."""
        due = (now - self.epoch + self.slipped) / self.period
        before = self.pace.complaint
        if self.pace.look(now, due, self.cycle + 1 - self.missed):
            self.waiting = bool(self.pace.complaint)
            if self.pace.complaint != before:
                self.report_change()

    def _take(self) -> None:
        if self.cycle not in self.disturbances:
            while (message := self.disturbance.take()) is not None:
                self.disturbances[message[1]] = message[2:]
        self.take_commands(self.cycle)

    def _advance(self) -> None:
        row = self.disturbances.pop(self.cycle, self.last_disturbance)
        self.last_disturbance = row
        if len(self.disturbances) > 10_000:
            self.disturbances = {k: v for k, v in self.disturbances.items() if k > self.cycle}
        self.dense += self.simulator.advance(self._gated(), *row)
        self.tell_telemetry()
        self.cycle += 1
        if self.cycles and self.cycle >= self.cycles:
            self.end_cycles()
            return
        self._snapshot()

    def _gated(self) -> float:
        """Return the command the gate lets through; a simulated rig is enabled by the first command that comes."""
        if not self.enabled and self.answered >= 0:
            self.enabled = self.gate.enable() is None
        command = self.gate.step(self.cycle * self.period)
        self.tell_driving(self.gate.driving or not self.enabled)
        return command

    def _snapshot(self) -> None:
        self.publish(self.cycle, self.simulator.measure(self.random.standard_normal(len(SENSED))).tolist())

    def figures(self) -> dict[str, Any]:
        """Return figures for diagnostics."""
        own = {"cycle": self.cycle, "late": self.late, "dense_event_steps": self.dense, "slipped_s": self.slipped}
        return {**super().figures(), **own, **self.pace.figures()}

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Say how the cycles go."""
        level, message, figures = super().health()
        if not np.all(np.isfinite(self.simulator.y)):
            return ERROR, "the plant's state is no longer finite: a smaller integration_step may help", figures
        if self.pace.complaint and self._active.is_set():
            slow = f"{self.pace.complaint}, the simulated time runs slower than the wall's: {ADVICE}"
            return (ERROR, f"{message}; {slow}", figures) if level == ERROR else (WARN, slow, figures)
        return level, message, figures


def main() -> NoReturn:
    """Run the node."""
    run_node(PlantSimNode)


if __name__ == "__main__":
    main()
