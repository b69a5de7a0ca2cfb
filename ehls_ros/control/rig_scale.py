"""Scale of a rig relative to the paper's: factors of defaults in newtons, pascals, metres and kilograms.

Tuning numbers, bounds and assumed noise are declared with their value for the paper's rig, and with the quantity of a rig to
which their default is proportional (``scale`` of :func:`ehls_ros.schema.quantity`). On the paper's rig every ratio is exactly
1. A number that a user gives is never scaled.

By these rules, a rig whose area, mass, oil volume, flow, friction and stiffness are all n times the paper's has the paper's
loop. With equal pressures and times and n-fold forces, (27) and (34) to (38) hold for n times each force, if

* k and b/h scale with the pressure, and g with its inverse;
* h and b scale with the mass, Delta_f and the bound of D with the force;
* phi3 scales with force / (pressure x compression), phi1 and phi2 with 1 / (force x pressure x compression).
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from ehls_ros.arrays import in_python, kernel
from ehls_ros.control.controllers.base import Noise, model_of, noise_of
from ehls_ros.physics.friction import gms
from ehls_ros.physics.parameters import Plant, Sensor
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import Parameters, scaled_defaults

PAPER_PLANT = Plant(
    supply_pressure=7.0e6,
    oil_density=840.0,
    bulk_modulus=6.9e8,
    discharge_coefficient=0.62,
    valve_area_gradient=0.0267,
    leakage_coefficient=4.7e-12,
    total_volume=1.5e-3,
    moving_mass=70.0,
    piston_area=2.6e-3,
    arm_length=0.5,
    spring_stiffness=4.0e4,
    viscous_damping=60.0,
    valve_bandwidth=111.46370743,
    valve_gain=1.0,
    gravity=9.81,
)
"""Coefficients of the rig for which defaults are declared, Table 2; ``config/rig_paper.yaml`` has the same values."""

PAPER_SPOOL, PAPER_STROKE = 1.0e-2, 0.6
"""Largest spool command and stroke of that rig [m]."""

PAPER_SENSORS = {
    "position": Sensor(noise_std=2.0e-6, resolution=5.0e-6),
    "load_pressure": Sensor(noise_std=1.0e3, resolution=1.2e3),
    "spool_position": Sensor(noise_std=1.0e-6, resolution=1.0e-6),
    "force": Sensor(noise_std=2.0, resolution=4.0),
}
"""Sensors of that rig as described in ``config/rig_paper_measured.yaml``."""

PAPER_DELAY = 1e-3
"""Delay of that rig's command [s]: one cycle."""

PAPER_COUPLING, PAPER_COUPLING_DAMPING = 2e6, 2e3
"""Stiffness and damping of that rig's coupling to the actuator under test [N/m, N s/m]."""

PAPER_STICKING = 865.4 * 0.089 / 1.969e5
"""Travel of that rig's piston until its last friction element slips [m]."""


@kernel
def largest_force(plant: Plant) -> float:
    """Return the force of the supply pressure on the piston [N]."""
    return plant.supply_pressure * plant.piston_area


@kernel
def compression(plant: Plant) -> float:
    """Return the change of load pressure per motion of the piston with the valve shut, e1 of (25) [Pa/m]."""
    return 4.0 * plant.piston_area * plant.bulk_modulus / plant.total_volume


def oil_frequency(plant: Plant) -> float:
    """Return the natural frequency of the moving mass on the oil with the valve shut [rad/s]."""
    return math.sqrt(in_python(compression)(plant) * plant.piston_area / plant.moving_mass)


def viscous_friction(rig: Rig) -> float:
    """Return the viscous friction of load and piston together [N s/m]; a friction model may have none."""
    return rig.plant.viscous_damping + float(rig.friction._asdict().get("viscous_coefficient", 0.0))


@kernel
def largest_speed(plant: Plant, spool: float) -> float:
    """Return the speed of the unloaded piston at a spool displacement [m/s]."""
    flow = (
        plant.discharge_coefficient * plant.valve_area_gradient * spool * math.sqrt(plant.supply_pressure / plant.oil_density)
    )
    return flow / plant.piston_area


PAPER_PRESSURE = PAPER_PLANT.supply_pressure
PAPER_FORCE = in_python(largest_force)(PAPER_PLANT)
PAPER_COMPRESSION = in_python(compression)(PAPER_PLANT)
PAPER_OIL_STIFFNESS = PAPER_COMPRESSION * PAPER_PLANT.piston_area
PAPER_SPEED = in_python(largest_speed)(PAPER_PLANT, PAPER_SPOOL)


class Ratios(NamedTuple):
    """A rig's quantities relative to those of the paper's rig [1]; declarations refer to these names in ``scale``.

    Attributes:
        force: supply pressure times piston area.
        pressure: supply pressure.
        compression: change of the load pressure per motion with the valve shut.
        mass: moving mass.
        spool: largest spool command.
        stroke: range of the piston's position.
        speed: speed of the unloaded piston at the largest spool command.
        sticking: travel until all friction elements slip; 1 for a friction model without elements.
        position_noise: noise of a reading, relative to that of the paper's sensor; ``stroke`` for a sensor that the rig file
            does not describe.
        pressure_noise: noise of a reading as above, or ``pressure``.
        spool_noise: noise of a reading as above, or ``spool``.
        force_noise: noise of a reading as above, or ``force``.
        delay: delay of the command; 1 if the rig has no such effect.
        coupling: stiffness of the coupling to the actuator under test; ``force / stroke`` without such an effect.
        coupling_damping: its damping, likewise.
    """

    force: float
    pressure: float
    compression: float
    mass: float
    spool: float
    stroke: float
    speed: float
    sticking: float
    position_noise: float
    pressure_noise: float
    spool_noise: float
    force_noise: float
    delay: float
    coupling: float
    coupling_damping: float


def ratios(rig: Rig) -> Ratios:
    """Return the scale of a rig relative to the paper's; a quantity missing in its file counts as the paper's."""
    plant, limits = rig.plant, rig.limits
    friction = rig.friction
    force, pressure = in_python(largest_force)(plant) / PAPER_FORCE, plant.supply_pressure / PAPER_PRESSURE
    spool, stroke = limits.spool / PAPER_SPOOL, (limits.position[1] - limits.position[0]) / PAPER_STROKE
    noise, like_these = noise_of(rig.effective().sensors), noise_of(PAPER_SENSORS)
    size = Noise(position=stroke, load_pressure=pressure, spool_position=spool, force=force)
    told = model_of(rig, PAPER_DELAY)
    delayed = any(use.name == "command_delay" for use in rig.effects)
    found = (
        force,
        pressure,
        in_python(compression)(plant) / PAPER_COMPRESSION,
        plant.moving_mass / PAPER_PLANT.moving_mass,
        spool,
        stroke,
        in_python(largest_speed)(plant, limits.spool) / PAPER_SPEED,
        gms.break_away(friction) / PAPER_STICKING if isinstance(friction, gms.Parameters) else 1.0,
        *(own / paper if own > 0.0 else other for own, paper, other in zip(noise, like_these, size, strict=True)),
    )
    known = [ratio if math.isfinite(ratio) and ratio > 0.0 else 1.0 for ratio in found]
    delay = told.command_delay / PAPER_DELAY if delayed else 1.0
    coupling = told.coupling_stiffness / PAPER_COUPLING or force / stroke
    damping = told.coupling_damping / PAPER_COUPLING_DAMPING or force / stroke
    return Ratios(*(*known, delay, coupling, damping))


def defaults_for(parameters: type, rig: Rig, stated: Mapping[str, Any] = MappingProxyType({})) -> Mapping[str, Any]:
    """Return the defaults that follow from a rig, by name; others are omitted.

    Args:
        parameters: a ``NamedTuple`` class with the declarations.
        rig: the rig as described to the user of the parameters.
        stated: defaults for the paper's rig in place of the declared ones.
    """
    return scaled_defaults(parameters, ratios(rig)._asdict(), stated)


def tuned_for(parameters: type[Parameters], rig: Rig, stated: Mapping[str, Any] = MappingProxyType({})) -> Parameters:
    """Return a parameter set with the defaults for a rig; arguments as those of :func:`defaults_for`."""
    return parameters(**defaults_for(parameters, rig, stated))
