"""A mass on a spring: the parts bolted to the piston do not move as one rigid body.

The states are the displacement of the mass relative to the piston, from its static equilibrium, and its velocity. If the rig
file's moving mass already includes a fraction of the mass, that fraction is removed there. Its weight, which the spring still
carries, is added back. Spring and disturbance may act on the mass instead of the piston, as with an elastic beam between
cylinder and load. With ``piston_share``, friction and damping act there too: all of the load except a fraction of the mass is
behind the elasticity, and the states are those of the piston relative to the load.
"""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._separated_load import contact, piston_rates, transmitted_force, without_piston
from ehls_ros.physics.effects.base import Form, Group, Peak, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V, X, disturbance_force
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = (
    "r' = v2 - v,  v2' = -(ω² r + 2 ζ ω r') - loaded (ks (x + r) + fd)/mass,  ω = 2π frequency;  m0 -> m0 - taken mass;  "
    "F = mass (ω² r + 2 ζ ω r') + loaded (ks x + fd);  with piston_share (3) holds for the load (x, v) of ml = m0 - mp, "
    "with A pL -> F, mp vp' = A pL - F, mp = piston_share m0, F = ml (ω² r + 2 ζ ω r'), r = xp - x"
)
SOURCE = "Den Hartog, Mechanical Vibrations, 1956, ch. 3: two-mass systems"
WORDS = Words(
    "a flexible mode of the load",
    inspect="inspect what is bolted to the piston, and how stiffly",
    measure="tap the load and read its natural frequency from an acceleration sensor",
    change="keep `flexible_mode` under `effects` in the rig file; it takes its mass out of `moving_mass`",
)
STATES = 2
PISTON = 0
YIELDING = ("frequency",)

MIN_MASS = 0.1
"""Mass below which the load it carries is reduced in proportion; otherwise its acceleration would be unbounded [kg]."""

MIN_FRACTION = 0.01
"""Fraction of the moving mass that always stays with the piston."""


class Parameters(NamedTuple):
    """The mass, its natural frequency with the piston fixed, and its fraction included in the rig file's moving mass."""

    mass: Annotated[float, quantity("kg", "mass not rigidly connected to the piston", minimum=0.0, maximum=1e4)] = 0.0
    frequency: Annotated[float, quantity("Hz", "natural frequency with the piston fixed", minimum=0.1, maximum=400.0)] = 10.0
    damping: Annotated[float, quantity("1", "damping ratio with the piston fixed", minimum=0.0, maximum=1.0)] = 0.02
    loaded: Annotated[float, quantity("1", "fraction of spring and disturbance acting on it", minimum=0.0, maximum=1.0)] = 0.0
    taken: Annotated[float, quantity("1", "fraction of it included in the moving mass", minimum=0.0, maximum=1.0)] = 0.0
    piston_share: Annotated[
        float,
        quantity("1", "fraction of the moving mass on the piston's side of the elasticity", minimum=0.0, maximum=0.9),
    ] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig without the included fraction of the mass, or without the piston's mass."""
    if parameters.piston_share > 0.0:
        return without_piston(rig, parameters.piston_share)
    mass = max(rig.plant.moving_mass - parameters.taken * parameters.mass, MIN_FRACTION * rig.plant.moving_mass)
    return rig.with_plant(moving_mass=mass)


def piston_share(parameters: Parameters) -> float:
    """Return the fraction of the moving mass that stays with the piston."""
    return parameters.piston_share


@kernel
def pull(velocity: float, z: Array, p: Parameters) -> float:
    """Return the force of spring and damper on the piston, per mass [m/s^2]."""
    omega = 2.0 * math.pi * p.frequency
    return omega * (omega * z[0] + 2.0 * p.damping * (z[1] - velocity))


@kernel
def joint_force(y: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the force of the piston on the load [N]."""
    omega = 2.0 * math.pi * p.frequency
    mass = plant.moving_mass
    return contact(z[0], z[1] - y[V], 0.0, 0.0, mass * omega * omega, 2.0 * p.damping * omega * mass)


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the spring force, restore the removed weight and remove the loads on the mass; or add the joint's force."""
    if p.piston_share > 0.0:
        return transmitted_force(value, joint_force(y, z, p, plant), p.piston_share, y, plant)
    carried = p.loaded * min(1.0, p.mass / MIN_MASS)
    far = carried * (plant.spring_stiffness * y[X] + disturbance_force(t, w))
    return value + p.mass * (pull(y[V], z, p) - p.taken * plant.gravity) + far


@kernel
def piston_position(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the position of a separate piston [m]."""
    return value + z[0] if p.piston_share > 0.0 else value


@kernel
def piston_velocity(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the velocity of a separate piston [m/s]."""
    return z[1] if p.piston_share > 0.0 else value


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    """Write the rates of the mass, or of a separate piston."""
    if p.piston_share > 0.0:
        piston_rates(joint_force(y, z, p, plant), p.piston_share, y, z[1], y[V], plant, dz)
        return
    dz[0] = z[1] - y[V]
    load = p.loaded * (plant.spring_stiffness * (y[X] + z[0]) + disturbance_force(t, w))
    dz[1] = -pull(y[V], z, p) - load / max(p.mass, MIN_MASS)


def forms(rig: Rig) -> tuple[Form, ...]:
    """An additional mass, a part of the rig file's mass, or the load behind a beam, without or with its friction."""
    free = {"mass": (), "frequency": (5.0, 10.0, 20.0, 40.0, Peak(1), Peak(2)), "damping": (0.05,) * 6}
    half = 0.5 * rig.plant.moving_mass
    behind = {"mass": (half, half, half), "frequency": (10.0, 20.0, 40.0), "damping": (0.05, 0.05, 0.05)}
    load = {"piston_share": (0.3, 0.3, 0.3), "frequency": (10.0, 20.0, 40.0), "damping": ()}
    return Form(free), Form(free, {"taken": 1.0}), Form(behind, {"taken": 1.0, "loaded": 1.0}), Form(load)
