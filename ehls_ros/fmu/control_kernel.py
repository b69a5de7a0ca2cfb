"""Controllers and friction observers on one block of numbers."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.control.controllers.base import FORESEEN, ROW, STATUS_SIZE, STATUS_TO_SI, Model, Noise
from ehls_ros.control.local_plant import step_on
from ehls_ros.control.observers.base import ELEMENTS, ObserverState
from ehls_ros.fmu.records import example, reader, view
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.sensors import VELOCITY

TIME, CYCLE, PERIOD, FIRST = range(4)
"""Indices of the first numbers of every block: time since the start [s], periods completed, sample period [s]; and the index
after them."""


class Compiled(NamedTuple):
    """Functions of a block.

    Attributes:
        start: begins at the first period; all memory has its initial values.
        step: answers the inputs of one period.
    """

    start: Callable[[Array], int]
    step: Callable[[Array], int]


class ObserverPlaces(NamedTuple):
    """Index in the block of the first number of each part of an observer.

    Attributes:
        friction: parameters of the friction model.
        compensation: parameters of the observer.
        estimate: the estimate.
        forces: forces of the elements.
        mode: modes of the elements.
        last: last velocity, and whether there was one.
        work: workspace of the integrator.
    """

    friction: int
    compensation: int
    estimate: int
    forces: int
    mode: int
    last: int
    work: int


class LawPlaces(NamedTuple):
    """Index in the block of the first number of each part of a control law.

    Attributes:
        tuning: parameters of the law.
        plant: coefficients of the modelled rig.
        cylinder: parameters of its cylinder.
        valve: parameters of its valve.
        limit: largest command [m], then those fields of the model that follow it.
        measured: readings.
        reference: reference and its derivatives.
        command: the command [m].
        status: status of the law in SI units.
        memory: its state.
        own: status in the law's units.
        row: the law's row.
    """

    tuning: int
    plant: int
    cylinder: int
    valve: int
    limit: int
    measured: int
    reference: int
    command: int
    status: int
    memory: int
    own: int
    row: int


def _places(kind: Any, given: dict[str, int]) -> Any:
    return kind(**{name: given[f"{name}_at"] for name in kind._fields})


@kernel_no_refcount
def _start(b: Array) -> int:
    b[TIME] = b[CYCLE] = 0.0
    return 0


def _observing(observer: Any, believed: Any, entries: int, observed: int, at: ObserverPlaces) -> Callable[[Array, float], None]:
    """Build ``observe(b, velocity)``, which updates the estimate in a block."""
    update = observer.updater(believed)
    friction_of, compensation_of = reader(example(believed.Parameters, entries)), reader(example(observer.Parameters))
    elements_of, last_of, work_of, estimate_of = (
        view(observed),
        view(2),
        view(WORK_ROWS, observed),
        view(ELEMENTS + 2 * observed),
    )

    @kernel_no_refcount
    def observe(b: Array, velocity: float) -> None:
        forces, mode, last = elements_of(b, at.forces), elements_of(b, at.mode), last_of(b, at.last)
        state = ObserverState(forces, mode, last, work_of(b, at.work), estimate_of(b, at.estimate))
        update(velocity, b[PERIOD], friction_of(b, at.friction), compensation_of(b, at.compensation), state)

    return observe


def build_observer(observer: Any, believed: Any, entries: int, observed: int, velocity_at: int, **places: int) -> Compiled:
    """Build a friction observer on a block.

    Args:
        observer: module of the observer.
        believed: module of the friction model.
        entries: length of the lists among the friction model's parameters.
        observed: number of the observer's elements.
        velocity_at: index of the measured velocity.
        places: fields of :class:`ObserverPlaces`, as ``friction_at`` and so on.
    """
    observe = _observing(observer, believed, entries, observed, _places(ObserverPlaces, places))

    @kernel_no_refcount
    def step(b: Array) -> int:
        observe(b, b[velocity_at])
        b[CYCLE] += 1.0
        b[TIME] = b[CYCLE] * b[PERIOD]
        return 0

    return Compiled(_start, step)


def build_law(
    law: Any,
    cylinder: Any,
    valve: Any,
    observer: Any,
    believed: Any,
    entries: int,
    observed: int,
    memory: int,
    signals: int,
    **places: int,
) -> Compiled:
    """Build a control law with its observer on a block.

    Args:
        law: module of the law.
        cylinder: module of the modelled rig's cylinder.
        valve: module of its valve.
        observer: module of the observer.
        believed: module of the friction model.
        entries: length of the lists among the friction model's parameters.
        observed: number of the observer's elements.
        memory: length of the law's memory.
        signals: number of readings.
        places: fields of :class:`ObserverPlaces` and :class:`LawPlaces`, as ``friction_at`` and so on.
    """
    seen, at = _places(ObserverPlaces, places), _places(LawPlaces, places)
    observe, answer = _observing(observer, believed, entries, observed, seen), step_on(law, cylinder, valve)
    friction_of, tuning_of = reader(example(believed.Parameters, entries)), reader(example(law.Parameters))
    plant_of, noise_of = reader(example(Plant)), reader(Noise())
    cylinder_of, valve_of = reader(example(cylinder.Parameters)), reader(example(valve.Parameters))
    signals_of, row_of, status_of, memory_of = view(signals), view(ROW), view(STATUS_SIZE), view(memory)
    estimate_of = view(ELEMENTS + 2 * observed)
    after = at.limit + 1 + len(Noise._fields)

    @kernel_no_refcount
    def step(b: Array) -> int:
        measured, row, status = signals_of(b, at.measured), row_of(b, at.row), status_of(b, at.own)
        for i in range(FORESEEN):
            row[i] = b[at.reference + i]
        for i in range(FORESEEN, ROW):
            row[i] = np.nan
        observe(b, measured[VELOCITY])
        model = Model(
            plant_of(b, at.plant),
            friction_of(b, seen.friction),
            b[PERIOD],
            b[at.limit],
            noise_of(b, at.limit + 1),
            b[after],
            b[after + 1],
            b[after + 2],
            cylinder_of(b, at.cylinder),
            valve_of(b, at.valve),
            1.0,
            1.0,
            1.0,
        )
        estimate, tuning = estimate_of(b, seen.estimate), tuning_of(b, at.tuning)
        b[at.command] = answer(measured, row, estimate, tuning, model, memory_of(b, at.memory), status)
        for i in range(STATUS_SIZE):
            b[at.status + i] = status[i] * STATUS_TO_SI[i]
        b[CYCLE] += 1.0
        b[TIME] = b[CYCLE] * b[PERIOD]
        return 0

    return Compiled(_start, step)
