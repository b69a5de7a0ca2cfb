"""Free play in the hinge between piston and what it moves.

With ``gap`` the spring is behind the hinge and centres its far side: around the middle nothing pulls. With ``held_gap``
friction holds the far side: the spring stays bent as it is until the play is taken up the other way. With ``load_gap``
all of the load is behind the hinge, most of the mass and the friction with it: it moves by itself until the play is
taken up.
"""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._parted import contact, handed_on, piston_rates, without_piston
from ehls_ros.physics.effects._play import RATE, dead_zone, dragged
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V, X
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = (
    "ks x -> ks dz(r, ±gap/2), r dragged by x with a play of held_gap;  with load_gap (3) holds for the load (x, v), "
    "with A pL -> F, mp vp' = A pL - F, mp = piston_share m0, F = contact of stiffness and damping beyond |xp - x| = load_gap/2"
)
SOURCE = "Nordin, Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38, 2002"
WORDS = Words(
    "backlash in the hinge",
    check="turn the load back and forth by hand and measure the free play; check pins and bushings",
)
STATES = 3
PISTON = 1


class Parameters(NamedTuple):
    """Free play in all, of a hinge whose far side is free, or held, or carries the load; and this hinge's faces."""

    gap: Annotated[float, quantity("m", "free play, far side centred by the spring", minimum=0.0, maximum=0.1)] = 0.0
    held_gap: Annotated[float, quantity("m", "free play, far side held where it is", minimum=0.0, maximum=0.1)] = 0.0
    load_gap: Annotated[float, quantity("m", "free play, all of the load on the far side", minimum=0.0, maximum=0.1)] = 0.0
    piston_share: Annotated[
        float, quantity("1", "fraction of the moving mass on the piston's side of load_gap", minimum=0.05, maximum=0.9)
    ] = 0.2
    stiffness: Annotated[float, quantity("N/m", "stiffness of the faces of load_gap", minimum=1e5, maximum=5e8)] = 1e8
    damping: Annotated[float, quantity("N s/m", "damping of the faces of load_gap", minimum=0.0, maximum=1e6)] = 3e4
    rounding: Annotated[
        float, quantity("1", "fraction of load_gap over which its faces come to bear", minimum=0.0, maximum=0.2)
    ] = 0.1


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig without the mass on the piston's side."""
    return without_piston(rig, parameters.piston_share) if parameters.load_gap > 0.0 else rig


def piston_share(parameters: Parameters) -> float:
    """Return the fraction of the moving mass on the piston's side."""
    return parameters.piston_share if parameters.load_gap > 0.0 else 0.0


@kernel
def pushed(y: Array, z: Array, p: Parameters) -> float:
    """Return the force across the hinge [N]."""
    return contact(z[1], z[2] - y[V], p.load_gap, p.rounding * p.load_gap, p.stiffness, p.damping)


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Replace the spring of (3) by the one behind the play; push the load by the hinge."""
    bent = dead_zone(dragged(z[0], y[X], p.held_gap), -0.5 * p.gap, 0.5 * p.gap)
    total = value + plant.spring_stiffness * (y[X] - bent)
    return handed_on(total, pushed(y, z, p), p.piston_share, y, plant) if p.load_gap > 0.0 else total


@kernel
def piston_position(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return where the piston is."""
    return value + z[1] if p.load_gap > 0.0 else value


@kernel
def piston_velocity(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return how fast the piston moves."""
    return z[2] if p.load_gap > 0.0 else value


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    """Remember where the far side was dragged to; move the piston."""
    dz[0] = RATE * (dragged(z[0], y[X], p.held_gap) - z[0])
    dz[1] = dz[2] = 0.0
    if p.load_gap > 0.0:
        piston_rates(pushed(y, z, p), p.piston_share, y, z[2], y[V], plant, dz[1:])


def forms(rig: Rig) -> tuple[Form, ...]:
    """Any of the plays, narrow, middling and wide."""
    parts = (0.02, 0.1, 0.3)
    starts = tuple(Share("position_m", part) for part in parts)
    narrow = tuple(Share("position_m", part) for part in (0.002, 0.01, 0.05))
    faces = {"piston_share": (), "stiffness": (), "rounding": ()}
    return Form({"gap": starts}), Form({"held_gap": starts}), Form({"load_gap": narrow, **faces})
