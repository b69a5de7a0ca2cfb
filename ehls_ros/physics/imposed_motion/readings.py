"""The errors that effects add to the sensors' readings along a recording."""

from collections.abc import Callable

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.physics.imposed_motion.base import Body, sampled
from ehls_ros.physics.plant import Chains, Coefficients, Relations


def build(states: int, chains: Chains) -> Body:
    """Build the part; its columns are the errors of position [m], load pressure [Pa] and force [N]."""
    position, pressure, force = chains.position_reading, chains.pressure_reading, chains.force_reading

    def writer(equations: Relations) -> Callable[..., None]:
        @kernel_no_refcount
        def write(t: float, y: Array, z: Array, c: Coefficients, row: Array) -> None:
            row[0] = position(0.0, t, y, c.inputs, z, c.effects, c.plant)
            row[1] = pressure(0.0, t, y, c.inputs, z, c.effects, c.plant)
            row[2] = force(0.0, t, y, c.inputs, z, c.effects, c.plant)

        return write

    return sampled(states, chains, writer)
