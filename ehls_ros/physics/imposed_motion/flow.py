"""The terms of the volume balance (2) along a recording."""

from collections.abc import Callable

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.physics.imposed_motion.base import Body, sampled
from ehls_ros.physics.plant import PL, Chains, Coefficients, Relations


def build(states: int, chains: Chains) -> Body:
    """Build the part, see :func:`~ehls_ros.physics.imposed_motion.base.sampled`.

    Its columns are load flow [m^3/s], total leakage [m^3/s], bulk modulus [Pa] and supply pressure [Pa].
    """
    return sampled(states, chains, _writer)


def _writer(equations: Relations) -> Callable[..., None]:
    effective_opening, volume = equations.effective_opening, equations.volume

    @kernel_no_refcount
    def write(t: float, y: Array, z: Array, c: Coefficients, row: Array) -> None:
        opening = effective_opening(t, y, z, c)
        flow, leak, modulus, supply = volume(opening, 1.0 if opening >= 0.0 else -1.0, t, y, z, c)
        row[0], row[1], row[2], row[3] = flow, c.plant.leakage_coefficient * y[PL] + leak, modulus, supply

    return write
