"""Valve with four metering edges, each with a gain, an overlap and a rounding.

The flow through an edge is turbulent, and laminar below a transition pressure. A rounded edge opens along a hyperbola, so that
it leaks within its overlap; a sharp one opens at its overlap, which is an event.
"""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant
from ehls_ros.schema import quantity

EQUATION = (
    "Q = Cd w gain o √(2/ρ) Δp/(Δp² + transition²)^(1/4),  o = (u + √(u² + rounding²))/2,  u = ±xv - overlap;  "
    "+ for P-A and B-T, - for P-B and A-T"
)
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 3 and 5; Jelali, Kroll, Hydraulic Servo-systems, 2003, ch. 4"
MODES = 4

EDGES = ("pa", "at", "pb", "bt")
"""The edges by the ports that they join."""

CHAMBER_OF_EDGE = {edge: "a" if "a" in edge else "b" for edge in EDGES}
"""Chamber whose flow passes an edge."""

SHARP = 1e-9
"""Rounding below which an edge opens at an event [m]; a larger one is resolved by the integration."""

_GAIN, _OVERLAP, _ROUND = (
    "flow gain of edge {}, relative to Cd w",
    "overlap of edge {}; negative: underlap",
    "rounding of edge {}",
)


class Parameters(NamedTuple):
    """The four edges, and the pressure drop below which their flow is laminar."""

    gain_pa: Annotated[float, quantity("1", _GAIN.format("P-A"), above=0.0, maximum=100.0)] = 1.0
    gain_at: Annotated[float, quantity("1", _GAIN.format("A-T"), above=0.0, maximum=100.0)] = 1.0
    gain_pb: Annotated[float, quantity("1", _GAIN.format("P-B"), above=0.0, maximum=100.0)] = 1.0
    gain_bt: Annotated[float, quantity("1", _GAIN.format("B-T"), above=0.0, maximum=100.0)] = 1.0
    overlap_pa: Annotated[float, quantity("m", _OVERLAP.format("P-A"), minimum=-0.1, maximum=0.1)] = 0.0
    overlap_at: Annotated[float, quantity("m", _OVERLAP.format("A-T"), minimum=-0.1, maximum=0.1)] = 0.0
    overlap_pb: Annotated[float, quantity("m", _OVERLAP.format("P-B"), minimum=-0.1, maximum=0.1)] = 0.0
    overlap_bt: Annotated[float, quantity("m", _OVERLAP.format("B-T"), minimum=-0.1, maximum=0.1)] = 0.0
    rounding_pa: Annotated[float, quantity("m", _ROUND.format("P-A"), minimum=0.0, maximum=0.1)] = 0.0
    rounding_at: Annotated[float, quantity("m", _ROUND.format("A-T"), minimum=0.0, maximum=0.1)] = 0.0
    rounding_pb: Annotated[float, quantity("m", _ROUND.format("P-B"), minimum=0.0, maximum=0.1)] = 0.0
    rounding_bt: Annotated[float, quantity("m", _ROUND.format("B-T"), minimum=0.0, maximum=0.1)] = 0.0
    transition_pressure: Annotated[
        float, quantity("Pa", "pressure drop below which the flow is laminar", minimum=1.0, maximum=1e8)
    ] = 1e5


def check(p: Parameters, where: str) -> None:
    """Accept every valve: the ranges of the keys suffice."""


def slope(p: Parameters, plant: Plant, flow: float) -> float:
    """Return the slope at no pressure drop, of an edge that passes the flow at half the supply pressure [m^3/(s Pa)]."""
    return flow / math.sqrt(0.5 * plant.supply_pressure * p.transition_pressure)


@kernel
def edge_flow(gain: float, u: float, rounding: float, drop: float, transition: float) -> float:
    """Return the flow through an edge [m^3/s].

    Args:
        gain: flow per opening and root of the pressure drop [m^2/(s Pa^0.5)].
        u: displacement beyond the overlap [m].
        rounding: rounding of the edge [m].
        drop: pressure drop [Pa].
        transition: pressure drop below which the flow is laminar [Pa].
    """
    if rounding > 0.0:
        area = 0.5 * (u + math.sqrt(u * u + rounding * rounding))
    elif u > 0.0:
        area = u
    else:
        # A sharp edge is closed: spares the roots of half the edges. The product is a dual where the drop is one.
        return 0.0 * drop
    return gain * area * drop / math.sqrt(math.sqrt(drop * drop + transition * transition))


@kernel
def chamber_flows(
    opening: float, supply: float, a: float, b: float, tank: float, p: Parameters, plant: Plant
) -> tuple[float, float, float]:
    """Return the flows into chamber A, into chamber B, and from the supply [m^3/s]."""
    gain = plant.discharge_coefficient * plant.valve_area_gradient * math.sqrt(2.0 / plant.oil_density)
    transition = p.transition_pressure
    pa = edge_flow(gain * p.gain_pa, opening - p.overlap_pa, p.rounding_pa, supply - a, transition)
    at = edge_flow(gain * p.gain_at, -opening - p.overlap_at, p.rounding_at, a - tank, transition)
    pb = edge_flow(gain * p.gain_pb, -opening - p.overlap_pb, p.rounding_pb, supply - b, transition)
    bt = edge_flow(gain * p.gain_bt, opening - p.overlap_bt, p.rounding_bt, b - tank, transition)
    return pa - at, pb - bt, pa + pb


@kernel
def gains(side: float, drop_a: float, drop_b: float, p: Parameters, plant: Plant) -> tuple[float, float]:
    """Return the flows into A and B per opening [m^2/s], without overlap and rounding."""
    gain = plant.discharge_coefficient * plant.valve_area_gradient * math.sqrt(2.0 / plant.oil_density)
    of_a, of_b = (p.gain_pa, p.gain_bt) if side > 0.0 else (p.gain_at, p.gain_pb)
    return gain * of_a * math.sqrt(drop_a), -gain * of_b * math.sqrt(drop_b)


@kernel
def drop_ratio(side: float, speed_a: float, speed_b: float, p: Parameters) -> tuple[float, float]:
    """Return the pressure drops between A or B and their ports, up to a common factor."""
    of_a, of_b = (p.gain_pa, p.gain_bt) if side > 0.0 else (p.gain_at, p.gain_pb)
    return (speed_a / of_a) ** 2, (speed_b / of_b) ** 2


@kernel
def _passed(u: float, rounding: float, mode: float) -> float:
    """Return a positive value once a sharp edge has opened or closed, against its mode."""
    return -mode * u if rounding < SHARP else -1.0


@kernel
def event(opening: float, mode: Array, p: Parameters) -> float:
    """Return a positive value once a sharp edge has opened or closed."""
    positive = max(
        _passed(opening - p.overlap_pa, p.rounding_pa, mode[0]), _passed(opening - p.overlap_bt, p.rounding_bt, mode[3])
    )
    negative = max(
        _passed(-opening - p.overlap_at, p.rounding_at, mode[1]), _passed(-opening - p.overlap_pb, p.rounding_pb, mode[2])
    )
    return max(positive, negative)


@kernel
def switch(opening: float, mode: Array, p: Parameters) -> None:
    """Change the modes of the edges that have opened or closed."""
    if _passed(opening - p.overlap_pa, p.rounding_pa, mode[0]) > 0.0:
        mode[0] = -mode[0]
    if _passed(-opening - p.overlap_at, p.rounding_at, mode[1]) > 0.0:
        mode[1] = -mode[1]
    if _passed(-opening - p.overlap_pb, p.rounding_pb, mode[2]) > 0.0:
        mode[2] = -mode[2]
    if _passed(opening - p.overlap_bt, p.rounding_bt, mode[3]) > 0.0:
        mode[3] = -mode[3]
