"""What a controller's file provides.

``Parameters``, a named tuple declaring its parameters; ``FOLLOWS``, what the reference it follows is, force or
position; ``FRICTION``, whether it uses the friction estimate; ``NEEDS``, the readings it cannot do without;
``memory(parameters)``, its state before the first cycle; ``FRICTION_MODEL``, where it contains one friction model
and serves no other; and a compiled

``step(m, r, f, p, model, memory, status) -> spool command [m]``

with ``m`` the measurement in the order of :data:`ehls_ros.physics.rig.SENSED`, ``r`` a row of :data:`ROW` numbers, ``f``
friction of the elements and viscous friction [N], ``p`` its parameters, ``model`` the :class:`Model`, ``memory`` updated in
place, and ``status`` filled in place by the indices below. It keeps the command within ``model.spool_limit``
without winding up, and finite whatever the measurement; a measurement that is not finite leaves nothing in
``memory``.

A row holds the reference and its first and second derivative, [N, N/s, N/s^2] for a force and [m, m/s, m/s^2] for a position,
and from :data:`FORESEEN` on the external force that is foreseen, with its first and second derivative [N, N/s, N/s^2]; these
are NaN where nothing is foreseen. A law that uses them says so with ``PREVIEW = True``. One that reckons with effects of the
rig which :class:`Model` tells of names them in ``KNOWS``: it may lose the force where the rig has one that it is not told of.

A law that keeps estimates within bounds names them in ``BOUNDED``, so that one that stands at its bound is reported.

A law that reckons with the commands under way, or adapts to what its own do, adds a compiled

``follow(command, own, memory) -> own``

It is called between two steps while another controller drives, with the command [m] that went to the valve and the one that
the last step returned. It corrects ``memory`` by that, and returns what the step would then have returned.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant, Sensor
from ehls_ros.physics.rig import Rig

E3, S, ALPHA, BETA, DELTA, U1, U2, U3, FORCE_ERROR, FORCE_BOUND, SATURATED, STATUS_SIZE = range(12)
"""Where a status holds its quantities; and its size. Pressures and masses are in the paper's units, MPa and t."""

STATUS_TO_SI = np.ones(STATUS_SIZE)
"""SI value of one unit of each quantity, for messages and recordings."""
STATUS_TO_SI[[E3, S]] = 1e6
STATUS_TO_SI[[U1, U2, U3]] = 1e9

ELEMENTS_FORCE, VISCOUS_FORCE = 0, 1
"""Where a friction estimate holds its two forces."""


FORESEEN = 3
"""Where a row of what a law follows holds the foreseen external force and its two derivatives."""

ROW = 6
"""Numbers in a row of what a law follows."""


class Noise(NamedTuple):
    """Standard deviation of one reading of a sensor, rounding included; 0: a perfect sensor, or one not described.

    Attributes:
        position: [m].
        load_pressure: [Pa].
        spool_position: [m].
        force: [N].
    """

    position: float = 0.0
    load_pressure: float = 0.0
    spool_position: float = 0.0
    force: float = 0.0


class Bounded(NamedTuple):
    """An estimate in the status that a law keeps within bounds, which are parameters of the law.

    Attributes:
        estimate: its symbol.
        place: index of it in the status.
        upper: name of the parameter that is its upper bound.
        lower: name of the lower one; empty: minus the upper one.
        unit: of the estimate.
        instead: what may be done beside moving a bound, as the end of a sentence.
    """

    estimate: str
    place: int
    upper: str
    lower: str = ""
    unit: str = "1"
    instead: str = ""


class Model(NamedTuple):
    """What a controller knows of the rig.

    Attributes:
        plant: its coefficients.
        friction: parameters of its friction model.
        period: of the cycles [s].
        spool_limit: largest command [m].
        noise: of its sensors.
        command_delay: time a command takes to the valve [s].
        coupling_stiffness, coupling_damping: of what holds the piston to the actuator under test [N/m, N s/m].
    """

    plant: Plant
    friction: Any
    period: float
    spool_limit: float
    noise: Noise = Noise()
    command_delay: float = 0.0
    coupling_stiffness: float = 0.0
    coupling_damping: float = 0.0


class ControllerLaw(Protocol):
    """The attributes of one controller's file.

    ``FRICTION_MODEL``, ``PREVIEW``, ``KNOWS``, ``BOUNDED`` and ``follow`` may be absent. What is learnt of the force to come is
    told to a law that has ``PREVIEW`` and ``assumptions``, of its filter.
    """

    Parameters: Any
    FOLLOWS: Literal["force", "position"]
    FRICTION: bool
    NEEDS: tuple[str, ...]

    def memory(self, p: Any) -> Array:
        """Return the state before the first cycle."""

    def step(self, m: Array, r: Array, f: Array, p: Any, model: Model, memory: Array, status: Array) -> float:
        """Return the spool command [m]."""


def model_of(rig: Rig, period: float) -> Model:
    """Return what a controller knows of the rig as it believes it to be.

    Args:
        rig: that rig. Of its effects a controller uses the command's delay and the coupling to the actuator under test.
        period: of the cycles [s].
    """
    known = {use.name: use.parameters for use in rig.effects}
    delay, coupling = known.get("command_delay"), known.get("coupling_stiffness")
    return Model(
        rig.plant,
        rig.friction,
        period,
        rig.limits.spool,
        noise_of(rig.sensors),
        0.0 if delay is None else delay.delay,
        0.0 if coupling is None else coupling.stiffness,
        0.0 if coupling is None else coupling.damping,
    )


def noise_of(sensors: Mapping[str, Sensor]) -> Noise:
    """Return the noise of a rig's sensors."""
    return Noise(*(_deviation(sensors.get(signal, Sensor())) for signal in Noise._fields))


def _deviation(sensor: Sensor) -> float:
    """Return the standard deviation of a reading, that of its rounding included."""
    return math.hypot(sensor.noise_std, sensor.resolution / math.sqrt(12.0))


@kernel
def saturate(value: float, limit: float) -> float:
    """Cut a value to [-limit, limit]; NaN becomes 0."""
    if math.isnan(value):
        return 0.0
    return min(max(value, -limit), limit)
