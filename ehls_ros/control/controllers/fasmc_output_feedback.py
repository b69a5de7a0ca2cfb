"""Finite-time adaptive sliding mode force control from what a rig measures, and with a command that arrives late.

The sliding surface (26), (27) is the paper's. Its law (34) needs velocity, friction and disturbance without delay or noise.
Here :mod:`ehls_ros.control.state_estimator` supplies them from position, load pressure, spool and force, for the moment the
command acts: friction from its GMS elements, and the external force and its rates in place of the adapted D of (38).

(34) takes the rates at one moment and holds the command for a cycle. Here the command is chosen for the cycle as a whole:
between its own arrival and that of the next command it takes the predicted s to 1/(1 + reaching_rate T) of itself. s is
nearly linear in the command, so two trials are enough. This is s' = -K s stepped backwards, and it tends to (34) as T goes
to 0. The paper's K of 8.8e4 1/s would remove all of s in one cycle, noise included.

The reference is extrapolated by its derivatives. The velocity reading is not used and may be NaN.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control import state_estimator
from ehls_ros.control.controllers import base
from ehls_ros.control.controllers.base import Model, saturate
from ehls_ros.control.state_estimator import (
    CELL_OFFSET,
    EXTERNAL,
    LEAST_DROP,
    VALVE_GAIN,
    Assumptions,
    State,
    foresee,
    move,
    observe,
    rates,
    send,
    state_of,
    supply_of,
)
from ehls_ros.physics import sensors
from ehls_ros.physics.plant import PL, XV, V, X
from ehls_ros.schema import quantity

FOLLOWS = "force"
FRICTION = False
FRICTION_MODEL = state_estimator.FRICTION_MODEL
NEEDS = ("position", "load_pressure", "spool_position", "force")

TRIALS = 2
"""Commands whose outcome is predicted before one is sent."""

STEEPEST = 3.0
"""Largest factor, either way, between the slope of s over the command and that of the valve's flow alone."""


class Parameters(NamedTuple):
    """Tuning of the law, and the filter's assumptions; k, g and xi are the paper's."""

    k: Annotated[
        float, quantity("MPa/s", "slope of the sliding surface: speed of a large error is k/2", minimum=0.1, maximum=1e3)
    ] = 12.0
    g: Annotated[float, quantity("1/MPa", "steepness of the sliding surface near zero error", minimum=0.1, maximum=1e4)] = 13.0
    xi: Annotated[float, quantity("1", "weight of the error's rate in the sliding variable", minimum=1e-3, maximum=1e3)] = 1.0
    reaching_rate: Annotated[float, quantity("1/s", "rate at which s is removed", minimum=0.0, maximum=1e6)] = 300.0
    command_delay: Annotated[float, quantity("s", "time a command takes to the valve", minimum=0.0, maximum=0.05)] = 1e-3
    coupling_stiffness: Annotated[
        float, quantity("N/m", "stiffness between the piston and its surroundings", minimum=0.0, maximum=1e9)
    ] = 2e6
    coupling_damping: Annotated[
        float, quantity("N s/m", "damping between the piston and its surroundings", minimum=0.0, maximum=1e6)
    ] = 2e3
    position_noise: Annotated[
        float, quantity("m", "standard deviation of a position reading, rounding included", above=0.0, maximum=1.0)
    ] = 2.5e-6
    pressure_noise: Annotated[
        float, quantity("Pa", "standard deviation of a load pressure reading", above=0.0, maximum=1e7)
    ] = 1.1e3
    spool_noise: Annotated[float, quantity("m", "standard deviation of a spool reading", above=0.0, maximum=1e-2)] = 1.05e-6
    force_noise: Annotated[float, quantity("N", "standard deviation of a load cell reading", above=0.0, maximum=1e5)] = 2.3
    motion_noise: Annotated[
        float,
        quantity("N s^1/2", "force missing in the model of the motion, root of its spectral density", minimum=0.0, maximum=1e6),
    ] = 0.5
    oil_noise: Annotated[
        float,
        quantity(
            "Pa/s^1/2", "pressure rate missing in the model of the flow, root of its spectral density", minimum=0.0, maximum=1e9
        ),
    ] = 500.0
    valve_noise: Annotated[
        float,
        quantity(
            "m/s^1/2", "spool rate missing in the model of the valve, root of its spectral density", minimum=0.0, maximum=1.0
        ),
    ] = 1e-6
    external_noise: Annotated[
        float, quantity("N/s^5/2", "noise of the external force's second derivative", minimum=0.0, maximum=1e15)
    ] = 1.3e8
    gain_noise: Annotated[float, quantity("1/s^1/2", "noise of the valve's gain", minimum=0.0, maximum=1e3)] = 0.05
    flow_noise: Annotated[float, quantity("Pa/s^3/2", "noise of the flow's error", minimum=0.0, maximum=1e12)] = 1e7
    offset_noise: Annotated[float, quantity("N/s^1/2", "noise of the load cell's offset", minimum=0.0, maximum=1e6)] = 30.0


def memory(p: Parameters) -> Array:
    """Return a filter before its first measurement."""
    return np.zeros(state_estimator.MEMORY_SIZE)


@kernel
def assumptions(p: Parameters) -> Assumptions:
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
        p.flow_noise,
        p.offset_noise,
    )


@kernel
def pressure_error(y: Array, wanted: float, area: float) -> float:
    """Return (26) [MPa] of a mean, with the force as the load cell reads it."""
    return (y[PL] - (wanted - y[CELL_OFFSET]) / area) * 1e-6


@kernel
def sliding_variable(error: float, error_rate: float, p: Parameters) -> float:
    """Return (27) [MPa/s]."""
    return p.xi * error_rate + p.k / (1.0 + math.exp(-p.g * error)) - 0.5 * p.k  # (27)


@kernel
def foreseen_variable(ahead: float, r: Array, supply: float, p: Parameters, model: Model, state: State) -> float:
    """Return s of the predicted mean, ``ahead`` [s] from now."""
    area, rate = model.plant.piston_area, state.work[0]
    wanted = r[0] + ahead * (r[1] + 0.5 * ahead * r[2])
    wanted_rate = r[1] + ahead * r[2]
    rates(state.foreseen, state.foreseen_mode, 0.0, supply, model, assumptions(p), rate)
    error_rate = (rate[PL] - wanted_rate / area) * 1e-6
    return sliding_variable(pressure_error(state.foreseen, wanted, area), error_rate, p)


@kernel
def command_for(r: Array, supply: float, p: Parameters, model: Model, state: State) -> float:
    """Return the spool command [m] of the law before it is limited."""
    plant, period, taken = model.plant, model.period, assumptions(p)
    foresee(supply, model, taken, state)
    s = foreseen_variable(p.command_delay, r, supply, p, model, state)
    target = s / (1.0 + p.reaching_rate * period)
    side = 1.0 if state.foreseen[XV] >= 0.0 else -1.0
    drop = max(supply - side * state.foreseen[PL], LEAST_DROP * plant.supply_pressure)
    flow_gain = plant.discharge_coefficient * plant.valve_area_gradient * math.sqrt(drop / plant.oil_density)
    opened = plant.valve_gain * (1.0 + state.foreseen[VALVE_GAIN]) * -math.expm1(-plant.valve_bandwidth * period)
    usual = p.xi * 4.0 * plant.bulk_modulus / plant.total_volume * flow_gain * opened * 1e-6
    slope, tried, outcome = usual, 0.0, 0.0
    wanted = state.commands[0]
    for trial in range(TRIALS):
        if trial > 0:
            foresee(supply, model, taken, state)
        command = saturate(wanted, model.spool_limit)
        move(state.foreseen, state.foreseen_mode, command, supply, period, model, taken, state.work)
        s = foreseen_variable(p.command_delay + period, r, supply, p, model, state)
        if trial > 0 and command != tried:
            found = (s - outcome) / (command - tried)
            slope = min(max(found, usual / STEEPEST), usual * STEEPEST)
        tried, outcome = command, s
        wanted = command + (target - s) / slope
    return wanted


@kernel
def step(m: Array, r: Array, f: Array, p: Parameters, model: Model, memory: Array, status: Array) -> float:
    """Return the spool command [m]."""
    status[:] = 0.0
    state = state_of(memory)
    if not observe(m, model, assumptions(p), state):
        status[base.SATURATED] = 1.0
        return 0.0
    wanted = command_for(r, supply_of(m, model), p, model, state)
    command = saturate(wanted, model.spool_limit)
    send(command, state)

    y, area = state.mean, model.plant.piston_area
    error = pressure_error(y, r[0], area)
    rates(y, state.mode, 0.0, supply_of(m, model), model, assumptions(p), state.work[0])
    status[base.E3] = error
    status[base.S] = sliding_variable(error, (state.work[0, PL] - r[1] / area) * 1e-6, p)
    status[base.ALPHA] = status[base.BETA] = 1.0
    status[base.DELTA] = y[EXTERNAL] + p.coupling_stiffness * y[X] + p.coupling_damping * y[V]
    status[base.FORCE_ERROR] = m[sensors.FORCE] - r[0]
    status[base.SATURATED] = 1.0 if wanted != command else 0.0
    # From numbers out of range the filter cannot recover: it starts again from the next measurement.
    if not math.isfinite(memory.sum()):
        memory[:] = 0.0
    return command


@kernel
def follow(command: float, own: float, memory: Array) -> float:
    """Put the command [m] that went to the valve in the place of the law's own, which does not depend on it."""
    state_of(memory).commands[0] = command
    return own
