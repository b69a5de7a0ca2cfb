"""Directional derivatives of the plant on a block: its equations compiled for duals."""

from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.duals import dual_array, dual_record, width_of
from ehls_ros.fmu.plant_kernel import COMMAND, DISPLACEMENT, FORCE, FORCE_RATE, OIL, SIGNALS, TIME, VELOCITY, Places
from ehls_ros.fmu.records import example, reader, view
from ehls_ros.physics import simulator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import FD, FD_RATE, FRICTION, INPUTS, START, TEMPERATURE, VD, XD, Chains, Coefficients, U
from ehls_ros.physics.sensors import SensorState
from ehls_ros.physics.simulator import Constants, State

WIDTH = width_of(1)
"""Width of a dual with one tangent."""

HELD = ((U, COMMAND), (FD, FORCE), (FD_RATE, FORCE_RATE), (XD, DISPLACEMENT), (VD, VELOCITY), (TEMPERATURE, OIL))
"""Inputs of the plant, and their places among the inputs of the block."""


class Compiled(NamedTuple):
    """``slopes(b)`` writes the derivatives of rates, event indicator and true readings in the direction of the seeds."""

    slopes: Callable[[Array], int]


def record_order(like: Any) -> tuple[int, ...]:
    """Return the places of a parameter set's numbers in the order of a record of duals: numbers first, then lists."""
    numbers, lists, place = list[int](), list[int](), 0
    for value in like:
        if isinstance(value, tuple):
            lists += range(place, place + len(value))
            place += len(value)
        else:
            numbers.append(place)
            place += 1
    return (*numbers, *lists)


def scratch_size(size: int, parameters: int, weights: int) -> int:
    """Return the numbers of scratch that ``slopes`` needs.

    Args:
        size: length of the state.
        parameters: number of coefficients of plant and friction.
        weights: number of the effects' parameters.
    """
    return WIDTH * (2 * size + parameters + weights + INPUTS + SIGNALS)


def build(
    friction: Any,
    elements: int,
    states: int,
    chains: Chains,
    weights: int,
    seed_at: int,
    slope_at: int,
    duals_at: int,
    **places: int,
) -> Compiled:
    """Build the derivatives.

    Args:
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the effects.
        weights: number of the effects' parameters.
        seed_at: index of the seeds, one for each variable.
        slope_at: index of the derivatives, one for each variable.
        duals_at: index of the scratch.
        places: fields of :class:`~ehls_ros.fmu.plant_kernel.Places`.
    """
    at = Places(**{name.removesuffix("_at"): index for name, index in places.items()})
    built, end = simulator.build(friction, elements, states, chains), FRICTION + elements
    size = end + states
    evaluate, observe = built.evaluate, simulator.observing(chains, end)
    plant_like, friction_like = example(Plant), example(friction.Parameters, elements)
    plant_order, friction_order = record_order(plant_like), record_order(friction_like)
    plant_of, friction_of, modes_of = reader(plant_like), reader(friction_like), view(1 + elements)
    y_at = duals_at
    rates_at = y_at + WIDTH * size
    plant_at = rates_at + WIDTH * size
    friction_at = plant_at + WIDTH * len(plant_order)
    weights_at = friction_at + WIDTH * len(friction_order)
    held_at = weights_at + WIDTH * weights
    truth_at = held_at + WIDTH * INPUTS
    state_rows, plant_rows, friction_rows = view(size, WIDTH), view(len(plant_order), WIDTH), view(len(friction_order), WIDTH)
    weight_rows, held_rows, truth_rows = view(weights, WIDTH), view(INPUTS, WIDTH), view(SIGNALS, WIDTH)
    signals_of = view(SIGNALS)

    @kernel_no_refcount
    def fill(b: Array, row: int, place: int) -> None:
        """Write the dual of a variable: value, seed, and zeros."""
        b[row] = b[place]
        b[row + 1] = b[seed_at + place]
        for lane in range(2, WIDTH):
            b[row + lane] = 0.0

    @kernel_no_refcount
    def slopes(b: Array) -> int:
        for i in range(size):
            fill(b, y_at + WIDTH * i, at.state + i)
        for i in range(len(plant_order)):
            fill(b, plant_at + WIDTH * i, at.plant + plant_order[i])
        for i in range(len(friction_order)):
            fill(b, friction_at + WIDTH * i, at.friction + friction_order[i])
        for i in range(weights):
            fill(b, weights_at + WIDTH * i, at.effects + i)
        for i in range(WIDTH * INPUTS):
            b[held_at + i] = 0.0
        b[held_at + WIDTH * START] = b[TIME]
        for held, place in HELD:
            fill(b, held_at + WIDTH * held, at.inputs + place)
        y, rate = dual_array(state_rows(b, y_at), WIDTH), dual_array(state_rows(b, rates_at), WIDTH)
        plant = dual_record(plant_rows(b, plant_at), WIDTH, plant_of(b, at.plant))
        rubbing = dual_record(friction_rows(b, friction_at), WIDTH, friction_of(b, at.friction))
        p, w = dual_array(weight_rows(b, weights_at), WIDTH), dual_array(held_rows(b, held_at), WIDTH)
        truth, mode = dual_array(truth_rows(b, truth_at), WIDTH), modes_of(b, at.mode)
        event = dual_array(truth_rows(b, truth_at), WIDTH)
        event[0] = evaluate(b[TIME], y, mode, Coefficients(plant, rubbing, w, p, w[U]), rate)
        b[slope_at + at.event] = b[truth_at + 1]
        readers = SensorState(signals_of(b, at.lagged), signals_of(b, at.lagged), signals_of(b, at.lagged))
        state = State(y, mode, w, signals_of(b, at.lagged), readers, truth, truth)
        observe(b[TIME], Constants(plant, rubbing, p, 0.0, 0.0, 0, 0.0, ()), state)
        for i in range(size):
            b[slope_at + at.rates + i] = b[rates_at + WIDTH * i + 1]
        for i in range(SIGNALS):
            b[slope_at + at.truth + i] = b[slope_at + at.measured + i] = b[truth_at + WIDTH * i + 1]
        return 0

    return Compiled(slopes)
