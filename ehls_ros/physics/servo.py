"""Actuator under test as a position servo: a second piston with valve and position loop, coupled to the loader.

Both pistons are one system of equations. The state is the loader's, as in :mod:`ehls_ros.physics.plant`, followed by the
servo's: position, velocity, load pressure, spool displacement, friction forces. The modes are arranged in the same order. The
force of the coupling between the pistons acts on both, in opposite directions. The position loop is sampled once per control
period, and its command is held.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.physics.cylinder import double_rod
from ehls_ros.physics.effects.base import CHAMBER_HOOKS
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import FD, Chains, Coefficients, V, X, first_effect, follow_servo, system
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.valve import load_flow


class Servo(NamedTuple):
    """Position servo.

    Attributes:
        rig: coefficients, friction and limits of the servo; without effects and sensors.
        gain: gain of the position loop, velocity per position error [1/s].
        start: initial position [m].
    """

    rig: Rig
    gain: float
    start: float


class ServoConstants(NamedTuple):
    """Constants of a simulated servo.

    Attributes:
        plant: coefficients of the servo.
        friction: friction parameters of the servo.
        gain: gain of the position loop [1/s].
        spool_limit: largest spool command of the servo [m].
    """

    plant: Plant
    friction: Any
    gain: float
    spool_limit: float


class CoupledCoefficients(NamedTuple):
    """The loader's :class:`~ehls_ros.physics.plant.Coefficients`, with the servo's.

    Attributes:
        plant, friction, inputs, effects, command, cylinder, valve: the loader's.
        servo: coefficients of the servo; its disturbance force is the coupling force on the loader.
    """

    plant: Plant
    friction: Any
    inputs: Array
    effects: Any
    command: float
    cylinder: Any
    valve: Any
    servo: Coefficients


@kernel_no_refcount
def _unchanged(value: Any, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> Any:
    """Return the model's value unchanged, in place of a hook."""
    return value


@kernel_no_refcount
def _unchanged_in_chamber(value: Any, pressure: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> Any:
    """Return the model's value unchanged, in place of a hook on a chamber."""
    return value


@kernel_no_refcount
def _no_rates(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant, dz: Array) -> None:
    """Write nothing, as there are no states."""


_HOOKS: dict[str, Any] = {
    **dict.fromkeys(Chains._fields, _unchanged),
    **dict.fromkeys(CHAMBER_HOOKS, _unchanged_in_chamber),
    "received": None,
    "jump": None,
    "rates": _no_rates,
}

NO_EFFECTS = Chains(**_HOOKS)
"""The hooks of a plant without effects."""


@kernel
def servo_command(
    wanted: float, wanted_velocity: float, x: float, load_pressure: float, gain: float, plant: Plant, limit: float
) -> float:
    """Return the spool command of the position loop [m]: proportional, with feedforward of the flow for the motion.

    Args:
        wanted: position setpoint [m].
        wanted_velocity: rate of the setpoint [m/s].
        x: position of the servo [m].
        load_pressure: load pressure of the servo [Pa].
        gain: velocity per position error [1/s].
        plant: coefficients of the servo.
        limit: largest spool command of the servo [m].
    """
    velocity = wanted_velocity + gain * (wanted - x)
    drop = plant.supply_pressure - math.copysign(1.0, velocity) * load_pressure
    root = math.sqrt(max(drop, 0.01 * plant.supply_pressure) / plant.oil_density)
    spool = plant.piston_area * velocity / (plant.discharge_coefficient * plant.valve_area_gradient * root)
    command = spool / plant.valve_gain
    return 0.0 if math.isnan(command) else min(max(command, -limit), limit)


def coupled_system(
    cylinder: Any, valve: Any, friction: Any, elements: int, states: int, chains: Chains
) -> tuple[Callable[..., float], Callable[..., None]]:
    """Build the loader's plant coupled to a servo with the same friction model; the servo has a double rod.

    Args:
        cylinder: module of the loader's cylinder.
        valve: module of its valve.
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the loader's effects.

    Returns:
        ``evaluate`` and ``switch`` for :mod:`ehls_ros.physics.integration`; their coefficients are
        :class:`CoupledCoefficients`, whose inputs they write to.
    """
    end = first_effect(cylinder, elements)
    size, modes = end + states, valve.MODES + cylinder.MODES + elements
    evaluate_loader, switch_loader = system(cylinder, valve, friction, elements, chains)
    evaluate_servo, switch_servo = system(double_rod, load_flow, friction, elements, NO_EFFECTS)
    coupling_force = chains.coupling_force

    @kernel_no_refcount
    def join(t: float, y: Array, c: CoupledCoefficients) -> None:
        """Update the coupling inputs of both pistons to the state at t."""
        follow_servo(c.inputs, t, y[size + X], y[size + V])
        loader = y[:size]
        c.servo.inputs[FD] = coupling_force(0.0, t, loader, c.inputs, y[end:size], c.effects, c.plant)

    @kernel_no_refcount
    def evaluate(t: float, y: Array, mode: Array, c: CoupledCoefficients, rate: Array) -> float:
        join(t, y, c)
        loader = evaluate_loader(t, y[:size], mode[:modes], c, rate[:size])
        servo = evaluate_servo(t, y[size:], mode[modes:], c.servo, rate[size:])
        return max(loader, servo)

    @kernel_no_refcount
    def switch(t: float, y: Array, mode: Array, c: CoupledCoefficients) -> None:
        join(t, y, c)
        switch_loader(t, y[:size], mode[:modes], c)
        switch_servo(t, y[size:], mode[modes:], c.servo)

    return evaluate, switch
