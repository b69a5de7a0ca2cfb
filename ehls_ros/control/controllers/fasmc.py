"""Finite-time adaptive sliding mode force control, equations (26)-(38).

The law is written in the units in which the paper gives its numbers: N, mm, MPa, t, s. Thus k = 12, g = 60, h = 25,
b = 107.5 are the paper's controller.

The robust term u3 is discretised implicitly (backward Euler). With the paper's numbers the reaching rate K is 8.8e4 1/s, and an
explicit u3 diverges above K T = 2, which the paper's 1 ms exceeds by a factor of 44. With the law, m0 s' = -m0 K s; stepped
backwards, the sliding variable at the end of the cycle is s/(1 + K T). The adaptation (36)-(38) acts on this predicted s, and
u3 removes the part of s that remains after the adaptation. The adaptive terms grow linearly over a cycle, so half their step is
used. All of this tends to (35)-(38) as T goes to 0. The adaptation removes at most all of s in one cycle, which keeps it stable
at any phi3.

At 1 ms the predicted s is 89 times smaller than the sampled one, so the adaptation rates are larger than the paper's. The
paper's phi1..3 cannot be meant in these units (phi1 = 103 would move alpha by 3e5 1/s at s = 1 MPa/s); the defaults were chosen
once, over all references and disturbances of Table 3.

The rate of the load pressure in s is the model's (25), corrected by the model's error in the change of pressure over the last
cycle. Without the correction, a model error of a few MPa/s, 0.2 % of the flow at full speed, would be as large as the surface's
slope k/2, and the error would grow without bound.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.bounds import pressure_error_bound_kernel
from ehls_ros.control.controllers import base
from ehls_ros.control.controllers.base import ELEMENTS_FORCE, MIN_DROP, VISCOUS_FORCE, Bounded, Model, saturate
from ehls_ros.physics import sensors
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.vector_math import exp
from ehls_ros.schema import quantity

FOLLOWS = "force"
INVERTS_VALVE = True
FRICTION = True
NEEDS = ("position", "velocity", "load_pressure", "spool_position", "force", "supply_pressure")
TUNED = ("g", "k", "phi3", "rate_correction")


class Parameters(NamedTuple):
    """Tuning of the law; k, g, h, b, xi and delta_f are the paper's."""

    k: Annotated[
        float,
        quantity(
            "MPa/s", "slope of the sliding surface: speed of a large error is k/2", minimum=0.1, maximum=1e3, scale="pressure"
        ),
    ] = 12.0
    g: Annotated[
        float,
        quantity("1/MPa", "steepness of the sliding surface near zero error", minimum=0.1, maximum=1e4, scale="1 / pressure"),
    ] = 60.0
    h: Annotated[float, quantity("t/s", "gain of the robust term", minimum=0.0, maximum=1e4, scale="mass")] = 25.0
    b: Annotated[
        float,
        quantity(
            "t MPa/s^2",
            "half width of the robust term: |s| ends within b/h",
            minimum=1e-3,
            maximum=1e6,
            scale="mass * pressure",
        ),
    ] = 107.5
    xi: Annotated[float, quantity("1", "weight of the error's rate in the sliding variable", minimum=1e-3, maximum=1e3)] = 1.0
    delta_f: Annotated[float, quantity("N", "bound of the disturbance force", minimum=0.0, maximum=1e9, scale="force")] = 5500.0
    phi1: Annotated[
        float,
        quantity(
            "mm^5/N^3",
            "adaptation rate of alpha, the scale of the identified friction",
            minimum=0.0,
            maximum=1e6,
            scale="1 / force / pressure / compression",
        ),
    ] = 1e-3
    phi2: Annotated[
        float,
        quantity(
            "mm^5/N^3",
            "adaptation rate of beta, the scale of the viscous friction",
            minimum=0.0,
            maximum=1e6,
            scale="1 / force / pressure / compression",
        ),
    ] = 1e-6
    phi3: Annotated[
        float,
        quantity(
            "mm^5/N",
            "adaptation rate of D, the remaining disturbance",
            minimum=0.0,
            maximum=1e9,
            scale="force / pressure / compression",
        ),
    ] = 2.5e5
    implicitness: Annotated[
        float,
        quantity(
            "1", "1: robust term stepped backwards; 0: explicitly, as printed, for periods below 2/K", minimum=0.0, maximum=1.0
        ),
    ] = 1.0
    rate_correction: Annotated[
        float,
        quantity("1", "fraction of the model's error in the pressure's rate that is corrected", minimum=0.0, maximum=1.0),
    ] = 1.0
    forgetting: Annotated[
        float, quantity("1/s", "rate at which alpha and beta return to 1 where nothing moves them", minimum=0.0, maximum=1e3)
    ] = 0.1
    scale_minimum: Annotated[float, quantity("1", "lower bound of alpha and beta", above=0.0, maximum=1.0)] = 0.2
    scale_maximum: Annotated[float, quantity("1", "upper bound of alpha and beta", minimum=1.0, maximum=100.0)] = 5.0
    delta_maximum: Annotated[
        float, quantity("N", "bound of D to either side, above the largest load", minimum=0.0, maximum=1e9, scale="force")
    ] = 5e4


_FRICTION = ", or identify the friction of the controller's rig"
BOUNDED = (
    Bounded("D̂", base.DELTA, "delta_maximum", unit="N", instead=", or give the controller's rig the load that it lacks"),
    Bounded("α̂", base.ALPHA, "scale_maximum", "scale_minimum", instead=_FRICTION),
    Bounded("β̂", base.BETA, "scale_maximum", "scale_minimum", instead=_FRICTION),
)

ALPHA, BETA, DELTA, CORRECTION, LAST_PRESSURE, LAST_RATE, STARTED, SINCE, ELEMENTS, VISCOUS, STRENGTH, MEMORY_SIZE = range(12)


def memory(p: Parameters) -> Array:
    """Return the paper's initial values: alpha = beta = 1, D = 0.01 N."""
    start = np.zeros(MEMORY_SIZE)
    start[ALPHA], start[BETA], start[DELTA] = 1.0, 1.0, 0.01
    return start


@kernel
def corrected_rate(model_rate: float, pressure: float, part: float, memory: Array) -> float:
    """Return the load pressure rate of the model, corrected by a fraction of its error since the last good reading.

    Model rate [MPa/s] and pressure [MPa] are the present ones; the previous ones are kept in ``memory``.
    """
    if memory[STARTED] == 1.0:
        measured = (pressure - memory[LAST_PRESSURE]) / memory[SINCE]
        missed = measured - 0.5 * (model_rate + memory[LAST_RATE])
        if math.isfinite(missed):
            memory[CORRECTION] += part * (missed - memory[CORRECTION])
    memory[LAST_PRESSURE], memory[LAST_RATE], memory[STARTED], memory[SINCE] = pressure, model_rate, 1.0, 0.0
    return model_rate + memory[CORRECTION]


@kernel
def paper_units(plant: Plant) -> Plant:
    """Return the rig's coefficients in N, mm, MPa, t, s."""
    return Plant(
        plant.supply_pressure * 1e-6,
        plant.oil_density * 1e-12,
        plant.bulk_modulus * 1e-6,
        plant.discharge_coefficient,
        plant.valve_area_gradient * 1e3,
        plant.leakage_coefficient * 1e15,
        plant.total_volume * 1e9,
        plant.moving_mass * 1e-3,
        plant.piston_area * 1e6,
        plant.arm_length * 1e3,
        plant.spring_stiffness * 1e-3,
        plant.viscous_damping * 1e-3,
        plant.valve_bandwidth,
        plant.valve_gain,
        plant.gravity * 1e3,
    )


@kernel
def step(m: Array, r: Array, f: Array, p: Parameters, model: Model, memory: Array, status: Array) -> float:
    """Return the spool command [m] of (34)."""
    plant = paper_units(model.plant)
    period = model.period
    area, m0 = plant.piston_area, plant.moving_mass
    hydraulic = 4.0 * plant.bulk_modulus / plant.total_volume
    e1 = hydraulic * area
    e2 = hydraulic * plant.leakage_coefficient
    e3 = hydraulic * plant.discharge_coefficient * plant.valve_area_gradient / math.sqrt(plant.oil_density)
    e4 = plant.valve_bandwidth
    e5 = plant.valve_gain * plant.valve_bandwidth

    x1, x2 = m[sensors.POSITION] * 1e3, m[sensors.VELOCITY] * 1e3
    x3, x4 = m[sensors.LOAD_PRESSURE] * 1e-6, m[sensors.SPOOL] * 1e3
    supply = m[sensors.SUPPLY_PRESSURE] * 1e-6
    x3d_rate, x3d_acceleration = r[1] / area, r[2] / area

    side = 1.0 if x4 >= 0.0 else -1.0
    drop = supply - side * x3
    least_drop = MIN_DROP * plant.supply_pressure
    root = math.sqrt(max(drop, least_drop))
    g1 = (-plant.spring_stiffness * x1 - plant.viscous_damping * x2 + area * x3) / m0 - plant.gravity
    g3 = e3 * root
    # Zero where the drop is at its lower bound: a steep slope there would keep the spool at its limit.
    g3_slope = -side * e3 / (2.0 * root) if drop > least_drop else 0.0

    model_rate = -e1 * x2 - e2 * x3 + g3 * x4  # (25)
    sound = math.isfinite(x1 + model_rate + supply + m[sensors.FORCE])
    x3_rate = model_rate
    memory[SINCE] += period
    if sound and drop > least_drop:
        x3_rate = corrected_rate(model_rate, x3, p.rate_correction, memory)
    elif sound:
        # At the lower bound of the drop the model's rate is wrong; uncorrected, it pulls the spool back from its limit.
        memory[CORRECTION], memory[STARTED] = 0.0, 0.0
    error = (m[sensors.FORCE] - r[0]) / area  # (26), with the force as the load cell has it
    error_rate = x3_rate - x3d_rate
    k = p.k * model.stiffness  # a change of the load moves s in proportion to the stiffness
    logistic = 1.0 / (1.0 + exp(-p.g * error))
    surface = k * logistic - 0.5 * k
    surface_slope = k * p.g * logistic * (1.0 - logistic)
    s = p.xi * error_rate + surface  # (27)

    elements, viscous = f[ELEMENTS_FORCE], f[VISCOUS_FORCE]
    rate = (p.h + p.h * p.xi * e1 * p.delta_f / p.b) / m0
    follow = p.xi * e1 * (p.phi1 * elements * elements + p.phi2 * viscous * viscous + p.phi3)
    implicit = p.implicitness * period
    reached = s / (1.0 + implicit * rate)
    share = p.xi * e1 / m0 * follow * period * period / (1.0 + implicit * rate)
    change = period * p.xi * e1 * reached / max(1.0, share)
    # With (36), (37) alone, the residual of sampling makes alpha and beta drift: hence the sigma-modification.
    forget = p.forgetting * period
    alpha = (memory[ALPHA] + p.phi1 * elements * change + forget) / (1.0 + forget)  # (36)
    beta = (memory[BETA] + p.phi2 * viscous * change + forget) / (1.0 + forget)  # (37)
    alpha = min(max(alpha, p.scale_minimum), p.scale_maximum)
    beta = min(max(beta, p.scale_minimum), p.scale_maximum)
    delta = saturate(memory[DELTA] + p.phi3 * change, p.delta_maximum)  # (38)
    adapted = (alpha - memory[ALPHA]) * elements + (beta - memory[BETA]) * viscous + (delta - memory[DELTA])
    s_next = (s - 0.5 * implicit * p.xi * e1 / m0 * adapted) / (1.0 + implicit * rate)

    psi = (
        m0 * p.xi * (-e1 * g1 - e2 * x3_rate + g3_slope * x3_rate * x4 - e4 * g3 * x4 - x3d_acceleration)
        + m0 * surface_slope * error_rate
    )
    u1 = -p.xi * e1 * (alpha * elements + beta * viscous + delta)
    u2 = -psi
    u3 = -m0 * rate * s_next  # (35)
    wanted = (u1 + u2 + u3) / (m0 * p.xi * e5 * g3) * 1e-3  # (34)
    command = saturate(wanted, model.spool_limit)
    # At the limit, only adaptation away from it continues; after an invalid measurement, none.
    if sound and (wanted == command or wanted * s > 0.0):
        memory[ALPHA], memory[BETA], memory[DELTA] = alpha, beta, delta
        memory[ELEMENTS], memory[VISCOUS], memory[STRENGTH] = elements, viscous, -m0 * e5 * g3 / e1 * 1e3

    status[base.E3] = error
    status[base.S] = s
    status[base.ALPHA] = memory[ALPHA]
    status[base.BETA] = memory[BETA]
    status[base.DELTA] = memory[DELTA]
    status[base.U1] = u1
    status[base.U2] = u2
    status[base.U3] = u3
    status[base.FORCE_ERROR] = m[sensors.FORCE] - r[0]
    status[base.FORCE_BOUND] = pressure_error_bound_kernel(k, p.g, p.h, p.b) * area
    status[base.SATURATED] = 1.0 if wanted != command else 0.0
    return command


@kernel
def follow(command: float, own: float, memory: Array) -> float:
    """Set D so that (34) yields another controller's command [m]; this law must not adapt to the other's error."""
    delta = memory[DELTA] + (memory[ALPHA] - 1.0) * memory[ELEMENTS] + (memory[BETA] - 1.0) * memory[VISCOUS]
    delta += memory[STRENGTH] * (command - own)
    if not math.isfinite(delta):
        return own
    memory[ALPHA], memory[BETA], memory[DELTA] = 1.0, 1.0, delta
    return command
