"""Interface of the file of a controller.

A file has these members:

* ``Parameters``: named tuple declaring its parameters.
* ``FOLLOWS``: kind of its reference, force or position.
* ``FRICTION``: whether it uses the friction estimate.
* ``NEEDS``: required readings.
* ``memory(parameters)``: its state before the first cycle.
* ``FRICTION_MODEL``: optional; its only supported friction model.
* ``step(m, r, f, p, model, memory, status) -> spool command [m]``: its compiled law.

The arguments of ``step`` are:

* ``m``: measurement in the order of :data:`ehls_ros.physics.rig.SENSED`; further readings of a rig may follow.
* ``r``: row of :data:`ROW` numbers.
* ``f``: friction of the elements and viscous friction [N].
* ``p``: its parameters.
* ``model``: the :class:`Model`.
* ``memory``: its state, updated in place.
* ``status``: quantities at the indices below, filled in place.

``step`` keeps the command within ``model.spool_limit``, without windup. The command is finite for any measurement, and a
non-finite measurement leaves no trace in ``memory``.

A row begins with the reference and its first and second derivative. They are in N, N/s and N/s^2 for a force, and in m, m/s
and m/s^2 for a position. From :data:`FORESEEN` on it holds the foreseen external force and its two derivatives. They are NaN if
nothing is foreseen. A law that uses them has ``PREVIEW = True``.

A law that takes effects of the rig from the :class:`Model` names them in ``KNOWS``. It may lose control of the force if such an
effect of the rig is missing in its model.

A law whose numbers can be tuned for a rig names those that matter in ``TUNED``; each has a unit and bounds in ``Parameters``.

A law that computes its command by the valve's flow gain and lag, from the present opening, has ``INVERTS_VALVE = True``.

A law with bounded estimates names them in ``BOUNDED``, so that an estimate at its bound is reported.

A law that models the commands in transit, or adapts to the effect of its commands, adds a compiled

``follow(command, own, memory) -> own``

It is called between two steps while another controller drives. ``command`` [m] was sent to the valve, and ``own`` [m] was
returned by the last step. ``follow`` corrects ``memory`` accordingly, and returns the command that the step would then have
returned.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant, Sensor
from ehls_ros.physics.rig import Rig

E3, S, ALPHA, BETA, DELTA, U1, U2, U3, FORCE_ERROR, FORCE_BOUND, SATURATED, STATUS_SIZE = range(12)
"""Indices of the quantities in a status, and its size. Pressures and masses are in the paper's units, MPa and t."""

STATUS_TO_SI = np.ones(STATUS_SIZE)
"""SI value of one unit of each quantity, for messages and recordings."""
STATUS_TO_SI[[E3, S]] = 1e6
STATUS_TO_SI[[U1, U2, U3]] = 1e9

ELEMENTS_FORCE, VISCOUS_FORCE = 0, 1
"""Indices of the two forces in a friction estimate."""


MIN_DROP = 0.01
"""Lower bound of the valve's pressure drop in the laws' equations, as a fraction of the nominal supply pressure."""

FORESEEN = 3
"""Index in a law's row of the foreseen external force, followed by its two derivatives."""

ROW = 6
"""Number of entries in a law's row."""


class Noise(NamedTuple):
    """Standard deviation of one reading of a sensor, including rounding; 0 for a perfect or undescribed sensor.

    Attributes:
        position: of the piston position [m].
        load_pressure: of the load pressure [Pa].
        spool_position: of the spool displacement [m].
        force: of the force [N].
    """

    position: float = 0.0
    load_pressure: float = 0.0
    spool_position: float = 0.0
    force: float = 0.0


class Bounded(NamedTuple):
    """Bounded estimate in the status; its bounds are parameters of the law.

    Attributes:
        estimate: symbol of the estimate.
        place: index of the estimate in the status.
        upper: name of the parameter with the upper bound.
        lower: name of the parameter with the lower bound; if empty, minus the upper bound.
        unit: unit of the estimate.
        instead: alternative to moving a bound, as the end of a sentence.
    """

    estimate: str
    place: int
    upper: str
    lower: str = ""
    unit: str = "1"
    instead: str = ""


class Model(NamedTuple):
    """A controller's model of the rig.

    Attributes:
        plant: coefficients of the rig.
        friction: parameters of the friction model.
        period: control period [s].
        spool_limit: largest command [m].
        noise: noise of the sensors.
        command_delay: delay of the command to the valve [s].
        coupling_stiffness, coupling_damping: those of the coupling to the actuator under test [N/m, N s/m].
        cylinder, valve: parameters of cylinder and valve; () if they have none. Where a cylinder has chambers, a law is given
            the ``plant`` of :mod:`ehls_ros.control.local_plant`.
        stiffness: stiffness of the oil at the present position, over that at position 0, for which a law is tuned [1].
        gain_positive, gain_negative: flow per positive and negative opening, over that with the coefficients of ``plant`` [1].
    """

    plant: Plant
    friction: Any
    period: float
    spool_limit: float
    noise: Noise = Noise()
    command_delay: float = 0.0
    coupling_stiffness: float = 0.0
    coupling_damping: float = 0.0
    cylinder: Any = ()
    valve: Any = ()
    stiffness: float = 1.0
    gain_positive: float = 1.0
    gain_negative: float = 1.0


class ControllerLaw(Protocol):
    """The attributes of a controller's file.

    ``FRICTION_MODEL``, ``PREVIEW``, ``KNOWS``, ``TUNED``, ``BOUNDED`` and ``follow`` are optional. The learnt external force is
    passed to a law that has ``PREVIEW`` and, for its filter, ``assumptions``.
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
    """Return a controller's model of the rig from its rig description.

    Args:
        rig: the rig as described to the controller. Of its effects, the delay of the command and the coupling to the actuator
            under test are used.
        period: control period [s].
    """
    known = {use.name: use.parameters for use in rig.effects}
    delay, coupling = known.get("command_delay"), known.get("coupling_stiffness")
    return Model(
        rig.plant,
        rig.friction,
        period,
        rig.limits.spool,
        noise_of(rig.effective().sensors),
        0.0 if delay is None else delay.delay,
        0.0 if coupling is None else coupling.stiffness,
        0.0 if coupling is None else coupling.damping,
        rig.cylinder.parameters,
        rig.valve.parameters,
    )


def noise_of(sensors: Mapping[str, Sensor]) -> Noise:
    """Return the noise of a rig's sensors."""
    return Noise(*(sensors.get(signal, Sensor()).reading_std for signal in Noise._fields))


@kernel
def saturate(value: float, limit: float) -> float:
    """Limit a value to [-limit, limit]; NaN becomes 0."""
    if math.isnan(value):
        return 0.0
    return min(max(value, -limit), limit)
