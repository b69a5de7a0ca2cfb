"""A friction model run along a recorded motion, with the functions its observer uses."""

import hashlib
import inspect
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.observers import rig_model
from ehls_ros.identification.motion import Motion
from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.friction.base import FrictionModel

MOST_PARTS = 60
"""Most parts into which a block is divided."""

ONE_STEP = rig_model.Parameters(steps=1)


def runner(model: FrictionModel) -> Callable[..., None]:
    """Build the compiled run of one friction model along a motion."""
    update = rig_model.updater(model)
    relaxation_rate = kernel(model.relaxation_rate)

    @kernel
    def run(velocity: Array, fresh: Any, period: float, friction: Any, p: Any, state: Any, out: Array) -> None:
        """Run the model.

        Args:
            velocity: velocity in the middle of each block, shape (n,) [m/s].
            fresh: whether a block begins a stretch without gaps, with the contact at rest, shape (n,).
            period: length of a block [s].
            friction: parameters of the model.
            p: parameters of the observer.
            state: state of the observer.
            out: where the mean force of each block goes, without the viscous part, shape (n,) [N].
        """
        for i in range(velocity.size):
            if fresh[i]:
                state.forces[:] = 0.0
                state.mode[:] = 0.0
                state.last[:] = 0.0
            before = velocity[i] if fresh[i] or i == 0 else velocity[i - 1]
            after = velocity[i] if i + 1 == velocity.size or fresh[i + 1] else velocity[i + 1]
            needed = period * relaxation_rate(friction, abs(velocity[i]))
            parts = max(1, math.ceil(min(needed, MOST_PARTS)))
            total = 0.0
            for part in range(parts):
                # Between the middles of the blocks the velocity is a straight line.
                at = (part + 0.5) / parts - 0.5
                v = velocity[i] + at * (velocity[i] - before if at < 0.0 else after - velocity[i])
                update(v, period / parts, friction, p, state)
                total += state.estimate[0]
            out[i] = total / parts

    return run


@cache
def _compiled(model: str) -> Any:
    """Compile (or load) the run of a friction model."""
    # The model may lie outside the package; a change of it, or of this file, makes another module.
    used = [Path(inspect.getfile(cast(ModuleType, FRICTION_MODELS.load(model)))), Path(__file__)]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in used)).hexdigest()[:16]
    glue = [
        "from numba import njit",
        "from ehls_ros.identification import along",
        "from ehls_ros.physics.friction import FRICTION_MODELS",
        f"run = along.runner(FRICTION_MODELS.load({model!r}))  # {digest}",
        "@njit(cache=True, error_model='numpy')",
        "def entry(*arguments):",
        "    run(*arguments)",
    ]
    return kernel_module("\n".join(glue) + "\n").entry


def force_along(motion: Motion, model: str, friction: Any) -> Array:
    """Return the mean friction force in each block of a motion, without the viscous part, shape (n,) [N].

    Args:
        motion: the motion, n blocks.
        model: name of the friction model.
        friction: its parameters.
    """
    out = np.empty(len(motion.velocity))
    state = rig_model.state(FRICTION_MODELS.load(model), friction)
    _compiled(model)(motion.velocity, motion.fresh, motion.period, friction, ONE_STEP, state, out)
    return out
