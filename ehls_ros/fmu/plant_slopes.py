"""Directional derivatives of the plant on a block: its equations compiled for duals."""

from collections.abc import Callable
from itertools import count
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.duals import dual_array, dual_record, numbers_of, width_of
from ehls_ros.fmu.plant_kernel import COMMAND, DISPLACEMENT, FORCE, FORCE_RATE, OIL, TIME, VELOCITY, Places
from ehls_ros.fmu.records import example, reader, view
from ehls_ros.physics import simulator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import (
    FD,
    FD_RATE,
    INPUTS,
    START,
    TEMPERATURE,
    VD,
    XD,
    Chains,
    Coefficients,
    U,
    first_effect,
)
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
    """Return the places of a parameter set's numbers in the order of a record of duals."""
    place = count()
    numbered = (tuple(next(place) for _ in value) if isinstance(value, tuple) else next(place) for value in like)
    return tuple(numbers_of(type(like)(*numbered)))


def scratch_size(size: int, parameters: int, weights: int, signals: int) -> int:
    """Return the numbers of scratch that ``slopes`` needs.

    Args:
        size: length of the state.
        parameters: number of coefficients of plant, friction, cylinder and valve.
        weights: number of the effects' parameters.
        signals: number of sensed signals.
    """
    return WIDTH * (2 * size + parameters + weights + INPUTS + signals)


def build(
    cylinder: Any,
    valve: Any,
    friction: Any,
    elements: int,
    states: int,
    chains: Chains,
    signals: int,
    weights: int,
    seed_at: int,
    slope_at: int,
    duals_at: int,
    **places: int,
) -> Compiled:
    """Build the derivatives.

    Args:
        cylinder: module of the cylinder.
        valve: module of the valve.
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the effects.
        signals: number of sensed signals.
        weights: number of the effects' parameters.
        seed_at: index of the seeds, one for each variable.
        slope_at: index of the derivatives, one for each variable.
        duals_at: index of the scratch.
        places: fields of :class:`~ehls_ros.fmu.plant_kernel.Places`.
    """
    at = Places(**{name.removesuffix("_at"): index for name, index in places.items()})
    built = simulator.build(cylinder, valve, friction, elements, states, chains)
    size = first_effect(cylinder, elements) + states
    evaluate, observe = built.evaluate, simulator.observing(cylinder, valve, elements, chains)
    misread = simulator.misreading(cylinder, elements, chains)
    likes = example(Plant), example(friction.Parameters, elements), example(cylinder.Parameters), example(valve.Parameters)
    rates_at = duals_at + WIDTH * size
    firsts = [rates_at + WIDTH * size]
    for like in likes:
        firsts.append(firsts[-1] + WIDTH * len(record_order(like)))
    weights_at = firsts[-1]
    held_at = weights_at + WIDTH * weights
    truth_at = held_at + WIDTH * INPUTS
    state_rows, weight_rows, held_rows = view(size, WIDTH), view(weights, WIDTH), view(INPUTS, WIDTH)
    truth_rows, modes_of, signals_of = view(signals, WIDTH), view(valve.MODES + cylinder.MODES + elements), view(signals)

    @kernel_no_refcount
    def fill(b: Array, row: int, place: int) -> None:
        """Write the dual of a variable: value, seed, and zeros."""
        b[row] = b[place]
        b[row + 1] = b[seed_at + place]
        for lane in range(2, WIDTH):
            b[row + lane] = 0.0

    def part(like: Any, place: int, first: int) -> Callable[[Array], Any]:
        """Build ``read(b)``: a parameter set of the block as a record of duals; () for an empty one."""
        order, read = record_order(like), reader(like)
        if not order:
            return kernel_no_refcount(lambda b: ())
        count, rows = len(order), view(len(order), WIDTH)

        @kernel_no_refcount
        def as_duals(b: Array) -> Any:
            for i in range(count):
                fill(b, first + WIDTH * i, place + order[i])
            return dual_record(rows(b, first), WIDTH, read(b, place))

        return as_duals

    plant_of, friction_of, cylinder_of, valve_of = map(part, likes, (at.plant, at.friction, at.cylinder, at.valve), firsts[:-1])

    @kernel_no_refcount
    def slopes(b: Array) -> int:
        for i in range(size):
            fill(b, duals_at + WIDTH * i, at.state + i)
        for i in range(weights):
            fill(b, weights_at + WIDTH * i, at.effects + i)
        for i in range(WIDTH * INPUTS):
            b[held_at + i] = 0.0
        b[held_at + WIDTH * START] = b[TIME]
        for held, place in HELD:
            fill(b, held_at + WIDTH * held, at.inputs + place)
        y, rate = dual_array(state_rows(b, duals_at), WIDTH), dual_array(state_rows(b, rates_at), WIDTH)
        plant, rubbing, chambers, edges = plant_of(b), friction_of(b), cylinder_of(b), valve_of(b)
        p, w = dual_array(weight_rows(b, weights_at), WIDTH), dual_array(held_rows(b, held_at), WIDTH)
        truth, mode = dual_array(truth_rows(b, truth_at), WIDTH), modes_of(b, at.mode)
        event = dual_array(truth_rows(b, truth_at), WIDTH)
        event[0] = evaluate(b[TIME], y, mode, Coefficients(plant, rubbing, w, p, w[U], chambers, edges), rate)
        b[slope_at + at.event] = b[truth_at + 1]
        readers = SensorState(signals_of(b, at.lagged), signals_of(b, at.lagged), signals_of(b, at.lagged))
        state = State(y, mode, w, signals_of(b, at.lagged), readers, truth, truth)
        constants = Constants(plant, rubbing, p, 0.0, 0.0, 0, 0.0, chambers, edges, ())
        observe(b[TIME], constants, state)
        for i in range(size):
            b[slope_at + at.rates + i] = b[rates_at + WIDTH * i + 1]
        for i in range(signals):
            b[slope_at + at.truth + i] = b[truth_at + WIDTH * i + 1]
        misread(b[TIME], constants, state, truth)
        for i in range(signals):
            b[slope_at + at.measured + i] = b[truth_at + WIDTH * i + 1]
        return 0

    return Compiled(slopes)
