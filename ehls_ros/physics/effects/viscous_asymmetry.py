"""Viscous friction that depends on the direction of motion."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.friction.base import sign
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = (
    "σf -> σf + asymmetry + forward along +x, σf - asymmetry + backward along -x; "
    "with a turning speed σf -> σf + asymmetry tanh(v/turning_speed)"
)
SOURCE = "Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, ... machines with friction, Automatica 30, 1994"
WORDS = Words(
    "a viscous friction that differs between the directions",
    inspect="look for a restriction in one line, and which way the seals face",
    measure="record fast strokes at one speed in both directions and compare their forces",
    change="keep `viscous_asymmetry` under `effects` in the rig file",
)


class Parameters(NamedTuple):
    """Half the difference between the directions, or a change in one of them."""

    asymmetry: Annotated[
        float, quantity("N s/m", "viscous coefficient added along +x, subtracted along -x", minimum=-1e6, maximum=1e6)
    ] = 0.0
    forward: Annotated[float, quantity("N s/m", "viscous coefficient added along +x only", minimum=-1e6, maximum=1e6)] = 0.0
    backward: Annotated[float, quantity("N s/m", "viscous coefficient added along -x only", minimum=-1e6, maximum=1e6)] = 0.0
    turning_speed: Annotated[
        float, quantity("m/s", "speed over which the asymmetry turns round; 0: at once", minimum=0.0, maximum=1.0)
    ] = 0.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Subtract the added friction."""
    turned = math.tanh(y[V] / p.turning_speed) if p.turning_speed > 0.0 else sign(y[V])
    return value - p.asymmetry * turned * y[V] - p.forward * max(y[V], 0.0) - p.backward * min(y[V], 0.0)


def forms(rig: Rig) -> tuple[Form, ...]:
    """Opposite changes in both directions, at once or over a range of speeds, or a change in one of them."""
    return (
        Form({"asymmetry": ()}),
        Form({"forward": ()}),
        Form({"backward": ()}),
        Form({"asymmetry": (), "turning_speed": (Share("velocity_m_s", 0.02), Share("velocity_m_s", 0.1))}),
    )
