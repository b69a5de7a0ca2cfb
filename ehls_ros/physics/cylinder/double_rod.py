"""Double-rod cylinder of the paper: one state for both chambers, the load pressure."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.physics import sensors
from ehls_ros.physics.cylinder.base import Equivalent, OilRates
from ehls_ros.physics.equations import load_pressure_rate
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, Chains, Coefficients, Oil, V, relations
from ehls_ros.physics.rig import EffectiveRig

EQUATION = "QL = Ac ẋ + Vt/(4 βe) ṗL + Ctc pL (2)"
SOURCE = "Kang et al. 2018, equation (2)"
STATES = MODES = 0
SENSED: tuple[str, ...] = ()
FLOW = DEFAULT_VALVE = "load_flow"
CHAMBERS = False


class Parameters(NamedTuple):
    """No keys beyond those of ``plant``."""


def check(p: Parameters, where: str) -> None:
    """Accept every cylinder."""


def check_stroke(p: Parameters, ends: tuple[float, float], where: str) -> None:
    """Accept every stroke: (2) has one volume."""


def derived(p: Parameters) -> dict[str, Any]:
    """Return no keys: area and volume are those of ``plant``."""
    return {}


def at_rest(p: Parameters, plant: Any) -> tuple[float, ...]:
    """Return no states: the load pressure at rest is zero."""
    return ()


def forces(p: Parameters, plant: Any) -> tuple[float, float]:
    """Return the force of the supply pressure on the piston in both directions [N]."""
    largest = plant.supply_pressure * plant.piston_area
    return -largest, largest


def oil_rates(rig: EffectiveRig, flow: float) -> OilRates:
    """Return the rates of (2), with the flow gain of (1) at the supply pressure."""
    p = rig.plant
    oil = 4.0 * p.bulk_modulus / p.total_volume
    column, leakage = oil * p.piston_area**2, oil * p.leakage_coefficient
    return OilRates(column, leakage, 0.5 * oil * flow / p.supply_pressure, ("bulk_modulus", "piston_area", "total_volume"))


def equivalent(valve: Any) -> Callable[..., Equivalent]:
    """Build the double rod at the present readings: the cylinder itself."""

    @kernel
    def local(m: Array, spool: float, least: float, plant: Plant, p: Any, v: Any) -> Equivalent:
        return Equivalent(plant, sensors.read_supply(m, plant), 0.0, 1.0)

    return local


def load_flow(valve: Any) -> Callable[..., float]:
    """Build the flow (1) at the present readings."""
    through = valve.load_flow

    @kernel
    def local(m: Array, spool: float, least: float, plant: Plant, p: Any, v: Any) -> float:
        side, supply, pressure = -1.0 if spool < 0.0 else 1.0, sensors.read_supply(m, plant), m[sensors.LOAD_PRESSURE]
        known = supply - side * pressure >= least * plant.supply_pressure
        flow: float = through(spool, side, pressure, supply, plant) if known else math.nan  # (1)
        return flow

    return local


def build(valve: Any, chains: Chains, first: int) -> Oil:
    """Build the volume balance (2) with the flow of a valve."""
    equations = relations(chains, valve.load_flow)
    effective_opening, volume, piston_velocity = equations.effective_opening, equations.volume, chains.piston_velocity
    valve_event, valve_switch, supply_pressure = valve.event, valve.switch, chains.supply_pressure

    @kernel_no_refcount
    def evaluate(t: float, y: Array, z: Array, mode: Array, c: Coefficients, rate: Array) -> float:
        orifice = effective_opening(t, y, z, c)
        flow, leak, modulus, _ = volume(orifice, mode[0], t, y, z, c)
        piston = piston_velocity(y[V], t, y, c.inputs, z, c.effects, c.plant)
        rate[PL] = load_pressure_rate(flow, piston, y[PL], leak, modulus, c.plant)  # (2)
        return valve_event(orifice, mode, c.valve)

    @kernel_no_refcount
    def switch(t: float, y: Array, z: Array, mode: Array, c: Coefficients) -> None:
        valve_switch(effective_opening(t, y, z, c), mode, c.valve)

    @kernel_no_refcount
    def sense(t: float, y: Array, z: Array, c: Coefficients, truth: Array) -> None:
        supply = supply_pressure(c.plant.supply_pressure, t, y, c.inputs, z, c.effects, c.plant)
        truth[sensors.LOAD_PRESSURE], truth[sensors.FORCE] = y[PL], c.plant.piston_area * y[PL]
        truth[sensors.SUPPLY_PRESSURE] = supply

    return Oil(evaluate, switch, sense)
