"""The whole loop in one process and one compiled kernel: the nodes' work without ROS.

Every part is the one the nodes run, in the same order, so that both give the same trajectory.
"""

import platform
import sys
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from ehls_ros import __version__
from ehls_ros.arrays import Array
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import STATUS_SIZE, model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.disturbances.base import ROW
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.references import REFERENCES
from ehls_ros.control.references.base import SampledReference
from ehls_ros.experiments.spec import Spec, Use, spec_to_mapping
from ehls_ros.physics.composition import kernel_module, plant_source
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.simulator import Simulator
from ehls_ros.recording.topics import CONTROLLER_STATUS, DISTURBANCE, FORCE_REFERENCE, LOADER_STATE
from ehls_ros.trajectory import Trajectory

CHUNK = 2000
"""Cycles between two reports of progress."""

_LOOP = """

from ehls_ros.control.controllers import {controller} as law
from ehls_ros.control.observers import {observer} as observer
from ehls_ros.physics.plant import FD, FD_RATE, START, TEMPERATURE, U, VD, XD


@njit(cache=True, error_model="numpy")
def loop(
    first, cycles, period, y, mode, plant, friction, inputs, effects, step, steps, work, sensor_state, noise, truth,
    measured, reference, disturbance, design_friction, observer_state, tuning, design, memory, status, record,
):
    dense = 0
    for k in range(first, first + cycles):
        sensors.true_signals(y, inputs[TEMPERATURE], plant, truth)
        sensors.measure(k, truth, noise[k - first], sensor_state, measured)
        observer.update(measured[sensors.VELOCITY], period, design_friction, observer_state)
        u = law.step(measured, reference[k], observer_state.estimate, tuning, design, memory, status)
        column = 0
        for i in range(measured.size):
            record[k, column] = measured[i]
            column += 1
        record[k, column] = u
        column += 1
        for i in range(observer_state.estimate.size):
            record[k, column] = observer_state.estimate[i]
            column += 1
        for i in range(status.size):
            record[k, column] = status[i]
            column += 1
        inputs[U], inputs[FD], inputs[FD_RATE] = u, disturbance[k, 0], disturbance[k, 1]
        inputs[XD], inputs[VD], inputs[START] = disturbance[k, 2], disturbance[k, 3], k * period
        c = model.Coefficients(plant, friction, inputs, effects)
        dense += run(k * period, y, mode, c, step, steps, work)
    return dense
"""


def sampled(use: Use, period: float) -> SampledReference:
    """Return a reference ready to be asked by cycle; ``period`` in s."""
    return SampledReference(REFERENCES.load(use.name), use.parameters, period)


def run_in_process(spec: Spec, progress: Callable[[int, int], None] | None = None) -> Trajectory:
    """Run an experiment without ROS.

    Args:
        spec: the experiment.
        progress: called now and then with the cycles done and the cycles in all.

    Returns:
        What a bag of the node graph would hold, but for the timing of messages.
    """
    settings, cycles = spec.settings, spec.cycles
    period = settings.control_period
    rig = spec.loader_rig()
    simulator = Simulator(rig, period, settings.integration_step, settings.initial_position)
    source = plant_source(rig) + _LOOP.format(controller=spec.controller.name, observer=settings.compensation)
    loop = kernel_module(source).loop

    reference = sampled(spec.reference, period).rows(cycles)
    kind = DISTURBANCES.load(spec.disturbance.name)
    disturbing = kind.build(spec.disturbance.parameters, sampled(spec.disturbance.signal, period), spec.rig, period)
    disturbance = np.empty((cycles + 1, ROW))
    disturbance[0] = disturbing.first()
    if not kind.REACTS:
        for k in range(cycles):
            disturbance[k + 1] = disturbing.following(k, 0.0, 0.0)

    observer_state = OBSERVERS.load(settings.compensation).state(spec.rig.friction)
    memory = CONTROLLERS.load(spec.controller.name).memory(spec.controller.parameters)
    estimate_size = observer_state.estimate.size
    record = np.empty((cycles, len(SENSED) + 1 + estimate_size + STATUS_SIZE))
    random = np.random.default_rng(settings.seed)
    done = 0
    while done < cycles:
        count = 1 if kind.REACTS else min(CHUNK, cycles - done)
        loop(
            done,
            count,
            period,
            simulator.y,
            simulator.mode,
            simulator.rig.plant,
            simulator.rig.friction,
            simulator.inputs,
            simulator.effects,
            simulator.step,
            simulator.steps,
            simulator.work,
            simulator.sensors,
            random.standard_normal((count, len(SENSED))),
            simulator.truth,
            simulator.measured,
            reference,
            disturbance,
            spec.rig.friction,
            observer_state,
            spec.controller.parameters,
            model_of(spec.rig, period),
            memory,
            np.zeros(STATUS_SIZE),
            record,
        )
        if kind.REACTS:
            position, velocity = record[done, 0], record[done, 1]
            disturbance[done + 1] = disturbing.following(done, position, velocity)
        done += count
        if progress is not None and (done % CHUNK == 0 or done == cycles):
            progress(done, cycles)
    return _trajectory(spec, record, reference, disturbance[:cycles], estimate_size)


def _trajectory(spec: Spec, record: Array, reference: Array, disturbance: Array, estimate_size: int) -> Trajectory:
    signals: dict[str, Array] = {}
    signals.update(zip(LOADER_STATE.signals.values(), record.T, strict=False))
    column = len(SENSED)
    signals["valve_command_m"] = record[:, column]
    signals["friction_fallback"] = np.zeros(len(record))
    estimate = record[:, column + 1 : column + 1 + estimate_size]
    elements = (estimate_size - 2) // 2
    if CONTROLLERS.load(spec.controller.name).FRICTION:
        signals["friction_gms_n"], signals["friction_viscous_n"] = estimate[:, 0], estimate[:, 1]
        signals["friction_elements_n"] = estimate[:, 2 : 2 + elements]
        signals["friction_slipping"] = estimate[:, 2 + elements :]
    signals.update(zip(CONTROLLER_STATUS.signals.values(), record[:, column + 1 + estimate_size :].T, strict=False))
    signals.update(zip(FORCE_REFERENCE.signals.values(), reference.T, strict=True))
    signals.update(zip(DISTURBANCE.signals.values(), disturbance.T, strict=True))
    time = np.arange(len(record), dtype=np.float64) * spec.settings.control_period
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
