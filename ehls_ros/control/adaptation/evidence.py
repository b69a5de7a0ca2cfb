"""Accumulate the regression data of all stages by one compiled function."""

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.adaptation import area, flow, friction
from ehls_ros.control.adaptation import valve as valve_stage
from ehls_ros.control.controllers.base import MIN_DROP, Model
from ehls_ros.physics import sensors
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.friction import gms
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.valve import VALVES

VALVE, FLOW, AREA, STAGES = range(4)
"""Indices of the stages' counts, and the number of stages."""

SINCE, SPOOL_READ, FLAGS = range(3)
"""Indices of flags: cycles since the last interruption, whether the spool was ever read; and the number of flags."""


class Basis(NamedTuple):
    """Reference of all estimates, from the rig file.

    Attributes:
        plant: coefficients of the rig file.
        delay: command delay [s].
        bank: delays to compare, with the bandwidth in use.
        fading: forgetting factor of a reading's weight per cycle.
        settled: cycles after an interruption before the valve's state is used.
        travel: motion back after which a reversal is detected [m].
        cylinder, valve: their parameters in the rig file.
    """

    plant: Plant
    delay: float
    bank: valve_stage.Bank
    fading: float
    settled: float
    travel: float
    cylinder: Any
    valve: Any


class Memory(NamedTuple):
    """Accumulated data of all stages; every array is updated in place.

    Attributes:
        flags: by the indices above.
        past: memory of :func:`ehls_ros.control.adaptation.valve.follow`.
        block: open block of :func:`ehls_ros.control.adaptation.flow.balance`.
        valve, flow, area: sums of the stages.
        counts: total weights of their rows, shape (STAGES, 1).
        row: scratch.
        track, ring: memory of :func:`ehls_ros.control.adaptation.friction.follow`.
    """

    flags: Array
    past: Array
    block: Array
    valve: Array
    flow: Array
    area: Array
    counts: Array
    row: Array
    track: Array
    ring: Array


def memory(basis: Basis) -> Memory:
    """Return the memory before the first cycle."""
    columns = valve_stage.columns(basis.bank.delays)
    return Memory(
        np.zeros(FLAGS),
        np.zeros((2, basis.bank.first + basis.bank.delays)),
        np.zeros(flow.OPEN),
        np.zeros((columns, columns)),
        np.zeros((flow.ROW, flow.ROW)),
        np.zeros((area.ROW, area.ROW)),
        np.zeros((STAGES, 1)),
        np.zeros(columns),
        np.zeros(friction.TRACKED),
        np.zeros((friction.RING, friction.SIGNALS)),
    )


def interrupt(memory: Memory) -> None:
    """Discard incomplete data after an interruption."""
    memory.flags[SINCE] = 0.0
    memory.past[:] = 0.0
    memory.block[:] = 0.0
    memory.track[:] = 0.0


def basis_of(model: Model, reach: float, forgetting: float) -> Basis:
    """Return the reference of the estimates from a rig file's model.

    Args:
        model: the rig file's.
        reach: largest relative change of the delay to search for.
        forgetting: time constant of the forgetting of readings [s].
    """
    cycles = model.command_delay / model.period
    first = max(math.floor((1.0 - reach) * cycles) - 1, 0)
    count = math.ceil((1.0 + reach) * cycles) + valve_stage.EXTRA + 1 - first
    plant = model.plant
    bank = valve_stage.Bank(first, count, plant.valve_bandwidth, plant.valve_gain, model.period)
    fading = math.exp(-model.period / forgetting)
    sliding = model.friction if isinstance(model.friction, gms.Parameters) else friction.NONE
    way = friction.BACK * friction.travel(sliding)
    return Basis(plant, model.command_delay, bank, fading, float(bank.settled), way, model.cylinder, model.valve)


def with_bandwidth(basis: Basis, bandwidth: float, memory: Memory) -> Basis:
    """Return a basis with another bandwidth of the valve [rad/s], and discard the valve's accumulated data."""
    memory.valve[:] = memory.counts[VALVE] = memory.past[:] = 0.0
    memory.flags[SINCE] = 0.0
    bank = basis.bank._replace(bandwidth=bandwidth)
    return basis._replace(bank=bank, settled=float(bank.settled))


class _Taking(NamedTuple):
    """The compiled entry."""

    take: Callable[..., None]


def build(cylinder: Any, valve: Any) -> _Taking:
    """Build the compiled entry for a cylinder and its valve."""
    equivalent, load_flow = cylinder.equivalent(valve), cylinder.load_flow(valve)

    @kernel
    def take_one(measured: Array, basis: Basis, memory: Memory) -> None:
        plant, counts, flags = basis.plant, memory.counts, memory.flags
        position, pressure = measured[sensors.POSITION], measured[sensors.LOAD_PRESSURE]
        spool, force = measured[sensors.SPOOL], measured[sensors.FORCE]
        settled = flags[SINCE] >= basis.settled
        if math.isfinite(spool):
            if flags[SPOOL_READ] == 0.0:
                flags[SPOOL_READ] = 1.0
                memory.flow[:, :] = 0.0
                counts[FLOW, 0] = 0.0
            if settled:
                valve_stage.compare(spool, basis.bank, memory.past, basis.fading, memory.row, memory.valve, counts[VALVE])
        elif flags[SPOOL_READ] == 0.0 and settled:
            spool = valve_stage.spool_at(basis.delay, basis.bank, memory.past)
        rod = equivalent(measured, spool, MIN_DROP, plant, basis.cylinder, basis.valve)
        driving = pressure - rod.offset / plant.piston_area
        through = load_flow(measured, spool, MIN_DROP, plant, basis.cylinder, basis.valve)
        fading = basis.fading**flow.BLOCK
        scratch = memory.row[: flow.ROW]
        flow.balance(
            position, driving, through, rod.plant, basis.bank.period, fading, memory.block, scratch, memory.flow, counts[FLOW]
        )
        if math.isfinite(force + pressure):
            few = memory.row[: area.ROW]
            area.compare(force, pressure, plant.piston_area, basis.fading, few, memory.area, counts[AREA])
        if not math.isfinite(force):
            force = plant.piston_area * pressure
        friction.follow(position, force, basis.travel, memory.track, memory.ring)

    @kernel
    def take(measured: Array, command: Array, basis: Basis, memory: Memory) -> None:
        for i in range(len(command)):
            take_one(measured[i], basis, memory)
            memory.flags[SINCE] += 1.0
            if math.isfinite(command[i]):
                valve_stage.follow(command[i], basis.bank, memory.past)

    return _Taking(take)


def evidence_kernel(cylinder: str, valve: str) -> ModuleType:
    """Return a module with the compiled ``take(measured, command, basis, memory)``, which adds cycles to the accumulated data.

    Its arguments are the readings in the order of ``SENSED``, shape (n, signals), the spool commands [m], shape (n,), the
    reference from the rig file, and the accumulated data, updated in place.

    Args:
        cylinder: file name of the cylinder.
        valve: that of its valve.
    """
    members = {"cylinder": CYLINDERS.load(cylinder), "valve": VALVES.load(valve)}
    return compiled(build, {"take": "measured, command, basis, memory"}, members)
