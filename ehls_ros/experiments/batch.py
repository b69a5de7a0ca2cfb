"""Batch runs of experiments: those of the same structure run side by side, as lanes of one compiled call.

Runs have the same structure if they differ only in numbers, references, disturbances and seeds: see :class:`Structure`. Other
experiments run separately, as in :mod:`ehls_ros.experiments.loop`: those with companions, with a disturbance that reacts to the
loader, with an effect that delays the command, or with a rare structure. The results are bit-identical to those of separate
runs.

The first batch of a structure compiles its loop, which takes longer than that of a single run and pays off from several hundred
runs of 10 s on; later ones find it in the cache.
"""

import os
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORCE_ERROR, FORESEEN
from ehls_ros.control.controllers.base import ROW as FOLLOWED
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import ROW as DISTURBED
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.references import REFERENCES
from ehls_ros.control.references.base import SampledReference
from ehls_ros.experiments.loop import (
    CHUNK,
    Columns,
    Control,
    control_of,
    ended,
    impossible,
    plant_of,
    run_in_process,
    trajectory_of,
)
from ehls_ros.experiments.loop_lanes import Known, LoopRows, Sizes, Timing, build, loop_rows
from ehls_ros.experiments.run_failure import Implausible
from ehls_ros.experiments.spec import Spec, Use, check_spec
from ehls_ros.physics.composition import Effects, compiled, is_compiled
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.integration import WORK_ROWS
from ehls_ros.physics.lane_memory import LANES, flat, numbers_in
from ehls_ros.physics.plausibility import possible_range
from ehls_ros.physics.sensors import FORCE
from ehls_ros.physics.simulator import Simulated
from ehls_ros.physics.valve import VALVES
from ehls_ros.recording.topics import REFERENCE_TOPICS
from ehls_ros.trajectory import Trajectory

Result = Trajectory | Exception
"""A run or its error; :class:`~ehls_ros.experiments.run_failure.Implausible` holds the run up to the failure."""

MIN_TOGETHER = 5
"""Minimum number of runs that are faster side by side than one after another."""

STRETCH = 400
"""Number of cycles after which a block's records are copied out, a divisor of :data:`~ehls_ros.experiments.loop.CHUNK`; they
fit into a processor's cache."""


class Structure(NamedTuple):
    """Common properties of the runs in the lanes of one block.

    Attributes:
        members: names of cylinder, valve, friction model, controller, its cylinder and valve, observer, and its friction model.
        effects: the effects in the plant's equations.
        sizes: sizes of all parts of the loop.
        timing: periods and steps.
        cycles: number of control cycles.
        known: types of the numbers, as returned by :func:`_kinds`.
    """

    members: tuple[str, ...]
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


def run_batch(
    specs: Iterable[Spec], *, check: bool = True, threads: int | None = 1, brief: bool = False
) -> Iterator[tuple[int, Result]]:
    """Run experiments without ROS.

    Args:
        specs: the experiments, consumed on demand.
        check: whether to reject values that are valid individually but inconsistent together.
        threads: number of threads that run blocks of lanes; None: one per processor.
        brief: whether to keep only force, reference and command of runs in lanes. Keeping the rest, with metadata, takes a
            third of a run's time and most of its memory.

    Yields:
        The index of each spec, and the result or exception of :func:`~ehls_ros.experiments.loop.run_in_process` for it, in the
        order in which the runs end.
    """
    waiting: dict[Hashable, list[_Lane]] = {}
    count = threads or len(os.sched_getaffinity(0))
    ahead = count if count > 1 else 0
    with ThreadPoolExecutor(count) if count > 1 else _Immediate() as pool:
        running = deque[Future[list[tuple[int, Result]]]]()
        for index, spec in enumerate(specs):
            try:
                lane = _lane(index, spec, check)
            except Exception as error:  # noqa: BLE001 - a failure is the result of this run, and the others continue
                yield index, error
                continue
            if lane is None:
                yield index, _run_separately(spec)
                continue
            group = waiting.setdefault(lane.structure, [])
            group.append(lane)
            if len(group) == LANES:
                running.append(pool.submit(_run_block, loop_kernel(lane.structure), waiting.pop(lane.structure), brief))
                while len(running) > ahead:
                    yield from running.popleft().result()
        for group in waiting.values():
            if len(group) >= MIN_TOGETHER:
                running.append(pool.submit(_run_block, loop_kernel(group[0].structure), group, brief))
        for group in waiting.values():
            if len(group) < MIN_TOGETHER:
                yield from ((lane.place, _run_separately(lane.spec)) for lane in group)
        while running:
            yield from running.popleft().result()


class _Immediate(Executor):
    """Executor that does the work immediately."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **keywords: Any) -> Future[Any]:
        """Do the work."""
        done = Future[Any]()
        done.set_result(work(*arguments, **keywords))
        return done


def _run_separately(spec: Spec) -> Result:
    try:
        return run_in_process(spec, check=False)
    except Exception as error:  # noqa: BLE001 - as above
        return error


def _lane(index: int, spec: Spec, check: bool) -> _Lane | None:
    """Return a run before its first cycle; None if it has to run separately."""
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
        constants.cylinder,
        constants.valve,
        control.friction,
        control.compensation,
        control.tuning,
        control.model,
        constants.warming,
    )
    believed = spec.controller_rig
    structure = Structure(
        (
            plant.rig.cylinder.model,
            plant.rig.valve.model,
            plant.rig.friction_model,
            spec.controller.name,
            believed.cylinder.model,
            believed.valve.model,
            spec.compensation.name,
            believed.friction_model,
        ),
        effects,
        Sizes(
            **plant.parts.numbers,
            oil=plant.rig.cylinder.law.STATES,
            oil_modes=plant.rig.cylinder.law.MODES + plant.rig.valve.law.MODES,
            signals=plant.state.truth.size,
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
    """Return the type of a number, or of all numbers in tuples; numba's typing would take over a tenth of a run."""
    return (type(value), *map(_kinds, value)) if isinstance(value, tuple) else type(value)


class _Sampled(SampledReference):
    """Reference shared by several runs, sampled once."""

    def __init__(self, use: Use, period: float, cycles: int) -> None:
        """Sample all cycles of the runs."""
        super().__init__(REFERENCES.load(use.name), use.parameters, period)
        self.all = super().rows(0, cycles)

    def rows(self, first: int, cycles: int) -> Array:
        """Return consecutive cycles, shape (cycles, 3)."""
        return self.all[first : first + cycles].copy() if first + cycles <= len(self.all) else super().rows(first, cycles)


class _Inputs:
    """External inputs of the runs of a block.

    Attributes:
        wanted: reference and its first and second derivative by run, shape (cycles, 3).
        disturbance: disturbance by run, shape (cycles, 4).
    """

    def __init__(self, lanes: list[_Lane], cycles: int) -> None:
        """Begin before the first cycle."""
        made: dict[str, _Sampled] = {}

        def sampled_once(use: Use, period: float) -> _Sampled:
            # As text, which distinguishes equal numbers of different sign or type.
            key = f"{use} {period!r}"
            if key not in made:
                made[key] = _Sampled(use, period, cycles)
            return made[key]

        self.wanted: list[Array] = []
        self.disturbance: list[Array] = []
        for spec in (lane.spec for lane in lanes):
            period, disturbance = spec.settings.control_period, spec.disturbance
            self.wanted.append(sampled_once(spec.reference, period).rows(0, cycles))
            signal = sampled_once(disturbance.signal, period)
            source = DISTURBANCES.load(disturbance.name).build(disturbance.parameters, signal, spec.rig, period)
            self.disturbance.append(source.rows(0, cycles))
        noisy = (any(sensor.noise_std > 0.0 for sensor in lane.plant.rig.sensors.values()) for lane in lanes)
        seeds = (lane.spec.settings.seed for lane in lanes)
        self._random = [np.random.default_rng(seed) if noise else None for seed, noise in zip(seeds, noisy, strict=True)]
        self._signals = signals = lanes[0].structure.sizes.signals
        self._given = np.zeros((LANES, min(cycles, STRETCH), signals + FOLLOWED + DISTURBED))
        self._given[:, :, signals : signals + FOLLOWED] = np.nan

    def given(self, now: slice, source: list[int]) -> Array:
        """Return the inputs of the loop in some cycles: noise, reference, disturbance; shape (LANES, n, numbers).

        Args:
            now: the cycles, which follow those of the previous call.
            source: the run whose numbers each lane uses.
        """
        given, signals = self._given[:, : now.stop - now.start], self._signals
        for run in set(source):
            if (random := self._random[run]) is not None:
                given[run, :, :signals] = random.standard_normal((given.shape[1], signals))
            given[run, :, signals : signals + FORESEEN] = self.wanted[run][now]
            given[run, :, signals + FOLLOWED :] = self.disturbance[run][now]
        for lane, run in enumerate(source):
            if lane != run:
                given[lane] = given[run]
        return given


def _run_block(run: Callable[..., int], lanes: list[_Lane], brief: bool) -> list[tuple[int, Result]]:
    """Run up to :data:`LANES` runs of one structure by its compiled loop."""
    structure = lanes[0].structure
    sizes, timing, cycles = structure.sizes, structure.timing, structure.cycles
    rows = loop_rows(sizes)
    columns = Columns.of(rows.status - rows.estimate, sizes.signals)
    force_and_command = (FORCE, columns.command)
    block = np.zeros((rows.end, LANES))
    for place in range(LANES):
        # Spare places repeat the first run.
        _fill(block[:, place], rows, lanes[place] if place < len(lanes) else lanes[0])
    memory = block.reshape(-1)
    inputs = _Inputs(lanes, cycles)
    record = np.empty((LANES, min(cycles, STRETCH), columns.status.stop))
    kept = np.empty((len(lanes), cycles, len(force_and_command) if brief else columns.status.stop))
    work, forces_work = np.empty((WORK_ROWS, rows.plant.rate - rows.plant.y)), np.empty((WORK_ROWS, sizes.forces))
    lost: dict[int, Implausible] = {}
    ends = [cycles] * len(lanes)
    # The run whose reference and disturbance each place uses.
    source = [place if place < len(lanes) else 0 for place in range(LANES)]
    for first in range(0, cycles, STRETCH):
        now = slice(first, min(first + STRETCH, cycles))
        run(first, timing, memory, lanes[0].known, inputs.given(now, source), record, work, forces_work)
        latest = record[:, : now.stop - first]
        kept[:, now] = latest[: len(lanes), :, force_and_command] if brief else latest[: len(lanes)]
        # As in a separate run, the true states are checked at intervals.
        suspect = _suspects(block, rows, hidden=now.stop % CHUNK == 0 or now.stop == cycles)
        if not suspect.any():
            continue
        for place in {place for place in source if suspect[place]}:
            spec = lanes[place].spec
            found = impossible(latest[place], block[rows.truth : rows.truth + sizes.signals, place], spec.rig.limits)
            if found is not None:
                lost[place], ends[place] = ended(spec, first, found), first + found.row + 1
        left = next((place for place in source if place not in lost), None)
        if left is None:
            break
        # A run that ended is replaced by another one with plausible numbers.
        for place, of in enumerate(source):
            if of in lost:
                source[place], block[:, place] = left, block[:, left]
    if not brief:
        kept[:, :, columns.status.start + FORCE_ERROR] += 0.0
    results: list[tuple[int, Result]] = []
    for place, (lane, end) in enumerate(zip(lanes, ends, strict=True)):
        numbers = kept[place, :end], inputs.wanted[place][:end], inputs.disturbance[place][:end]
        made = _brief_of(lane.spec, *numbers) if brief else trajectory_of(lane.spec, columns, *numbers)
        if place in lost:
            lost[place].trajectory = made
        results.append((lane.place, lost.get(place, made)))
    return results


def _suspects(block: Array, rows: LoopRows, *, hidden: bool) -> NDArray[np.bool_]:
    """Return which lanes have implausible readings or, with ``hidden``, implausible true values at the last cycle."""
    suspect: NDArray[np.bool_] = block[rows.impossible] > 0.0
    if hidden:
        # Truth and measured follow each other in a block.
        signals = rows.measured - rows.truth
        away = np.abs(block[rows.truth : rows.truth + signals] - block[rows.middle : rows.middle + signals])
        suspect |= ~(away <= block[rows.farthest : rows.farthest + signals]).all(axis=0)
    return suspect


def _brief_of(spec: Spec, kept: Array, wanted: Array, _disturbance: Array) -> Trajectory:
    """Return the signals kept of a brief run."""
    names = REFERENCE_TOPICS[CONTROLLERS.load(spec.controller.name).FOLLOWS].signals.values()
    signals = {"force_n": kept[:, 0], "valve_command_m": kept[:, 1], next(iter(names)): wanted[:, 0]}
    return Trajectory(np.arange(len(kept), dtype=np.float64) * spec.settings.control_period, signals)


def is_ready(spec: Spec) -> bool:
    """Return whether the loop of such runs is compiled; False for a run that has to run separately."""
    lane = _lane(0, spec, check=False)
    return lane is not None and is_compiled(_loop(lane.structure))


def loop_kernel(structure: Structure) -> Callable[..., int]:
    """Return the compiled loop of a structure; not thread-safe."""
    run: Callable[..., int] = _loop(structure).run
    return run


def _loop(structure: Structure) -> ModuleType:
    """Return the module of a structure's loop."""
    cylinder, valve, friction, law, known_cylinder, known_valve, observer, believed = structure.members
    members = {
        "cylinder": CYLINDERS.load(cylinder),
        "valve": VALVES.load(valve),
        "friction": FRICTION_MODELS.load(friction),
        "law": CONTROLLERS.load(law),
        "known_cylinder": CYLINDERS.load(known_cylinder),
        "known_valve": VALVES.load(known_valve),
        "observer": OBSERVERS.load(observer),
        "believed": FRICTION_MODELS.load(believed),
    }
    entry = "first, timing, block, like, given, record, work, forces_work"
    return compiled(build, {"run": entry}, members, structure.sizes._asdict(), structure.effects, threads=True)


def _fill(numbers: Array, rows: LoopRows, lane: _Lane) -> None:
    """Write the initial values of a run to its place."""
    state, control = lane.plant.state, lane.control
    sensors, observed = state.sensors, control.observed
    middle, farthest = possible_range(lane.spec.rig.limits, lane.structure.sizes.signals + 1)
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
        (rows.middle, middle),
        (rows.farthest, farthest),
        (rows.known, np.array(flat(lane.known))),
    ):
        numbers[row : row + values.size] = values.ravel()
