"""A spool with inertia: it follows the command as a second-order system instead of the first-order one of (4).

The command of (4) is modified so that its spool displacement is Kv q, the second-order response, at any bandwidth.
"""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "q'' = ωn² (u - q) - 2 ζ ωn q';  u -> q + q'/ωv, with which (4) has the solution xv = Kv q"
SOURCE = "Thayer, Transfer functions for Moog servovalves, Moog Technical Bulletin 103, 1958"
WORDS = Words(
    "the second-order dynamics of the spool",
    inspect="inspect the phase in the valve's data sheet: beyond the bandwidth it falls below -90°",
    measure="record a small step of the command and look whether the spool overshoots",
    change="keep `valve_second_order` under `effects` in the rig file",
)
STATES = 2


class Parameters(NamedTuple):
    """Second-order spool; at a natural frequency of zero it remains first-order."""

    natural_frequency: Annotated[float, quantity("rad/s", "natural frequency; 0: first order", minimum=0.0, maximum=5e3)] = 0.0
    damping: Annotated[float, quantity("1", "damping ratio", minimum=0.01, maximum=2.0)] = 0.7


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the command for which (4) gives the second-order response [m]."""
    return z[0] + z[1] / plant.valve_bandwidth if p.natural_frequency > 0.0 else value


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    """Write the rates of q and q'."""
    dz[0] = z[1]
    dz[1] = p.natural_frequency * (p.natural_frequency * (u - z[0]) - 2.0 * p.damping * z[1])


def forms(rig: Rig) -> tuple[Form, ...]:
    """Natural frequency, starting from half to four times the bandwidth, and damping."""
    frequencies = tuple(factor * rig.plant.valve_bandwidth for factor in (0.5, 1.0, 2.0, 4.0))
    return (Form({"natural_frequency": frequencies, "damping": (0.7, 0.7, 0.7, 0.7)}),)
