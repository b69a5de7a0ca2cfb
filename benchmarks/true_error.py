"""Error of the true force under a controller, cycle by cycle, with arbitrary elements between controller and valve."""

from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.controller import Controller, Outlook
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.experiments.loop import sampled, simulator_of
from ehls_ros.experiments.spec import Spec, company_of
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.sensors import FORCE
from ehls_ros.physics.simulator import Simulator


class Cycles(NamedTuple):
    """Results, a row for each cycle.

    Attributes:
        error: true force less the reference wanted [N], shape (n,).
        command: command that the valve received [m], shape (n,).
    """

    error: Array
    command: Array

    def largest(self) -> float:
        """Return the largest error of the last half [N]."""
        return float(np.max(np.abs(self.error[len(self.error) // 2 :])))


def true_cycles(spec: Spec, added: Array | None = None, plant: Simulator | None = None) -> Cycles:
    """Run an experiment whose controller needs no friction estimate, companions included.

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
    model = model_of(spec.controller_rig, period)
    company = company_of(spec, model, spec.settings.title)
    law = Controller(spec.controller.name, spec.controller.parameters, model, company)
    noise = np.random.default_rng(spec.settings.seed).standard_normal((cycles, len(SENSED)))
    error, command = np.empty(cycles), np.zeros(cycles) if added is None else added.copy()
    no_friction = np.zeros(2)
    for cycle in range(cycles):
        measured = plant.measure(noise[cycle])
        error[cycle] = plant.truth[FORCE] - wanted[cycle, 0]
        answer = law.step(measured, wanted[cycle], no_friction, outlook=Outlook(cycle, place[cycle], actuator[cycle]))
        command[cycle] += answer
        plant.advance(command[cycle], *rows[cycle])
    return Cycles(error, command)
