"""The disturbance to come, where the command of the actuator under test is known before it moves.

A force actuator's force is its command. A position servo is simulated ahead with the loader that it moves
(:mod:`ehls_ros.control.servo_model`); it enters the loader through the coupling that the controller knows, m v' = ... - d with
d = -(kc x + cc v). The model may be wrong: the law's filter estimates what the foreseen force lacks.
"""

from collections.abc import Mapping
from typing import NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import Past, Setting, Upcoming
from ehls_ros.control.composition import servo_kernel
from ehls_ros.control.controllers.base import FORESEEN, Model
from ehls_ros.control.disturbances.position_servo import MovingMass, PositionGain, SupplyPressure, servo_plant
from ehls_ros.control.servo_model import pair
from ehls_ros.errors import BadInput

ACTUATOR = True


class Parameters(NamedTuple):
    """The position servo, whose valve and cylinder are of the loader's type; a force actuator needs none of them."""

    moving_mass: MovingMass = 70.0
    supply_pressure: SupplyPressure = 2.1e7
    position_gain: PositionGain = 30.0


class ForceActuator:
    """Hands the law the actuator's force."""

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

    def save(self) -> None:
        """Store nothing."""


class PositionServo(ForceActuator):
    """Turns a position servo's command into the force that its motion will bring to the loader."""

    def __init__(self, p: Parameters, model: Model) -> None:
        """Prepare servo and loader, and compile (or load) their motion."""
        servo = model._replace(plant=servo_plant(model.plant, p.moving_mass, p.supply_pressure))
        self._pair = pair(servo, model, p.position_gain)
        self._foresee = servo_kernel().foresee
        self._next = -1

    def ahead(self, upcoming: Upcoming) -> None:
        """Move the servo through these cycles, and write the force and its derivatives into the rows."""
        if upcoming.first != self._next:
            self._pair.started[:] = 0.0
        self._next = upcoming.first + len(upcoming.rows)
        self._foresee(upcoming.rows, upcoming.actuator, self._pair)


def build(p: Parameters, setting: Setting) -> ForceActuator:
    """Return the preview ready to work.

    Raises:
        BadInput: the law uses no preview, or nothing is known of the coupling to a position servo.
    """
    if not getattr(setting.law, "PREVIEW", False):
        raise BadInput("this controller does not use what is foreseen", "disturbance_preview", "one that has PREVIEW")
    if setting.actuator == "force":
        return ForceActuator()
    if setting.model.coupling_stiffness == 0.0:
        expected = "coupling_stiffness under known_effects of the experiment, or under effects of the controller's rig"
        raise BadInput("the controller does not know the coupling to the servo", "disturbance_preview", expected)
    return PositionServo(p, setting.model)
