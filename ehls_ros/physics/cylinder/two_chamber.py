"""Cylinder with the pressures of both chambers as states: a single rod, or two rods of different size.

Chamber A pushes towards +x. Pressures are relative to the atmosphere. Below the vapour pressure, the state of a chamber stands
for the volume of a cavity: the pressure stays at the vapour pressure, and the cavity has V0/βe times the distance of the state
from it. The oil in the chamber is thus conserved while the cavity grows and collapses. Both are events.

The pressure at the valve's port P falls by ``supply_resistance`` per flow with a lag: pump, accumulator and line in one.
"""

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.errors import BadInput
from ehls_ros.physics import sensors
from ehls_ros.physics.cylinder.base import Equivalent, OilRates
from ehls_ros.physics.equations import ATMOSPHERE, air_compliance
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, Chains, Coefficients, Oil, V, X, relations
from ehls_ros.physics.rig import CHAMBER_SENSED, EffectiveRig
from ehls_ros.schema import quantity

EQUATION = (
    "(V_A/βe + H_A) ṗ_A = Q_A - A_A ẋ - Ctc (p_A - p_B) - C_A (p_A - p_T);  "
    "(V_B/βe + H_B) ṗ_B = Q_B + A_B ẋ + Ctc (p_A - p_B) - C_B (p_B - p_T);  "
    "V_A = volume_a + A_A x,  V_B = volume_b - A_B x;  1/βe of each with the compliance of its air;  F = A_A p_A - A_B p_B"
)
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 6; Jelali, Kroll, Hydraulic Servo-systems, 2003, ch. 4"
STATES, MODES = 3, 2
SENSED = CHAMBER_SENSED
FLOW, DEFAULT_VALVE = "chamber_flows", "four_edges"
CHAMBERS = True

LEAST_VOLUME = 1e-2
"""Smallest volume of a chamber, as a fraction of that at position 0: beyond its end, a piston compresses no less."""


class Parameters(NamedTuple):
    """Areas, volumes and leakages by chamber, tank and supply."""

    area_a: Annotated[float, quantity("m^2", "piston area in chamber A", above=0.0, typical=3e-3)]
    area_b: Annotated[float, quantity("m^2", "piston area in chamber B", above=0.0, typical=1.5e-3)]
    volume_a: Annotated[float, quantity("m^3", "oil of chamber A, hose included, at position 0", above=0.0, typical=1e-3)]
    volume_b: Annotated[float, quantity("m^3", "oil of chamber B, hose included, at position 0", above=0.0, typical=5e-4)]
    hose_compliance_a: Annotated[float, quantity("m^3/Pa", "widening of the hose to A", minimum=0.0, maximum=1e-8)] = 0.0
    hose_compliance_b: Annotated[float, quantity("m^3/Pa", "widening of the hose to B", minimum=0.0, maximum=1e-8)] = 0.0
    leakage_a: Annotated[float, quantity("m^5/(N s)", "leakage from A to the tank", minimum=0.0, maximum=1e-8)] = 0.0
    leakage_b: Annotated[float, quantity("m^5/(N s)", "leakage from B to the tank", minimum=0.0, maximum=1e-8)] = 0.0
    air_a: Annotated[
        float, quantity("1", "volume fraction of undissolved air in A at atmospheric pressure", minimum=0.0, maximum=0.5)
    ] = 0.0
    air_b: Annotated[float, quantity("1", "the same in B", minimum=0.0, maximum=0.5)] = 0.0
    tank_pressure: Annotated[float, quantity("Pa", "pressure at the valve's port T", minimum=0.0, maximum=1e8)] = 0.0
    vapour_pressure: Annotated[
        float,
        quantity("Pa", "pressure at which the oil cavitates, relative to the atmosphere", minimum=-ATMOSPHERE, maximum=0.0),
    ] = -1e5
    supply_resistance: Annotated[float, quantity("Pa s/m^3", "supply pressure lost per flow", minimum=0.0, maximum=1e12)] = 0.0
    supply_time_constant: Annotated[
        float, quantity("s", "lag of the supply pressure behind the flow", minimum=1e-3, maximum=100.0)
    ] = 1e-2


def check(p: Parameters, where: str) -> None:
    """Raise BadInput if an area exceeds the other one a hundredfold."""
    ratio = p.area_a / p.area_b
    if not 0.01 <= ratio <= 100.0:
        raise BadInput(f"area_a is {p.area_a:g} and area_b {p.area_b:g}", where, "areas in m^2 with a ratio of 0.01 to 100")


def check_stroke(p: Parameters, ends: tuple[float, float], where: str) -> None:
    """Raise BadInput if a chamber has no oil left at an end of the stroke."""
    for key, at_zero, area, end in (("volume_a", p.volume_a, p.area_a, ends[0]), ("volume_b", p.volume_b, -p.area_b, ends[1])):
        if at_zero + area * end <= LEAST_VOLUME * at_zero:
            what = f"{key} is {at_zero:g} m^3, and the chamber has {at_zero + area * end:.3g} m^3 left at position {end:g} m"
            raise BadInput(
                what, where, f"a volume at position 0 beyond the {abs(area * end):.3g} m^3 of the stroke up to there"
            )


def derived(p: Parameters) -> dict[str, Any]:
    """Return the area to which the load pressure refers, the mean of both, and the volume of an equally stiff double rod."""
    area = 0.5 * (p.area_a + p.area_b)
    stiffness = p.area_a * p.area_a / p.volume_a + p.area_b * p.area_b / p.volume_b
    return {"piston_area": area, "total_volume": 4.0 * area * area / stiffness}


def at_rest(p: Parameters, plant: Any) -> tuple[float, ...]:
    """Return pressures without driving force whose mean is that of P and T, and the supply pressure."""
    both = (plant.supply_pressure + p.tank_pressure) / (p.area_a + p.area_b)
    return both * p.area_b, both * p.area_a, plant.supply_pressure


def forces(p: Parameters, plant: Any) -> tuple[float, float]:
    """Return the forces with one chamber at the supply pressure and the other one at that of the tank [N]."""
    supply, tank = plant.supply_pressure, p.tank_pressure
    return p.area_a * tank - p.area_b * supply, p.area_a * supply - p.area_b * tank


def oil_rates(rig: EffectiveRig, flow: float) -> OilRates:
    """Return the rates of the stiffer chamber, and of the stiffest oil column within the limits of the position."""
    p, plant, modulus = rig.cylinder.parameters, rig.plant, rig.plant.bulk_modulus
    # A bound is infinite or not a number in a rig file without limits.
    ends = [x for x in rig.limits.position if math.isfinite(x)] or [0.0]
    a = [1.0 / (volume(p.volume_a, p.area_a, x) / modulus + p.hose_compliance_a) for x in ends]
    b = [1.0 / (volume(p.volume_b, -p.area_b, x) / modulus + p.hose_compliance_b) for x in ends]
    column = max(p.area_a**2 * one + p.area_b**2 * other for one, other in zip(a, b, strict=True))
    leakage = max(max(a) * (plant.leakage_coefficient + p.leakage_a), max(b) * (plant.leakage_coefficient + p.leakage_b))
    orifice = max(*a, *b) * rig.valve.law.slope(rig.valve.parameters, plant, flow)
    return OilRates(column, leakage, orifice, ("bulk_modulus",))


def volume(at_zero: float, area: float, x: float) -> float:
    """Return the volume of a chamber [m^3] at a position [m]; ``area`` is negative if it shrinks with the position."""
    return max(at_zero + area * x, LEAST_VOLUME * at_zero)


volume_of = kernel(volume, python=volume)


@kernel
def modulus_with_air(oil: float, air: float, pressure: float) -> float:
    """Return the bulk modulus in a chamber [Pa], from that of the oil, the fraction of air, and the pressure [Pa]."""
    return oil / (1.0 + oil * air * air_compliance(pressure)) if air > 0.0 else oil


class Terms(NamedTuple):
    """Terms of both chambers' balances.

    Attributes:
        flow_a, flow_b: flow from the valve [m^3/s].
        lost_a, lost_b: leakage out of the chamber [m^3/s].
        modulus_a, modulus_b: bulk modulus in it [Pa].
        supplied: flow from the supply [m^3/s].
    """

    flow_a: float
    flow_b: float
    lost_a: float
    lost_b: float
    modulus_a: float
    modulus_b: float
    supplied: float


def terms(valve: Any, chains: Chains) -> Callable[..., Terms]:
    """Build the terms of the chambers' balances with the flows of a valve.

    Returns:
        Compiled ``terms(opening, supply, a, b, t, y, z, c)`` at an effective opening [m] and pressures at P, A and B [Pa].
    """
    flows, piston_leakage = valve.chamber_flows, chains.piston_leakage

    @kernel_no_refcount
    def at(opening: float, supply: float, a: float, b: float, t: float, y: Array, z: Array, c: Coefficients) -> Terms:
        p, plant = c.cylinder, c.plant
        flow_a, flow_b, supplied = flows(opening, supply, a, b, p.tank_pressure, c.valve, plant)
        past = piston_leakage(plant.leakage_coefficient * (a - b), a - b, t, y, c.inputs, z, c.effects, plant)
        lost_a, lost_b = past + p.leakage_a * (a - p.tank_pressure), p.leakage_b * (b - p.tank_pressure) - past
        modulus_a, modulus_b = plant.bulk_modulus, plant.bulk_modulus
        # One branch for both: most oil is free of air, and the powers are expensive.
        if p.air_a + p.air_b > 0.0:
            modulus_a, modulus_b = modulus_with_air(modulus_a, p.air_a, a), modulus_with_air(modulus_b, p.air_b, b)
        return Terms(flow_a, flow_b, lost_a, lost_b, modulus_a, modulus_b, supplied)

    return at


@kernel
def pressure_rate(
    inflow: float, cavity: float, volume: float, at_zero: float, modulus: float, compliance: float, oil: float
) -> float:
    """Return the rate of a chamber's state [Pa/s].

    Args:
        inflow: volume flow into the chamber, less the growth of the chamber [m^3/s].
        cavity: mode of the chamber: -1 if it has a cavity, 1 if not.
        volume: its volume [m^3].
        at_zero: its volume at position 0 [m^3].
        modulus: bulk modulus in it [Pa].
        compliance: that of its hose [m^3/Pa].
        oil: bulk modulus of the rig [Pa].
    """
    # One division in either mode.
    stored, soft = (modulus, volume + modulus * compliance) if cavity > 0.0 else (oil, at_zero)
    return inflow * stored / soft


@kernel
def _compressions(x: float, modulus: float, p: Parameters) -> tuple[float, float]:
    """Return the pressure changes of A and B per motion of the piston with the valve shut, over the modulus [1/m]."""
    soft_a = volume_of(p.volume_a, p.area_a, x) + modulus * p.hose_compliance_a
    soft_b = volume_of(p.volume_b, -p.area_b, x) + modulus * p.hose_compliance_b
    return p.area_a / soft_a, p.area_b / soft_b


class Drops(NamedTuple):
    """Pressures at the open edges.

    Attributes:
        port_a, port_b: pressures at the ports of A and B [Pa].
        drop_a, drop_b: pressure drops between chamber and port [Pa].
        mean: that of the double rod [Pa].
        largest: driving force without flow, times the side [N].
        known: whether none of them is raised to the least.
    """

    port_a: float
    port_b: float
    drop_a: float
    drop_b: float
    mean: float
    largest: float
    known: bool


@kernel
def _drops(m: Array, side: float, ratio_a: float, ratio_b: float, floor: float, plant: Plant, p: Parameters) -> Drops:
    """Return the pressures at the edges open on a side, by readings of both chambers or as in steady motion."""
    supply, tank, area = sensors.read_supply(m, plant), p.tank_pressure, plant.piston_area
    pressure = m[sensors.LOAD_PRESSURE] if math.isfinite(m[sensors.LOAD_PRESSURE]) else 0.0
    port_a, port_b = (supply, tank) if side > 0.0 else (tank, supply)
    largest = side * (p.area_a * port_a - p.area_b * port_b)
    mean = max(largest / area - side * pressure, floor)
    factor = area * mean / (p.area_a * ratio_a + p.area_b * ratio_b)
    drop_a, drop_b, known = factor * ratio_a, factor * ratio_b, mean > floor
    if m.size > sensors.PRESSURE_B and math.isfinite(m[sensors.PRESSURE_A]) and math.isfinite(m[sensors.PRESSURE_B]):
        drop_a = max(side * (port_a - m[sensors.PRESSURE_A]), floor)
        drop_b = max(side * (m[sensors.PRESSURE_B] - port_b), floor)
        known = min(drop_a, drop_b) > floor
    return Drops(port_a, port_b, drop_a, drop_b, mean, largest, known)


def equivalent(valve: Any) -> Callable[..., Equivalent]:
    """Build the double rod that the cylinder is at the present readings.

    For edges of one gain, or of gains in the ratio of the areas, a single rod moves steadily as a double rod of the mean area
    with an additional constant force, (A_A - A_B)(ps + pT)/2: the pressure drop of both edges of a side is proportional to
    A_A ps - A_B pT - F or to A_B ps - A_A pT + F. Without readings of the chambers, their pressures are those of such a motion.
    """
    gains, drop_ratio = valve.gains, valve.drop_ratio

    @kernel
    def local(m: Array, spool: float, least: float, plant: Plant, p: Parameters, v: Any) -> Equivalent:
        x = m[sensors.POSITION] if math.isfinite(m[sensors.POSITION]) else 0.0
        side = -1.0 if spool < 0.0 else 1.0
        area, tank, modulus = plant.piston_area, p.tank_pressure, plant.bulk_modulus
        offset = 0.5 * (p.area_a - p.area_b) * (plant.supply_pressure + tank)
        ratio_a, ratio_b = drop_ratio(side, p.area_a, p.area_b, v)
        at = _drops(m, side, ratio_a, ratio_b, least * plant.supply_pressure, plant, p)
        flow_a, flow_b = gains(side, at.drop_a, at.drop_b, v, plant)
        part_a, part_b = _compressions(x, modulus, p)
        stiffness = p.area_a * part_a + p.area_b * part_b
        middle_a, middle_b = _compressions(0.0, modulus, p)
        # QL per opening that raises the force of the double rod as fast, and Cd of (1) for it.
        flow = area * (part_a * flow_a - part_b * flow_b) / stiffness
        discharge = flow * math.sqrt(plant.oil_density / at.mean) / plant.valve_area_gradient
        local_plant = Plant(
            plant.supply_pressure - tank,
            plant.oil_density,
            modulus,
            discharge,
            plant.valve_area_gradient,
            plant.leakage_coefficient * area * (part_a + part_b) / stiffness,
            4.0 * area * area / stiffness,
            plant.moving_mass,
            area,
            plant.arm_length,
            plant.spring_stiffness,
            plant.viscous_damping,
            plant.valve_bandwidth,
            plant.valve_gain,
            plant.gravity - offset / plant.moving_mass,
        )
        return Equivalent(
            local_plant,
            (at.largest - side * offset) / area,
            offset,
            stiffness / (p.area_a * middle_a + p.area_b * middle_b),
        )

    return local


def load_flow(valve: Any) -> Callable[..., float]:
    """Build the flow of the double rod that the cylinder is at the present readings, from those of both chambers."""
    drop_ratio, chamber_flows = valve.drop_ratio, valve.chamber_flows

    @kernel
    def local(m: Array, spool: float, least: float, plant: Plant, p: Parameters, v: Any) -> float:
        side = -1.0 if spool < 0.0 else 1.0
        ratio_a, ratio_b = drop_ratio(side, p.area_a, p.area_b, v)
        at = _drops(m, side, ratio_a, ratio_b, least * plant.supply_pressure, plant, p)
        if not at.known:
            return math.nan
        a, b = at.port_a - side * at.drop_a, at.port_b + side * at.drop_b
        flow_a, flow_b, _ = chamber_flows(spool, sensors.read_supply(m, plant), a, b, p.tank_pressure, v, plant)
        part_a, part_b = _compressions(m[sensors.POSITION], plant.bulk_modulus, p)
        return plant.piston_area * (part_a * flow_a - part_b * flow_b) / (p.area_a * part_a + p.area_b * part_b)

    return local


def build(valve: Any, chains: Chains, first: int) -> Oil:
    """Build the volume balances of both chambers with the flows of a valve."""
    A, B, P, CAVITY_A, CAVITY_B = first, first + 1, first + 2, valve.MODES, valve.MODES + 1
    effective_opening = relations(chains).effective_opening
    piston_position, piston_velocity = chains.piston_position, chains.piston_velocity
    terms_at, valve_event, valve_switch = terms(valve, chains), valve.event, valve.switch

    @kernel_no_refcount
    def cavities(y: Array, mode: Array, c: Coefficients) -> float:
        vapour = c.cylinder.vapour_pressure
        return max(-mode[CAVITY_A] * (y[A] - vapour), -mode[CAVITY_B] * (y[B] - vapour))

    @kernel_no_refcount
    def evaluate(t: float, y: Array, z: Array, mode: Array, c: Coefficients, rate: Array) -> float:
        p, plant, w = c.cylinder, c.plant, c.inputs
        a = y[A] if mode[CAVITY_A] > 0.0 else p.vapour_pressure
        b = y[B] if mode[CAVITY_B] > 0.0 else p.vapour_pressure
        # Not a state: every other part of the plant reads the driving force here.
        y[PL] = (p.area_a * a - p.area_b * b) / plant.piston_area
        rate[PL] = 0.0
        opening = effective_opening(t, y, z, c)
        x = piston_position(y[X], t, y, w, z, c.effects, plant)
        v = piston_velocity(y[V], t, y, w, z, c.effects, plant)
        of = terms_at(opening, y[P], a, b, t, y, z, c)
        into_a, into_b = of.flow_a - p.area_a * v - of.lost_a, of.flow_b + p.area_b * v - of.lost_b
        oil, soft_a, soft_b = plant.bulk_modulus, p.hose_compliance_a, p.hose_compliance_b
        volume_a, volume_b = volume_of(p.volume_a, p.area_a, x), volume_of(p.volume_b, -p.area_b, x)
        rate[A] = pressure_rate(into_a, mode[CAVITY_A], volume_a, p.volume_a, of.modulus_a, soft_a, oil)
        rate[B] = pressure_rate(into_b, mode[CAVITY_B], volume_b, p.volume_b, of.modulus_b, soft_b, oil)
        rate[P] = (plant.supply_pressure - p.supply_resistance * of.supplied - y[P]) / p.supply_time_constant
        return max(valve_event(opening, mode, c.valve), cavities(y, mode, c))

    @kernel_no_refcount
    def switch(t: float, y: Array, z: Array, mode: Array, c: Coefficients) -> None:
        vapour = c.cylinder.vapour_pressure
        valve_switch(effective_opening(t, y, z, c), mode, c.valve)
        if -mode[CAVITY_A] * (y[A] - vapour) > 0.0:
            mode[CAVITY_A] = -mode[CAVITY_A]
        if -mode[CAVITY_B] * (y[B] - vapour) > 0.0:
            mode[CAVITY_B] = -mode[CAVITY_B]

    @kernel_no_refcount
    def sense(t: float, y: Array, z: Array, c: Coefficients, truth: Array) -> None:
        p = c.cylinder
        a, b = max(y[A], p.vapour_pressure), max(y[B], p.vapour_pressure)
        force = p.area_a * a - p.area_b * b
        truth[sensors.LOAD_PRESSURE], truth[sensors.FORCE] = force / c.plant.piston_area, force
        truth[sensors.SUPPLY_PRESSURE] = y[P]
        truth[sensors.PRESSURE_A], truth[sensors.PRESSURE_B] = a, b

    return Oil(evaluate, switch, sense)
