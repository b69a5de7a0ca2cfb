"""An end stop inside the stroke: beyond it the piston is pushed back, and never pulled."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Quantile, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V, X
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = "F = -(stiffness d max(1 + loss d', 0) + damping max(d', 0)), d > 0 the depth beyond upper; mirrored below lower"
SOURCE = (
    "Gilardi, Sharf, Literature survey of contact dynamics modelling, Mechanism and Machine Theory 37, 2002: Kelvin-Voigt, "
    "and Hunt-Crossley, whose loss grows with the depth"
)
WORDS = Words(
    "an end stop inside the stroke",
    check="move slowly over the stroke and look for contact; check the position limits",
)


class Parameters(NamedTuple):
    """Where the stops are, and what they are like; ten metres are beyond any stroke."""

    upper: Annotated[float, quantity("m", "position of the upper stop", minimum=-10.0, maximum=10.0)] = 10.0
    lower: Annotated[float, quantity("m", "position of the lower stop", minimum=-10.0, maximum=10.0)] = -10.0
    stiffness: Annotated[float, quantity("N/m", "stiffness of a stop", minimum=1e3, maximum=1e9)] = 1e7
    damping: Annotated[float, quantity("N s/m", "damping on the way into a stop", minimum=0.0, maximum=1e6)] = 1e4
    loss: Annotated[float, quantity("s/m", "change of the stiffness per speed, in and out", minimum=0.0, maximum=100.0)] = 0.0


@kernel
def push(depth: float, speed: float, p: Parameters) -> float:
    """Return what a stop pushes with, ``depth`` behind its face, at a speed into it [N]."""
    return p.stiffness * depth * max(1.0 + p.loss * speed, 0.0) + p.damping * max(speed, 0.0) if depth > 0.0 else 0.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Push back."""
    return value - push(y[X] - p.upper, y[V], p) + push(p.lower - y[X], -y[V], p)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The upper stop, the lower, both: seldom, at times and often reached."""
    upper = tuple(Quantile("position_m", part) for part in (0.995, 0.95, 0.85))
    lower = tuple(Quantile("position_m", part) for part in (0.005, 0.05, 0.15))
    contact = {"stiffness": (1e6, 1e6, 1e6), "damping": (1e3, 1e3, 1e3), "loss": (0.0, 0.0, 0.0)}
    return (
        Form({"upper": upper, **contact}),
        Form({"lower": lower, **contact}),
        Form({"upper": upper, "lower": lower, **contact}),
    )
