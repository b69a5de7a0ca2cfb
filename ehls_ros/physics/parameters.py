"""Coefficients of the rig, each declared once with unit, range and help; friction models declare their own."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.schema import quantity, text


class Plant(NamedTuple):
    """Hydraulics, valve and beam load: the coefficients of equations (1)-(4)."""

    supply_pressure: Annotated[float, quantity("Pa", "supply pressure ps", above=0.0, typical=2.1e7)]
    oil_density: Annotated[float, quantity("kg/m^3", "density of the oil, rho", above=0.0, typical=860.0)]
    bulk_modulus: Annotated[float, quantity("Pa", "effective bulk modulus of the oil, beta_e", above=0.0, typical=1e9)]
    discharge_coefficient: Annotated[float, quantity("1", "discharge coefficient of the valve, Cd", above=0.0, typical=0.62)]
    valve_area_gradient: Annotated[float, quantity("m", "valve area per spool displacement, w", above=0.0, typical=0.03)]
    leakage_coefficient: Annotated[
        float, quantity("m^5/(N s)", "internal leakage of the cylinder, Ctc", minimum=0.0, typical=5e-12)
    ]
    total_volume: Annotated[float, quantity("m^3", "oil volume of both chambers and lines, Vt", above=0.0, typical=1e-3)]
    moving_mass: Annotated[float, quantity("kg", "equivalent mass of piston and load, m0", above=0.0, typical=100.0)]
    piston_area: Annotated[float, quantity("m^2", "ram area, Ac", above=0.0, typical=2e-3)]
    arm_length: Annotated[float, quantity("m", "arm of the beam, L", above=0.0, typical=0.5)]
    spring_stiffness: Annotated[float, quantity("N/m", "equivalent spring of the beam load, ks", minimum=0.0, typical=4e4)]
    viscous_damping: Annotated[
        float, quantity("N s/m", "viscous damping of the friction loading device, B0", minimum=0.0, typical=100.0)
    ]
    valve_bandwidth: Annotated[float, quantity("rad/s", "bandwidth of the servo valve, omega_v", above=0.0, typical=300.0)]
    valve_gain: Annotated[float, quantity("1", "spool displacement per spool command, Kv", above=0.0, typical=1.0)]
    gravity: Annotated[
        float,
        quantity("m/s^2", "gravity along -x as in (3); negative: along +x", minimum=-20.0, maximum=20.0, typical=9.81),
    ]


class Sensor(NamedTuple):
    """Imperfections of one sensor; none by default."""

    noise_std: Annotated[float, quantity("signal", "standard deviation of white noise per sample", minimum=0.0)] = 0.0
    resolution: Annotated[float, quantity("signal", "step of the converter; 0: none", minimum=0.0)] = 0.0
    gain: Annotated[float, quantity("1", "gain, reading over true value", above=0.0)] = 1.0
    bias: Annotated[float, quantity("signal", "constant offset")] = 0.0
    bandwidth: Annotated[float, quantity("rad/s", "first-order bandwidth; 0: no lag", minimum=0.0)] = 0.0
    delay: Annotated[float, quantity("s", "pure delay", minimum=0.0, maximum=1.0)] = 0.0

    @property
    def reading_std(self) -> float:
        """Standard deviation of a reading, including its rounding, in the signal's unit."""
        return math.hypot(self.noise_std, self.resolution / math.sqrt(12.0))


class Limits(NamedTuple):
    """Limits of the rig."""

    spool: Annotated[float, quantity("m", "largest spool command", above=0.0, typical=1e-3)]
    force: Annotated[float, quantity("N", "largest driving force", above=0.0, typical=4e4)]
    load_pressure: Annotated[float, quantity("Pa", "largest load pressure", above=0.0, typical=2.1e7)]
    position: Annotated[tuple[float, float], text("smallest and largest piston position", "m", typical=(-0.1, 0.1))]
    velocity: Annotated[float, quantity("m/s", "largest piston velocity", above=0.0, typical=1.0)]
