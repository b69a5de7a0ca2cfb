"""The simulator's compiled plant on one block of numbers."""

from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.fmu.records import example, reader, view
from ehls_ros.physics import simulator
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import (
    FD,
    FD_RATE,
    FRICTION,
    INPUTS,
    PERIOD,
    START,
    TEMPERATURE,
    VD,
    XD,
    Chains,
    Coefficients,
    U,
    X,
    first_effect,
)
from ehls_ros.physics.sensors import SensorState
from ehls_ros.physics.simulator import Constants, State

TIME, CYCLE, CONTROL_PERIOD, STEP, STEPS, FIRST = range(6)
"""Indices of the first numbers of every block: time since the start [s], periods completed, sample period [s], integration
step [s], integration steps per period; and the index after them."""

COMMAND, FORCE, FORCE_RATE, DISPLACEMENT, VELOCITY, OIL, OIL_RATE, INPUT_COUNT = range(8)
"""Places of the inputs from ``inputs_at`` on: spool command [m], force [N], its rate [N/s], displacement [m] and velocity [m/s]
of the actuator under test, oil temperature [K] and its rate [K/s]; and their number."""

TABLE_COLUMNS = 6
"""Columns of the sensors' table."""


class Compiled(NamedTuple):
    """Functions of a block.

    Attributes:
        start: sets the state at rest and reads the sensors.
        step: integrates over one period from the inputs, and reads the sensors.
        rates: writes the rates of the state, the event indicator and the readings at the present time and state.
        change: changes the modes at an event.
    """

    start: Callable[[Array], int]
    step: Callable[[Array], int]
    rates: Callable[[Array], int]
    change: Callable[[Array], int]


class Places(NamedTuple):
    """Index in the block of the first number of each part.

    Attributes:
        plant: coefficients of the plant.
        friction: parameters of the friction model.
        cylinder: parameters of the cylinder.
        valve: parameters of the valve.
        effects: parameters of the effects.
        table: table of the sensors, row by row.
        position: initial position [m].
        oil: initial states of the oil.
        inputs: the inputs.
        noise: standard normal number for the next reading of each sensor.
        measured: readings.
        truth: true values of the readings.
        state: state of the plant.
        rates: its rates.
        event: event indicator.
        mode: modes.
        held: inputs as the plant holds them.
        lagged: lagged signals.
        past: ring buffers of the sensors.
        work: workspace of the integrator.
    """

    plant: int
    friction: int
    cylinder: int
    valve: int
    effects: int
    table: int
    position: int
    oil: int
    inputs: int
    noise: int
    measured: int
    truth: int
    state: int
    rates: int
    event: int
    mode: int
    held: int
    lagged: int
    past: int
    work: int


def build(
    cylinder: Any,
    valve: Any,
    friction: Any,
    elements: int,
    states: int,
    chains: Chains,
    signals: int,
    weights: int,
    earlier: int,
    columns: int,
    **places: int,
) -> Compiled:
    """Build the plant on a block.

    Args:
        cylinder: module of the cylinder.
        valve: module of the valve.
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the effects.
        signals: number of sensed signals.
        weights: number of the effects' parameters.
        earlier: number of past commands that the effects need.
        columns: length of the sensors' ring buffers.
        places: fields of :class:`Places`, as ``plant_at`` and so on.
    """
    at = Places(**{name.removesuffix("_at"): index for name, index in places.items()})
    built = simulator.build(cylinder, valve, friction, elements, states, chains)
    size, modes = first_effect(cylinder, elements) + states, valve.MODES + cylinder.MODES
    observe = simulator.observing(cylinder, valve, elements, chains)
    misread = simulator.misreading(cylinder, elements, chains)
    cycle, sense, evaluate, switch = built.cycle, built.sense, built.evaluate, built.switch
    plant_of, friction_of = reader(example(Plant)), reader(example(friction.Parameters, elements))
    cylinder_of, valve_of = reader(example(cylinder.Parameters)), reader(example(valve.Parameters))
    weights_of, table_of, signals_of, past_of = (
        view(weights),
        view(signals, TABLE_COLUMNS),
        view(signals),
        view(signals, columns),
    )
    state_of, modes_of, held_of, work_of, row_of = (
        view(size),
        view(modes + elements),
        view(INPUTS + earlier),
        view(WORK_ROWS, size),
        view(4),
    )

    oil_states = cylinder.STATES

    @kernel_no_refcount
    def constants_of(b: Array) -> Constants:
        plant, rubbing, weighing = plant_of(b, at.plant), friction_of(b, at.friction), weights_of(b, at.effects)
        chambers, edges = cylinder_of(b, at.cylinder), valve_of(b, at.valve)
        return Constants(plant, rubbing, weighing, b[CONTROL_PERIOD], b[STEP], int(b[STEPS]), 0.0, chambers, edges, ())

    @kernel_no_refcount
    def run_of(b: Array) -> State:
        readers = SensorState(table_of(b, at.table), signals_of(b, at.lagged), past_of(b, at.past))
        y, mode, held, work = state_of(b, at.state), modes_of(b, at.mode), held_of(b, at.held), work_of(b, at.work)
        return State(y, mode, held, work, readers, signals_of(b, at.truth), signals_of(b, at.measured))

    @kernel_no_refcount
    def start(b: Array) -> int:
        state = run_of(b)
        for i in range(size):
            state.y[i] = 0.0
        for i in range(oil_states):
            state.y[FRICTION + elements + i] = b[at.oil + i]
        for i in range(modes + elements):
            state.mode[i] = 1.0 if i < modes else 0.0
        for i in range(INPUTS + earlier):
            state.inputs[i] = 0.0
        state.y[X] = b[at.position]
        state.inputs[PERIOD], state.inputs[TEMPERATURE] = b[CONTROL_PERIOD], b[at.inputs + OIL]
        b[TIME] = b[CYCLE] = 0.0
        sense(0, constants_of(b), state, signals_of(b, at.noise))
        return 0

    @kernel_no_refcount
    def step(b: Array) -> int:
        number, constants, state = int(b[CYCLE]), constants_of(b), run_of(b)
        state.inputs[TEMPERATURE] = b[at.inputs + OIL]
        dense = cycle(number, constants, state, b[at.inputs + COMMAND], row_of(b, at.inputs + FORCE))
        state.inputs[TEMPERATURE] += b[at.inputs + OIL_RATE] * b[CONTROL_PERIOD]
        b[CYCLE] = number + 1
        b[TIME] = (number + 1) * b[CONTROL_PERIOD]
        sense(number + 1, constants, state, signals_of(b, at.noise))
        return dense

    @kernel_no_refcount
    def now(b: Array, state: State) -> Coefficients:
        w = state.inputs
        w[U], w[FD], w[FD_RATE], w[START] = b[at.inputs + COMMAND], b[at.inputs + FORCE], b[at.inputs + FORCE_RATE], b[TIME]
        w[XD], w[VD], w[TEMPERATURE] = b[at.inputs + DISPLACEMENT], b[at.inputs + VELOCITY], b[at.inputs + OIL]
        return simulator.coefficients(constants_of(b), w, w[U])

    @kernel_no_refcount
    def rates(b: Array) -> int:
        state = run_of(b)
        c = now(b, state)
        b[at.event] = evaluate(b[TIME], state.y, state.mode, c, state_of(b, at.rates))
        constants = constants_of(b)
        observe(b[TIME], constants, state)
        for i in range(signals):
            state.measured[i] = state.truth[i]
        misread(b[TIME], constants, state, state.measured)
        return 0

    @kernel_no_refcount
    def change(b: Array) -> int:
        state = run_of(b)
        switch(b[TIME], state.y, state.mode, now(b, state))
        return 0

    return Compiled(start, step, rates, change)
