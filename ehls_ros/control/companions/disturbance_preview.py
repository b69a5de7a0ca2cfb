"""Preview of the disturbance, from the command of the actuator under test before it moves.

The force of a force actuator is its command. A position servo is simulated ahead together with the loader that it moves
(:mod:`ehls_ros.control.servo_model`); it acts on the loader through the modelled coupling, m v' = ... - d with
d = -(kc x + cc v). The model may be wrong: the law's filter estimates the error of the predicted force.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import Companion, Setting, Upcoming
from ehls_ros.control.controllers.base import FORESEEN, ROW, Model
from ehls_ros.control.disturbances.position_servo import MovingMass, PositionGain, SupplyPressure, servo_plant
from ehls_ros.control.servo_model import pair, servo_kernel
from ehls_ros.errors import BadInput
from ehls_ros.physics.parameters import Plant

ACTUATOR = True

BRIDGED = 10
"""Most omitted cycles over which the servo is assumed to have followed its command."""

SETTLING = 10.0
"""Time constants of the position loop after which the initial state of the servo's model no longer matters."""


class Parameters(NamedTuple):
    """Position servo with valve and cylinder of the loader's type; unused for a force actuator."""

    moving_mass: MovingMass = 70.0
    supply_pressure: SupplyPressure = 2.1e7
    position_gain: PositionGain = 30.0


class ForceActuator(Companion):
    """Preview for a force actuator, whose force is its command."""

    def ahead(self, upcoming: Upcoming) -> None:
        """Write the force and its derivatives into the rows."""
        upcoming.rows[:, FORESEEN:] = upcoming.actuator


class PositionServo(Companion):
    """Preview for a position servo, by simulating the force of its motion on the loader."""

    def __init__(self, p: Parameters, model: Model, alike: Plant) -> None:
        """Initialise servo and loader at rest; the servo's valve and cylinder are like given ones."""
        servo = model._replace(plant=servo_plant(alike, p.moving_mass, p.supply_pressure))
        self._pair = pair(servo, model, p.position_gain)
        self._foresee = servo_kernel().foresee
        self._period = model.period
        self._settling = SETTLING / p.position_gain / model.period if p.position_gain > 0.0 else math.inf
        self._next = -1
        self._age = 0.0

    def prepare(self) -> None:
        """Compile or load the simulation of both by a call without cycles."""
        self._foresee(np.empty((0, ROW)), np.empty((0, FORESEEN)), self._pair)

    def ahead(self, upcoming: Upcoming) -> None:
        """Simulate the servo over these cycles, and write the force and its derivatives into the rows.

        At cycle 0 the servo and its model are at rest. The preview of a model started later is used only after it has settled.
        """
        left_out = upcoming.first - self._next
        if 0 < left_out <= BRIDGED and self._next > 0:
            self._bridge(left_out, upcoming)
        elif left_out != 0:
            self._pair.started[:] = 0.0
            self._age = math.inf if upcoming.first == 0 else 0.0
        self._next = upcoming.first + len(upcoming.rows)
        self._foresee(upcoming.rows, upcoming.actuator, self._pair)
        cycles = np.arange(len(upcoming.rows))
        unknown = np.maximum.accumulate(np.where(np.isfinite(upcoming.actuator).all(axis=1), -1, cycles))
        age = np.where(unknown < 0, self._age + cycles, cycles - unknown - 1.0)
        upcoming.rows[age < self._settling, FORESEEN:] = np.nan
        self._age = float(age[-1]) + 1.0

    def _bridge(self, left_out: int, upcoming: Upcoming) -> None:
        """Simulate the servo over omitted cycles, by extrapolation from the first one after them."""
        rows = np.full((left_out, ROW), np.nan)
        rows[:, :FORESEEN] = before(upcoming.rows[0, :FORESEEN], left_out, self._period)
        commands = before(upcoming.actuator[0], left_out, self._period)
        self._foresee(rows, commands, self._pair)
        self._age += left_out


def before(row: Array, cycles: int, period: float) -> Array:
    """Extrapolate a value and its derivatives to the cycles before a row, with constant second derivative.

    Args:
        row: value and its two derivatives, shape (3,).
        cycles: number of cycles.
        period: control period [s].

    Returns:
        The rows in order of time, shape (cycles, 3).
    """
    ago = period * np.arange(-float(cycles), 0.0)
    value = row[0] + ago * (row[1] + 0.5 * ago * row[2])
    return np.column_stack((value, row[1] + ago * row[2], np.full(cycles, row[2])))


def check(p: Parameters, setting: Setting) -> None:
    """Reject a law that uses no preview, and a position servo with unknown coupling.

    Raises:
        BadInput: either is the case.
    """
    if not getattr(setting.law, "PREVIEW", False):
        raise BadInput("this controller does not use what is foreseen", "companion disturbance_preview", "one that has PREVIEW")
    if setting.actuator != "force" and setting.model.coupling_stiffness == 0.0:
        expected = "coupling_stiffness under known_effects of the experiment, or under effects of the controller's rig"
        raise BadInput("the controller does not know the coupling to the servo", "companion disturbance_preview", expected)


def build(p: Parameters, setting: Setting) -> Companion:
    """Return a new preview companion."""
    if setting.actuator == "force":
        return ForceActuator()
    return PositionServo(p, setting.model, setting.under_test or setting.model.plant)
