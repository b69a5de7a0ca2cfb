"""Derivatives of a trajectory."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.duals import constant, dual_array, dual_record
from ehls_ros.physics import sensors, simulator
from ehls_ros.physics.plant import TEMPERATURE, Chains
from ehls_ros.physics.simulator import Constants, State


class Given(NamedTuple):
    plant: Any
    friction: Any
    plant_rows: Array
    friction_rows: Array
    effect_rows: Array
    period: float
    step: float
    steps: int


class Start(NamedTuple):
    y: Array
    mode: Array
    inputs: Array
    work: Array
    sensors: sensors.SensorState
    truth: Array
    measured: Array


class Sensitive(NamedTuple):
    run: Callable[..., int]


def build(friction: Any, elements: int, states: int, chains: Chains, width: int) -> Sensitive:
    built = simulator.build(friction, elements, states, chains)
    advance, sense, hold = built.advance, built.sense, built.hold

    @kernel
    def run(given: Given, start: Start, rows: Array, noise: Array, out: Array) -> int:
        constants = Constants(
            dual_record(given.plant_rows, width, given.plant),
            dual_record(given.friction_rows, width, given.friction),
            dual_array(given.effect_rows, width),
            constant(given.period, width),
            constant(given.step, width),
            given.steps,
            0.0,
        )
        state = State(
            dual_array(start.y, width),
            start.mode,
            start.inputs,
            dual_array(start.work, width),
            sensors.SensorState(
                start.sensors.table, dual_array(start.sensors.lagged, width), dual_array(start.sensors.past, width)
            ),
            dual_array(start.truth, width),
            dual_array(start.measured, width),
        )
        dense, written = 0, dual_array(out, width)
        for k in range(rows.shape[0]):
            state.inputs[TEMPERATURE] = rows[k, 5]
            sense(k, constants, state, noise)
            row, measured = written[k], state.measured
            for i in range(measured.size):
                row[i] = measured[i]
            hold(state.inputs, k * given.period, rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4])
            dense += advance(k, constants, state)
        return dense

    return Sensitive(run)


def build_plain(friction: Any, elements: int, states: int, chains: Chains) -> Sensitive:
    built = simulator.build(friction, elements, states, chains)
    advance, sense, hold = built.advance, built.sense, built.hold

    @kernel
    def run(constants: Any, state: Any, rows: Array, noise: Array, out: Array) -> int:
        dense = 0
        for k in range(rows.shape[0]):
            state.inputs[TEMPERATURE] = rows[k, 5]
            sense(k, constants, state, noise)
            out[k] = state.measured
            hold(state.inputs, k * constants.period, rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4])
            dense += advance(k, constants, state)
        return dense

    return Sensitive(run)
