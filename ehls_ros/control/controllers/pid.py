"""PID with feed-forward that moves the rod at constant velocity, for friction identification.

The wanted motion is a ramp that turns round at the ends of its travel; the force reference is not used.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controllers import base
from ehls_ros.control.controllers.base import Model, saturate
from ehls_ros.physics import sensors
from ehls_ros.schema import quantity

FRICTION = False

LEAST_DROP = 0.01
"""The pressure drop over the valve is taken no smaller than this part of the nominal supply pressure."""


class Parameters(NamedTuple):
    """The motion and the loop's gains."""

    velocity: Annotated[
        float, quantity("m/s", "velocity to move at; its sign is the first direction", minimum=-1.0, maximum=1.0)
    ] = 0.02
    travel: Annotated[float, quantity("m", "way from one end to the other, centred on the start", above=0.0, maximum=10.0)] = (
        0.2
    )
    proportional: Annotated[float, quantity("1/s", "velocity asked for per position error", minimum=0.0, maximum=1e3)] = 20.0
    integral: Annotated[float, quantity("1/s^2", "rate of that for a lasting error", minimum=0.0, maximum=1e4)] = 50.0
    derivative: Annotated[float, quantity("1", "part of the velocity error that is added", minimum=0.0, maximum=10.0)] = 0.2


WANTED, DIRECTION, INTEGRAL, CENTRE, STARTED = range(5)


def memory(p: Parameters) -> Array:
    """Return a ramp that has not started."""
    return np.zeros(5)


@kernel
def step(m: Array, r: Array, f: Array, p: Parameters, model: Model, memory: Array, status: Array) -> float:
    """Return the spool command [m]."""
    plant, period = model.plant, model.period
    position = m[sensors.POSITION]
    status[:] = 0.0
    if not math.isfinite(position):
        status[base.SATURATED] = 1.0
        return 0.0
    if memory[STARTED] == 0.0:
        memory[WANTED], memory[CENTRE], memory[STARTED] = position, position, 1.0
        memory[DIRECTION] = 1.0 if p.velocity >= 0.0 else -1.0
    memory[WANTED] += memory[DIRECTION] * abs(p.velocity) * period
    away = memory[WANTED] - memory[CENTRE]
    if away * memory[DIRECTION] > 0.5 * p.travel:
        memory[WANTED] = memory[CENTRE] + memory[DIRECTION] * 0.5 * p.travel
        memory[DIRECTION] = -memory[DIRECTION]
    wanted_velocity = memory[DIRECTION] * abs(p.velocity)

    error = memory[WANTED] - position
    integral = memory[INTEGRAL] + period * error
    velocity = (
        wanted_velocity
        + p.proportional * error
        + p.integral * integral
        + p.derivative * (wanted_velocity - m[sensors.VELOCITY])
    )
    supply, pressure = m[sensors.SUPPLY_PRESSURE], m[sensors.LOAD_PRESSURE]
    side = 1.0 if velocity >= 0.0 else -1.0
    root = math.sqrt(max(supply - side * pressure, LEAST_DROP * plant.supply_pressure) / plant.oil_density)
    flow = plant.piston_area * velocity + plant.leakage_coefficient * pressure
    wanted = flow / (plant.discharge_coefficient * plant.valve_area_gradient * root * plant.valve_gain)
    command = saturate(wanted, model.spool_limit)
    # At the limit, the integral moves only away from it.
    if wanted == command or wanted * error < 0.0:
        memory[INTEGRAL] = integral

    status[base.SATURATED] = 1.0 if wanted != command else 0.0
    return command
