"""A rig that can be stepped: plant kernel, state, inputs and sensors together."""

import math

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.physics import sensors
from ehls_ros.physics.composition import effects_in_kernel, kernel_module, plant_source, rig_elements
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.plant import FRICTION, INPUTS, PERIOD, TEMPERATURE, X
from ehls_ros.physics.plausibility import implausible
from ehls_ros.physics.rig import SENSED, Rig

DEFAULT_STEP = 1e-4
"""Integration step [s]; benchmarks/physics_convergence.py shows why."""

OIL_TEMPERATURE = 313.15
"""Oil temperature where nothing is said [K]."""


def earlier_commands(rig: Rig, period: float) -> int:
    """Return how many commands sent before the present one the rig's effects look back on.

    Args:
        rig: the rig.
        period: control period [s].
    """
    reach = max((getattr(EFFECTS.load(use.name), "REACH", 0.0) for use in rig.effects), default=0.0)
    return math.ceil(reach / period)


class Simulator:
    """One simulated rig, advanced a control period at a time.

    Attributes:
        rig: the rig with its parameter-shifting effects worked in.
        y: state as :mod:`ehls_ros.physics.plant` lays it out.
        mode: modes as there.
        inputs: inputs as there.
        cycle: number of control periods done.
    """

    def __init__(
        self,
        rig: Rig,
        period: float = 1e-3,
        step: float = DEFAULT_STEP,
        position: float = 0.0,
        temperature: float = OIL_TEMPERATURE,
        warming: float = 0.0,
    ) -> None:
        """Prepare and compile (or load) the kernel; the rig rests without pressure.

        Args:
            rig: rig to simulate.
            period: control period [s].
            step: largest integration step [s]; the period is cut into equal steps no longer.
            position: initial piston position [m].
            temperature: initial oil temperature [K].
            warming: rate at which the oil warms [K/s].
        """
        self.rig = rig.effective()
        self.period = period
        self.steps = max(1, math.ceil(period / step - 1e-9))
        self.step = period / self.steps
        kernel = kernel_module(plant_source(rig))
        elements = rig_elements(rig)
        self._advance, self._sense, self._hold = kernel.advance, kernel.sense, kernel.hold
        self.y = np.zeros(FRICTION + elements + kernel.EFFECT_STATES)
        self.mode = np.zeros(1 + elements)
        self.inputs = np.zeros(INPUTS + earlier_commands(rig, period))
        self.inputs[PERIOD] = period
        self.effects = np.array([value for use in effects_in_kernel(rig) for value in use.parameters], dtype=np.float64)
        self.work = np.empty((WORK_ROWS, self.y.size))
        self.sensors = sensors.prepare(self.rig.sensors, period)
        self.truth = np.zeros(len(SENSED))
        self.measured = np.zeros(len(SENSED))
        self.cycle = 0
        self._warm_up()
        self.y[X] = position
        self.mode[0] = 1.0
        self.inputs[TEMPERATURE] = temperature
        self.warming = warming

    def _warm_up(self) -> None:
        """Compile now what would otherwise compile in the first cycle."""
        self.measure(np.zeros(len(SENSED)))
        self._hold(self.inputs, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.mode[0] = 1.0
        self._run(0)
        self.y[:] = 0.0
        self.mode[:] = 0.0

    def _run(self, steps: int) -> int:
        done: int = self._advance(
            self.cycle * self.period,
            self.y,
            self.mode,
            self.rig.plant,
            self.rig.friction,
            self.inputs,
            self.effects,
            self.step,
            steps,
            self.work,
        )
        return done

    def measure(self, noise: Array) -> Array:
        """Read the sensors at the present cycle.

        Args:
            noise: standard normal numbers, shape (signals,).

        Returns:
            The readings in the order of ``SENSED``; the same array every time.
        """
        self._sense(
            self.cycle,
            self.cycle * self.period,
            self.y,
            self.rig.plant,
            self.inputs,
            self.effects,
            self.sensors,
            noise,
            self.truth,
            self.measured,
        )
        return self.measured

    def trouble(self) -> str:
        """Return what cannot be true of the rig as it was last measured, with advice; empty if nothing."""
        found = implausible(self.truth[np.newaxis], self.rig.limits)
        return "" if found is None else f"{found.what} (at {self.cycle * self.period:g} s)"

    def advance(self, command: float, force: float, force_rate: float, displacement: float, velocity: float) -> int:
        """Go on by one control period.

        Args:
            command: spool command, held [m].
            force: disturbance force now [N].
            force_rate: and its rate [N/s].
            displacement: displacement of the position servo now [m].
            velocity: and its velocity [m/s].

        Returns:
            Number of integration steps in which events came too densely to be located.
        """
        self._hold(self.inputs, self.cycle * self.period, command, force, force_rate, displacement, velocity)
        dense = self._run(self.steps)
        self.inputs[TEMPERATURE] += self.warming * self.period
        self.cycle += 1
        return dense
