"""A safety gate with a rig at rest, advanced cycle by cycle."""

import math
from pathlib import Path

from ehls_ros.experiments.spec import load_rig
from ehls_ros.hardware.gate_parameters import Parameters
from ehls_ros.hardware.safety_gate import Gate
from ehls_ros.physics.rig import SENSED

PERIOD = 1e-3
RIG = load_rig(Path(__file__).parents[2] / "config" / "rig_paper.yaml")
AREA = RIG.plant.piston_area
REST = {"supply_pressure": RIG.plant.supply_pressure, "oil_temperature": 313.15}


class Bench:
    """Simulates the rig and the controller.

    Attributes:
        gate: under test.
        cycle: number of the next snapshot.
        time: of the next step [s].
        wall: wall time, which times emergency stops [s].
    """

    def __init__(self, measured=SENSED, **parameters):
        self.wall = 0.0
        chosen = Parameters(**{"enable_time": 0.0, **parameters})
        self.gate = Gate(RIG, PERIOD, chosen, measured, bounds={}, clock=lambda: self.wall)
        self.gate.begin()
        self.cycle = 0
        self.time = 100.0

    def sense(self, reference=math.nan, lag=0.0, **readings):
        """Pass a snapshot of the rig at rest except for the given readings, ``lag`` s old; the others change slightly."""
        values = {**REST, **readings}
        tremble = 1e-9 * (self.cycle % 2)
        self.gate.sense(self.cycle, [values.get(signal, tremble) for signal in SENSED], reference, lag=lag)
        self.cycle += 1

    def step(self, elapsed=PERIOD):
        """Return the next output."""
        self.time += elapsed
        return self.gate.step(self.time)

    def turn(self, command=1e-3, sender="controller", reference=math.nan, **readings):
        """Run one cycle; None: without a command."""
        self.sense(reference, **readings)
        if command is not None:
            self.gate.take(self.cycle - 1, command, sender)
        return self.step()

    def turns(self, count, command=1e-3, **inputs):
        """Run several cycles and return the outputs."""
        return [self.turn(command, **inputs) for _ in range(count)]

    def run(self, command=1e-3, cycles=5, **inputs):
        """Enable the gate and run several cycles with a command."""
        self.turn(command, **inputs)
        assert self.gate.enable() is None
        self.turns(cycles, command, **inputs)
        assert self.gate.state == "active"
        return self

    def counts(self):
        """Return the counts of the faults that occurred."""
        return {name: detector.count for name, detector in self.gate.detectors.items() if detector.count}

    def causes_named(self):
        """Return the names of the causes of the trip, in order."""
        return [cause.detector for cause in self.gate.causes]
