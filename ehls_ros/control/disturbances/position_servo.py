"""The actuator under test, as in the paper's experiment: a position servo with its own valve and cylinder.

It acts on the loader through the elasticity of beam and hinges, feels the loader's reaction, and has its own
position loop.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, in_python, kernel
from ehls_ros.control.controllers.base import saturate
from ehls_ros.control.disturbances.base import DISPLACEMENT, ROW, VELOCITY
from ehls_ros.control.references.base import SampledReference
from ehls_ros.physics.effects.coupling_stiffness import Parameters as Coupling
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, V, X
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import quantity

REACTS = True


MovingMass = Annotated[float, quantity("kg", "moving mass of the servo", above=0.0, maximum=1e5, scale="mass")]
SupplyPressure = Annotated[float, quantity("Pa", "supply pressure of the servo", above=0.0, maximum=1e8, scale="pressure")]
PositionGain = Annotated[float, quantity("1/s", "velocity per position error", minimum=0.0, maximum=1e3)]


class Parameters(NamedTuple):
    """The servo and the beam between it and the loader; valve and cylinder are of the loader's type."""

    stiffness: Annotated[
        float,
        quantity("N/m", "stiffness of beam and hinges between the pistons", above=0.0, maximum=1e9, scale="force / stroke"),
    ] = 2e6
    damping: Annotated[
        float, quantity("N s/m", "damping of beam and hinges", minimum=0.0, maximum=1e6, scale="force / stroke")
    ] = 2e3
    moving_mass: MovingMass = 70.0
    supply_pressure: SupplyPressure = 2.1e7
    position_gain: PositionGain = 30.0


def servo_plant(plant: Plant, moving_mass: float, supply_pressure: float) -> Plant:
    """Return a servo's coefficients: valve and cylinder are the loader's, without its spring and its weight."""
    return plant._replace(supply_pressure=supply_pressure, moving_mass=moving_mass, spring_stiffness=0.0, gravity=0.0)


@kernel
def servo_command(wanted: float, wanted_velocity: float, x: float, load_pressure: float, gain: float, plant: Plant) -> float:
    """Return the spool command of the position loop [m]: proportional, with the motion's flow fed forward.

    Args:
        wanted: position wanted [m].
        wanted_velocity: its rate [m/s].
        x: the servo's position [m].
        load_pressure: its load pressure [Pa].
        gain: velocity per position error [1/s].
        plant: its coefficients.
    """
    velocity = wanted_velocity + gain * (wanted - x)
    drop = plant.supply_pressure - math.copysign(1.0, velocity) * load_pressure
    root = math.sqrt(max(drop, 0.01 * plant.supply_pressure) / plant.oil_density)
    spool = plant.piston_area * velocity / (plant.discharge_coefficient * plant.valve_area_gradient * root)
    return spool / plant.valve_gain


def loader_effects(p: Parameters) -> tuple[EffectUse, ...]:
    """Return the coupling through which the servo's displacement enters the loader's plant."""
    return (EffectUse("coupling_stiffness", Coupling(p.stiffness, p.damping)),)


class PositionServo:
    """A simulated position servo under its own loop."""

    def __init__(self, p: Parameters, signal: SampledReference, rig: Rig, period: float) -> None:
        """Build the servo from the loader's kind of valve and cylinder."""
        plant = servo_plant(rig.plant, p.moving_mass, p.supply_pressure)
        self._parameters = p
        self._signal = signal
        self._rig = rig._replace(plant=plant, effects=(), sensors={})
        self._servo = Simulator(self._rig, period, position=float(signal.row(0)[0]))
        self._row = np.zeros(ROW)

    def first(self) -> Array:
        """Return the row of cycle 0."""
        return self._now()

    def following(self, cycle: int, position: float, velocity: float) -> Array:
        """Move the servo on by one cycle against the loader and return its row."""
        p, y = self._parameters, self._servo.y
        pull = p.stiffness * (position - y[X]) + p.damping * (velocity - y[V])
        self._servo.advance(self._command(cycle), -pull, 0.0, 0.0, 0.0)
        return self._now()

    def _command(self, cycle: int) -> float:
        """Return the spool command of the position loop within the valve's limit [m]."""
        plant, y = self._rig.plant, self._servo.y
        wanted, velocity, _ = self._signal.row(cycle)
        command = in_python(servo_command)(wanted, velocity, y[X], y[PL], self._parameters.position_gain, plant)
        limited: float = in_python(saturate)(command, self._rig.limits.spool)
        return limited

    def _now(self) -> Array:
        self._row[DISPLACEMENT], self._row[VELOCITY] = self._servo.y[X], self._servo.y[V]
        return self._row


def build(p: Parameters, signal: SampledReference, rig: Rig, period: float) -> PositionServo:
    """Return the servo ready to run."""
    return PositionServo(p, signal, rig, period)
