"""Stability margins of a law on a rig, from the loop's response to an impulse of the command.

A law with a filter has no transfer function that could be written down. Its loop is measured as on a rig, but in simulation and
without noise: the same run is made twice, once with a small impulse added to one command on its way to the valve. The
difference of the commands that the valve receives, over the impulse, is the impulse response of the sensitivity S = 1/(1 + L),
and L = 1/S - 1.

The loop is that of a moving piston: all friction elements slip, their force is constant, and the rig without it has the same
loop. The impulse acts at the largest velocity of the actuator under test, when the filter expects an active external force and
its loop is the fastest. At rest, friction damps any oscillation that could begin.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ehls_ros.control.disturbances.base import FORCE_RATE, VELOCITY
from ehls_ros.control.margins import LoopMargins, loop_margins
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.experiments.tuning.task import loses
from ehls_ros.physics.friction import gms
from ehls_ros.physics.rig import Rig

EARLIEST, LATEST, WINDOW = 0.8, 1.8, 1.0
"""Times between which the impulse acts, and time over which the response is taken [s]."""

DECAY = 1.5
"""Rate of the exponential by which the response is multiplied [1/s]: the loop is evaluated as far to the right of the imaginary
axis, less than a hundredth of the frequencies that matter, so that slow modes need not decay within the window."""

IMPULSE = 1e-6
"""Impulse over the largest spool command."""

DECAYED = 3e-2
"""Largest such response over the impulse in the last tenth of the window for a stable loop."""

RESOLUTION = 16
"""Length of the Fourier transform over that of the response, so that neighbouring frequencies lie close together."""

SLIPPING = 1e-6
"""Friction of the elements of a rig whose friction is left out, over the rig's."""

UNSTABLE = LoopMargins(0.0, 0.0, 0.0, 0.0)
"""Margins of an unstable loop, and of one that has lost the force: there, the valve at its limit answers no impulse."""


def margins_of(spec: Spec) -> LoopMargins:
    """Return the margins of a law on the rig that it knows; all zero if its loop is unstable or loses the force."""
    period = spec.settings.control_period
    earliest, latest, window = (round(time / period) for time in (EARLIEST, LATEST, WINDOW))
    settings = spec.settings._replace(duration=(latest + window) * period)
    smooth = changed(spec, slipping)
    smooth = smooth._replace(settings=settings, rig=smooth.rig._replace(sensors={}))
    usual = stepped_run(smooth)
    if loses(smooth, usual.largest()):
        return UNSTABLE
    activity = np.abs(usual.disturbance[earliest:latest, [FORCE_RATE, VELOCITY]]).max(axis=1)
    first = earliest + int(np.argmax(activity))
    added = np.zeros(smooth.cycles)
    added[first] = IMPULSE * spec.rig.limits.spool
    moved = stepped_run(smooth, added).command - usual.command
    response = moved[first : first + window] / added[first] * np.exp(-DECAY * period * np.arange(window))
    if not np.all(np.isfinite(response)) or np.max(np.abs(response[-window // 10 :])) > DECAYED:
        return UNSTABLE
    length = RESOLUTION * window
    omega = 2.0 * math.pi * np.fft.rfftfreq(length, period)[1:]
    opened: NDArray[np.complex128] = 1.0 / np.fft.rfft(response, length)[1:].astype(np.complex128) - 1.0
    return LoopMargins(*map(float, loop_margins(omega.astype(np.float64), opened)))


def changed(spec: Spec, change: Callable[[Rig], Rig]) -> Spec:
    """Return an experiment with the same change of the rig and of the controller's."""
    return spec._replace(rig=change(spec.rig), controller_rig=change(spec.controller_rig))


def slipping(rig: Rig) -> Rig:
    """Return a rig without the force of its friction elements; only GMS has such."""
    friction = rig.friction
    if not isinstance(friction, gms.Parameters):
        return rig
    return rig.with_friction(
        coulomb_force=SLIPPING * friction.coulomb_force,
        static_force=SLIPPING * friction.static_force,
        element_stiffness=tuple(SLIPPING * each for each in friction.element_stiffness),
        attraction_rate=SLIPPING * friction.attraction_rate,
    )
