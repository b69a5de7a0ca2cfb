"""Many experiments at once: those of the same structure side by side, as lanes of one compiled call.

Runs have the same structure if they differ only in numbers, references, disturbances and seeds: see
:class:`Structure`. What has no place in lanes runs by itself, as in :mod:`ehls_ros.experiments.loop`: experiments with
companions, with a disturbance that feels the loader, with an effect that delays the command; and runs that nothing else
resembles. Each run has the numbers it has by itself, to the last bit.

The first batch of a structure compiles its loop, which takes longer than that of a single run and pays off from several hundred
runs of 10 s on; later ones find it in the cache.
"""

import os
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, cast

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORCE_ERROR, FORESEEN
from ehls_ros.control.controllers.base import ROW as FOLLOWED
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import ROW as DISTURBED
from ehls_ros.control.disturbances.base import Planned
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.references.base import SampledReference
from ehls_ros.experiments.loop import (
    CHUNK,
    Columns,
    Control,
    Implausible,
    control_of,
    ended,
    impossible,
    plant_of,
    run_in_process,
    sampled,
    trajectory_of,
)
from ehls_ros.experiments.loop_lanes import SIGNALS, Known, LoopRows, Sizes, Timing, build, loop_rows
from ehls_ros.experiments.spec import Spec, check_spec
from ehls_ros.physics.composition import Effects, compiled
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.lane_memory import LANES, flat, numbers_in
from ehls_ros.physics.rig import EffectiveRig
from ehls_ros.physics.simulator import Simulated
from ehls_ros.trajectory import Trajectory

Result = Trajectory | Exception
"""A run, or why there is none; :class:`~ehls_ros.experiments.loop.Implausible` holds the run as far as it went."""

FEWEST = 5
"""Fewest runs that are faster side by side than one after another."""


class Structure(NamedTuple):
    """What runs must have in common to be lanes of one block.

    Attributes:
        members: names of friction model, controller, observer, and of the friction model that the observer believes in.
        effects: the effects in the plant's equations.
        sizes: of everything in the loop.
        timing: periods and steps.
        cycles: number of control cycles.
        known: types of the numbers, as :func:`_kinds` tells them.
    """

    members: tuple[str, str, str, str]
    effects: Effects
    sizes: Sizes
    timing: Timing
    cycles: int
    known: Hashable


class _Lane(NamedTuple):
    """A run before its first cycle."""

    place: int
    spec: Spec
    plant: Simulated
    control: Control
    known: Known
    structure: Structure


def run_batch(specs: Iterable[Spec], *, check: bool = True, threads: int | None = 1) -> Iterator[tuple[int, Result]]:
    """Run experiments without ROS.

    Args:
        specs: the experiments, taken as they are needed.
        check: refuse numbers that are allowed one by one but together describe no rig.
        threads: threads that run blocks of lanes; None: one per processor.

    Yields:
        The place of each spec, and what :func:`~ehls_ros.experiments.loop.run_in_process` returns or raises for it; in the
        order in which the runs end.
    """
    waiting: dict[Hashable, list[_Lane]] = {}
    count = threads or len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(count) as pool:
        under_way = deque[Future[list[tuple[int, Result]]]]()
        for index, spec in enumerate(specs):
            try:
                lane = _lane(index, spec, check)
            except Exception as error:  # noqa: BLE001 - a failure is the result of this run, and the others continue
                yield index, error
                continue
            if lane is None:
                yield index, _alone(spec)
                continue
            alike = waiting.setdefault(lane.structure, [])
            alike.append(lane)
            if len(alike) == LANES:
                under_way.append(pool.submit(_run_block, loop_kernel(lane.structure), waiting.pop(lane.structure)))
                while len(under_way) > count:
                    yield from under_way.popleft().result()
        for alike in waiting.values():
            if len(alike) >= FEWEST:
                under_way.append(pool.submit(_run_block, loop_kernel(alike[0].structure), alike))
        for alike in waiting.values():
            if len(alike) < FEWEST:
                yield from ((lane.place, _alone(lane.spec)) for lane in alike)
        while under_way:
            yield from under_way.popleft().result()


def _alone(spec: Spec) -> Result:
    try:
        return run_in_process(spec, check=False)
    except Exception as error:  # noqa: BLE001 - as above
        return error


def _lane(index: int, spec: Spec, check: bool) -> _Lane | None:
    """Return a run before its first cycle; None if it has to run by itself."""
    if check:
        check_spec(spec, spec.settings.title)
    if spec.companions or DISTURBANCES.load(spec.disturbance.name).REACTS:
        return None
    plant, control = plant_of(spec), control_of(spec)
    effects = plant.parts.effects
    if any(hasattr(EFFECTS.load(name), "received") for name in effects.names):
        return None
    constants = plant.constants
    known = Known(
        constants.plant,
        constants.friction,
        control.friction,
        control.compensation,
        control.tuning,
        control.model,
        constants.warming,
    )
    believed = spec.controller_rig
    structure = Structure(
        (plant.rig.friction_model, spec.controller.name, spec.compensation.name, believed.friction_model),
        effects,
        Sizes(
            **plant.parts.numbers,
            inputs=plant.state.inputs.size,
            parameters=constants.effects.size,
            delays=plant.state.sensors.past.shape[1],
            forces=control.observed.forces.size,
            memory=control.memory.size,
            known=numbers_in(known),
        ),
        Timing(constants.period, constants.step, constants.steps),
        spec.cycles,
        _kinds(known),
    )
    return _Lane(index, spec, plant, control, known, structure)


def _kinds(value: Any) -> Any:
    """Return the type of a number, or those of all numbers in tuples; numba's own would take longer than a tenth of a run."""
    return (type(value), *map(_kinds, value)) if isinstance(value, tuple) else type(value)


class _Signals:
    """What comes from outside in a run."""

    def __init__(self, spec: Spec, rig: EffectiveRig) -> None:
        """Begin before the first cycle of an experiment, whose loader is a rig."""
        period = spec.settings.control_period
        kind = DISTURBANCES.load(spec.disturbance.name)
        self._reference: SampledReference = sampled(spec.reference, period)
        signal = sampled(spec.disturbance.signal, period)
        self._disturbance = cast(Planned, kind.build(spec.disturbance.parameters, signal, spec.rig, period))
        self._random = np.random.default_rng(spec.settings.seed)
        self._noisy = any(sensor.noise_std > 0.0 for sensor in rig.sensors.values())

    def write(self, first: int, given: Array, wanted: Array, disturbance: Array) -> None:
        """Write the rows of some cycles: what the loop is given, the reference, and the disturbance."""
        count = len(given)
        if self._noisy:
            given[:, :SIGNALS] = self._random.standard_normal((count, SIGNALS))
        wanted[:] = self._reference.rows(first, count)
        disturbance[:] = self._disturbance.rows(first, count)
        given[:, SIGNALS : SIGNALS + FORESEEN] = wanted
        given[:, SIGNALS + FOLLOWED :] = disturbance


def _run_block(run: Callable[..., int], lanes: list[_Lane]) -> list[tuple[int, Result]]:
    """Run up to :data:`LANES` runs of one structure by its compiled loop."""
    structure = lanes[0].structure
    sizes, timing, cycles = structure.sizes, structure.timing, structure.cycles
    rows = loop_rows(sizes)
    columns = Columns.of(rows.status - rows.estimate)
    block = np.zeros((rows.end, LANES))
    for place in range(LANES):
        # Places left over run the first one too.
        _fill(block[:, place], rows, lanes[place] if place < len(lanes) else lanes[0])
    memory = block.reshape(-1)
    record = np.empty((LANES, cycles, columns.status.stop))
    wanted, disturbance = np.empty((len(lanes), cycles, FORESEEN)), np.empty((len(lanes), cycles, DISTURBED))
    signals = [_Signals(lane.spec, lane.plant.rig) for lane in lanes]
    work, forces_work = np.empty((WORK_ROWS, rows.plant.rate - rows.plant.y)), np.empty((WORK_ROWS, sizes.forces))
    lost: dict[int, Implausible] = {}
    ends = [cycles] * len(lanes)
    # Whose reference and disturbance each place has.
    source = [place if place < len(lanes) else 0 for place in range(LANES)]
    for first in range(0, cycles, CHUNK):
        now = slice(first, min(first + CHUNK, cycles))
        given = np.zeros((LANES, now.stop - first, SIGNALS + FOLLOWED + DISTURBED))
        given[:, :, SIGNALS : SIGNALS + FOLLOWED] = np.nan
        for place, signal in enumerate(signals):
            if source[place] == place:
                signal.write(first, given[place], wanted[place, now], disturbance[place, now])
        given = given[source]
        run(first, timing, memory, lanes[0].known, given, record, work, forces_work)
        for place in set(source).difference(lost):
            spec = lanes[place].spec
            truth = block[rows.truth : rows.truth + SIGNALS, place]
            found = impossible(record[place, now], truth, spec.rig.limits)
            if found is not None:
                lost[place], ends[place] = ended(spec, first, found), first + found.row + 1
        left = next((place for place in source if place not in lost), None)
        if left is None:
            break
        # A run that ended is replaced by another one, whose numbers are possible.
        for place, of in enumerate(source):
            if of in lost:
                source[place], block[:, place] = left, block[:, left]
    record[:, :, columns.status.start + FORCE_ERROR] += 0.0
    results: list[tuple[int, Result]] = []
    for place, (lane, end) in enumerate(zip(lanes, ends, strict=True)):
        made = trajectory_of(lane.spec, columns, record[place, :end], wanted[place, :end], disturbance[place, :end])
        if place in lost:
            lost[place].trajectory = made
        results.append((lane.place, lost.get(place, made)))
    return results


def loop_kernel(structure: Structure) -> Callable[..., int]:
    """Return the compiled loop of a structure; threads must not ask for one at the same time."""
    friction, law, observer, believed = structure.members
    members = {
        "friction": FRICTION_MODELS.load(friction),
        "law": CONTROLLERS.load(law),
        "observer": OBSERVERS.load(observer),
        "believed": FRICTION_MODELS.load(believed),
    }
    entry = "first, timing, block, like, given, record, work, forces_work"
    run: Callable[..., int] = compiled(
        build, {"run": entry}, members, structure.sizes._asdict(), structure.effects, threads=True
    ).run
    return run


def _fill(numbers: Array, rows: LoopRows, lane: _Lane) -> None:
    """Write a run's numbers before the first cycle to its place."""
    state, control = lane.plant.state, lane.control
    sensors, observed = state.sensors, control.observed
    for row, values in (
        (rows.plant.y, state.y),
        (rows.plant.mode, state.mode),
        (rows.elements.y, observed.forces),
        (rows.elements.mode, observed.mode),
        (rows.inputs, state.inputs),
        (rows.effects, lane.plant.constants.effects),
        (rows.table, sensors.table),
        (rows.lagged, sensors.lagged),
        (rows.past, sensors.past),
        (rows.estimate, observed.estimate),
        (rows.last, observed.last),
        (rows.memory, control.memory),
        (rows.known, np.array(flat(lane.known))),
    ):
        numbers[row : row + values.size] = values.ravel()
