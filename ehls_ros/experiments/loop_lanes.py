"""Closed loop of :mod:`ehls_ros.experiments.loop` for lanes: many runs of one structure in one compiled call.

The parts and their order are the same. Each part processes all lanes before the next, so that the compiler can vectorise it.
Parts that cannot be vectorised, such as a law that calls the C library, are executed lane by lane. The lanes are independent.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from numba import njit

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.control.controllers.base import ROW as FOLLOWED
from ehls_ros.control.controllers.base import STATUS_SIZE, Model
from ehls_ros.control.disturbances.base import DISPLACEMENT, FORCE, FORCE_RATE, VELOCITY
from ehls_ros.control.disturbances.base import ROW as DISTURBED
from ehls_ros.control.local_plant import step_on
from ehls_ros.control.observers.base import ELEMENTS, ObserverState
from ehls_ros.control.observers.rig_model import Motion
from ehls_ros.physics import sensors, simulator
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.lane_memory import LANES, Rows, column, numbers, stack
from ehls_ros.physics.lanes import LaneRows, lanes_integrator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import FRICTION, TEMPERATURE, Chains, Coefficients, U, hold
from ehls_ros.physics.sensors import SensorState
from ehls_ros.physics.simulator import Constants, State

SENSOR_COLUMNS = 6


class Known(NamedTuple):
    """Values of a lane that are constant during a run.

    Attributes:
        plant: the effective rig's coefficients.
        friction: its friction parameters.
        cylinder, valve: those of its cylinder and valve; () if they have none.
        believed: friction parameters of the observer.
        compensation: the observer's parameters.
        tuning: the controller's parameters.
        model: the controller's model of the rig.
        warming: rate of the oil temperature [K/s].
    """

    plant: Plant
    friction: Any
    cylinder: Any
    valve: Any
    believed: Any
    compensation: Any
    tuning: Any
    model: Model
    warming: float


class Timing(NamedTuple):
    """Timing common to all lanes.

    Attributes:
        period: control period [s].
        step: integration step [s].
        steps: integration steps per period.
    """

    period: float
    step: float
    steps: int


class LoopRows(NamedTuple):
    """First rows of the loop's variables in a block.

    Attributes:
        plant: the plant's integrator.
        elements: the observer's integrator.
        inputs: the plant's inputs.
        effects: parameters of its effects.
        table, lagged, past: the sensors' state.
        truth: true values of the sensed signals.
        measured: their readings. Command, estimate and status follow; together they form a row of the record.
        command: spool command [m].
        estimate: the observer's estimate.
        status: the controller's status.
        last: the observer's last velocity.
        motion: velocity and acceleration of the observer's motion, and its number of integration steps.
        memory: the controller's memory.
        given: noise, reference and disturbance of a cycle.
        middle, farthest: middle and half width of the plausible range of each reading and of the command.
        impossible: 1 after a cycle with a value out of these ranges.
        known: :class:`Known`.
        end: number of all rows.
    """

    plant: LaneRows
    elements: LaneRows
    inputs: int
    effects: int
    table: int
    lagged: int
    past: int
    truth: int
    measured: int
    command: int
    estimate: int
    status: int
    last: int
    motion: int
    memory: int
    given: int
    middle: int
    farthest: int
    impossible: int
    known: int
    end: int


class Sizes(NamedTuple):
    """Sizes of a loop, fixed at compile time.

    Attributes:
        elements: number of the plant's friction forces.
        states: number of its effects' states.
        oil: number of its cylinder's states.
        oil_modes: number of the modes of its cylinder and valve.
        signals: number of its sensed signals.
        inputs: number of its inputs.
        parameters: number of its effects' parameters.
        delays: columns of the sensors' past.
        forces: number of the observer's forces.
        memory: size of the controller's memory.
        known: number of values in :class:`Known`.
    """

    elements: int
    states: int
    oil: int
    oil_modes: int
    signals: int
    inputs: int
    parameters: int
    delays: int
    forces: int
    memory: int
    known: int

    @property
    def plant(self) -> int:
        """Number of the plant's states."""
        return FRICTION + self.elements + self.oil + self.states

    @property
    def modes(self) -> int:
        """Number of the plant's modes."""
        return self.oil_modes + self.elements


def loop_rows(sizes: Sizes) -> LoopRows:
    """Return the rows of a block of lanes."""
    rows = Rows()
    return LoopRows(
        plant=LaneRows.of(rows, sizes.plant, sizes.modes),
        elements=LaneRows.of(rows, sizes.forces, sizes.forces),
        inputs=rows.take(sizes.inputs),
        effects=rows.take(sizes.parameters),
        table=rows.take(sizes.signals * SENSOR_COLUMNS),
        lagged=rows.take(sizes.signals),
        past=rows.take(sizes.signals * sizes.delays),
        truth=rows.take(sizes.signals),
        measured=rows.take(sizes.signals),
        command=rows.take(),
        estimate=rows.take(ELEMENTS + 2 * sizes.forces),
        status=rows.take(STATUS_SIZE),
        last=rows.take(2),
        motion=rows.take(3),
        memory=rows.take(sizes.memory),
        given=rows.take(sizes.signals + FOLLOWED + DISTURBED),
        middle=rows.take(sizes.signals + 1),
        farthest=rows.take(sizes.signals + 1),
        impossible=rows.take(),
        known=rows.take(sizes.known),
        end=rows.count,
    )


class _Loop(NamedTuple):
    """The compiled loop."""

    run: Callable[..., int]


def build(
    cylinder: Any,
    valve: Any,
    friction: Any,
    law: Any,
    known_cylinder: Any,
    known_valve: Any,
    observer: Any,
    believed: Any,
    chains: Chains,
    **numbers_of: int,
) -> _Loop:
    """Build the loop of a block of lanes.

    Args:
        cylinder: module of the plant's cylinder.
        valve: module of its valve.
        friction: module of the plant's friction model.
        law: module of the controller.
        known_cylinder: module of the cylinder that the law is to know.
        known_valve: module of the valve that it is to know.
        observer: module of the friction observer.
        believed: module of the observer's friction model.
        chains: hooks of the plant's effects; none may delay the command.
        **numbers_of: :class:`Sizes`.
    """
    sizes = Sizes(**numbers_of)
    rows = loop_rows(sizes)
    size, modes, SIGNALS = sizes.plant, sizes.modes, sizes.signals
    plant = simulator.build(cylinder, valve, friction, sizes.elements, sizes.states, chains)
    sense, step = plant.sense, step_on(law, known_cylinder, known_valve)
    observe = _observation(observer, believed, rows, sizes)

    states, inputs_of, effects_of = column(size), column(sizes.inputs), column(sizes.parameters)
    table_of, past_of, signals = column(SIGNALS, SENSOR_COLUMNS), column(SIGNALS, sizes.delays), column(SIGNALS)
    estimate_of, memory_of, status_of = column(ELEMENTS + 2 * sizes.forces), column(sizes.memory), column(STATUS_SIZE)
    followed_of, disturbed_of, no_work = column(FOLLOWED), column(DISTURBED), stack(1, 1)
    GIVEN, KNOWN, INPUTS, EFFECTS = rows.given, rows.known, rows.inputs, rows.effects
    REFERENCE, DISTURBANCE, RECORD = GIVEN + SIGNALS, GIVEN + SIGNALS + FOLLOWED, rows.measured
    MIDDLE, FARTHEST, IMPOSSIBLE = rows.middle, rows.farthest, rows.impossible
    given_size, record_size = SIGNALS + FOLLOWED + DISTURBED, rows.last - rows.measured

    @kernel_no_refcount
    def coefficients(block: Array, like: Known, lane: int) -> Coefficients:
        known = numbers(like, block, KNOWN, lane)
        w = inputs_of(block, INPUTS, lane)
        effects = effects_of(block, EFFECTS, lane)
        return Coefficients(known.plant, known.friction, w, effects, w[U], known.cylinder, known.valve)

    integrate = lanes_integrator(plant.evaluate, plant.switch, coefficients, rows.plant, size, modes, order=simulator.ORDER)

    @kernel_no_refcount
    def read_sensors(k: int, block: Array, like: Known, timing: Timing) -> None:
        for lane in range(LANES):
            c, y = coefficients(block, like, lane), states(block, rows.plant.y, lane)
            constants = Constants(
                c.plant, c.friction, c.effects, timing.period, timing.step, timing.steps, 0.0, c.cylinder, c.valve, ()
            )
            lagged, past = signals(block, rows.lagged, lane), past_of(block, rows.past, lane)
            kept = SensorState(table_of(block, rows.table, lane), lagged, past)
            truth, measured = signals(block, rows.truth, lane), signals(block, rows.measured, lane)
            sense(k, constants, State(y, y, c.inputs, no_work(), kept, truth, measured), signals(block, GIVEN, lane))

    @kernel_no_refcount
    def command_valves(k: int, block: Array, like: Known, timing: Timing) -> None:
        for lane in range(LANES):
            known = numbers(like, block, KNOWN, lane)
            measured, followed = signals(block, rows.measured, lane), followed_of(block, REFERENCE, lane)
            estimate, memory = estimate_of(block, rows.estimate, lane), memory_of(block, rows.memory, lane)
            status = status_of(block, rows.status, lane)
            u = step(measured, followed, estimate, known.tuning, known.model, memory, status)
            block[rows.command * LANES + lane] = u
            d = disturbed_of(block, DISTURBANCE, lane)
            start = k * timing.period
            hold(inputs_of(block, INPUTS, lane), start, u, d[FORCE], d[FORCE_RATE], d[DISPLACEMENT], d[VELOCITY])

    @kernel_no_refcount
    def check(block: Array) -> None:
        for place in range(SIGNALS + 1):
            for lane in range(LANES):
                away = abs(block[(RECORD + place) * LANES + lane] - block[(MIDDLE + place) * LANES + lane])
                possible = away <= block[(FARTHEST + place) * LANES + lane]
                block[IMPOSSIBLE * LANES + lane] = block[IMPOSSIBLE * LANES + lane] if possible else 1.0

    @kernel_no_refcount
    def warm(block: Array, like: Known, timing: Timing) -> None:
        for lane in range(LANES):
            warming = numbers(like, block, KNOWN, lane).warming
            block[(INPUTS + TEMPERATURE) * LANES + lane] += warming * timing.period

    @kernel_no_refcount
    def run(
        first: int, timing: Timing, block: Array, like: Known, given: Array, record: Array, work: Array, forces_work: Array
    ) -> int:
        """Run some cycles.

        Args:
            first: number of the first cycle.
            timing: timing of all lanes.
            block: the lanes' memory, updated in place.
            like: constants of any lane; only their type matters.
            given: noise, reference and disturbance by lane and cycle, shape (LANES, n, numbers).
            record: rows by lane and cycle, as in the loop for one run, shape (LANES, n or more, columns).
            work: workspace of the plant's integrator.
            forces_work: workspace of the observer's integrator.

        Returns:
            Number of integration steps with more events than could be located.
        """
        dense = 0
        for i in range(given.shape[1]):
            k = first + i
            for lane in range(LANES):
                for place in range(given_size):
                    block[(GIVEN + place) * LANES + lane] = given[lane, i, place]
            read_sensors(k, block, like, timing)
            observe(block, like, timing, forces_work)
            command_valves(k, block, like, timing)
            check(block)
            for lane in range(LANES):
                for place in range(record_size):
                    record[lane, i, place] = block[(RECORD + place) * LANES + lane]
            dense += integrate(k * timing.period, block, like, timing.step, timing.steps, work)
            warm(block, like, timing)
        return dense

    return _Loop(run)


def _observation(observer: Any, believed: Any, rows: LoopRows, sizes: Sizes) -> Callable[..., None]:
    """Build the observers' update in all lanes: ``observe(block, like, timing, work)``."""
    size = sizes.forces
    forces_of, last_of, estimate_of, no_work = column(size), column(2), column(ELEMENTS + 2 * size), stack(1, 1)
    SPEED = rows.measured + sensors.VELOCITY

    @kernel_no_refcount
    def observed(block: Array, lane: int, work: Array) -> ObserverState:
        forces, mode = forces_of(block, rows.elements.y, lane), forces_of(block, rows.elements.mode, lane)
        return ObserverState(forces, mode, last_of(block, rows.last, lane), work, estimate_of(block, rows.estimate, lane))

    if not hasattr(observer, "driven"):
        update = observer.updater(believed)

        @kernel_no_refcount
        def observe(block: Array, like: Known, timing: Timing, work: Array) -> None:
            for lane in range(LANES):
                known, state = numbers(like, block, rows.known, lane), observed(block, lane, no_work())
                velocity = block[SPEED * LANES + lane]
                update(velocity, timing.period, known.believed, known.compensation, state)

        return observe

    before, after = observer.around(believed)
    evaluate, switch = observer.driven(believed)
    STARTED, RATE, STEPS = rows.motion, rows.motion + 1, rows.motion + 2

    @kernel_no_refcount
    def motion(block: Array, like: Known, lane: int) -> Motion:
        known = numbers(like, block, rows.known, lane)
        return Motion(known.believed, block[STARTED * LANES + lane], block[RATE * LANES + lane])

    together = lanes_integrator(evaluate, switch, motion, rows.elements, size, size)
    alone = integrator(evaluate, switch, size)

    @njit(error_model="numpy", forceinline=False)
    def run_alone(block: Array, like: Known, timing: Timing, lane: int, work: Array) -> None:
        state, steps = observed(block, lane, work), int(block[STEPS * LANES + lane])
        if steps > 0:
            alone(0.0, state.forces, state.mode, motion(block, like, lane), timing.period / steps, steps, work)

    @kernel_no_refcount
    def observe_together(block: Array, like: Known, timing: Timing, work: Array) -> None:
        for lane in range(LANES):
            known, state = numbers(like, block, rows.known, lane), observed(block, lane, no_work())
            velocity = block[SPEED * LANES + lane]
            driving, steps = before(velocity, timing.period, known.believed, known.compensation, state)
            block[STARTED * LANES + lane], block[RATE * LANES + lane] = driving.velocity, driving.acceleration
            block[STEPS * LANES + lane] = steps
        steps, equal = int(block[STEPS * LANES]), True
        for lane in range(LANES):
            equal &= block[STEPS * LANES + lane] == steps
        if equal and steps > 0:
            together(0.0, block, like, timing.period / steps, steps, work)
        else:
            for lane in range(LANES):
                run_alone(block, like, timing, lane, work)
        for lane in range(LANES):
            known, state = numbers(like, block, rows.known, lane), observed(block, lane, no_work())
            after(known.believed, state)

    return observe_together
