"""The reference solver's plant with effects, derived independently from their physics.

Where the package has a closed form or an additional state, this uses a different formulation: the supply's loss by a root
finder, the second-order spool as the state xv itself, the flexible mass by its position.
"""

import math
from typing import Any

import numpy as np
from reference_solver import Constants, Floats, Plant
from scipy.optimize import brentq

ATMOSPHERE = 101325.0


def plant_with(**numbers: Any) -> type[Plant]:
    """Return a plant class with the coefficients of some effects set; the others are neutral."""
    return type("PlantWithEffects", (EffectsPlant,), numbers)


class EffectsPlant(Plant):
    """Additional states: rate of the second-order spool, loss of the supply, position and velocity of the flexible mass."""

    own_tolerance = (1e-15, 1e-6, 1e-15, 1e-14)
    delay, bias = 0.0, 0.0
    natural, damping = 0.0, 0.7
    laminar, turbulent, settling = 0.0, 0.0, 0.0
    air, outward, scratch = 0.0, 0.0, 0.0
    one_way, viscous_one_way, squeeze = 0.0, 0.0, 0.0
    slope, bend, sine, cosine, wavelength = 0.0, 0.0, 0.0, 0.0, 1.0
    cubic, gap, stop, stop_stiffness, stop_damping = 0.0, 0.0, 10.0, 1e7, 0.0
    mass, taken, mode_frequency, mode_damping = 0.0, 0.0, 10.0, 0.0
    ripple, ripple_frequency, weight = 0.0, 1.0, 0.0
    # A piston separated from the load: its mass, and the joint. It replaces the flexible mass among the states.
    piston, play, rounding, joint_stiffness, joint_damping = 0.0, 0.0, 0.0, 0.0, 0.0

    def __init__(self, c: Constants, law: str) -> None:
        super().__init__(c, law)
        self.first = 4 + self.law.states
        self.sent: list[tuple[float, float]] = []

    def begin(self, t: float, u: float, fd: float, fd_rate: float) -> None:
        super().begin(t, u, fd, fd_rate)
        self.sent.append((t + self.delay, u + self.bias))

    def until(self, t: float, end: float) -> float:
        near = 1e-12
        arrived = [u for at, u in self.sent if at <= t + near]
        self.u = arrived[-1] if arrived else self.bias
        return min([end, *(at for at, _ in self.sent if at > t + near)])

    def spool_rate(self, y: Floats) -> float:
        return float(y[self.first]) if self.natural else super().spool_rate(y)

    def level(self, y: Floats) -> float:
        x, v, pL = y[:3].tolist()
        wave = 2.0 * math.pi * x / self.wavelength
        direction = (v > 0.0) - (v < 0.0)
        s = self.c.s(v) + direction * self.one_way + self.squeeze * abs(pL)
        s += self.slope * x + self.bend * x**2 + self.sine * math.sin(wave) + self.cosine * math.cos(wave)
        return max(s, 1.0)

    def flow_lost(self, y: Floats, pressure: float) -> float:
        """Return the flow through the spool at a supply pressure [m^3/s]."""
        across = pressure - math.copysign(1.0, y[3]) * y[2]
        return float(self.c.Cd * self.c.w * abs(y[3]) * math.sqrt(max(across, 0.0) / self.c.rho))

    def lost(self, flow: float) -> float:
        return self.laminar * flow + self.turbulent * flow**2

    def supply(self, y: Floats) -> float:
        ps = self.c.ps
        if self.settling:
            return ps - float(y[self.first + 1])
        most = self.flow_lost(y, ps)
        if most == 0.0 or self.lost(most) == 0.0:
            return ps
        flow = brentq(lambda q: q - self.flow_lost(y, ps - self.lost(q)), 0.0, most, xtol=1e-20, rtol=1e-14)
        return float(ps - self.lost(flow))

    def chambers(self, y: Floats) -> tuple[float, float]:
        return max((self.c.ps + y[2]) / 2.0, 0.0), max((self.c.ps - y[2]) / 2.0, 0.0)

    def modulus(self, y: Floats) -> float:
        softness = []
        for gauge in self.chambers(y):
            p = gauge + ATMOSPHERE
            air = self.air * (ATMOSPHERE / p) ** (5.0 / 7.0)
            softness.append(1.0 / self.c.beta_e + air / (1.4 * p))
        return 2.0 / math.fsum(softness)

    def leakage(self, y: Floats) -> float:
        pL = float(y[2])
        scratch = math.copysign(self.scratch * math.sqrt(abs(pL)), pL)
        # The piston's sweep beyond the load's enters the balance like a leakage.
        swept = self.c.Ac * float(y[self.first + 3] - y[1]) if self.piston else 0.0
        return super().leakage(y) + swept + self.outward * self.chambers(y)[0] / 2.0 + scratch

    def spring_of_mode(self, y: Floats) -> float:
        """Return the force between piston and flexible mass [N]."""
        omega = 2.0 * math.pi * self.mode_frequency
        at, speed = y[self.first + 2 : self.first + 4].tolist()
        return float(self.mass * (omega**2 * (at - y[0]) + 2.0 * self.mode_damping * omega * (speed - y[1])))

    def joint(self, y: Floats) -> float:
        """Return the force by which a separated piston pushes the load [N]."""
        stretch, rate = (y[self.first + 2 : self.first + 4] - y[:2]).tolist()
        if self.play == 0.0:
            return float(self.joint_stiffness * stretch + self.joint_damping * rate)
        corner = self.rounding * self.play
        ahead, behind = (corner * float(np.logaddexp(0.0, (d - self.play / 2.0) / corner)) for d in (stretch, -stretch))
        bears = 1.0 - math.exp(-(ahead + behind) / corner)
        return self.joint_stiffness * (ahead - behind) + self.joint_damping * bears * rate

    def extra_force(self, t: float, y: Floats) -> float:
        x, v = y[:2].tolist()
        play = x - math.copysign(max(abs(x) - self.gap / 2.0, 0.0), x)
        deep = x - self.stop
        stop = self.stop_stiffness * deep + self.stop_damping * max(v, 0.0) if deep > 0.0 else 0.0
        ripple = self.ripple * math.sin(2.0 * math.pi * self.ripple_frequency * t)
        mode = self.spring_of_mode(y) - self.taken * self.mass * self.c.g
        if self.piston:
            mode = self.joint(y) - self.c.Ac * float(y[2]) - self.piston * self.c.g
        return self.c.ks * play - self.cubic * x**3 - stop + ripple + self.weight + mode - self.viscous_one_way * abs(v)

    def own_rates(self, t: float, y: Floats) -> list[float]:
        rate, loss, _, speed = y[self.first :].tolist()
        # With q'/Kv for the rate and q/Kv for the spool, it is the equation of q.
        spool = self.natural**2 * (self.c.Kv * self.u - y[3]) - 2.0 * self.damping * self.natural * rate
        settled = self.lost(self.flow_lost(y, self.c.ps - loss))
        losing = (settled - loss) / self.settling if self.settling else 0.0
        pulled = -self.spring_of_mode(y) / self.mass if self.mass else 0.0
        if self.piston:
            pulled = (self.c.Ac * float(y[2]) - self.joint(y)) / self.piston
        return [spool if self.natural else 0.0, losing, speed, pulled]
