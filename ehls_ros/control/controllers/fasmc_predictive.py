"""Finite-time adaptive sliding mode force control that predicts friction and disturbance by rate and model.

As in :mod:`~ehls_ros.control.controllers.fasmc_output_feedback`, a filter predicts the state to the time when the command acts,
including friction elements, and the command is chosen for the whole cycle. There are four differences:

* The law takes sensor noise, command delay and coupling to the actuator under test from the rig file.
* The filter's bandwidth for the external force follows the activity of that force (:mod:`ehls_ros.control.process_noise`). No
  size or period of the force is assumed, so one tuning serves quiet rigs and rough ones. A force foreseen by a companion is
  subtracted from the force to be estimated. The filter of the quieter remainder is quieter.
* The steepness of the sliding surface follows the activity too. A quiet filter has little noise, so the surface may be steep
  and leave little error. A fast filter would pass its noise on to the force.
* The force missing in the model of the motion is taken in proportion to the noise of the load cell: a rig with finer sensors is
  known more exactly.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array, kernel
from ehls_ros.control import process_noise, reaching_law, state_estimator
from ehls_ros.control.controllers.base import Model
from ehls_ros.control.process_noise import ProcessNoise, external_noise
from ehls_ros.control.reaching_law import RateWeight, ReachingRate, Slope, Surface, answer
from ehls_ros.control.reaching_law import tracking as surface_tracking
from ehls_ros.control.rig_scale import (
    PAPER_FORCE,
    PAPER_OIL_STIFFNESS,
    PAPER_PLANT,
    PAPER_PRESSURE,
    PAPER_SENSORS,
    PAPER_SPOOL,
    largest_force,
)
from ehls_ros.control.state_estimator import (
    EXTERNAL_RATE,
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
from ehls_ros.physics.plant import V
from ehls_ros.schema import quantity

FOLLOWS = "force"
FRICTION = False
FRICTION_MODEL = state_estimator.FRICTION_MODEL
NEEDS = ("position", "load_pressure", "spool_position", "force")
TUNED = ("reaching_rate", "k", "g", "calm_g", "rate_noise", "least_noise", "reversal_factor", "motion_noise")
PREVIEW = True
KNOWS = ("command_delay", "coupling_stiffness")

follow = reaching_law.follow

MIN_POSITION_NOISE, MIN_PRESSURE_NOISE, MIN_SPOOL_NOISE, MIN_FORCE_NOISE = 1e-9, 10.0, 1e-9, 0.03
"""Lower bounds of the sensors' standard deviations on the paper's rig [m, Pa, m, N], as no model is more accurate; those of
pressure, spool and force are scaled with the rig's."""

PAPER_FORCE_NOISE = PAPER_SENSORS["force"].reading_std
"""Noise of the load cell for which ``motion_noise`` is declared [N]."""


class Parameters(NamedTuple):
    """Tuning of the law, and assumptions of the filter on the rig; g and xi are the paper's, k is three times the paper's.

    ``motion_noise`` holds for a load cell with :data:`PAPER_FORCE_NOISE` on the rig's scale.
    """

    k: Slope = 36.0
    g: Annotated[
        float,
        quantity(
            "1/MPa",
            "steepness of the surface near zero error while the disturbance is restless",
            minimum=0.1,
            maximum=1e4,
            scale="1 / pressure",
        ),
    ] = 60.0
    calm_g: Annotated[
        float, quantity("1/MPa", "the same while the disturbance is calm", minimum=0.1, maximum=1e4, scale="1 / pressure")
    ] = 100.0
    calm_noise: Annotated[
        float,
        quantity(
            "N/s^5/2",
            "noise of the external force's second derivative half way between both",
            above=0.0,
            maximum=1e15,
            scale="force",
        ),
    ] = 4e6
    xi: RateWeight = 1.0
    reaching_rate: ReachingRate = 300.0
    motion_noise: MotionNoise = 0.5
    oil_noise: OilNoise = 500.0
    valve_noise: ValveNoise = 1e-6
    least_noise: Annotated[
        float,
        quantity("N/s^5/2", "noise of a resting external force's second derivative", minimum=0.0, maximum=1e15, scale="force"),
    ] = 1e6
    rate_noise: Annotated[
        float,
        quantity("1/s^3/2", "that noise over the rms of the force's rate", minimum=0.0, maximum=1e6),
    ] = 600.0
    unrest_memory: Annotated[float, quantity("s", "time over which that rms is taken", minimum=1e-3, maximum=1e3)] = 0.5
    reversal_factor: Annotated[
        float, quantity("1", "factor of the noise after a reversal of the motion", minimum=1.0, maximum=1e3)
    ] = 2.0
    reversal_travel: Annotated[
        float, quantity("m", "travel after a reversal for which it holds", minimum=0.0, maximum=1.0, scale="sticking")
    ] = 1.7e-3
    gain_noise: GainNoise = 0.02
    discharge_noise: DischargeNoise = 0.01
    least_opening: LeastOpening = 1e-4
    flow_noise: FlowNoise = 1e6
    offset_noise: OffsetNoise = 30.0
    actuator_mass: ActuatorMass = PAPER_PLANT.moving_mass
    actuator_stiffness: ActuatorStiffness = PAPER_OIL_STIFFNESS


def memory(p: Parameters) -> Array:
    """Return the filter's memory before its first measurement, with an external force at rest."""
    return np.zeros(state_estimator.MEMORY_SIZE + process_noise.SIZE)


def tracking(omega: Array, p: Parameters, model: Model) -> NDArray[np.complex128]:
    """Return the response of the force to the reference at frequencies [rad/s], for the modelled rig and an active force."""
    return surface_tracking(omega, Surface(p.k, p.g, p.xi, p.reaching_rate), model.period, model.command_delay)


@kernel
def assumptions(state: State, activity: Array, p: Parameters, model: Model) -> Assumptions:
    """Return the parameters of the filter for the next cycle, and update the activity from the present estimate."""
    relation = ProcessNoise(p.least_noise, p.rate_noise, p.unrest_memory, p.reversal_factor, p.reversal_travel)
    rate = state.mean[EXTERNAL_RATE] - state.expected[1]
    noise = external_noise(rate, state.mean[V], model.period, relation, activity)
    force, pressure = largest_force(model.plant) / PAPER_FORCE, model.plant.supply_pressure / PAPER_PRESSURE
    force_noise = max(model.noise.force, MIN_FORCE_NOISE * force)
    return Assumptions(
        model.coupling_stiffness,
        model.coupling_damping,
        model.command_delay,
        max(model.noise.position, MIN_POSITION_NOISE),
        max(model.noise.load_pressure, MIN_PRESSURE_NOISE * pressure),
        max(model.noise.spool_position, MIN_SPOOL_NOISE * (model.spool_limit / PAPER_SPOOL)),
        force_noise,
        p.motion_noise * force_noise / (PAPER_FORCE_NOISE * force),
        p.oil_noise,
        p.valve_noise,
        noise,
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
    active = taken.external_noise**2 / (taken.external_noise**2 + p.calm_noise**2)
    surface = Surface(p.k * model.stiffness, p.calm_g + active * (p.g - p.calm_g), p.xi, p.reaching_rate)
    return answer(m, r, surface, model, taken, memory, status)
