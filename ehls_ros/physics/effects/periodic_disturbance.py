"""A periodic force on the piston: pump ripple, a machine running nearby."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Peak, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "environment"
EQUATION = "F = sine sin(a) + cosine cos(a) + second_sine sin(2a) + second_cosine cos(2a);  a = 2π frequency t"
SOURCE = "Bodson, Sacks, Khosla, Harmonic generation in adaptive feedforward cancellation schemes, IEEE TAC 39, 1994"
WORDS = Words(
    "a periodic force",
    inspect="look for pumps and machines that turn at this frequency",
    measure="stop them one by one and watch the line in the force's spectrum",
    change="keep `periodic_disturbance` under `effects` in the rig file only if its source cannot be removed",
)


class Parameters(NamedTuple):
    """Amplitudes of the fundamental and its second harmonic, and frequency; phases refer to the start of the experiment."""

    sine: Annotated[float, quantity("N", "sine part along +x", minimum=-1e6, maximum=1e6)] = 0.0
    cosine: Annotated[float, quantity("N", "cosine part along +x", minimum=-1e6, maximum=1e6)] = 0.0
    second_sine: Annotated[float, quantity("N", "sine part of the second harmonic along +x", minimum=-1e6, maximum=1e6)] = 0.0
    second_cosine: Annotated[float, quantity("N", "its cosine part along +x", minimum=-1e6, maximum=1e6)] = 0.0
    frequency: Annotated[float, quantity("Hz", "frequency", minimum=1e-3, maximum=1e3)] = 1.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the force."""
    angle = 2.0 * math.pi * p.frequency * t
    s, c = math.sin(angle), math.cos(angle)
    return value + p.sine * s + p.cosine * c + 2.0 * p.second_sine * s * c + p.second_cosine * (c * c - s * s)


def forms(rig: Rig) -> tuple[Form, ...]:
    """A sine wave, starting from the residual's two strongest spectral lines; and one with its second harmonic."""
    lines = (Peak(1), Peak(2))
    return (
        Form({"sine": (), "cosine": (), "frequency": lines}),
        Form({"sine": (), "cosine": (), "second_sine": (), "second_cosine": (), "frequency": lines}),
    )
