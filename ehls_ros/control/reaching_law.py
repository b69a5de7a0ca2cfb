"""Reach the paper's sliding surface with a command that is held for a cycle and acts with a delay.

(34) uses the rates at one moment and holds the command for a cycle. Here the command is chosen for the whole cycle: between its
arrival and that of the next command it reduces the predicted s by the factor 1/(1 + reaching_rate T). s is nearly linear in the
command, so two trials suffice. This is s' = -K s stepped backwards, and it tends to (34) as T goes to 0. The paper's K of
8.8e4 1/s would remove all of s in one cycle, noise included.

The reference is extrapolated by its derivatives.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controllers import base
from ehls_ros.control.controllers.base import MIN_DROP, Model, saturate
from ehls_ros.control.state_estimator import (
    CELL_OFFSET,
    DISCHARGE,
    EXTERNAL,
    VALVE_GAIN,
    Assumptions,
    State,
    coupling_force,
    foresee,
    move,
    observe,
    rates,
    send,
    side_gain,
    state_of,
    supply_of,
)
from ehls_ros.physics import sensors
from ehls_ros.physics.plant import PL, XV
from ehls_ros.schema import quantity

TRIALS = 2
"""Number of trial commands with predicted outcome."""

KINK_TRIALS = 8
"""That number if the flow per opening jumps at null: a secant across null finds too small a command."""

STEEPEST = 3.0
"""Largest ratio, either way, of the slope of s over the command to that by the valve's flow alone."""


Slope = Annotated[
    float,
    quantity(
        "MPa/s", "slope of the sliding surface: speed of a large error is k/2", minimum=0.1, maximum=1e3, scale="pressure"
    ),
]
RateWeight = Annotated[float, quantity("1", "weight of the error's rate in the sliding variable", minimum=1e-3, maximum=1e3)]
ReachingRate = Annotated[float, quantity("1/s", "rate at which s is removed", minimum=0.0, maximum=1e6)]


class Surface(NamedTuple):
    """Sliding surface and reaching rate; k, g and xi are the paper's.

    Attributes:
        k: speed of a large error is k/2 [MPa/s].
        g: steepness near zero error [1/MPa].
        xi: weight of the error's rate [1].
        reaching_rate: rate at which s is removed [1/s].
    """

    k: float
    g: float
    xi: float
    reaching_rate: float


@kernel
def pressure_error(y: Array, wanted: float, area: float) -> float:
    """Return (26) [MPa] for a mean, with the force as read by the load cell."""
    return (y[PL] - (wanted - y[CELL_OFFSET]) / area) * 1e-6


@kernel
def sliding_variable(error: float, error_rate: float, surface: Surface) -> float:
    """Return (27) [MPa/s]."""
    return surface.xi * error_rate + surface.k / (1.0 + math.exp(-surface.g * error)) - 0.5 * surface.k  # (27)


@kernel
def foreseen_variable(
    ahead: float, r: Array, supply: float, surface: Surface, model: Model, p: Assumptions, state: State
) -> float:
    """Return s of the predicted mean, ``ahead`` [s] from now."""
    area, rate = model.plant.piston_area, state.work[0]
    wanted = r[0] + ahead * (r[1] + 0.5 * ahead * r[2])
    wanted_rate = r[1] + ahead * r[2]
    rates(state.foreseen, state.foreseen_mode, 0.0, supply, model, p, rate)
    error_rate = (rate[PL] - wanted_rate / area) * 1e-6
    return sliding_variable(pressure_error(state.foreseen, wanted, area), error_rate, surface)


@kernel
def command_for(r: Array, supply: float, surface: Surface, model: Model, p: Assumptions, state: State) -> float:
    """Return the law's spool command [m] before limitation."""
    plant, period = model.plant, model.period
    foresee(supply, model, p, state)
    s = foreseen_variable(p.command_delay, r, supply, surface, model, p, state)
    target = s / (1.0 + surface.reaching_rate * period)
    side = 1.0 if state.foreseen[XV] >= 0.0 else -1.0
    drop = max(supply - side * state.foreseen[PL], MIN_DROP * plant.supply_pressure)
    discharge = side_gain(side, model) * plant.discharge_coefficient * (1.0 + state.foreseen[DISCHARGE])
    flow_gain = discharge * plant.valve_area_gradient * math.sqrt(drop / plant.oil_density)
    opened = plant.valve_gain * (1.0 + state.foreseen[VALVE_GAIN]) * -math.expm1(-plant.valve_bandwidth * period)
    usual = surface.xi * 4.0 * plant.bulk_modulus / plant.total_volume * flow_gain * opened * 1e-6
    slope, tried, outcome = usual, 0.0, 0.0
    wanted = state.commands[0]
    for trial in range(TRIALS if model.gain_positive == model.gain_negative else KINK_TRIALS):
        if trial > 0:
            foresee(supply, model, p, state)
        command = saturate(wanted, model.spool_limit)
        move(state.foreseen, state.foreseen_mode, command, supply, period, model, p, state.work)
        s = foreseen_variable(p.command_delay + period, r, supply, surface, model, p, state)
        if trial > 0 and command != tried:
            found = (s - outcome) / (command - tried)
            slope = min(max(found, usual / STEEPEST), usual * STEEPEST)
        tried, outcome = command, s
        wanted = command + (target - s) / slope
    return wanted


@kernel
def answer(m: Array, r: Array, surface: Surface, model: Model, p: Assumptions, memory: Array, status: Array) -> float:
    """Return the spool command [m] from the filter's update by the readings, and store it as sent.

    Args:
        m: readings in the order of ``SENSED``.
        r: row that the law follows, as defined in :mod:`ehls_ros.control.controllers.base`.
        surface: the sliding surface.
        model: model of the rig.
        p: the filter's assumptions.
        memory: the filter's memory, followed by further memory of the law; all of it is reset if numbers are out of range.
        status: output.
    """
    status[:] = 0.0
    state, supply = state_of(memory), supply_of(m, model)
    if not observe(m, r[base.FORESEEN :], model, p, state):
        status[base.SATURATED] = 1.0
        return 0.0
    wanted = command_for(r, supply, surface, model, p, state)
    command = saturate(wanted, model.spool_limit)
    send(command, state)
    y, area = state.mean, model.plant.piston_area
    error = pressure_error(y, r[0], area)
    rates(y, state.mode, 0.0, supply, model, p, state.work[0])
    status[base.E3] = error
    status[base.S] = sliding_variable(error, (state.work[0, PL] - r[1] / area) * 1e-6, surface)
    status[base.ALPHA] = status[base.BETA] = 1.0
    status[base.DELTA] = y[EXTERNAL] + coupling_force(y, p)
    status[base.FORCE_ERROR] = m[sensors.FORCE] - r[0]
    status[base.SATURATED] = 1.0 if wanted != command else 0.0
    # The filter cannot recover from numbers out of range: reset it for the next measurement.
    if not math.isfinite(memory.sum()):
        memory[:] = 0.0
    return command


@kernel
def follow(command: float, own: float, memory: Array) -> float:
    """Replace the law's last command by the one sent to the valve [m]; the law's command does not depend on it."""
    state_of(memory).commands[0] = command
    return own


def tracking(omega: Array, surface: Surface, period: float, delay: float) -> NDArray[np.complex128]:
    """Return the small-signal response of the force to the reference, for the modelled rig.

    With F the force, r the reference, h = delay + period and lambda = k g / (4 xi), the command of a cycle makes
    (F' + lambda F)(t + h) - (r' + lambda r), extrapolated over h, equal to 1/(1 + reaching_rate T) of its value over the delay.

    Args:
        omega: frequencies [rad/s].
        surface: the sliding surface.
        period: control period [s].
        delay: delay of a command to the valve [s].
    """
    turning = (1j * omega).astype(np.complex128)
    slope = surface.k * surface.g / (4.0 * surface.xi)
    kept = 1.0 / (1.0 + surface.reaching_rate * period)

    def extrapolated(ahead: float) -> NDArray[np.complex128]:
        rate = turning * (1.0 + turning * ahead)
        value: NDArray[np.complex128] = rate + slope * (1.0 + turning * ahead * (1.0 + 0.5 * turning * ahead))
        return value

    wanted = extrapolated(delay + period) - kept * extrapolated(delay)
    reached = np.exp(turning * (delay + period)) - kept * np.exp(turning * delay)
    response: NDArray[np.complex128] = wanted / (reached * (turning + slope))
    return response
