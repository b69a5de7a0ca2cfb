"""Experiments on an FMU in place of the simulated rig."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ehls_ros.control.controller import Outlook
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import Columns, controller_of, sampled, trajectory_of
from ehls_ros.experiments.run_failure import Implausible, RunFailed
from ehls_ros.experiments.spec import Spec, check_spec
from ehls_ros.fmu.foreign_plant import ForeignPlant
from ehls_ros.fmu.plant_map import PlantMap, map_from_mapping
from ehls_ros.physics.sensors import VELOCITY
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.trajectory import Trajectory

CHECKED = 50
"""Number of cycles after which the plant's state is checked."""


def fmu_plant(spec: Spec, path: Path, plant_map: Path | None) -> ForeignPlant:
    """Load an FMU as the plant of an experiment.

    Args:
        spec: the experiment; its rig file describes the plant.
        path: the FMU.
        plant_map: map of its variables; None if they have the names of the signals.

    Raises:
        BadInput: FMU or map cannot be used, or the experiment's actuator under test reacts to the loader.
        WorkFailed: the FMU crashed or hung.
    """
    if spec.servo() is not None:
        expected = "a disturbance by force, as the actuator under test is an input of the FMU"
        raise BadInput(f"the disturbance {spec.disturbance.name} reacts to the loader", spec.settings.title, expected)
    variables = PlantMap() if plant_map is None else map_from_mapping(read_yaml(plant_map, "map"), str(plant_map))
    settings = spec.settings
    start = settings.initial_position, settings.oil_temperature, settings.oil_warming
    return ForeignPlant(path, variables, spec.rig, settings.control_period, *start)


def run_on_fmu(
    spec: Spec, path: Path, plant_map: Path | None, progress: Callable[[int, int], None]
) -> tuple[Trajectory, RunFailed | None]:
    """Run an experiment on an FMU without ROS, and keep the cycles of a failed run.

    Args:
        spec: the experiment.
        path: the FMU.
        plant_map: see :func:`fmu_plant`.
        progress: called now and then with the number of cycles done and the total number.

    Returns:
        The run, and its failure; None if it succeeded.

    Raises:
        BadInput: the spec's values are inconsistent, or FMU or map cannot be used.
        WorkFailed: the FMU crashed or hung before the first cycle.
    """
    check_spec(spec, spec.settings.title)
    period, cycles = spec.settings.control_period, spec.cycles
    reference, actuator = sampled(spec.reference, period), sampled(spec.disturbance.signal, period)
    wanted, place, actuator_rows = reference.rows(0, cycles), reference.place(0, cycles), actuator.rows(0, cycles)
    kind = DISTURBANCES.load(spec.disturbance.name)
    disturbance = kind.build(spec.disturbance.parameters, actuator, spec.rig, period).rows(0, cycles)
    law = controller_of(spec)
    observer = FrictionEstimator(spec.compensation.name, spec.controller_rig, period, spec.compensation.parameters)
    columns = Columns.of(observer.state.estimate.size, len(spec.rig.sensed))
    record = np.empty((cycles, columns.status.stop))
    random, failure, done = np.random.default_rng(spec.settings.seed), None, cycles
    plant = fmu_plant(spec, path, plant_map)
    try:
        for cycle in range(cycles):
            measured = plant.measure(random.standard_normal(len(spec.rig.sensed)))
            estimate = observer.update(float(measured[VELOCITY]))
            outlook = Outlook(cycle, place[cycle], actuator_rows[cycle])
            command = law.step(measured, wanted[cycle], estimate, outlook=outlook)
            record[cycle] = np.concatenate([measured, [command], estimate, law.status])
            plant.advance(command, *disturbance[cycle].tolist())
            if plant.lost or cycle % CHECKED == 0:
                progress(cycle, cycles)
                if trouble := plant.trouble():
                    failure, done = Implausible(f"the run ended: {trouble}"), cycle + 1
                    break
    finally:
        plant.close()
    return trajectory_of(spec, columns, record[:done], wanted[:done], disturbance[:done]), failure
