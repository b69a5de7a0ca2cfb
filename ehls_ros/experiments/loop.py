"""The whole loop in one process and one compiled kernel: the nodes' work without ROS.

Every part is the one the nodes run, in the same order, so that both give the same trajectory.
"""

import os
import platform
import sys
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, cast

import numba
import numpy as np
from numpy.random import Generator

from ehls_ros import __version__
from ehls_ros.arrays import Array
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import STATUS_SIZE, model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import ROW, Planned
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import ELEMENTS
from ehls_ros.control.references import REFERENCES
from ehls_ros.control.references.base import SampledReference
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.spec import Spec, Use, check_spec, spec_to_mapping
from ehls_ros.physics.composition import kernel_module, plant_source
from ehls_ros.physics.plausibility import implausible
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.sensors import POSITION, VELOCITY
from ehls_ros.physics.simulator import Simulator
from ehls_ros.recording.topics import CONTROLLER_STATUS, DISTURBANCE, LOADER_STATE, REFERENCE_TOPICS
from ehls_ros.trajectory import Trajectory

CHUNK = 2000
"""Cycles in a block."""

_LOOP = """

from ehls_ros.control.controllers import {controller} as law
from ehls_ros.control.observers import {observer} as observer
from ehls_ros.physics.friction import {believed} as believed_friction

observe_friction = observer.updater(believed_friction)


@njit(cache=True, error_model="numpy")
def loop(
    first, period, y, mode, plant, friction, inputs, effects, step, steps, warming, work, sensor_state, noise, truth, measured,
    reference, disturbance, design_friction, compensation, observer_state, tuning, design, memory, status, record,
):
    dense = 0
    for i in range(record.shape[0]):
        k = first + i
        observe(k, k * period, y, plant, inputs, effects, sensor_state, noise[i], truth, measured)
        observe_friction(measured[sensors.VELOCITY], period, design_friction, compensation, observer_state)
        u = law.step(measured, reference[i], observer_state.estimate, tuning, design, memory, status)
        column = 0
        for value in measured:
            record[i, column] = value
            column += 1
        record[i, column] = u
        column += 1
        for value in observer_state.estimate:
            record[i, column] = value
            column += 1
        for value in status:
            record[i, column] = value
            column += 1
        model.hold(inputs, k * period, u, disturbance[i, 0], disturbance[i, 1], disturbance[i, 2], disturbance[i, 3])
        dense += move(k * period, y, mode, plant, friction, inputs, effects, step, steps, work)
        inputs[model.TEMPERATURE] += warming * period
    return dense
"""


def sampled(use: Use, period: float) -> SampledReference:
    """Return a reference ready to be asked by cycle; ``period`` in s."""
    return SampledReference(REFERENCES.load(use.name), use.parameters, period)


def simulator_of(spec: Spec) -> Simulator:
    """Return a spec's plant, ready to be stepped."""
    settings = spec.settings
    return Simulator(
        spec.loader_rig(),
        settings.control_period,
        settings.integration_step,
        settings.initial_position,
        settings.oil_temperature,
        settings.oil_warming,
    )


class Block(NamedTuple):
    """Some cycles on end, a row each.

    Attributes:
        first: number of the first cycle.
        record: measurement, command, friction estimate, controller status; see :class:`Columns`.
        reference: what the controller follows and its first and second derivative.
        disturbance: force, its rate, displacement, velocity.
    """

    first: int
    record: Array
    reference: Array
    disturbance: Array


class Columns(NamedTuple):
    """Where a block's record holds what."""

    measured: slice
    command: int
    estimate: slice
    status: slice

    @classmethod
    def of(cls, estimate_size: int) -> "Columns":
        """Return the columns for a friction estimate of a size."""
        estimate = len(SENSED) + 1
        status = estimate + estimate_size
        return cls(slice(0, len(SENSED)), len(SENSED), slice(estimate, status), slice(status, status + STATUS_SIZE))


class Implausible(WorkFailed):
    """A run that came to what no rig can: its numbers are lost, or far beyond the rig's limits.

    Attributes:
        trajectory: the run up to there, where it was kept.
    """

    trajectory: Trajectory | None = None


class ClosedLoop:
    """A spec's plant, observer and controller in one compiled loop.

    Attributes:
        columns: layout of the blocks' records.
        dense: integration steps so far in which events came too densely to be located.
    """

    def __init__(self, spec: Spec) -> None:
        """Prepare and compile (or load) the loop.

        Raises:
            BadInput: the spec's numbers describe no rig, or nothing that can be run on it.
        """
        check_spec(spec, spec.settings.title)
        self._spec = spec
        period = spec.settings.control_period
        self._simulator = simulator_of(spec)
        believed = spec.controller_rig
        parts = {"controller": spec.controller.name, "observer": spec.compensation.name, "believed": believed.friction_model}
        source = plant_source(spec.loader_rig()) + _LOOP.format(**parts)
        self._loop = kernel_module(source).loop
        self._observer_state = OBSERVERS.load(spec.compensation.name).state(believed.friction_law, believed.friction)
        self._model = model_of(spec.controller_rig, period)
        self._memory = CONTROLLERS.load(spec.controller.name).memory(spec.controller.parameters)
        self.columns = Columns.of(self._observer_state.estimate.size)
        self.dense = 0

    def blocks(self) -> Iterator[Block]:
        """Run the experiment.

        Yields:
            The cycles in order, :data:`CHUNK` at a time. The record's memory is used again for the next block.

        Raises:
            Implausible: the rig came to what cannot be true, in the last of the cycles yielded before.
        """
        spec = self._spec
        period, cycles = spec.settings.control_period, spec.cycles
        reference = sampled(spec.reference, period)
        kind = DISTURBANCES.load(spec.disturbance.name)
        disturbing = kind.build(spec.disturbance.parameters, sampled(spec.disturbance.signal, period), spec.rig, period)
        random = np.random.default_rng(spec.settings.seed)
        kept = np.empty((CHUNK, self.columns.status.stop))
        status = np.zeros(STATUS_SIZE)
        following = disturbing.first()
        for first in range(0, cycles, CHUNK):
            count = min(CHUNK, cycles - first)
            record = kept[:count]
            wanted = reference.rows(first, count)
            if not kind.REACTS:
                disturbance = cast(Planned, disturbing).rows(first, count)
                self._run(first, record, wanted, disturbance, status, random)
            else:
                # What feels the loader is known for one cycle at a time.
                disturbance = np.empty((count, ROW))
                for i in range(count):
                    disturbance[i], one = following, slice(i, i + 1)
                    self._run(first + i, record[one], wanted[one], disturbance[one], status, random)
                    following = disturbing.following(first + i, record[i, POSITION], record[i, VELOCITY])
            # A sensor may hide what the rig itself comes to.
            lost = implausible(record[:, : self.columns.command + 1], spec.rig.limits)
            hidden = implausible(self._simulator.truth[np.newaxis], spec.rig.limits)
            if lost is None and hidden is not None:
                lost = hidden._replace(row=count - 1)
            end = count if lost is None else lost.row + 1
            yield Block(first, record[:end], wanted[:end], disturbance[:end])
            if lost is not None:
                raise Implausible(
                    f"the run ended at {(first + lost.row) * period:g} s of {spec.settings.duration:g} s: {lost.what}"
                )

    def _run(self, first: int, record: Array, reference: Array, disturbance: Array, status: Array, random: Generator) -> None:
        simulator, spec = self._simulator, self._spec
        self.dense += self._loop(
            first,
            spec.settings.control_period,
            simulator.y,
            simulator.mode,
            simulator.rig.plant,
            simulator.rig.friction,
            simulator.inputs,
            simulator.effects,
            simulator.step,
            simulator.steps,
            simulator.warming,
            simulator.work,
            simulator.sensors,
            random.standard_normal((len(record), len(SENSED))),
            simulator.truth,
            simulator.measured,
            reference,
            disturbance,
            spec.controller_rig.friction,
            spec.compensation.parameters,
            self._observer_state,
            spec.controller.parameters,
            self._model,
            self._memory,
            status,
            record,
        )


def run_in_process(spec: Spec, progress: Callable[[int, int], None] | None = None) -> Trajectory:
    """Run an experiment without ROS.

    Args:
        spec: the experiment.
        progress: called now and then with the cycles done and the cycles in all.

    Returns:
        What a bag of the node graph would hold, but for the timing of messages.

    Raises:
        BadInput: the spec's numbers describe no rig, or more cycles than fit into memory.
        Implausible: the rig came to what cannot be true; the error holds the run until then.
    """
    loop = ClosedLoop(spec)
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
    except Implausible as error:
        error.trajectory = _trajectory(spec, loop.columns, record[:done], reference[:done], disturbance[:done])
        raise
    return _trajectory(spec, loop.columns, record, reference, disturbance)


def _check_memory(spec: Spec, columns: int) -> None:
    needed, there = 8 * columns * spec.cycles, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > there:
        what = f"{spec.cycles} cycles take {needed / 1e9:.3g} GB of memory"
        raise BadInput(
            what, spec.settings.title, f"at most {there / 1e9:.3g} GB: a shorter duration or a longer control_period"
        )


def run_in_stretches(spec: Spec) -> Iterator[Trajectory]:
    """Run an experiment without ROS, only as far ahead as somebody asks.

    Args:
        spec: the experiment.

    Yields:
        What :func:`run_in_process` returns, :data:`CHUNK` cycles at a time. Its memory is used again for the next stretch.
    """
    loop = ClosedLoop(spec)
    for block in loop.blocks():
        yield _trajectory(spec, loop.columns, block.record, block.reference, block.disturbance, block.first)


def _trajectory(
    spec: Spec, columns: Columns, record: Array, reference: Array, disturbance: Array, first: int = 0
) -> Trajectory:
    signals: dict[str, Array] = {}
    signals.update(zip(LOADER_STATE.signals.values(), record[:, columns.measured].T, strict=True))
    signals["valve_command_m"] = record[:, columns.command]
    signals["friction_fallback"] = np.zeros(len(record))
    estimate = record[:, columns.estimate]
    elements = (estimate.shape[1] - ELEMENTS) // 2
    law = CONTROLLERS.load(spec.controller.name)
    if law.FRICTION:
        signals["friction_gms_n"], signals["friction_viscous_n"] = estimate[:, 0], estimate[:, 1]
        signals["friction_elements_n"] = estimate[:, ELEMENTS : ELEMENTS + elements]
        signals["friction_slipping"] = estimate[:, ELEMENTS + elements :]
    signals.update(zip(CONTROLLER_STATUS.signals.values(), record[:, columns.status].T, strict=False))
    signals.update(zip(REFERENCE_TOPICS[law.FOLLOWS].signals.values(), reference.T, strict=True))
    signals.update(zip(DISTURBANCE.signals.values(), disturbance.T, strict=True))
    time = np.arange(first, first + len(record), dtype=np.float64) * spec.settings.control_period
    return Trajectory(time, signals, metadata(spec, "in-process"))


def metadata(spec: Spec, timing: str) -> dict[str, Any]:
    """Return what a recording says of how it was made: spec, rig, versions, timing mode."""
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
