"""A run stepped cycle by cycle: true force and motion, with arbitrary elements between controller and valve.

Unlike :mod:`ehls_ros.experiments.loop` it compiles nothing that depends on the combination of plant and controller, and knows
the true force. A run takes two to three times as long.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.controller import Outlook
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.experiments.loop import controller_of, sampled, simulator_of
from ehls_ros.experiments.spec import Spec
from ehls_ros.physics.sensors import FORCE, VELOCITY
from ehls_ros.physics.simulator import Simulator

CHECKED = 50
"""Number of cycles after which the rig's state is checked."""


class Cycles(NamedTuple):
    """Results, a row for each cycle.

    Attributes:
        error: true force less the reference wanted [N], shape (n,); infinite from an impossible state of the rig on, and the
            others NaN.
        command: command that the valve received [m], shape (n,).
        truth: true values of the readings in the order of the rig's ``sensed``, shape (n, signals).
        disturbance: force [N], force rate [N/s], displacement [m] and velocity [m/s] of the actuator under test, shape (n, 4).
    """

    error: Array
    command: Array
    truth: Array
    disturbance: Array

    def largest(self) -> float:
        """Return the largest error of the last half [N]."""
        return largest(self.error)

    def swing(self) -> float:
        """Return the amplitude of a sine with the rms error of the last half [N]; infinite if the force is lost.

        Short peaks, as friction makes them where the piston breaks away, hardly count; an oscillation does in full.
        """
        return swing(self.error)


def largest(error: Array) -> float:
    """Return the largest magnitude of the last half of an error, shape (n,)."""
    return float(np.max(np.abs(error[len(error) // 2 :]), initial=0.0))


def swing(error: Array) -> float:
    """Return the amplitude of a sine with the rms of the last half of an error, shape (n,); infinite if it is not finite."""
    amplitude = math.sqrt(2.0 * float(np.mean(error[len(error) // 2 :] ** 2)))
    return amplitude if math.isfinite(amplitude) else math.inf


def stepped_run(spec: Spec, added: Array | None = None, plant: Simulator | None = None) -> Cycles:
    """Run an experiment, companions included.

    Args:
        spec: the experiment.
        added: added to the spool command on its way to the plant [m], shape (cycles,).
        plant: replaces the experiment's.
    """
    period, cycles = spec.settings.control_period, spec.cycles
    plant, reference = plant or simulator_of(spec), sampled(spec.reference, period)
    wanted, place = reference.rows(0, cycles), reference.place(0, cycles)
    actuator = sampled(spec.disturbance.signal, period).rows(0, cycles)
    signal = sampled(spec.disturbance.signal, period)
    disturbing = DISTURBANCES.load(spec.disturbance.name).build(spec.disturbance.parameters, signal, spec.rig, period)
    rows = disturbing.rows(0, cycles).tolist()
    law = controller_of(spec)
    uses = spec.compensation
    observer = FrictionEstimator(uses.name, spec.controller_rig, period, uses.parameters) if law.uses_friction else None
    noise = np.random.default_rng(spec.settings.seed).standard_normal((cycles, plant.truth.size))
    error, command = np.empty(cycles), np.zeros(cycles) if added is None else added.copy()
    truth, disturbance = np.empty((cycles, plant.truth.size)), np.empty((cycles, len(plant.acting)))
    friction = np.zeros(2)
    for cycle in range(cycles):
        measured = plant.measure(noise[cycle])
        truth[cycle] = plant.truth
        error[cycle] = plant.truth[FORCE] - wanted[cycle, 0]
        if observer is not None:
            friction = observer.update(float(measured[VELOCITY]))
        answer = law.step(measured, wanted[cycle], friction, outlook=Outlook(cycle, place[cycle], actuator[cycle]))
        command[cycle] += answer
        plant.advance(command[cycle], *rows[cycle])
        disturbance[cycle] = plant.acting
        if cycle % CHECKED == 0 and plant.trouble():
            error[cycle:], command[cycle:], truth[cycle:], disturbance[cycle:] = math.inf, math.nan, math.nan, math.nan
            break
    return Cycles(error, command, truth, disturbance)
