"""The friction elements run along a recorded motion, and the force balance (3), (5) they stand in.

    F = m0 a + (B0 + σf) v + ks x + F0 + Σ F_i

is linear in mass, viscous damping, spring and constant force; only the elements have to be run.
"""

import math
from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.observers import gms
from ehls_ros.identification.motion import Motion
from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.friction import gms as model
from ehls_ros.physics.friction.gms import Parameters as Friction

ONE_STEP = gms.Parameters(steps=1)

MOST_PARTS = 60
"""Most integration steps in a block."""

_RUN = '''"""Friction elements along a motion, generated."""
from numba import njit
from ehls_ros.control.observers import gms
from ehls_ros.physics.friction import gms as model

update = gms.updater(model)


@njit(cache=True, error_model="numpy")
def run(velocity, fresh, period, parts, friction, p, state, out):
    step = period / parts
    for i in range(velocity.size):
        if fresh[i]:
            state.forces[:] = 0.0
            state.mode[:] = 0.0
            state.last[:] = 0.0
        before = velocity[i] if fresh[i] or i == 0 else velocity[i - 1]
        after = velocity[i] if i + 1 == velocity.size or fresh[i + 1] else velocity[i + 1]
        total = 0.0
        for part in range(parts):
            # From the block's beginning to its end, the velocity straight between the blocks' middles.
            at = (part + 0.5) / parts - 0.5
            v = velocity[i] + at * (velocity[i] - before if at < 0.0 else after - velocity[i])
            update(v, step, friction, p, state)
            total += state.estimate[0]
        out[i] = total / parts
'''


def elements_force(motion: Motion, friction: Friction) -> Array:
    """Return the mean force of the elements together in each block, shape (n,) [N]."""
    out = np.empty(len(motion.velocity))
    # A slipping element follows at the rate C/s; the integration has to be finer than that.
    quickest = friction.attraction_rate / min(friction.coulomb_force, friction.static_force)
    parts = max(1, min(math.ceil(quickest * motion.period), MOST_PARTS))
    run = kernel_module(_RUN).run
    run(motion.velocity, motion.fresh, motion.period, parts, friction, ONE_STEP, gms.state(model, friction), out)
    return out


def linear_columns(motion: Motion, names: Sequence[str]) -> Array:
    """Return what the linear coefficients multiply, shape (n, names).

    Args:
        motion: the recording.
        names: of ``viscous``, ``spring``, ``constant``, ``mass``.
    """
    columns = {
        "viscous": motion.velocity,
        "spring": motion.position,
        "constant": np.ones(len(motion.velocity)),
        "mass": motion.acceleration,
    }
    return np.column_stack([columns[name] for name in names])
