"""A friction model run along a recorded motion, as its observer runs it along a measured one."""

import hashlib
import inspect
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, cast

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.observers.rig_model import DRIVING
from ehls_ros.identification.motion import Motion
from ehls_ros.physics.composition import kernel_module
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.friction.base import FrictionModel, sign
from ehls_ros.physics.integration import WORK_ROWS, integrator

MOST_PARTS = 60
"""Most parts into which a block is divided."""


class Line(NamedTuple):
    """Velocity in a part of a block: a straight line in time."""

    friction: Any
    velocity: float
    acceleration: float


class Contact(NamedTuple):
    """State of a contact: forces and modes of its elements, and scratch of the integrator."""

    forces: Array
    mode: Array
    work: Array


def runner(model: FrictionModel) -> Callable[..., None]:
    """Build the compiled run of one friction model along a motion."""
    level, rates, force, event, switch = model.level, model.rates, model.force, model.event, model.switch
    relaxation_rate = kernel(model.relaxation_rate)

    @kernel
    def evaluate(t: float, y: Array, mode: Array, c: Line, rate: Array) -> float:
        v = c.velocity + c.acceleration * t
        s = level(v, c.friction)
        rates(v, s, y, mode, c.friction, rate)
        return event(v, DRIVING * sign(v), s, y, mode, c.friction)

    @kernel
    def change(t: float, y: Array, mode: Array, c: Line) -> None:
        v = c.velocity + c.acceleration * t
        switch(v, DRIVING * sign(v), level(v, c.friction), y, mode, c.friction)

    advance = integrator(evaluate, change)

    @kernel
    def run(velocity: Array, fresh: Any, period: float, friction: Any, contact: Contact, out: Array) -> None:
        """Run the model.

        Args:
            velocity: velocity in the middle of each block, shape (n,) [m/s].
            fresh: whether a block begins a stretch without gaps, with the contact at rest, shape (n,).
            period: length of a block [s].
            friction: parameters of the model.
            contact: the contact's state.
            out: where the mean force of each block goes, without the viscous part, shape (n,) [N].
        """
        last = velocity[0]
        for i in range(velocity.size):
            if fresh[i]:
                contact.forces[:] = 0.0
                contact.mode[:] = 0.0
            before = velocity[i] if fresh[i] or i == 0 else velocity[i - 1]
            after = velocity[i] if i + 1 == velocity.size or fresh[i + 1] else velocity[i + 1]
            needed = period * relaxation_rate(friction, abs(velocity[i]))
            parts = max(1, math.ceil(min(needed, MOST_PARTS)))
            step = period / parts
            total = 0.0
            for part in range(parts):
                # Between the middles of the blocks the velocity is a straight line.
                at = (part + 0.5) / parts - 0.5
                v = velocity[i] + at * (velocity[i] - before if at < 0.0 else after - velocity[i])
                if part > 0 or not fresh[i]:
                    line = Line(friction, last, (v - last) / step)
                    advance(0.0, contact.forces, contact.mode, line, step, 1, contact.work)
                last = v
                # At v = 0 the viscous term is zero.
                total += force(0.0, 0.0, level(v, friction), contact.forces, contact.mode, friction)
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
    elements = FRICTION_MODELS.load(model).states(friction)
    contact = Contact(np.zeros(elements), np.zeros(elements), np.empty((WORK_ROWS, elements)))
    _compiled(model)(motion.velocity, motion.fresh, motion.period, friction, contact, out)
    return out
