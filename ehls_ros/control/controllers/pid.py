"""Position loop for friction identification: feedforward of the reference motion, and PI on the position error.

The flow of the reference motion and the leakage at the measured load pressure are fed forward through the valve's flow equation
(1); the reference acceleration compensates the valve's lag. The loop removes only the remainder: the compression of the oil
when friction reverses, and errors of the rig file's valve. The measured velocity is not used, as a rig has no sensor for it.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controllers import base
from ehls_ros.control.controllers.base import MIN_DROP, Model, saturate
from ehls_ros.physics import sensors
from ehls_ros.schema import quantity

FOLLOWS = "position"
FRICTION = False
NEEDS = ("position", "load_pressure", "supply_pressure")


class Parameters(NamedTuple):
    """Gains of the loop."""

    proportional: Annotated[float, quantity("1/s", "velocity per position error", minimum=0.0, maximum=1e3)] = 40.0
    integral: Annotated[float, quantity("1/s^2", "rate of that velocity for a lasting error", minimum=0.0, maximum=1e4)] = 400.0
    correction: Annotated[
        float, quantity("m/s", "largest velocity by which an error is corrected", above=0.0, maximum=10.0, scale="speed")
    ] = 0.05


INTEGRAL = 0


def memory(p: Parameters) -> Array:
    """Return a zero integral."""
    return np.zeros(1)


@kernel
def step(m: Array, r: Array, f: Array, p: Parameters, model: Model, memory: Array, status: Array) -> float:
    """Return the spool command [m]."""
    plant = model.plant
    status[:] = 0.0
    error = r[0] - m[sensors.POSITION]
    if math.isnan(error):
        status[base.SATURATED] = 1.0
        return 0.0
    integral = memory[INTEGRAL] + model.period * error
    asked = p.proportional * error + p.integral * integral
    correction = saturate(asked, p.correction)
    velocity = r[1] + correction
    supply, pressure = m[sensors.SUPPLY_PRESSURE], m[sensors.LOAD_PRESSURE]
    side = 1.0 if velocity >= 0.0 else -1.0
    root = math.sqrt(max(supply - side * pressure, MIN_DROP * plant.supply_pressure) / plant.oil_density)
    flow = plant.piston_area * (velocity + r[2] / plant.valve_bandwidth) + plant.leakage_coefficient * pressure
    wanted = flow / (plant.discharge_coefficient * plant.valve_area_gradient * root * plant.valve_gain)
    command = saturate(wanted, model.spool_limit)
    # At a limit, the integral moves only away from it; after an invalid measurement, not at all.
    if (asked == correction or asked * error < 0.0) and (wanted == command or wanted * error < 0.0):
        memory[INTEGRAL] = integral

    status[base.SATURATED] = 1.0 if wanted != command else 0.0
    return command
