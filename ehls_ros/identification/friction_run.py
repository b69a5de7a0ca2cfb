"""Run of a friction model along a recorded motion, as its observer runs it along a measured one."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.observers.rig_model import Motion as Straight
from ehls_ros.control.observers.rig_model import driven
from ehls_ros.duals import dual_array, dual_record, record_rows, width_of
from ehls_ros.identification.motion import Motion
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.friction.base import FrictionModel
from ehls_ros.physics.integration import WORK_ROWS, integrator

MAX_PARTS = 60
"""Maximum number of parts into which a block is divided."""


class Contact(NamedTuple):
    """State of a contact: forces and modes of its elements, and scratch memory of the integrator."""

    forces: Array
    mode: Array
    work: Array


class Run(NamedTuple):
    """The compiled run of one friction model along a motion."""

    run: Callable[..., None]


def build(friction: FrictionModel) -> Run:
    """Build the run of one friction model along a motion."""
    level, force, advance = friction.level, friction.force, integrator(*driven(friction))
    relaxation_rate = kernel(friction.relaxation_rate)

    @kernel
    def run(velocity: Array, fresh: Any, period: float, friction: Any, contact: Contact, out: Array) -> None:
        """Run the model.

        Args:
            velocity: velocity in the middle of each block, shape (n,) [m/s].
            fresh: whether a block begins a stretch without gaps, with the contact at rest, shape (n,).
            period: length of a block [s].
            friction: parameters of the model.
            contact: the contact's state.
            out: receives the mean force of each block, without the viscous part, shape (n,) [N].
        """
        last = velocity[0]
        for i in range(velocity.size):
            if fresh[i]:
                contact.forces[:] = 0.0
                contact.mode[:] = 0.0
            before = velocity[i] if fresh[i] or i == 0 else velocity[i - 1]
            after = velocity[i] if i + 1 == velocity.size or fresh[i + 1] else velocity[i + 1]
            needed = period * relaxation_rate(friction, abs(velocity[i]))
            parts = max(1, math.ceil(min(needed, MAX_PARTS)))
            step = period / parts
            total = 0.0
            for part in range(parts):
                # The velocity is interpolated linearly between the middles of the blocks.
                at = (part + 0.5) / parts - 0.5
                v = velocity[i] + at * (velocity[i] - before if at < 0.0 else after - velocity[i])
                if part > 0 or not fresh[i]:
                    straight = Straight(friction, last, (v - last) / step)
                    advance(0.0, contact.forces, contact.mode, straight, step, 1, contact.work)
                last = v
                # At v = 0 the viscous term is zero.
                total += force(0.0, 0.0, level(v, friction), contact.forces, contact.mode, friction)
            out[i] = total / parts

    return Run(run)


MAX_TANGENTS = 14
"""Maximum number of tangents of :func:`slopes_along`."""

WIDTH = width_of(MAX_TANGENTS)
"""Width of the duals of :func:`slopes_along`."""


class Rows(NamedTuple):
    """Duals as rows of floats, for parameters, forces and scratch memory of the integrator; and the modes."""

    friction: Array
    forces: Array
    mode: Array
    work: Array


def build_slopes(friction: FrictionModel) -> Run:
    """Build the run of one friction model along a motion, with derivatives by the parameters."""
    run_model = build(friction).run

    @kernel
    def run(velocity: Array, fresh: Any, period: float, friction: Any, rows: Rows, out: Array) -> None:
        """Run the model; ``friction`` supplies the parameters' names, and ``out`` has the shape (n, WIDTH)."""
        contact = Contact(dual_array(rows.forces, WIDTH), rows.mode, dual_array(rows.work, WIDTH))
        run_model(velocity, fresh, period, dual_record(rows.friction, WIDTH, friction), contact, dual_array(out, WIDTH))

    return Run(run)


@cache
def compiled_run(model: str, *, slopes: bool = False) -> Callable[..., None]:
    """Return the compiled run of a friction model, without or with derivatives."""
    state = "rows" if slopes else "contact"
    entries = {"run": f"velocity, fresh, period, friction, {state}, out"}
    run: Callable[..., None] = compiled(
        build_slopes if slopes else build, entries, {"friction": FRICTION_MODELS.load(model)}
    ).run
    return run


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
    compiled_run(model)(motion.velocity, motion.fresh, motion.period, friction, contact, out)
    return out


def slopes_along(motion: Motion, model: str, friction: Any) -> Array:
    """Return the derivatives of the force of :func:`force_along`, shape (n, tangents) [N].

    Args:
        motion: the motion, n blocks.
        model: name of the friction model.
        friction: its parameters, of which some are :class:`~ehls_ros.duals.Dual`.
    """
    elements, out = FRICTION_MODELS.load(model).states(friction), np.empty((len(motion.velocity), WIDTH))
    # The names alone, so that one kernel serves any number of elements.
    names = type(friction)(*(() if isinstance(p, tuple) else 0.0 for p in friction))
    forces, work = np.zeros((elements, WIDTH)), np.zeros((WORK_ROWS, elements, WIDTH))
    rows = Rows(record_rows(friction, WIDTH), forces, np.zeros(elements), work)
    compiled_run(model, slopes=True)(motion.velocity, motion.fresh, motion.period, names, rows, out)
    return out[:, 1:]
