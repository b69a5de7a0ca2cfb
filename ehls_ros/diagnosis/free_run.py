"""Free run: open-loop simulation from the recording's start, driven only by its command and disturbance.

Errors that the stages of :mod:`ehls_ros.diagnosis.stages` compare moment by moment accumulate here. Valve and cylinder
integrate, so an error of the valve's null makes the position of even a good model drift. The free run is therefore no verdict
on the model.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, in_python
from ehls_ros.diagnosis.loss import rms
from ehls_ros.diagnosis.record import (
    COMMAND,
    FORCE,
    LOAD,
    POSITION,
    PRESSURE,
    SERVO_POSITION,
    SERVO_VELOCITY,
    SPOOL,
    SUPPLY,
    TEMPERATURE,
    VELOCITY,
    Record,
    prepare,
)
from ehls_ros.diagnosis.stages import SENSED as RECORDED_AS
from ehls_ros.errors import BadInput
from ehls_ros.physics.composition import rig_elements
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.plant import FRICTION, PL, XV, V, X
from ehls_ros.physics.plant import TEMPERATURE as OIL
from ehls_ros.physics.rig import EVERY_SENSED, Rig
from ehls_ros.physics.simulator import OIL_TEMPERATURE, Simulator
from ehls_ros.trajectory import Trajectory, has_both_chambers

FREE_RUN = 20.0
"""Longest time simulated without the measured states, up to the first pause of the recording [s]."""

FREE_START = 0.01
"""Time over which the initial state of a free run is averaged [s]."""

MOVED = 10.0
"""Standard deviation of a signal relative to its noise above which a free run is compared with it."""

BEYOND_STROKE = 1.0
"""Distance beyond the stroke, relative to the stroke, at which a free run is stopped."""


class Followed(NamedTuple):
    """One signal, measured and simulated.

    Attributes:
        name: by the data contract.
        measured: shape (n,).
        before: of the given model, NaN from where the run was aborted, shape (n,).
        after: of the extended model; None if there is none.
        nrmse_before, nrmse_after: rms difference as a fraction of the measured signal's standard deviation; None if there is
            no model or its run was aborted.
    """

    name: str
    measured: Array
    before: Array
    after: Array | None
    nrmse_before: float | None
    nrmse_after: float | None


class FreeRun(NamedTuple):
    """Free runs of both models along a recording.

    Attributes:
        time: since the recording's start, shape (n,) [s].
        signals: the measured signals that move.
        remarks: remarks for the reader.
    """

    time: Array
    signals: tuple[Followed, ...]
    remarks: tuple[str, ...]


def free_run(trajectory: Trajectory, rig: Rig, extended: Rig, name: str = "recording", seconds: float = FREE_RUN) -> FreeRun:
    """Simulate the beginning of a recording with the given and the extended model.

    Args:
        trajectory: the recording; needs command, position or velocity, and load pressure or force.
        rig: the given model.
        extended: the extended model; the given one if there is none.
        name: name of the recording in errors.
        seconds: longest time to simulate [s].

    Returns:
        The run.

    Raises:
        BadInput: a required signal is missing.
    """
    time = trajectory.time_s
    part = time <= time[0] + seconds
    head = Trajectory(time[part], {name: values[part] for name, values in trajectory.signals.items()})
    whole = prepare(head, rig, name)
    record = whole.parts([(0, int(whole.bounds[1]))])
    columns = simulated_columns(record, name, TEMPERATURE)
    before = _run(record, rig)
    after = None if extended == rig else _run(record, extended)
    signals = tuple(
        _followed(record, signal, before[:, column], None if after is None else after[:, column])
        for signal, column in columns.items()
    )
    remarks = ["the position integrates any error of the valve's null, so it may drift even with a good model"]
    for which, run in (("the model as it was given", before), ("the extended model", after)):
        if run is not None and not np.all(np.isfinite(run)):
            until = float(record.time[np.argmin(np.all(np.isfinite(run), axis=1))] - record.time[0])
            remarks.append(f"{which} leaves the stroke and was stopped after {until:.2g} s")
    return FreeRun(record.time - record.time[0], signals, tuple(remarks))


def simulated_columns(record: Record, name: str, *omitted: str) -> dict[str, int]:
    """Return the columns of the simulator's readings, by the recorded signals that move, without some signals.

    Raises:
        BadInput: a signal that a simulation requires is missing from the recording of this name.
    """
    for needed in ((COMMAND,), (POSITION,), (PRESSURE, FORCE)):
        if not any(signal in record for signal in needed):
            raise BadInput(f"there is no {' or '.join(needed)}", name, "the command, the position and the load pressure")
    recorded = ((RECORDED_AS[sensor], column) for column, sensor in enumerate(EVERY_SENSED))
    return {
        signal: column
        for signal, column in recorded
        if signal in record and signal not in omitted and float(np.std(record.signals[signal])) > MOVED * record.noise[signal]
    }


def _followed(record: Record, signal: str, before: Array, after: Array | None) -> Followed:
    measured = record.signals[signal]
    good, size = record.good[signal], float(np.std(measured))

    def nrmse(values: Array | None) -> float | None:
        if values is None or not np.all(np.isfinite(values)):
            return None
        return rms((values - measured)[good]) / size

    return Followed(signal, measured, before, after, nrmse(before), nrmse(after))


def _run(record: Record, rig: Rig) -> Array:
    """Return the simulated sensor signals from the recording's start, NaN once the piston is far beyond the stroke."""
    simulator = Simulator(rig.quiet(), record.period)
    _start(simulator, record)
    return follow(simulator, record, 0, len(record.time))


def follow(simulator: Simulator, record: Record, begin: int, end: int) -> Array:
    """Simulate a part of a recording, driven by its command and disturbance.

    Args:
        simulator: the rig, in the state of the first sample.
        record: the recording.
        begin: first sample.
        end: the sample after the last.

    Returns:
        The sensor signals, NaN once the piston is far beyond the stroke, shape (end - begin, signals).
    """
    command, load = record.values(COMMAND)[begin:end], record.values(LOAD)[begin:end]
    rates = np.append(np.diff(load) / record.period, 0.0)
    servo, servo_speed = record.values(SERVO_POSITION)[begin:end], record.values(SERVO_VELOCITY)[begin:end]
    oil = record.signals.get(TEMPERATURE, np.full(len(record.time), OIL_TEMPERATURE))[begin:end]
    low, high = simulator.rig.limits.position
    room = BEYOND_STROKE * (high - low)
    none = np.zeros(len(simulator.rig.sensed))
    out = np.full((len(command), len(none)), np.nan)
    for k in range(len(command)):
        simulator.inputs[OIL] = oil[k]
        out[k] = simulator.measure(none)
        if not (low - room <= simulator.y[X] <= high + room and math.isfinite(float(np.sum(simulator.y)))):
            out[k:] = np.nan
            break
        simulator.advance(command[k], load[k], rates[k], servo[k], servo_speed[k])
    return out


def _first(record: Record, sensor: str, sensors: Mapping[str, Sensor]) -> float:
    """Return the initial value of a sensor's quantity, corrected for gain and bias; 0 without such a sensor."""
    signal = RECORDED_AS[sensor]
    if signal not in record:
        return 0.0
    samples = max(1, round(FREE_START / record.period))
    known = record.signals[signal][:samples][record.good[signal][:samples]]
    description = sensors.get(sensor, Sensor())
    return (float(np.mean(known)) - description.bias) / description.gain if known.size else 0.0


def _start(simulator: Simulator, record: Record) -> None:
    """Set the state to the initial measurements, and friction to the value that balances the forces there."""
    plant, sensors, y = simulator.rig.plant, simulator.rig.sensors, simulator.y
    y[X] = _first(record, "position", sensors)
    pressure = _first(record, "load_pressure", sensors)
    if PRESSURE not in record:
        pressure = _first(record, "force", sensors) / plant.piston_area
    chambers = None
    if has_both_chambers(record.signals):
        chambers = _first(record, "pressure_a", sensors), _first(record, "pressure_b", sensors)
    set_pressures(simulator, pressure, chambers, _first(record, "supply_pressure", sensors) if SUPPLY in record else None)
    y[XV] = _first(record, "spool_position", sensors) if SPOOL in record else plant.valve_gain * record.values(COMMAND)[0]
    if VELOCITY in record:
        y[V] = _first(record, "velocity", sensors)
    else:
        samples = max(3, round(FREE_START / record.period))
        y[V] = float(np.polyfit(record.time[:samples] - record.time[0], record.signals[POSITION][:samples], 1)[0])
    balance_friction(simulator, record, 0)


def set_pressures(simulator: Simulator, load: float, chambers: tuple[float, float] | None, supply: float | None) -> None:
    """Set the pressures in the state.

    Args:
        simulator: the rig.
        load: load pressure [Pa].
        chambers: pressures of A and B [Pa]; if they are not known, those with this driving force that differ equally from rest.
        supply: supply pressure [Pa]; that of the rig if it is not known.
    """
    rig, y = simulator.rig, simulator.y
    y[PL] = load
    if not rig.cylinder.law.CHAMBERS:
        return
    p, driving = rig.cylinder.parameters, rig.plant.piston_area * load
    if chambers is None:
        a, b, _ = rig.cylinder.law.at_rest(p, rig.plant)
        chambers = a + 0.5 * driving / p.area_a, b - 0.5 * driving / p.area_b
    first = FRICTION + rig_elements(rig)
    y[first : first + 3] = *chambers, rig.plant.supply_pressure if supply is None else supply


def balance_friction(simulator: Simulator, record: Record, at: int) -> None:
    """Set the friction elements to the force that balances the others, without acceleration.

    Args:
        simulator: the rig, whose position, velocity and load pressure are set.
        record: the recording, for its disturbance.
        at: the sample of this state.
    """
    rig, y = simulator.rig, simulator.y
    plant, friction = rig.plant, rig.friction
    driving = plant.piston_area * y[PL] - plant.spring_stiffness * y[X] - plant.moving_mass * plant.gravity
    held = driving - record.values(LOAD)[at] - (plant.viscous_damping + friction.viscous_coefficient) * y[V]
    elements = y[FRICTION : FRICTION + rig_elements(rig)]
    if elements.size:
        in_python(rig.friction_law.begin)(held, rig.friction_level(math.inf), friction, elements)
