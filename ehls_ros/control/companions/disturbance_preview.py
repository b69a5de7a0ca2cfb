"""The disturbance to come, where the command of the actuator under test is known before it moves.

A force actuator's force is its command. A position servo is simulated ahead with the loader that it moves
(:mod:`ehls_ros.control.servo_model`); it enters the loader through the coupling that the controller knows, m v' = ... - d with
d = -(kc x + cc v). The model may be wrong: the law's filter estimates what the foreseen force lacks.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import Kept, Past, Setting, Upcoming
from ehls_ros.control.composition import servo_kernel
from ehls_ros.control.controllers.base import FORESEEN, ROW, Model
from ehls_ros.control.disturbances.position_servo import MovingMass, PositionGain, SupplyPressure, servo_plant
from ehls_ros.control.servo_model import pair
from ehls_ros.errors import BadInput

ACTUATOR = True

BRIDGED = 10
"""Most cycles left out through which the servo is taken to have followed its command."""

SETTLING = 10.0
"""Time constants of the position loop after which it no longer matters where the servo's model started."""


class Parameters(NamedTuple):
    """The position servo, whose valve and cylinder are of the loader's type; a force actuator needs none of them."""

    moving_mass: MovingMass = 70.0
    supply_pressure: SupplyPressure = 2.1e7
    position_gain: PositionGain = 30.0


class ForceActuator:
    """Hands the law the actuator's force."""

    def prepare(self) -> None:
        """Do nothing: nothing is compiled."""

    def room(self, first: int, place: Array) -> int:
        """Return the number of these cycles: nothing is learnt from them."""
        return len(place)

    def ahead(self, upcoming: Upcoming) -> None:
        """Write the force and its derivatives into the rows."""
        upcoming.rows[:, FORESEEN:] = upcoming.actuator

    def done(self, past: Past, model: Model) -> Model:
        """Return the model as it is."""
        return model

    def interrupt(self) -> None:
        """Do nothing: the actuator's command goes on."""

    def report(self) -> Mapping[str, float | str]:
        """Return nothing."""
        return {}

    def at_bounds(self) -> tuple[str, ...]:
        """Return nothing: nothing is estimated."""
        return ()

    def kept(self) -> Kept:
        """Keep nothing: nothing is learnt."""
        return Kept()

    def recall(self, kept: Kept) -> None:
        """Recall nothing."""


class PositionServo(ForceActuator):
    """Turns a position servo's command into the force that its motion will bring to the loader."""

    def __init__(self, p: Parameters, model: Model) -> None:
        """Put servo and loader at rest."""
        servo = model._replace(plant=servo_plant(model.plant, p.moving_mass, p.supply_pressure))
        self._pair = pair(servo, model, p.position_gain)
        self._foresee = servo_kernel().foresee
        self._period = model.period
        self._settling = SETTLING / p.position_gain / model.period if p.position_gain > 0.0 else math.inf
        self._next = -1
        self._age = 0.0

    def prepare(self) -> None:
        """Compile or load the motion of both: they move through no cycle."""
        self._foresee(np.empty((0, ROW)), np.empty((0, FORESEEN)), self._pair)

    def ahead(self, upcoming: Upcoming) -> None:
        """Move the servo through these cycles, and write the force and its derivatives into the rows.

        At cycle 0 the servo is at rest, as its model is. A model that starts later is believed once it has settled.
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
        """Move the servo through cycles that were left out, by what is known of the first one after them."""
        rows = np.full((left_out, ROW), np.nan)
        rows[:, :FORESEEN] = before(upcoming.rows[0, :FORESEEN], left_out, self._period)
        commands = before(upcoming.actuator[0], left_out, self._period)
        self._foresee(rows, commands, self._pair)
        self._age += left_out


def before(row: Array, cycles: int, period: float) -> Array:
    """Return the cycles before a row of a value and its two derivatives, the second taken as constant.

    Args:
        row: shape (3,).
        cycles: how many.
        period: of the cycles [s].

    Returns:
        The rows in order of time, shape (cycles, 3).
    """
    ago = period * np.arange(-float(cycles), 0.0)
    value = row[0] + ago * (row[1] + 0.5 * ago * row[2])
    return np.column_stack((value, row[1] + ago * row[2], np.full(cycles, row[2])))


def check(p: Parameters, setting: Setting) -> None:
    """Refuse a law that uses no preview, and a position servo of whose coupling nothing is known.

    Raises:
        BadInput: it is one of both.
    """
    if not getattr(setting.law, "PREVIEW", False):
        raise BadInput("this controller does not use what is foreseen", "companion disturbance_preview", "one that has PREVIEW")
    if setting.actuator != "force" and setting.model.coupling_stiffness == 0.0:
        expected = "coupling_stiffness under known_effects of the experiment, or under effects of the controller's rig"
        raise BadInput("the controller does not know the coupling to the servo", "companion disturbance_preview", expected)


def build(p: Parameters, setting: Setting) -> ForceActuator:
    """Return the preview ready to work."""
    return ForceActuator() if setting.actuator == "force" else PositionServo(p, setting.model)
