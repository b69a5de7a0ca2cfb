"""Learning filters for a force loop that is known with an uncertainty.

From load cycle to load cycle a correction c of the reference changes the repeated error by e := e + T dc, with T the response
of the force to the reference. With dc = -Q L e the error at one frequency is multiplied by 1 - Q L T. T is known as
T0 (1 + W D), |D| <= 1, so the remaining fraction is at most

    rho = Q (|1 - L T0| + |L T0| W)

and the learning converges for every such loop with rho < 1. L = conj(T0) / (|T0|^2 (1 + W^2)) minimises the mean square of the
remaining fraction for a D of random phase; with it rho = Q W (1 + W) / (1 + W^2). Q has no phase. It is 1 as long as rho keeps
:data:`MARGIN` from 1, and falls to 0 beyond.

Source: Bristow, Tharayil, Alleyne, A survey of iterative learning control, IEEE Control Systems Magazine 26, 2006, section on
robust design; the weight from the relative errors of gain, valve bandwidth and delay.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.controllers.base import ControllerLaw, Model
from ehls_ros.errors import BadInput

Spectrum: TypeAlias = NDArray[np.complex128]

MARGIN = 0.2
"""Least distance of rho from 1."""

ROLL_OFF = 1.5
"""Ratio of the frequency at which Q reaches 0 to that at which it begins to fall."""

GRID = 512
"""Frequencies at which the condition is checked, besides those of the harmonics."""

MIN_RESPONSE = 0.2
"""Smallest response that is inverted."""

HOLD = 1.5
"""Delay of a sampled law in periods, as it is computed once per period and held for one."""


class Loop(NamedTuple):
    """Known model of the force loop, at some frequencies.

    Attributes:
        response: T0, response of the force to the reference.
        uncertainty: W, its largest relative error.
    """

    response: Spectrum
    uncertainty: Array


class Design(NamedTuple):
    """Filters of a repetitive correction, at the harmonics of a load cycle.

    Attributes:
        response: T0.
        uncertainty: W.
        learning: L.
        robustness: Q, real.
        rate: remaining fraction, after one repetition, of the slowest harmonic that is learnt at full strength, if T = T0.
        worst: largest remaining fraction for the worst T; below 1 - MARGIN.
        bandwidth: frequency up to which Q is 1 [Hz].
        gain: L T0 if given; 0 if designed from the uncertainty.
    """

    response: Spectrum
    uncertainty: Array
    learning: Spectrum
    robustness: Array
    rate: float
    worst: float
    bandwidth: float
    gain: float

    def inverse(self, response: Spectrum, uncertainty: Array) -> Spectrum:
        """Return L for an updated estimate of the response."""
        return learning_filter(Loop(response, uncertainty), self.gain)


def force_loop(law: ControllerLaw, tuning: Any, model: Model, uncertainty: float) -> Callable[[Array], Loop]:
    """Return a function from frequencies [rad/s] to the loop of a law.

    A law with ``tracking`` provides the response of the force to the reference, correct up to errors of its coefficients. For
    any other law the response is between 1 and that of the valve's lag and the delay.

    Args:
        law: file of the controller.
        tuning: parameters of the controller.
        model: its model of the rig.
        uncertainty: relative error of valve gain, valve bandwidth and delay.
    """
    tracking = cast(Callable[[Array, Any, Model], Spectrum] | None, getattr(law, "tracking", None))

    def loop(omega: Array) -> Loop:
        lag = omega / model.plant.valve_bandwidth
        late = model.command_delay + HOLD * model.period
        doubt = uncertainty * (1.0 + lag / np.sqrt(1.0 + lag**2) + omega * late)
        if tracking is not None:
            return Loop(tracking(omega, tuning, model), doubt)
        late_response = np.exp(-1j * omega * late) / (1.0 + 1j * lag)
        return Loop(np.ones(omega.shape, dtype=np.complex128), doubt + np.abs(late_response - 1.0))

    return loop


def remaining(loop: Loop, learning: Spectrum, robustness: Array) -> Array:
    """Return the largest remaining fraction rho at each frequency."""
    share = learning * loop.response
    return robustness * (np.abs(1.0 - share) + np.abs(share) * loop.uncertainty)


def design(loop_at: Callable[[Array], Loop], size: int, period: float, gain: float = 0.0) -> Design:
    """Return the filters for a load cycle.

    Args:
        loop_at: function from :func:`force_loop`.
        size: samples of the load cycle.
        period: length of the load cycle [s].
        gain: L T0 [1]; 0 to design it from the uncertainty.

    Raises:
        BadInput: with this gain the learning does not converge with :data:`MARGIN` at the first harmonic.
    """
    base = 2.0 * math.pi / period
    harmonics = base * np.arange(size // 2 + 1)
    highest = math.pi * size / period
    fine = np.geomspace(min(base, 1e-2 * highest), highest, GRID)
    grid = np.union1d(harmonics, fine)
    loop = loop_at(grid)
    learning = learning_filter(loop, gain)
    bad = np.flatnonzero(remaining(loop, learning, np.ones(grid.shape)) > 1.0 - MARGIN)
    first = float(grid[bad[0]]) if bad.size else highest
    if first <= base:
        what = f"gain {gain:g}: the error of the first harmonic, {1.0 / period:g} Hz, need not fall from cycle to cycle"
        if gain == 0.0:
            what = f"the force loop is too uncertain at the first harmonic, {1.0 / period:g} Hz, to learn anything"
        raise BadInput(what, "companion learning", "gain 0, which designs it, or a smaller uncertainty")
    edge = first / ROLL_OFF if bad.size else highest
    if bad.size and edge < base:
        edge = base
    robustness = falling(grid, edge, max(first, edge * 1.0001))
    full = (robustness == 1.0) & (grid > 0.0)
    rho = remaining(loop, learning, robustness)
    rate = np.abs(1.0 - learning * loop.response)
    at = np.searchsorted(grid, harmonics)
    return Design(
        loop.response[at],
        loop.uncertainty[at],
        learning[at],
        robustness[at],
        float(rate[full].max(initial=0.0)),
        float(rho.max()),
        edge / (2.0 * math.pi),
        gain,
    )


def learning_filter(loop: Loop, gain: float) -> Spectrum:
    """Return L at each frequency; ``gain`` as in :func:`design`."""
    inverse = np.conj(loop.response) / np.maximum(np.abs(loop.response) ** 2, MIN_RESPONSE**2)
    if gain > 0.0:
        return gain * inverse
    return inverse / (1.0 + loop.uncertainty**2)


def falling(omega: Array, begin: float, end: float) -> Array:
    """Return 1 up to ``begin`` and 0 from ``end`` on, with a half cosine between, at some frequencies."""
    part = np.clip((omega - begin) / (end - begin), 0.0, 1.0)
    return 0.5 * (1.0 + np.cos(math.pi * part))
