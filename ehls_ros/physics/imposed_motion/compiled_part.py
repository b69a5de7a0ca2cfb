"""Compile a part of the model, for floats and for duals."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.duals import dual_array, dual_record
from ehls_ros.physics.composition import Switched
from ehls_ros.physics.imposed_motion.base import Body, ModelRun, Motion, Scratch, scratch
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.plant import FRICTION, INPUTS


class Compiled(NamedTuple):
    """The compiled ``run`` of a part."""

    run: Callable[..., Any]


class Rows(NamedTuple):
    """Duals as rows of floats.

    Attributes:
        plant, friction, effects: parameters, as in :class:`~ehls_ros.physics.imposed_motion.base.ModelRun`.
        inputs: arrays of the part's inputs.
        motion: position, velocity, pressure and spool, shape (4, n, width), or empty where they do not vary.
    """

    plant: Array
    friction: Array
    effects: Array
    inputs: tuple[Array, ...]
    motion: Array


def build(part: Any, **contained: Any) -> Compiled:
    """Build a part for floats, with ``run(a, inputs, out)``; the output has the shape (n, columns).

    Args:
        part: the part's module.
        contained: the arguments of its builder: number of the effects' ``states``, their ``chains``, and, where the part
            contains them, ``friction`` and its ``elements``, or ``cylinder`` and ``valve``.
    """
    body: Body = part.build(**contained)
    run_samples, size, modes, own = body.run, body.states, body.modes, body.own

    @kernel
    def run(a: ModelRun, inputs: Any, out: Array) -> None:
        run_samples(a, inputs, scratch(size, modes, a.history), scratch(own, own, 0), out)

    return Compiled(run)


@kernel
def _as_given(motion: Motion, rows: Array) -> Motion:
    return motion


@kernel
def _nothing(inputs: None, rows: tuple[Array, ...]) -> None:
    return


def build_duals(part: Any, width: int, moved: int, **contained: Any) -> Compiled:
    """Build a part for duals, with ``run(a, inputs, rows, out, found)``.

    ``a`` and ``inputs`` hold the fields' names and constants, the rows hold the values of the duals. The output, shape
    (n, columns, width), is scratch; ``found``, shape (places, columns, n), receives the values and then the tangents.

    Args:
        part: the part's module.
        width: width of a dual.
        moved: whether the motion varies.
        contained: the arguments of its builder, see :func:`build`.
    """
    body: Body = part.build(**contained)
    run_samples, size, modes, own = body.run, body.states, body.modes, body.own
    inputs_of = part.of_duals(width) if hasattr(part, "of_duals") else _nothing

    @kernel
    def varied(m: Motion, rows: Array) -> Motion:
        position, velocity, pressure, spool = rows[0], rows[1], rows[2], rows[3]
        return Motion(
            m.time,
            dual_array(position, width),
            dual_array(velocity, width),
            dual_array(pressure, width),
            dual_array(spool, width),
            m.command,
            m.disturbance,
            m.servo_position,
            m.servo_velocity,
            m.temperature,
        )

    @kernel
    def dual_slopes(slope: Array) -> Any:
        return dual_array(slope, width)

    @kernel
    def first_values(slope: Array) -> Array:
        return slope[:, 0]

    motion_of, slopes_of = (varied, dual_slopes) if moved else (_as_given, first_values)

    @kernel
    def run(a: ModelRun, inputs: Any, rows: Rows, out: Array, found: Array) -> int:
        plant, friction = dual_record(rows.plant, width, a.plant), dual_record(rows.friction, width, a.friction)
        effects = Switched(a.effects.on, dual_array(rows.effects, width))
        given = ModelRun(motion_of(a.motion, rows.motion), a.fresh, a.period, a.steps, a.history, plant, friction, effects)
        y, work = np.zeros((size, width)), np.zeros((WORK_ROWS, size, width))
        y_own, work_own = np.zeros((own, width)), np.zeros((WORK_ROWS, own, width))
        slope = np.zeros((FRICTION, width))
        s = Scratch(
            dual_array(y, width),
            np.zeros(modes),
            np.zeros(INPUTS + a.history),
            slopes_of(slope),
            dual_array(work, width),
        )
        beside = Scratch(
            dual_array(y_own, width), np.zeros(own), np.zeros(INPUTS), slopes_of(slope), dual_array(work_own, width)
        )
        run_samples(given, inputs_of(inputs, rows.inputs), s, beside, dual_array(out, width))
        # Make each column contiguous, as callers read them one by one.
        for i in range(out.shape[0]):
            for column in range(found.shape[1]):
                for place in range(found.shape[0]):
                    found[place, column, i] = out[i, column, place]
        # Duals do not keep their memory alive: this use extends its lifetime to here.
        return y.size + work.size + y_own.size + work_own.size + slope.size

    return Compiled(run)
