"""Finite-time adaptive sliding mode force control from a rig's sensors, with a delayed command.

The sliding surface (26), (27) is the paper's. Its law (34) requires velocity, friction and disturbance without delay or noise.
Here :mod:`ehls_ros.control.state_estimator` estimates them from position, load pressure, spool and force, for the moment the
command acts: friction from its GMS elements, and the external force and its rates in place of the adapted D of (38).
:mod:`ehls_ros.control.reaching_law` chooses the command for the whole cycle. The velocity reading is not used and may be NaN.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array, kernel
from ehls_ros.control import reaching_law, state_estimator
from ehls_ros.control.controllers.base import Model
from ehls_ros.control.reaching_law import RateWeight, ReachingRate, Slope, Surface, answer
from ehls_ros.control.reaching_law import tracking as surface_tracking
from ehls_ros.control.rig_scale import PAPER_COUPLING, PAPER_COUPLING_DAMPING, PAPER_DELAY, PAPER_OIL_STIFFNESS, PAPER_PLANT
from ehls_ros.control.state_estimator import (
    ActuatorMass,
    ActuatorStiffness,
    Assumptions,
    DischargeNoise,
    FlowNoise,
    GainNoise,
    LeastOpening,
    MotionNoise,
    OffsetNoise,
    OilNoise,
    State,
    ValveNoise,
    state_of,
    yielding_mass,
)
from ehls_ros.schema import quantity

FOLLOWS = "force"
FRICTION = False
FRICTION_MODEL = state_estimator.FRICTION_MODEL
NEEDS = ("position", "load_pressure", "spool_position", "force")
TUNED = ("reaching_rate", "g", "external_noise", "flow_noise")
PREVIEW = True

follow = reaching_law.follow


class Parameters(NamedTuple):
    """Tuning of the law, and the filter's assumptions; k, g and xi are the paper's."""

    k: Slope = 12.0
    g: Annotated[
        float,
        quantity("1/MPa", "steepness of the sliding surface near zero error", minimum=0.1, maximum=1e4, scale="1 / pressure"),
    ] = 13.0
    xi: RateWeight = 1.0
    reaching_rate: ReachingRate = 300.0
    command_delay: Annotated[
        float, quantity("s", "time a command takes to the valve", minimum=0.0, maximum=0.05, scale="delay")
    ] = PAPER_DELAY
    coupling_stiffness: Annotated[
        float,
        quantity("N/m", "stiffness between the piston and its surroundings", minimum=0.0, maximum=1e9, scale="coupling"),
    ] = PAPER_COUPLING
    coupling_damping: Annotated[
        float,
        quantity(
            "N s/m", "damping between the piston and its surroundings", minimum=0.0, maximum=1e6, scale="coupling_damping"
        ),
    ] = PAPER_COUPLING_DAMPING
    position_noise: Annotated[
        float,
        quantity(
            "m", "standard deviation of a position reading, rounding included", above=0.0, maximum=1.0, scale="position_noise"
        ),
    ] = 2.5e-6
    pressure_noise: Annotated[
        float, quantity("Pa", "standard deviation of a load pressure reading", above=0.0, maximum=1e7, scale="pressure_noise")
    ] = 1.1e3
    spool_noise: Annotated[
        float, quantity("m", "standard deviation of a spool reading", above=0.0, maximum=1e-2, scale="spool_noise")
    ] = 1.05e-6
    force_noise: Annotated[
        float, quantity("N", "standard deviation of a load cell reading", above=0.0, maximum=1e5, scale="force_noise")
    ] = 2.3
    motion_noise: MotionNoise = 0.5
    oil_noise: OilNoise = 500.0
    valve_noise: ValveNoise = 1e-6
    external_noise: Annotated[
        float, quantity("N/s^5/2", "noise of the external force's second derivative", minimum=0.0, maximum=1e15, scale="force")
    ] = 1.3e8
    gain_noise: GainNoise = 0.05
    discharge_noise: DischargeNoise = 0.005
    least_opening: LeastOpening = 5e-4
    flow_noise: FlowNoise = 1e7
    offset_noise: OffsetNoise = 30.0
    actuator_mass: ActuatorMass = PAPER_PLANT.moving_mass
    actuator_stiffness: ActuatorStiffness = PAPER_OIL_STIFFNESS


def memory(p: Parameters) -> Array:
    """Return the filter's memory before its first measurement."""
    return np.zeros(state_estimator.MEMORY_SIZE)


def tracking(omega: Array, p: Parameters, model: Model) -> NDArray[np.complex128]:
    """Return the response of the force to the reference at some frequencies [rad/s], for the modelled rig."""
    return surface_tracking(omega, Surface(p.k, p.g, p.xi, p.reaching_rate), model.period, p.command_delay)


@kernel
def assumptions(state: State, activity: Array, p: Parameters, model: Model) -> Assumptions:
    """Return the parameters of the filter."""
    return Assumptions(
        p.coupling_stiffness,
        p.coupling_damping,
        p.command_delay,
        p.position_noise,
        p.pressure_noise,
        p.spool_noise,
        p.force_noise,
        p.motion_noise,
        p.oil_noise,
        p.valve_noise,
        p.external_noise,
        p.gain_noise,
        p.discharge_noise,
        p.least_opening,
        p.flow_noise,
        p.offset_noise,
        yielding_mass(p.actuator_mass, state),
        p.actuator_stiffness,
    )


@kernel
def step(m: Array, r: Array, f: Array, p: Parameters, model: Model, memory: Array, status: Array) -> float:
    """Return the spool command [m]."""
    taken = assumptions(state_of(memory), memory[state_estimator.MEMORY_SIZE :], p, model)
    return answer(m, r, Surface(p.k * model.stiffness, p.g, p.xi, p.reaching_rate), model, taken, memory, status)
