"""Loader and position servo as one system, for the independent solver: two plants, coupled by a spring and a damper.

Like :mod:`reference_solver`, it shares no code with the package.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from reference_solver import (
    ABSOLUTE_TOLERANCE,
    FORCE_TOLERANCE,
    RELATIVE_TOLERANCE,
    Constants,
    Event,
    Floats,
    Plant,
    Solution,
    integrate,
)


@dataclass(frozen=True)
class Coupling:
    """The beam between the pistons, and the servo's parameters; the package's defaults."""

    stiffness: float = 2e6
    damping: float = 2e3
    mass: float = 70.0
    supply: float = 2.1e7
    gain: float = 30.0
    limit: float = 1e-2


class Pulled(Plant):
    """A plant with an additional force on its piston."""

    pull = 0.0

    def extra_force(self, t: float, y: Floats) -> float:
        return self.pull


class Pair:
    """The loader's states, then the servo's; each has the interface of :class:`reference_solver.Plant`."""

    def __init__(self, loader: Constants, law: str, coupling: Coupling) -> None:
        self.coupling = coupling
        servo = replace(loader, ps=coupling.supply, m0=coupling.mass, ks=0.0, g=0.0)
        self.loader, self.servo = Pulled(loader, law), Pulled(servo, law)
        self.size = 4 + self.loader.law.states
        self.sampled = (0.0, 0.0)

    def parts(self, y: Floats) -> tuple[Floats, Floats]:
        """Return both states, and couple the pistons according to them."""
        first, second = y[: self.size], y[self.size :]
        c = self.coupling
        self.loader.pull = float(c.stiffness * (second[0] - first[0]) + c.damping * (second[1] - first[1]))
        self.servo.pull = -self.loader.pull
        return first, second

    def sample(self, y: Floats) -> None:
        self.sampled = float(y[self.size]), float(y[self.size + 2])

    def begin(self, t: float, u: float, wanted: float, rate: float) -> None:
        x, pL = self.sampled
        c = self.servo.c
        v = rate + self.coupling.gain * (wanted - x)
        drop = max(c.ps - math.copysign(pL, v * pL), 0.01 * c.ps)
        spool = c.Ac * v / (c.Cd * c.w * math.sqrt(drop / c.rho)) / c.Kv
        limit = self.coupling.limit
        self.loader.begin(t, u, 0.0, 0.0)
        self.servo.begin(t, min(max(spool, -limit), limit), 0.0, 0.0)

    def until(self, t: float, end: float) -> float:
        return end

    def start(self, t: float, y: Floats) -> None:
        first, second = self.parts(y)
        self.loader.start(t, first)
        self.servo.start(t, second)

    def events(self, y: Floats) -> list[Event]:
        first, second = self.parts(y)
        found = [self._of(event, 0) for event in self.loader.events(first)]
        return found + [self._of(event, 1) for event in self.servo.events(second)]

    def _of(self, event: Event, which: int) -> Event:
        """Return one piston's event as an event of both."""
        return Event(
            lambda t, y: event.function(t, self.parts(y)[which]),
            event.direction,
            lambda t, y: event.action(t, self.parts(y)[which]),
        )

    def rhs(self, t: float, y: Floats) -> Floats:
        first, second = self.parts(y)
        return np.concatenate([self.loader.rhs(t, first), self.servo.rhs(t, second)])


def both_turning(cycles: int, period: float) -> Floats:
    """Return inputs of :func:`solve_pair` with which both pistons reverse again and again."""
    t = np.arange(cycles) * period
    omega = 2.0 * math.pi * 4.0
    command = 1.2e-4 * np.sin(2.0 * math.pi * 7.0 * t) + 2e-5
    return np.column_stack([command, 4e-3 * np.sin(omega * t), 4e-3 * omega * np.cos(omega * t)])


def solve_pair(
    loader: Constants,
    law: str,
    inputs: Floats,
    period: float,
    start: tuple[float, float] = (0.0, 0.0),
    coupling: Coupling | None = None,
    rtol: float = RELATIVE_TOLERANCE,
) -> Solution:
    """Integrate loader and servo from rest without pressure.

    Args:
        loader: constants of the loader.
        law: friction law of both.
        inputs: the loader's spool command [m], the servo's reference position [m] and its rate [m/s] at each cycle, shape
            (cycles, 3).
        period: time between two cycles [s].
        start: positions of loader and servo [m].
        coupling: the beam and the servo.
        rtol: relative tolerance; the absolute ones scale with it.

    Returns:
        The solution; a state is the loader's, then the servo's.
    """
    pair = Pair(loader, law, coupling or Coupling())
    atol = np.tile([*ABSOLUTE_TOLERANCE, *[FORCE_TOLERANCE] * pair.loader.law.states], 2) * (rtol / RELATIVE_TOLERANCE)
    y = np.zeros(atol.size)
    y[0], y[pair.size] = start
    return integrate(pair, y, inputs, period, rtol, atol)
