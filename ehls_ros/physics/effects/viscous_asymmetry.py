"""Viscous friction that depends on the direction of motion."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "Ff -> Ff + asymmetry |v|: σf + asymmetry along +x, σf - asymmetry along -x"
SOURCE = "Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, ... machines with friction, Automatica 30, 1994"
WORDS = Words(
    "a viscous friction that differs between the directions",
    check="compare fast strokes in both directions; look for a restriction in one line",
)


class Parameters(NamedTuple):
    """Half the difference between the directions."""

    asymmetry: Annotated[
        float, quantity("N s/m", "viscous coefficient added along +x, subtracted along -x", minimum=-1e6, maximum=1e6)
    ] = 0.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Subtract the added friction, which acts along -x for a positive asymmetry."""
    return value - p.asymmetry * abs(y[V])


def forms(rig: Rig) -> tuple[Form, ...]:
    """The asymmetry."""
    return (Form({"asymmetry": ()}),)
