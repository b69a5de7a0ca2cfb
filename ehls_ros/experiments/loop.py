"""The closed loop in one process and one compiled kernel: the work of the nodes without ROS.

The parts and their order are those of the nodes, so that both give the same trajectory.
"""

import os
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.random import Generator

from ehls_ros import __version__
from ehls_ros.arrays import Array, kernel
from ehls_ros.control.companions.base import Past, Upcoming
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORESEEN, STATUS_SIZE, STATUS_TO_SI, Model, model_of
from ehls_ros.control.controllers.base import ROW as FOLLOWED
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import ROW
from ehls_ros.control.estimate_bounds import bounds_of
from ehls_ros.control.local_plant import memory_on, step_on
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import ELEMENTS, ObserverState
from ehls_ros.control.programme.motion import point_signals
from ehls_ros.control.references import REFERENCES
from ehls_ros.control.references.base import SampledReference
from ehls_ros.errors import BadInput
from ehls_ros.experiments import learnt_files
from ehls_ros.experiments.run_failure import Implausible, NotKept, RunFailed
from ehls_ros.experiments.spec import Spec, Use, check_spec, company_of, signal_kind, spec_to_mapping, uses_actuator
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.parameters import Limits
from ehls_ros.physics.plant import TEMPERATURE
from ehls_ros.physics.plausibility import Exceedance, implausible
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.sensors import VELOCITY
from ehls_ros.physics.simulator import Constants, Simulated, Simulator, State, at_rest, parts_of, plant_kernel
from ehls_ros.recording.topics import ACTUATOR_TOPICS, CONTROLLER_STATUS, DISTURBANCE, READINGS, REFERENCE_TOPICS
from ehls_ros.trajectory import Trajectory

CHUNK = 2000
"""Number of cycles in a block."""


class Control(NamedTuple):
    """Observer and controller of a loop, with their states.

    Attributes:
        friction: friction parameters of the observer.
        compensation: the observer's parameters.
        observed: its state.
        tuning: the controller's parameters.
        model: the controller's model of the rig.
        memory: its state.
        status: its status after the last step.
    """

    friction: Any
    compensation: Any
    observed: ObserverState
    tuning: Any
    model: Model
    memory: Array
    status: Array


class Given(NamedTuple):
    """External inputs of some cycles, one row per cycle.

    Attributes:
        noise: standard normal numbers, shape (n, signals).
        reference: reference of the law, shape (n, :data:`ehls_ros.control.controllers.base.ROW`).
        disturbance: force, its rate, displacement, velocity, shape (n, 4). For a simulated servo, the last two are its
            setpoints, and are overwritten with the actual values.
    """

    noise: Array
    reference: Array
    disturbance: Array


class _Loop(NamedTuple):
    """The compiled loop."""

    run: Callable[..., int]


def build(plant: Any, law: Any, cylinder: Any, valve: Any, observer: Any, believed: Any) -> _Loop:
    """Build the loop of a compiled plant, a controller for a cylinder and valve, and an observer with its friction model."""
    sense, cycle, update, step = plant.sense, plant.cycle, observer.updater(believed), step_on(law, cylinder, valve)

    @kernel
    def run(first: int, constants: Constants, state: State, control: Control, given: Given, record: Array) -> int:
        dense = 0
        measured, estimate, status = state.measured, control.observed.estimate, control.status
        for i in range(record.shape[0]):
            k = first + i
            sense(k, constants, state, given.noise[i])
            update(measured[VELOCITY], constants.period, control.friction, control.compensation, control.observed)
            u = step(measured, given.reference[i], estimate, control.tuning, control.model, control.memory, status)
            column = 0
            for value in measured:
                record[i, column] = value
                column += 1
            record[i, column] = u
            column += 1
            for value in estimate:
                record[i, column] = value
                column += 1
            for value in status:
                record[i, column] = value
                column += 1
            dense += cycle(k, constants, state, u, given.disturbance[i])
            state.inputs[TEMPERATURE] += constants.warming * constants.period
        return dense

    return _Loop(run)


def loop_kernel(spec: Spec) -> ModuleType:
    """Return the compiled loop of a spec's plant, observer and controller."""
    members = {
        "plant": plant_kernel(parts_of(spec.loader_rig()), coupled=spec.servo() is not None),
        "law": CONTROLLERS.load(spec.controller.name),
        "cylinder": spec.controller_rig.cylinder.law,
        "valve": spec.controller_rig.valve.law,
        "observer": OBSERVERS.load(spec.compensation.name),
        "believed": spec.controller_rig.friction_law,
    }
    return compiled(build, {"run": "first, constants, state, control, given, record"}, members)


def sampled(use: Use, period: float) -> SampledReference:
    """Return a reference sampled by cycle; ``period`` in s."""
    return SampledReference(REFERENCES.load(use.name), use.parameters, period)


def plant_of(spec: Spec) -> Simulated:
    """Return a spec's plant, at rest."""
    return at_rest(spec.loader_rig(), *_timing(spec), servo=spec.servo(), **_start(spec))


def simulator_of(spec: Spec) -> Simulator:
    """Return a spec's plant, ready to be stepped."""
    return Simulator(spec.loader_rig(), *_timing(spec), servo=spec.servo(), **_start(spec))


def _timing(spec: Spec) -> tuple[float, float | None]:
    return spec.settings.control_period, spec.settings.integration_step


def _start(spec: Spec) -> dict[str, float]:
    settings = spec.settings
    return {
        "position": settings.initial_position,
        "temperature": settings.oil_temperature,
        "warming": settings.oil_warming,
    }


class Block(NamedTuple):
    """Consecutive cycles, one row per cycle.

    Attributes:
        first: number of the first cycle.
        record: measurement, command, friction estimate, controller status; see :class:`Columns`.
        reference: the controller's reference and its first and second derivative.
        disturbance: force, its rate, displacement, velocity.
    """

    first: int
    record: Array
    reference: Array
    disturbance: Array


class Columns(NamedTuple):
    """Columns of a block's record."""

    measured: slice
    command: int
    estimate: slice
    status: slice

    @classmethod
    def of(cls, estimate_size: int, signals: int) -> "Columns":
        """Return the columns for a friction estimate of the given size and a number of sensed signals."""
        estimate = signals + 1
        status = estimate + estimate_size
        return cls(slice(0, signals), signals, slice(estimate, status), slice(status, status + STATUS_SIZE))


def controller_of(spec: Spec) -> Controller:
    """Return a spec's controller with its companions, for the rig that it knows; this compiles or loads the law.

    Raises:
        BadInput: a companion cannot work with this controller or rig.
    """
    use, rig = spec.controller, spec.controller_rig
    model = model_of(rig, spec.settings.control_period)
    company = company_of(spec, model, spec.settings.title)
    return Controller(use.name, use.parameters, model, company, rig.cylinder.model, rig.valve.model)


def control_of(spec: Spec) -> Control:
    """Return a spec's observer and controller before the first cycle."""
    believed = spec.controller_rig
    law, observer = CONTROLLERS.load(spec.controller.name), OBSERVERS.load(spec.compensation.name)
    return Control(
        friction=believed.friction,
        compensation=spec.compensation.parameters,
        observed=observer.state(believed.friction_law, believed.friction),
        tuning=spec.controller.parameters,
        model=model_of(believed, spec.settings.control_period),
        memory=memory_on(law, believed.cylinder.law, spec.controller.parameters),
        status=np.zeros(STATUS_SIZE),
    )


def impossible(record: Array, truth: Array, limits: Limits) -> Exceedance | None:
    """Return the first cycle with physically impossible values, or None.

    Args:
        record: rows of the cycles, which begin with the readings and the command.
        truth: true values of the sensed signals in the last cycle; a sensor may hide impossible values.
        limits: the rig's limits.
    """
    lost = implausible(record[:, : truth.size + 1], limits)
    hidden = implausible(truth[np.newaxis], limits)
    return hidden._replace(row=len(record) - 1) if lost is None and hidden is not None else lost


def ended(spec: Spec, first: int, lost: Exceedance) -> Implausible:
    """Return the error of a run that ended in one of the cycles from ``first`` on."""
    time = (first + lost.row) * spec.settings.control_period
    return Implausible(f"the run ended at {time:g} s of {spec.settings.duration:g} s: {lost.what}")


class ClosedLoop:
    """A spec's plant, observer and controller in one compiled loop.

    Attributes:
        columns: layout of the blocks' records.
        company: the controller's companions.
        dense: number of integration steps so far with too many events to be located.
    """

    def __init__(self, spec: Spec, *, check: bool = True) -> None:
        """Prepare and compile (or load) the loop.

        Args:
            spec: the experiment.
            check: whether to reject values that are valid individually but inconsistent together.

        Raises:
            BadInput: the spec's values are inconsistent, or it cannot be run on the rig.
        """
        if check:
            check_spec(spec, spec.settings.title)
        self._spec = spec
        self._plant = plant_of(spec)
        self._control = control_of(spec)
        self.company = company_of(spec, self._control.model, spec.settings.title)
        learnt_files.recall(self.company, spec)
        self.company.prepare()
        self._run_compiled = loop_kernel(spec).run
        self.columns = Columns.of(self._control.observed.estimate.size, self._plant.state.truth.size)
        self.dense = 0
        nothing = np.empty((0, self.columns.status.stop))
        self._run(0, nothing, np.empty((0, FOLLOWED)), np.empty((0, ROW)), np.random.default_rng())

    def become(self, rig: Rig) -> None:
        """Replace the loader's rig from the next cycle on; its sensors stay unchanged.

        Args:
            rig: a rig with the same effects, possibly of other values.

        Raises:
            BadInput: the rig has other effects, for which the loop is not compiled.
        """
        settings = self._spec.settings
        # The actuator under test stays the same.
        now = at_rest(self._spec._replace(rig=rig).loader_rig(), *_timing(self._spec), servo=self._spec.servo())
        if now.parts.effects.names != self._plant.parts.effects.names:
            wanted = ", ".join(self._plant.parts.effects.names) or "none"
            raise BadInput(f"a rig with the effects {now.parts.effects.names}", settings.title, f"those of the loop: {wanted}")
        self._plant = self._plant._replace(rig=now.rig, constants=now.constants)

    def blocks(self) -> Iterator[Block]:
        """Run the experiment.

        Yields:
            The cycles in order, up to :data:`CHUNK` at a time. The record's memory is reused for the next block.

        Raises:
            Implausible: the rig reached an impossible state in the last of the cycles yielded before.
        """
        spec = self._spec
        period, cycles = spec.settings.control_period, spec.cycles
        reference, actuator = sampled(spec.reference, period), sampled(spec.disturbance.signal, period)
        kind = DISTURBANCES.load(spec.disturbance.name)
        disturbing = kind.build(spec.disturbance.parameters, sampled(spec.disturbance.signal, period), spec.rig, period)
        random = np.random.default_rng(spec.settings.seed)
        kept = np.empty((CHUNK, self.columns.status.stop))
        first = 0
        while first < cycles:
            count = min(CHUNK, cycles - first)
            if self.company:
                place = reference.place(first, count)
                count = self.company.room(first, place)
            record, wanted = kept[:count], reference.rows(first, count)
            rows = np.full((count, FOLLOWED), np.nan)
            rows[:, :FORESEEN] = wanted
            if self.company:
                self.company.ahead(Upcoming(first, rows, place[:count], actuator.rows(first, count)))
            disturbance = disturbing.rows(first, count)
            self._run(first, record, rows, disturbance, random)
            if self.company:
                past = Past(
                    first,
                    rows,
                    wanted,
                    place[:count],
                    record[:, self.columns.measured],
                    record[:, self.columns.command],
                    record[:, self.columns.status],
                )
                self._control = self._control._replace(model=self.company.done(past, self._control.model))
            lost = impossible(record, self._plant.state.truth, spec.rig.limits)
            end = count if lost is None else lost.row + 1
            yield Block(first, record[:end], wanted[:end], disturbance[:end])
            if lost is not None:
                raise ended(spec, first, lost)
            first += count

    def keep_learnt(self) -> None:
        """Write the learnt arrays of the companions to their files.

        Raises:
            NotKept: a file cannot be written.
        """
        try:
            learnt_files.keep(self.company, self._spec)
        except NotWritten as error:
            raise NotKept(str(error)) from None

    def _run(self, first: int, record: Array, reference: Array, disturbance: Array, random: Generator) -> None:
        given = Given(random.standard_normal((len(record), self._plant.state.truth.size)), reference, disturbance)
        self.dense += self._run_compiled(first, self._plant.constants, self._plant.state, self._control, given, record)


def run_in_process(spec: Spec, progress: Callable[[int, int], None] | None = None, *, check: bool = True) -> Trajectory:
    """Run an experiment without ROS.

    Args:
        spec: the experiment.
        progress: called now and then with the number of cycles done and the total number.
        check: whether to reject values that are valid individually but inconsistent together.

    Returns:
        The signals that a bag of the node graph would contain, without the timing of messages.

    Raises:
        BadInput: the spec's values are inconsistent, or the run does not fit into memory.
        RunFailed: the state of the rig became impossible, or a companion's file cannot be written; the error holds the run.
    """
    loop = ClosedLoop(spec, check=check)
    _check_memory(spec, loop.columns.status.stop + 3 + ROW)
    record = np.empty((spec.cycles, loop.columns.status.stop))
    reference = np.empty((spec.cycles, 3))
    disturbance = np.empty((spec.cycles, ROW))
    done = 0
    try:
        for block in loop.blocks():
            done = block.first + len(block.record)
            for whole, part in ((record, block.record), (reference, block.reference), (disturbance, block.disturbance)):
                whole[block.first : done] = part
            if progress is not None:
                progress(done, spec.cycles)
        loop.keep_learnt()
    except RunFailed as error:
        error.trajectory = trajectory_of(spec, loop.columns, record[:done], reference[:done], disturbance[:done])
        raise
    return trajectory_of(spec, loop.columns, record, reference, disturbance)


def run_as_far_as_it_goes(
    spec: Spec, progress: Callable[[int, int], None] | None = None
) -> tuple[Trajectory, RunFailed | None]:
    """Run an experiment without ROS, and keep the cycles of a failed run.

    Args:
        spec: the experiment.
        progress: called now and then with the number of cycles done and the total number.

    Returns:
        The run, and its failure; None if it succeeded.

    Raises:
        BadInput: the spec's values are inconsistent, or the run does not fit into memory.
    """
    try:
        return run_in_process(spec, progress), None
    except RunFailed as error:
        if error.trajectory is None:
            raise
        return error.trajectory, error


def _check_memory(spec: Spec, columns: int) -> None:
    needed, there = 8 * columns * spec.cycles, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > there:
        what = f"{spec.cycles} cycles take {needed / 1e9:.3g} GB of memory"
        raise BadInput(
            what, spec.settings.title, f"at most {there / 1e9:.3g} GB: a shorter duration or a longer control_period"
        )


def run_in_stretches(spec: Spec, later: Sequence[tuple[float, Rig]] = ()) -> Iterator[Trajectory]:
    """Run an experiment without ROS, in stretches on demand.

    Args:
        spec: the experiment.
        later: times [s] and later rigs in order, each valid from the first stretch that begins at its time or later; see
            :meth:`ClosedLoop.become`.

    Yields:
        The result of :func:`run_in_process`, up to :data:`CHUNK` cycles at a time. Its memory is reused for the next stretch.
    """
    loop = ClosedLoop(spec)
    waiting = list(later)
    for block in loop.blocks():
        yield trajectory_of(spec, loop.columns, block.record, block.reference, block.disturbance, block.first)
        end = (block.first + len(block.record)) * spec.settings.control_period
        while waiting and end >= waiting[0][0]:
            loop.become(waiting.pop(0)[1])
    loop.keep_learnt()


def trajectory_of(
    spec: Spec, columns: Columns, record: Array, reference: Array, disturbance: Array, first: int = 0
) -> Trajectory:
    """Return consecutive cycles as signals.

    Args:
        spec: the experiment.
        columns: layout of the record.
        record: record, one row per cycle.
        reference: the reference and its first and second derivative, shape (n, 3).
        disturbance: force, its rate, displacement, velocity, shape (n, 4).
        first: number of the first cycle.
    """
    signals: dict[str, Array] = {}
    signals.update(zip((READINGS[name] for name in spec.rig.sensed), record[:, columns.measured].T, strict=True))
    signals["valve_command_m"] = record[:, columns.command]
    signals["friction_fallback"] = np.zeros(len(record))
    estimate = record[:, columns.estimate]
    elements = (estimate.shape[1] - ELEMENTS) // 2
    law = CONTROLLERS.load(spec.controller.name)
    if law.FRICTION:
        signals["friction_gms_n"], signals["friction_viscous_n"] = estimate[:, 0], estimate[:, 1]
        signals["friction_elements_n"] = estimate[:, ELEMENTS : ELEMENTS + elements]
        signals["friction_slipping"] = estimate[:, ELEMENTS + elements :]
    status = record[:, columns.status] * STATUS_TO_SI
    signals.update(zip(CONTROLLER_STATUS.signals.values(), status.T, strict=False))
    bounds = bounds_of(law, spec.controller.parameters)
    at_bound = [bound.reached(status[:, bound.place]) for bound in bounds]
    signals["at_bound"] = np.any(at_bound, axis=0).astype(np.float64) if at_bound else np.zeros(len(record))
    signals.update(zip(REFERENCE_TOPICS[law.FOLLOWS].signals.values(), reference.T, strict=True))
    signals.update(zip(DISTURBANCE.signals.values(), disturbance.T, strict=True))
    period = spec.settings.control_period
    if uses_actuator(spec):
        told = ACTUATOR_TOPICS[signal_kind(spec.disturbance.name)]
        actuator = sampled(spec.disturbance.signal, period).rows(first, len(record))
        signals.update(zip(told.signals.values(), actuator.T, strict=True))
    time = np.arange(first, first + len(record), dtype=np.float64) * period
    if spec.reference.name == "programme":
        signals.update(point_signals(spec.reference.parameters, time, period))
    return Trajectory(time, signals, metadata(spec, "in-process"))


def metadata(spec: Spec, timing: str) -> dict[str, Any]:
    """Return the metadata of a recording: spec, rig, versions, timing mode."""
    mapping = spec_to_mapping(spec)
    rig = mapping.pop("rig")
    return {
        "title": spec.settings.title,
        "spec": mapping,
        "rig": rig,
        "timing": timing,
        "versions": {
            "ehls_ros": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "numba": numba.__version__,
            "platform": sys.platform,
        },
    }
