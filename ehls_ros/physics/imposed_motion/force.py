"""The force of the effects beyond (3) along a recording."""

from collections.abc import Callable

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.physics.imposed_motion.base import Body, sampled
from ehls_ros.physics.plant import Chains, Coefficients, Relations


def build(states: int, chains: Chains) -> Body:
    """Build the part, see :func:`~ehls_ros.physics.imposed_motion.base.sampled`; its column is the force along +x [N]."""
    return sampled(states, chains, _writer)


def _writer(equations: Relations) -> Callable[..., None]:
    extra = equations.extra

    @kernel_no_refcount
    def write(t: float, y: Array, z: Array, c: Coefficients, row: Array) -> None:
        row[0] = extra(t, y, z, c)

    return write
