"""Independent solution of the plant, as a reference for the package's.

It shares no code with the package: the equations (1)-(8) are written anew from their source, and the integrator is scipy's
DOP853 at tight tolerance. Each change of mode (orifice, dead zone, stick, slip) is a terminal event at which the
integration is restarted. Between two cycles the command is held and the disturbance changes at its rate.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Floats = NDArray[np.float64]

RELATIVE_TOLERANCE = 1e-12
ABSOLUTE_TOLERANCE = (1e-15, 1e-14, 1e-6, 1e-17)
FORCE_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Constants:
    """The paper's Tables 1 and 2 in the paper's symbols, SI units."""

    ps: float = 7e6
    rho: float = 840.0
    beta_e: float = 6.9e8
    Cd: float = 0.62
    w: float = 0.0267
    Ctc: float = 4.7e-12
    Vt: float = 1.5e-3
    m0: float = 70.0
    Ac: float = 2.6e-3
    ks: float = 4e4
    B0: float = 60.0
    omega_v: float = 111.46370743
    Kv: float = 1.0
    g: float = 9.81
    Fc: float = 640.8
    Fs: float = 865.4
    Vs: float = 2.031e-3
    delta: float = 0.8764
    sigma_f: float = 7265.0
    k: tuple[float, ...] = (1.884e6, 1.969e5, 1.841e5)
    alpha: tuple[float, ...] = (0.829, 0.089, 0.082)
    C: float = 1650.0
    overlap: tuple[float, float] = (0.0, 0.0)

    def s(self, v: float) -> float:
        """Return (7)."""
        return self.Fc + (self.Fs - self.Fc) * math.exp(-math.pow(abs(v) / self.Vs, self.delta))


class Event(NamedTuple):
    """A function of time and state whose zero, crossed in ``direction``, changes the modes by ``action``."""

    function: Callable[[float, Floats], float]
    direction: int
    action: Callable[[float, Floats], None]


class GeneralisedMaxwellSlip:
    """(5), (6), (8); 0 marks a sticking block, +-1 one that slips this way."""

    def __init__(self, c: Constants) -> None:
        self.c = c
        self.states = len(c.k)
        self.modes = [0] * self.states

    def start(self, v: float, other: float, acceleration: float) -> None:
        pass

    def force(self, v: float, other: float, s: float, F: Floats) -> float:
        return math.fsum(F) + self.c.sigma_f * v

    def rates(self, v: float, s: float, F: Floats) -> list[float]:
        c = self.c
        return [
            c.C * (mode * alpha - f / s) if mode else k * v
            for mode, alpha, k, f in zip(self.modes, c.alpha, c.k, F, strict=True)
        ]

    def events(self, plant: "Plant") -> list[Event]:
        found = []
        for i, mode in enumerate(self.modes):
            if not mode:

                def excess(t: float, y: Floats, i: int = i) -> float:
                    return float(math.copysign(y[4 + i], y[4 + i] * y[1]) - self.c.alpha[i] * plant.level(y))

                def slip(t: float, y: Floats, i: int = i) -> None:
                    self.modes[i] = 1 if y[1] > 0 else -1

                found.append(Event(excess, 1, slip))
        moving = next((mode for mode in self.modes if mode), 0)
        if moving:
            found.append(Event(lambda t, y: float(y[1]), -moving, self._hold))
        return found

    def _hold(self, t: float, y: Floats) -> None:
        self.modes = [0] * self.states


class Stribeck:
    """Friction as a function of velocity, and a true standstill."""

    def __init__(self, c: Constants) -> None:
        self.c = c
        self.states = 0
        self.mode = 0

    def start(self, v: float, other: float, acceleration: float) -> None:
        if self.mode == 0 and abs(other) > self.c.Fs:
            self.mode = 1 if other > 0 else -1

    def force(self, v: float, other: float, s: float, F: Floats) -> float:
        return self.mode * s + self.c.sigma_f * v if self.mode else other

    def rates(self, v: float, s: float, F: Floats) -> list[float]:
        return []

    def events(self, plant: "Plant") -> list[Event]:
        if self.mode:
            return [Event(lambda t, y: float(y[1]), -self.mode, self._stop)]

        def leave(direction: int) -> Event:
            def action(t: float, y: Floats) -> None:
                self.mode = direction

            return Event(lambda t, y: direction * plant.other_force(t, y) - self.c.Fs, 1, action)

        return [leave(1), leave(-1)]

    def _stop(self, t: float, y: Floats) -> None:
        self.mode = 0
        y[1] = 0.0


class LuGre:
    """One bristle; |v| has its kink where the integration restarts."""

    def __init__(self, c: Constants) -> None:
        self.c = c
        self.states = 1
        self.side = 0

    def start(self, v: float, other: float, acceleration: float) -> None:
        if self.side == 0:
            self.side = 1 if acceleration > 0 else -1

    def force(self, v: float, other: float, s: float, F: Floats) -> float:
        return float(F[0]) + self.c.sigma_f * v

    def rates(self, v: float, s: float, F: Floats) -> list[float]:
        return [math.fsum(self.c.k) * (v - self.side * v * F[0] / s)]

    def events(self, plant: "Plant") -> list[Event]:
        return [Event(lambda t, y: float(y[1]), -self.side, self._turn)]

    def _turn(self, t: float, y: Floats) -> None:
        self.side = -self.side


LAWS: dict[str, Callable[[Constants], Any]] = {"gms": GeneralisedMaxwellSlip, "stribeck": Stribeck, "lugre": LuGre}


class Plant:
    """(1)-(4) with modes; the state is x, v, pL, xv, then the friction law's forces, then a subclass's additional states.

    A subclass with effects overrides the affected methods.
    """

    own_tolerance: tuple[float, ...] = ()

    def __init__(self, c: Constants, law: str) -> None:
        self.c = c
        self.law = LAWS[law](c)
        self.side = 0
        self.t0, self.u, self.fd, self.fd_rate = 0.0, 0.0, 0.0, 0.0

    def sample(self, y: Floats) -> None:
        """Sample the state at the start of a cycle; the base class samples nothing."""

    def begin(self, t: float, u: float, fd: float, fd_rate: float) -> None:
        """Take the inputs of a cycle."""
        self.t0, self.u, self.fd, self.fd_rate = t, u, fd, fd_rate

    def until(self, t: float, end: float) -> float:
        """Return the time until which the command stays constant, and apply the one that holds from t on."""
        return end

    def level(self, y: Floats) -> float:
        """Return (7)."""
        return self.c.s(float(y[1]))

    def extra_force(self, t: float, y: Floats) -> float:
        return 0.0

    def opening(self, xv: float) -> float:
        c = self.c
        return xv - c.overlap[0] if self.side > 0 else xv + c.overlap[1] if self.side < 0 else 0.0

    def supply(self, y: Floats) -> float:
        return self.c.ps

    def leakage(self, y: Floats) -> float:
        return float(self.c.Ctc * y[2])

    def modulus(self, y: Floats) -> float:
        return self.c.beta_e

    def own_rates(self, t: float, y: Floats) -> list[float]:
        return []

    def other_force(self, t: float, y: Floats) -> float:
        """Return the right side of (3) without friction."""
        c = self.c
        fd = self.fd + self.fd_rate * (t - self.t0)
        return float(c.Ac * y[2] - c.B0 * y[1] - c.ks * y[0] - c.m0 * c.g - fd) + self.extra_force(t, y)

    def spool_rate(self, y: Floats) -> float:
        return float(self.c.omega_v * (self.c.Kv * self.u - y[3]))

    def rhs(self, t: float, y: Floats) -> Floats:
        c = self.c
        _, v, pL, xv = y[:4].tolist()
        F = y[4 : 4 + self.law.states]
        other, s = self.other_force(t, y), self.level(y)
        QL = c.Cd * c.w * self.opening(xv) * math.sqrt((self.supply(y) - self.side * pL) / c.rho)
        return np.array(
            [
                v,
                (other - self.law.force(v, other, s, F)) / c.m0,
                4.0 * self.modulus(y) / c.Vt * (QL - c.Ac * v - self.leakage(y)),
                self.spool_rate(y),
                *self.law.rates(v, s, F),
                *self.own_rates(t, y),
            ]
        )

    def valve_events(self, y: Floats) -> list[Event]:
        if y[3] == 0.0 and self.spool_rate(y) == 0.0:
            return []
        plus, minus = self.c.overlap
        middle = plus + minus > 0.0
        if self.side > 0:
            return [Event(lambda t, y: float(y[3] - plus), -1, self._to(0 if middle else -1))]
        if self.side < 0:
            return [Event(lambda t, y: float(y[3] + minus), 1, self._to(0 if middle else 1))]
        return [
            Event(lambda t, y: float(y[3] - plus), 1, self._to(1)),
            Event(lambda t, y: float(y[3] + minus), -1, self._to(-1)),
        ]

    def _to(self, side: int) -> Callable[[float, Floats], None]:
        def action(t: float, y: Floats) -> None:
            self.side = side

        return action

    def events(self, y: Floats) -> list[Event]:
        """Return all possible next events."""
        return self.valve_events(y) + self.law.events(self)

    def start(self, t: float, y: Floats) -> None:
        """Leave a mode that is invalid after a jump of the inputs, or after a velocity was set to zero."""
        if self.side == 0 and not any(self.c.overlap):
            self.side = 1 if self.spool_rate(y) >= 0 else -1
        self.law.start(float(y[1]), self.other_force(t, y), float(self.rhs(t, y)[1]))


class Solution(NamedTuple):
    """States at the cycles, shape (cycles + 1, states), and the number of mode changes."""

    y: Floats
    events: int


def solve(
    constants: Constants,
    law: str,
    inputs: Floats,
    period: float,
    rtol: float = RELATIVE_TOLERANCE,
    position: float = 0.0,
    kind: type[Plant] = Plant,
) -> Solution:
    """Integrate the plant from rest without pressure.

    Args:
        constants: of the rig.
        law: friction law, a key of :data:`LAWS`.
        inputs: spool command [m], disturbance force [N] and its rate [N/s] at each cycle, shape (cycles, 3).
        period: time between two cycles [s].
        rtol: relative tolerance; the absolute ones scale with it.
        position: initial position [m].
        kind: the plant, with its effects.

    Returns:
        The solution.
    """
    plant = kind(constants, law)
    atol = np.array([*ABSOLUTE_TOLERANCE, *[FORCE_TOLERANCE] * plant.law.states, *plant.own_tolerance])
    atol *= rtol / RELATIVE_TOLERANCE
    y = np.zeros(atol.size)
    y[0] = position
    return integrate(plant, y, inputs, period, rtol, atol)


def integrate(plant: Any, y: Floats, inputs: Floats, period: float, rtol: float, atol: Floats) -> Solution:
    """Integrate a plant, or an object with its methods, from a state.

    Args:
        plant: the plant.
        y: the state.
        inputs: arguments of ``begin`` at each cycle after the time, shape (cycles, arguments).
        period: time between two cycles [s].
        rtol: relative tolerance.
        atol: absolute tolerances, one per state.

    Returns:
        The solution.
    """
    out, count = [y.copy()], 0
    for cycle, given in enumerate(inputs.tolist()):
        t, end = cycle * period, (cycle + 1) * period
        plant.sample(y)
        plant.begin(t, *given)
        while t < end:
            until = plant.until(t, end)
            plant.start(t, y)
            events = plant.events(y)
            watched = []
            for event in events:

                def watch(t: float, y: Floats, function: Callable[..., float] = event.function) -> float:
                    return function(t, y)

                watch.terminal, watch.direction = True, event.direction  # type: ignore[attr-defined]
                watched.append(watch)
            part = solve_ivp(plant.rhs, (t, until), y, method="DOP853", rtol=rtol, atol=atol, events=watched)
            if part.status < 0:
                raise RuntimeError(part.message)
            t, y = float(part.t[-1]), part.y[:, -1].copy()
            for event, times in zip(events, part.t_events, strict=True):
                if times.size:
                    event.action(t, y)
                    count += 1
        out.append(y.copy())
    return Solution(np.array(out), count)


@dataclass(frozen=True)
class Case:
    """A motion that both solvers run: constants and law, their names in the rig file, and the inputs."""

    name: str
    law: str
    constants: Constants
    inputs: Floats
    period: float = 1e-3
    friction: dict[str, Any] = field(default_factory=dict)
    effects: list[dict[str, Any]] = field(default_factory=list)

    def shortened(self, duration: float) -> "Case":
        """Return the first ``duration`` seconds."""
        return replace(self, inputs=self.inputs[: round(duration / self.period)])


def cases() -> dict[str, Case]:
    """Return the motions by name, 2 s each."""
    t = np.arange(2000) * 1e-3
    still = np.zeros_like(t)
    paper = Constants()
    omega = 2.0 * math.pi
    small = np.column_stack([1.5e-5 * np.sin(2.0 * omega * t), still, still])
    large = np.column_stack([6e-4 * np.sin(omega * t), 5e3 * np.sin(omega * t + 0.7), 5e3 * omega * np.cos(omega * t + 0.7)])
    # Breaks away, runs, stops within the overlap, breaks away the other way against gravity's pull, stops.
    stages = np.select([t < 0.3, t < 0.7, t < 1.1, t < 1.5], [6e-5, 0.0, -9e-5, 0.0], 1.2e-4)
    overlapped = replace(paper, overlap=(2e-5, 3e-5))
    found = [
        Case("stick-slip", "gms", paper, small),
        Case("large sine", "gms", paper, large),
        Case(
            "break-away",
            "stribeck",
            overlapped,
            np.column_stack([stages, still, still]),
            effects=[{"name": "valve_dead_zone", "positive": 2e-5, "negative": 3e-5}],
        ),
        Case("bristle", "lugre", paper, small),
    ]
    return {case.name: case for case in found}
