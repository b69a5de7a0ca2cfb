"""Backlash in the hinge between piston and load.

With ``gap``, the spring is behind the hinge and centres its far side, so it exerts no force around the middle. With
``held_gap``, friction holds the far side, so the spring keeps its deflection until the play is taken up in the other direction.
With ``load_gap``, the whole load is behind the hinge, with most of the mass and the friction; it moves freely until the play is
taken up.
"""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import FOLLOW_RATE, dead_zone, play_output
from ehls_ros.physics.effects._separated_load import contact, piston_rates, transmitted_force, without_piston
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V, X
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = (
    "ks x -> ks dz(r, ±gap/2), r = play of width held_gap driven by x;  with load_gap (3) holds for the load (x, v), "
    "with A pL -> F, mp vp' = A pL - F, mp = piston_share m0, F = contact of stiffness and damping beyond |xp - x| = load_gap/2"
)
SOURCE = "Nordin, Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38, 2002"
WORDS = Words(
    "backlash in the hinge",
    inspect="inspect pins and bushings between piston and load",
    measure="move the load back and forth by hand and read the free play from a dial gauge",
    change="keep `hinge_backlash` under `effects` in the rig file until the joint is repaired",
)
STATES = 3
PISTON = 1
YIELDING = ("gap", "held_gap", "load_gap", "stiffness")


class Parameters(NamedTuple):
    """Total play of a hinge whose far side is centred, held, or carries the load; and contact faces of ``load_gap``."""

    gap: Annotated[float, quantity("m", "play, far side centred by the spring", minimum=0.0, maximum=0.1)] = 0.0
    held_gap: Annotated[float, quantity("m", "play, far side held by friction", minimum=0.0, maximum=0.1)] = 0.0
    load_gap: Annotated[float, quantity("m", "play, whole load on the far side", minimum=0.0, maximum=0.1)] = 0.0
    piston_share: Annotated[
        float, quantity("1", "fraction of the moving mass on the piston's side of load_gap", minimum=0.05, maximum=0.9)
    ] = 0.2
    stiffness: Annotated[float, quantity("N/m", "stiffness of the faces of load_gap", minimum=1e5, maximum=5e8)] = 1e8
    damping: Annotated[float, quantity("N s/m", "damping of the faces of load_gap", minimum=0.0, maximum=1e6)] = 3e4
    rounding: Annotated[
        float, quantity("1", "fraction of load_gap over which its faces come into contact", minimum=0.0, maximum=0.2)
    ] = 0.1


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig without the mass on the piston's side of ``load_gap``."""
    return without_piston(rig, parameters.piston_share) if parameters.load_gap > 0.0 else rig


def corner(p: Parameters, period: float, varied: bool) -> str:
    """Return why a trajectory has no derivatives: without rounding, the faces' damping jumps at contact, without an event."""
    return "no rounding, so that the force jumps at contact" if p.load_gap > 0.0 and p.rounding == 0.0 else ""


def piston_share(parameters: Parameters) -> float:
    """Return the fraction of the moving mass on the piston's side; 0 without ``load_gap``."""
    return parameters.piston_share if parameters.load_gap > 0.0 else 0.0


@kernel
def joint_force(y: Array, z: Array, p: Parameters) -> float:
    """Return the force across the hinge [N]."""
    return contact(z[1], z[2] - y[V], p.load_gap, p.rounding * p.load_gap, p.stiffness, p.damping)


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Replace the spring of (3) by the one behind the play, and the pressure force by the hinge force."""
    deflection = dead_zone(play_output(z[0], y[X], p.held_gap), -0.5 * p.gap, 0.5 * p.gap)
    total = value + plant.spring_stiffness * (y[X] - deflection)
    return transmitted_force(total, joint_force(y, z, p), p.piston_share, y, plant) if p.load_gap > 0.0 else total


@kernel
def piston_position(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the position of a separate piston [m]."""
    return value + z[1] if p.load_gap > 0.0 else value


@kernel
def piston_velocity(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the velocity of a separate piston [m/s]."""
    return z[2] if p.load_gap > 0.0 else value


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    """Write the rates of the held far side and of a separate piston."""
    dz[0] = FOLLOW_RATE * (play_output(z[0], y[X], p.held_gap) - z[0])
    dz[1] = dz[2] = 0.0
    if p.load_gap > 0.0:
        piston_rates(joint_force(y, z, p), p.piston_share, y, z[2], y[V], plant, dz[1:])


def forms(rig: Rig) -> tuple[Form, ...]:
    """One of the plays, with narrow, medium and wide starting values."""
    starts = tuple(Share("position_m", fraction) for fraction in (0.02, 0.1, 0.3))
    narrow = tuple(Share("position_m", fraction) for fraction in (0.002, 0.01, 0.05))
    faces = {"piston_share": (), "stiffness": (), "rounding": ()}
    return Form({"gap": starts}), Form({"held_gap": starts}), Form({"load_gap": narrow, **faces})
