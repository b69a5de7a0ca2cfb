"""An end stop inside the stroke: it pushes the piston back and never pulls."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Quantile, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V, X
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = (
    "F = -(stiffness d (d/1 mm)^(exponent - 1) max(1 + loss d', 0) + damping max(d', 0)), d > 0 the depth beyond upper; "
    "mirrored below lower"
)
SOURCE = (
    "Gilardi, Sharf, Literature survey of contact dynamics modelling, Mechanism and Machine Theory 37, 2002: Kelvin-Voigt, "
    "Hunt-Crossley, whose loss grows with the depth, and Hertz, exponent 3/2"
)
WORDS = Words(
    "an end stop inside the stroke",
    inspect="look along the stroke for marks of contact, and compare them with the position limits",
    measure="move slowly over the whole stroke and note where the force rises",
    change="keep `end_stop` under `effects` in the rig file, and set `limits.position` inside it",
)


REFERENCE_DEPTH = 1e-3
"""Depth at which the force does not depend on the exponent [m]."""


class Parameters(NamedTuple):
    """Position and contact of the stops; the default of ten metres is beyond any stroke."""

    upper: Annotated[float, quantity("m", "position of the upper stop", minimum=-10.0, maximum=10.0)] = 10.0
    lower: Annotated[float, quantity("m", "position of the lower stop", minimum=-10.0, maximum=10.0)] = -10.0
    stiffness: Annotated[float, quantity("N/m", "stiffness of a stop, at a depth of 1 mm", minimum=1e3, maximum=1e9)] = 1e7
    damping: Annotated[float, quantity("N s/m", "damping while moving into a stop", minimum=0.0, maximum=1e6)] = 1e4
    loss: Annotated[float, quantity("s/m", "relative stiffening per speed into the stop", minimum=0.0, maximum=100.0)] = 0.0
    exponent: Annotated[float, quantity("1", "growth of the force with the depth", minimum=1.0, maximum=3.0)] = 1.0


@kernel
def push(depth: float, speed: float, p: Parameters) -> float:
    """Return the force of a stop at a depth [m] beyond its face and a speed into it [m/s], in N."""
    if depth <= 0.0:
        return 0.0
    spring = p.stiffness * depth * (depth / REFERENCE_DEPTH) ** (p.exponent - 1.0)
    return spring * max(1.0 + p.loss * speed, 0.0) + p.damping * max(speed, 0.0)


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the forces of both stops."""
    return value - push(y[X] - p.upper, y[V], p) + push(p.lower - y[X], -y[V], p)


def corner(p: Parameters, period: float, varied: bool) -> str:
    """Return why a trajectory into a stop has no derivatives: damping makes the force jump at contact, without an event."""
    reachable = p.upper < Parameters().upper or p.lower > Parameters().lower
    return "a damping, with which the force jumps at contact (take a loss instead)" if reachable and p.damping > 0.0 else ""


def forms(rig: Rig) -> tuple[Form, ...]:
    """Upper stop, lower or both, with starts reached rarely, sometimes and often; and one stop with a Hertzian contact."""
    upper = tuple(Quantile("position_m", fraction) for fraction in (0.995, 0.95, 0.85))
    lower = tuple(Quantile("position_m", fraction) for fraction in (0.005, 0.05, 0.15))
    contact = {"stiffness": (1e6, 1e6, 1e6), "damping": (1e3, 1e3, 1e3), "loss": (0.0, 0.0, 0.0)}
    hertz = {"exponent": 1.5}
    return (
        Form({"upper": upper, **contact}),
        Form({"lower": lower, **contact}),
        Form({"upper": upper, "lower": lower, **contact}),
        Form({"upper": upper, **contact}, hertz),
        Form({"lower": lower, **contact}, hertz),
    )
