"""The position servo acts on the piston through the elasticity of beam and hinges."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V, X, servo_displacement, servo_velocity
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "environment"
EQUATION = "F = stiffness (x_servo - x) + damping (v_servo - v)"
SOURCE = "two masses on an elastic beam; Kang et al. 2018, Fig. 1"
WORDS = Words(
    "the elastic coupling to the position servo",
    inspect="inspect the beam, its hinges and the servo's mounting",
    measure="record the servo's displacement while the piston is blocked",
    change="keep `coupling_stiffness` under `effects` in the rig file",
)
NEEDS = ("disturbance_displacement_m",)
COUPLES = True


class Parameters(NamedTuple):
    """The beam as a spring and a damper between the two pistons."""

    stiffness: Annotated[float, quantity("N/m", "stiffness between the pistons", minimum=0.0, maximum=1e9)] = 0.0
    damping: Annotated[float, quantity("N s/m", "damping between the pistons", minimum=0.0, maximum=1e6)] = 0.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the force of the spring and the damper."""
    return value + p.stiffness * (servo_displacement(t, w) - y[X]) + p.damping * (servo_velocity(w) - y[V])


def forms(rig: Rig) -> tuple[Form, ...]:
    """A spring, without or with its damper."""
    return Form({"stiffness": ()}), Form({"stiffness": (), "damping": ()})
