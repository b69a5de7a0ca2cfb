"""A sinusoidal force on the piston: pump ripple, a machine running nearby."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Peak, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "environment"
EQUATION = "F = sine sin(2π frequency t) + cosine cos(2π frequency t)"
SOURCE = "Bodson, Sacks, Khosla, Harmonic generation in adaptive feedforward cancellation schemes, IEEE TAC 39, 1994"
WORDS = Words(
    "a periodic force",
    inspect="look for pumps and machines that turn at this frequency",
    measure="stop them one by one and watch the line in the force's spectrum",
    change="keep `periodic_disturbance` under `effects` in the rig file only if its source cannot be removed",
)


class Parameters(NamedTuple):
    """Amplitudes and frequency of the sine wave; its phase refers to the start of the experiment."""

    sine: Annotated[float, quantity("N", "sine part along +x", minimum=-1e6, maximum=1e6)] = 0.0
    cosine: Annotated[float, quantity("N", "cosine part along +x", minimum=-1e6, maximum=1e6)] = 0.0
    frequency: Annotated[float, quantity("Hz", "frequency", minimum=1e-3, maximum=1e3)] = 1.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the force."""
    angle = 2.0 * math.pi * p.frequency * t
    return value + p.sine * math.sin(angle) + p.cosine * math.cos(angle)


def forms(rig: Rig) -> tuple[Form, ...]:
    """A sine wave, starting from the residual's two strongest spectral lines."""
    return (Form({"sine": (), "cosine": (), "frequency": (Peak(1), Peak(2))}),)
