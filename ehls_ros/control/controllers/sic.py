"""Structure invariance compensation: feedforward of the motion's flow, and a PI force loop.

The disturbance acts on the load pressure through the piston's velocity, -e1 x2 in (25). A spool that passes
exactly this flow makes the pressure invariant to the motion; the PI loop does the rest. There is no friction compensation.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controllers import base
from ehls_ros.control.controllers.base import MIN_DROP, Model, saturate
from ehls_ros.physics import sensors
from ehls_ros.schema import quantity

FOLLOWS = "force"
INVERTS_VALVE = True
FRICTION = False
NEEDS = ("velocity", "load_pressure", "spool_position", "force", "supply_pressure")
TUNED = ("proportional", "integral")

WINDING_DROP = 0.1
"""Pressure drop, as a fraction of the supply pressure, below which the valve has no reserve and integration stops."""


class Parameters(NamedTuple):
    """Tuning of the compensation and of the loop."""

    proportional: Annotated[
        float, quantity("1/s", "rate at which the loop removes the pressure error", minimum=0.0, maximum=1e4)
    ] = 280.0
    integral: Annotated[float, quantity("1/s^2", "rate at which the remaining error is removed", minimum=0.0, maximum=1e4)] = (
        200.0
    )
    compensation: Annotated[
        float, quantity("1", "fraction of the motion's flow that is fed forward", minimum=0.0, maximum=1.5)
    ] = 1.0


INTEGRAL, LAST_VELOCITY, STARTED = 0, 1, 2


def memory(p: Parameters) -> Array:
    """Return a zero integral."""
    return np.zeros(3)


@kernel
def step(m: Array, r: Array, f: Array, p: Parameters, model: Model, memory: Array, status: Array) -> float:
    """Return the spool command [m]."""
    plant, period = model.plant, model.period
    supply, pressure, spool = m[sensors.SUPPLY_PRESSURE], m[sensors.LOAD_PRESSURE], m[sensors.SPOOL]
    side = 1.0 if spool >= 0.0 else -1.0
    drop = supply - side * pressure
    least_drop = MIN_DROP * plant.supply_pressure
    root = math.sqrt(max(drop, least_drop) / plant.oil_density)
    flow_gain = plant.discharge_coefficient * plant.valve_area_gradient * root * plant.valve_gain
    compliance = plant.total_volume / (4.0 * plant.bulk_modulus)

    velocity = m[sensors.VELOCITY]
    if memory[STARTED] == 0.0 and math.isfinite(velocity):
        memory[LAST_VELOCITY], memory[STARTED] = velocity, 1.0
    acceleration = (velocity - memory[LAST_VELOCITY]) / period
    if math.isfinite(velocity):
        memory[LAST_VELOCITY] = velocity
    # The flow's rate compensates the valve's lag.
    motion = plant.piston_area * (velocity + acceleration / plant.valve_bandwidth)

    error = pressure - r[0] / plant.piston_area
    integral = memory[INTEGRAL] + period * error
    wanted_rate = r[1] / plant.piston_area - p.proportional * error - p.integral * integral
    wanted = (p.compensation * motion + plant.leakage_coefficient * pressure + compliance * wanted_rate) / flow_gain
    command = saturate(wanted, model.spool_limit)
    # Near the limit of the spool or of the supply, the integral moves only away from it.
    if (wanted == command and drop > WINDING_DROP * plant.supply_pressure) or wanted * error > 0.0:
        memory[INTEGRAL] = integral

    status[:] = 0.0
    status[base.E3] = error * 1e-6
    status[base.FORCE_ERROR] = m[sensors.FORCE] - r[0]
    status[base.SATURATED] = 1.0 if wanted != command else 0.0
    return command
