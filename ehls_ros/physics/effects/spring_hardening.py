"""A spring that hardens (or softens) with its deflection."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import X
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = "ks x -> ks x + cubic x³ + quintic x⁵"
SOURCE = "Kovacic, Brennan, The Duffing Equation, 2011"
WORDS = Words(
    "a spring that hardens with its deflection",
    inspect="inspect the spring for coils that touch and for guides that bind",
    measure="measure the spring's force at rest at five positions over the stroke",
    change="keep `spring_hardening` under `effects` in the rig file",
)


class Parameters(NamedTuple):
    """Terms beyond the linear stiffness."""

    cubic: Annotated[float, quantity("N/m^3", "cubic stiffness", minimum=-1e12, maximum=1e12)] = 0.0
    quintic: Annotated[float, quantity("N/m^5", "quintic stiffness", minimum=-1e15, maximum=1e15)] = 0.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Subtract the cubic and quintic terms."""
    square = y[X] * y[X]
    return value - (p.cubic + p.quintic * square) * square * y[X]


def forms(rig: Rig) -> tuple[Form, ...]:
    """One of the two terms, or both: a spring that softens with growing deflection does so less and less."""
    return Form({"cubic": ()}), Form({"quintic": ()}), Form({"cubic": (), "quintic": ()})
