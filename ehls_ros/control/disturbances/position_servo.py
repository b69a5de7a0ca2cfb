"""Actuator under test as in the paper's experiment: a position servo with valve, cylinder and position loop.

It acts on the loader through the elasticity of beam and hinges, and the loader acts back on it.
"""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.disturbances.base import DISPLACEMENT, ROW, VELOCITY
from ehls_ros.control.local_plant import double_rod_of
from ehls_ros.control.references.base import SampledReference
from ehls_ros.control.rig_scale import PAPER_COUPLING, PAPER_COUPLING_DAMPING, viscous_friction
from ehls_ros.physics.effects.coupling_stiffness import Parameters as Coupling
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import EffectUse, Rig
from ehls_ros.physics.servo import Servo
from ehls_ros.schema import quantity

REACTS = True


MovingMass = Annotated[float, quantity("kg", "moving mass of the servo", above=0.0, maximum=1e5, scale="mass")]
SupplyPressure = Annotated[float, quantity("Pa", "supply pressure of the servo", above=0.0, maximum=1e8, scale="pressure")]
PositionGain = Annotated[float, quantity("1/s", "velocity per position error", minimum=0.0, maximum=1e3)]


class Parameters(NamedTuple):
    """The servo and the beam between it and the loader; valve and cylinder are the loader's, or a double rod like it."""

    stiffness: Annotated[
        float,
        quantity("N/m", "stiffness of beam and hinges between the pistons", above=0.0, maximum=1e9, scale="coupling"),
    ] = PAPER_COUPLING
    damping: Annotated[
        float, quantity("N s/m", "damping of beam and hinges", minimum=0.0, maximum=1e6, scale="coupling_damping")
    ] = PAPER_COUPLING_DAMPING
    moving_mass: MovingMass = 70.0
    supply_pressure: SupplyPressure = 2.1e7
    position_gain: PositionGain = 30.0


def servo_plant(plant: Plant, moving_mass: float, supply_pressure: float) -> Plant:
    """Return a servo's coefficients: valve and cylinder are the loader's, without its spring and weight."""
    return plant._replace(supply_pressure=supply_pressure, moving_mass=moving_mass, spring_stiffness=0.0, gravity=0.0)


def loader_effects(p: Parameters) -> tuple[EffectUse, ...]:
    """Return the coupling through which the servo's displacement enters the loader's plant."""
    return (EffectUse("coupling_stiffness", Coupling(p.stiffness, p.damping)),)


STEADY = 0.5
"""Gain of the servo's loop over that from which it swings on its oil."""


def steady_gain(rig: Rig) -> float:
    """Return the gain of the position loop of a servo like the loader: the usual one, or less if it would swing [1/s]."""
    return min(Parameters().position_gain, STEADY * swinging_gain(rig, rig.plant.moving_mass))


def swinging_gain(rig: Rig, moving_mass: float) -> float:
    """Return the gain of the position loop from which a servo's mass swings on its oil [1/s].

    It is the sum of the rates at which leakage and viscous friction damp the motion (Merritt, Hydraulic Control Systems, 1967,
    6.5: K_v < 2 ζ ω_h); the servo's command takes away the valve's damping.

    Args:
        rig: the loader's rig, which provides valve, cylinder and friction of the servo.
        moving_mass: of the servo [kg].
    """
    plant = double_rod_of(rig).rig.plant
    return 4.0 * plant.bulk_modulus * plant.leakage_coefficient / plant.total_volume + viscous_friction(rig) / moving_mass


def servo(p: Parameters, rig: Rig, start: float) -> Servo:
    """Return the servo.

    Args:
        p: parameters of the servo.
        rig: the loader's rig, which provides valve, cylinder and friction of the servo.
        start: initial position [m].
    """
    alike = double_rod_of(rig).rig
    plant = servo_plant(alike.plant, p.moving_mass, p.supply_pressure)
    return Servo(alike._replace(plant=plant, effects=(), sensors={}), p.position_gain, start)


class PositionReference:
    """Motion setpoint of the servo, as rows."""

    def __init__(self, signal: SampledReference) -> None:
        """Store the displacement signal."""
        self._signal = signal

    def rows(self, first: int, cycles: int) -> Array:
        """Return the rows of consecutive cycles, shape (cycles, ROW)."""
        rows = np.zeros((cycles, ROW))
        rows[:, [DISPLACEMENT, VELOCITY]] = self._signal.rows(first, cycles)[:, :2]
        return rows


def build(p: Parameters, signal: SampledReference, rig: Rig, period: float) -> PositionReference:
    """Return the source of the servo's reference."""
    return PositionReference(signal)
