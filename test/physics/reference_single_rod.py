"""Independent solution of a single rod with four metering edges, as :mod:`reference_solver` for the paper's plant.

The volume balances of Merritt, ch. 6, are written anew, with the volume of a cavity as a state of its own. The state is x, v,
an unused entry, xv and the friction forces of :class:`reference_solver.Plant`, then p_A, p_B, the cavities of A and B, and p_P.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

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

Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class SingleRodConstants(Constants):
    """Areas, volumes, hoses and leakages by chamber; gains, overlaps and roundings by edge P-A, A-T, P-B, B-T."""

    areas: tuple[float, float] = (2e-3, 1e-3)
    volumes: tuple[float, float] = (1e-3, 5e-4)
    hoses: tuple[float, float] = (0.0, 0.0)
    outward: tuple[float, float] = (0.0, 0.0)
    gains: Four = (1.0, 1.0, 1.0, 1.0)
    overlaps: Four = (0.0, 0.0, 0.0, 0.0)
    roundings: Four = (0.0, 0.0, 0.0, 0.0)
    laminar: float = 1e5
    tank: float = 0.0
    vapour: float = -1e5
    droop: float = 0.0
    lag: float = 1e-2

    def mapping(self, rig: dict[str, Any], law: str) -> dict[str, Any]:
        """Return a rig file of this rig, made from that of the paper's."""
        names = {
            "supply_pressure": "ps", "oil_density": "rho", "bulk_modulus": "beta_e", "discharge_coefficient": "Cd",
            "valve_area_gradient": "w", "leakage_coefficient": "Ctc", "moving_mass": "m0", "spring_stiffness": "ks",
            "viscous_damping": "B0", "valve_bandwidth": "omega_v", "valve_gain": "Kv", "gravity": "g",
        }  # fmt: skip
        edges = ("pa", "at", "pb", "bt")
        valve = {
            f"{key}_{edge}": value
            for key, of in (("gain", self.gains), ("overlap", self.overlaps), ("rounding", self.roundings))
            for edge, value in zip(edges, of, strict=True)
        }
        friction = {
            "coulomb_force": self.Fc, "static_force": self.Fs, "stribeck_velocity": self.Vs, "stribeck_exponent": self.delta,
            "viscous_coefficient": self.sigma_f, "element_stiffness": list(self.k), "element_weight": list(self.alpha),
            "attraction_rate": self.C,
        }  # fmt: skip
        sides = {
            f"{key}_{side}": value
            for key, of in (
                ("area", self.areas),
                ("volume", self.volumes),
                ("hose_compliance", self.hoses),
                ("leakage", self.outward),
            )
            for side, value in zip("ab", of, strict=True)
        }
        rest = {
            "tank_pressure": self.tank, "vapour_pressure": self.vapour, "supply_resistance": self.droop,
            "supply_time_constant": self.lag,
        }  # fmt: skip
        stroke = min(0.9 * self.volumes[0] / self.areas[0], 0.9 * self.volumes[1] / self.areas[1], 0.3)
        return {
            **rig,
            "plant": {"arm_length": 0.5, **{name: getattr(self, symbol) for name, symbol in names.items()}},
            "friction": {**friction, "model": law},
            "cylinder": {"model": "two_chamber", **sides, **rest},
            "valve": {"model": "four_edges", **valve, "transition_pressure": self.laminar},
            "limits": {**rig["limits"], "position": [-stroke, stroke]},
        }


class SingleRod(Plant):
    """Two chambers, each without or with a cavity."""

    c: SingleRodConstants
    own_tolerance = (1e-6, 1e-6, 1e-20, 1e-20, 1e-6)

    def __init__(self, c: SingleRodConstants, law: str) -> None:
        super().__init__(c, law)
        self.first = 4 + self.law.states
        self.cavity = [False, False]
        self.open = [True] * 4

    def at_rest(self) -> list[float]:
        """Return pressures without driving force, no cavities, and the supply pressure."""
        c = self.c
        total = c.ps + c.tank
        share = c.areas[1] / sum(c.areas)
        return [share * total, (1.0 - share) * total, 0.0, 0.0, c.ps]

    def pressures(self, y: Floats) -> list[float]:
        return [self.c.vapour if self.cavity[i] else float(y[self.first + i]) for i in range(2)]

    def other_force(self, t: float, y: Floats) -> float:
        c, (a, b) = self.c, self.pressures(y)
        fd = self.fd + self.fd_rate * (t - self.t0)
        return float(c.areas[0] * a - c.areas[1] * b - c.B0 * y[1] - c.ks * y[0] - c.m0 * c.g - fd)

    def displacements(self, y: Floats) -> list[float]:
        """Return the displacement of the spool beyond the overlap of each edge."""
        o = self.c.overlaps
        return [y[3] - o[0], -y[3] - o[1], -y[3] - o[2], y[3] - o[3]]

    def flows(self, y: Floats) -> list[float]:
        c, (a, b), supply = self.c, self.pressures(y), y[self.first + 4]
        drops = supply - a, a - c.tank, supply - b, b - c.tank
        out = []
        for u, r, gain, drop, opened in zip(self.displacements(y), c.roundings, c.gains, drops, self.open, strict=True):
            area = 0.5 * (u + math.hypot(u, r)) if r > 0.0 else (u if opened else 0.0)
            out.append(gain * c.Cd * c.w * area * math.sqrt(2.0 / c.rho) * drop * (drop**2 + c.laminar**2) ** -0.25)
        return out

    def rhs(self, t: float, y: Floats) -> Floats:
        c, (a, b) = self.c, self.pressures(y)
        x, v = float(y[0]), float(y[1])
        F = y[4 : self.first]
        other, s = self.other_force(t, y), self.level(y)
        pa, at, pb, bt = self.flows(y)
        into = (
            pa - at - c.areas[0] * v - c.Ctc * (a - b) - c.outward[0] * (a - c.tank),
            pb - bt + c.areas[1] * v + c.Ctc * (a - b) - c.outward[1] * (b - c.tank),
        )
        volumes = c.volumes[0] + c.areas[0] * x, c.volumes[1] - c.areas[1] * x
        rates = [0.0 if self.cavity[i] else into[i] / (volumes[i] / c.beta_e + c.hoses[i]) for i in range(2)]
        holes = [-into[i] if self.cavity[i] else 0.0 for i in range(2)]
        supply = (c.ps - c.droop * (pa + pb) - y[self.first + 4]) / c.lag
        acceleration = (other - self.law.force(v, other, s, F)) / c.m0
        return np.array([v, acceleration, 0.0, self.spool_rate(y), *self.law.rates(v, s, F), *rates, *holes, supply])

    def valve_events(self, y: Floats) -> list[Event]:
        found = []
        for i in range(2):
            place = self.first + (2 + i if self.cavity[i] else i)
            level = 0.0 if self.cavity[i] else self.c.vapour

            def reached(t: float, y: Floats, place: int = place, level: float = level) -> float:
                return float(y[place]) - level

            def change(t: float, y: Floats, i: int = i) -> None:
                self.cavity[i] = not self.cavity[i]
                y[self.first + i], y[self.first + 2 + i] = self.c.vapour, 0.0

            found.append(Event(reached, -1, change))
        for i in range(4):
            if self.c.roundings[i] == 0.0 and self.spool_rate(y) != 0.0:

                def edge(t: float, y: Floats, i: int = i) -> float:
                    return self.displacements(y)[i]

                def turn(t: float, y: Floats, i: int = i) -> None:
                    self.open[i] = not self.open[i]

                found.append(Event(edge, -1 if self.open[i] else 1, turn))
        return found

    def start(self, t: float, y: Floats) -> None:
        if t == 0.0:
            # An edge that only touches its overlap opens where the spool moves to.
            rates = [1.0, -1.0, -1.0, 1.0]
            self.open = [
                u > 0.0 or (u == 0.0 and r * self.spool_rate(y) >= 0.0)
                for u, r in zip(self.displacements(y), rates, strict=True)
            ]
        self.law.start(float(y[1]), self.other_force(t, y), float(self.rhs(t, y)[1]))


def solve_single_rod(
    constants: SingleRodConstants, law: str, inputs: Floats, period: float, rtol: float = RELATIVE_TOLERANCE
) -> Solution:
    """Integrate from rest without driving force; arguments and result as those of :func:`reference_solver.solve`."""
    plant = SingleRod(constants, law)
    atol = np.array([*ABSOLUTE_TOLERANCE, *[FORCE_TOLERANCE] * plant.law.states, *plant.own_tolerance])
    atol *= rtol / RELATIVE_TOLERANCE
    y = np.zeros(atol.size)
    y[plant.first :] = plant.at_rest()
    return integrate(plant, y, inputs, period, rtol, atol)


def random_rig(random: np.random.Generator) -> SingleRodConstants:
    """Return a rig with a single rod, as they are built: bore 40 to 100 mm, ratio of areas 1.25 to 2, stroke 0.2 to 0.6 m."""
    area = math.pi / 4.0 * random.uniform(0.04, 0.1) ** 2
    areas = area, area / random.uniform(1.25, 2.0)
    stroke = random.uniform(0.2, 0.6)
    hose = random.uniform(1e-4, 4e-4, 2)
    supply = random.uniform(7e6, 21e6)
    # Full speed at a millimetre of the spool.
    rated = areas[0] * random.uniform(0.2, 0.6)
    gradient = rated / (0.62 * 1e-3 * math.sqrt(supply / 860.0))
    force = supply * area
    level = random.uniform(0.01, 0.05) * force
    return replace(
        SingleRodConstants(),
        ps=supply,
        rho=860.0,
        beta_e=random.uniform(6e8, 1.4e9),
        w=gradient,
        Ctc=rated / supply * random.uniform(1e-3, 1e-2),
        m0=random.uniform(20.0, 400.0),
        ks=random.uniform(0.0, 1.0) * 0.2 * force / stroke,
        B0=random.uniform(50.0, 500.0),
        omega_v=random.uniform(60.0, 400.0),
        Fc=level,
        Fs=level * random.uniform(1.1, 1.5),
        Vs=random.uniform(2e-3, 1e-2),
        delta=random.uniform(1.0, 2.0),
        sigma_f=random.uniform(0.05, 0.3) * level / 0.1,
        k=tuple(level / random.uniform(2e-4, 4e-4) * share for share in (0.6, 0.25, 0.15)),
        alpha=(0.6, 0.25, 0.15),
        C=2.0 * level,
        areas=areas,
        volumes=(areas[0] * stroke / 2 + hose[0], areas[1] * stroke / 2 + hose[1]),
        hoses=tuple(random.uniform(0.0, 0.3) * hose / 1e9),
        outward=tuple(rated / supply * random.uniform(0.0, 3e-3, 2)),
        gains=(1.0, random.uniform(0.7, 1.3), random.uniform(0.5, 1.0), random.uniform(0.5, 1.0)),
        overlaps=tuple(random.uniform(-1e-5, 2e-5, 4)),
        roundings=tuple(random.choice([0.0, 1.0]) * random.uniform(5e-6, 2e-5, 4)),
        laminar=random.uniform(0.5e5, 2e5),
        tank=random.uniform(0.0, 5e5),
        droop=random.uniform(0.0, 0.1) * supply / rated,
        lag=random.uniform(5e-3, 5e-2),
    )
