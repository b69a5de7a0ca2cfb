"""Residuals of a rig file's equations for a recording, by stage, and the sizes of their terms.

A double rod has one residual of the flow, a single rod one of each chamber; both have one of the supply pressure.
"""

from collections.abc import Mapping
from typing import Any

import numba as nb
import numpy as np
from scipy.signal import butter, sosfiltfilt

from . import kernel
from .effects import is_single
from .recording import Recording
from .single_rod import chambers, edges

BAND = 25.0  # Hz, bandwidth of the flow and force balances
EDGE = 0.1  # s, omitted at either end

Columns = Mapping[str, np.ndarray]


@nb.njit(cache=True)
def friction_along(v, dt, stiffness, weight, attraction, fc, fs, vs, exponent, lugre):
    """Return the friction force of a given motion, without the viscous part."""
    force, mode = np.zeros(stiffness.size), np.zeros(stiffness.size)
    out = np.empty(v.size)
    for j in range(v.size):
        side = 1.0 if v[j] > 0.0 else -1.0
        s = fc + (fs - fc) * np.exp(-((abs(v[j]) / vs) ** exponent))
        total = 0.0
        for i in range(force.size):
            if lugre:
                decay = np.exp(-stiffness[i] * abs(v[j]) / s * dt)
                force[i] = side * s + (force[i] - side * s) * decay
            else:
                if mode[i] * v[j] < 0.0:
                    mode[i] = 0.0
                if mode[i] == 0.0:
                    force[i] += stiffness[i] * v[j] * dt
                    if side * force[i] > weight[i] * s:
                        force[i] = side * weight[i] * s
                        mode[i] = side
                else:
                    force[i] += attraction * (side * weight[i] - force[i] / s) * dt
            total += force[i]
        out[j] = total
    return out


@nb.njit(cache=True)
def follow(given, decay, first):
    """Return a first-order lag at the end of each cycle of a held signal."""
    out = np.empty(given.size - 1)
    at = first
    for i in range(out.size):
        at = given[i] + (at - given[i]) * decay
        out[i] = at
    return out


def mean_area(rig: Mapping[str, Any]) -> float:
    """Return the area to which the load pressure refers, m^2."""
    return chambers(rig)["mean_area"] if is_single(rig) else rig["plant"]["piston_area"]


def load_pressure(rig: Mapping[str, Any], c: Columns) -> np.ndarray:
    """Return the recorded load pressure: of a single rod, the force of both chambers over the mean area, Pa."""
    if not is_single(rig):
        return c["load_pressure_pa"]
    p = chambers(rig)
    return (p["area_a"] * c["pressure_a_pa"] - p["area_b"] * c["pressure_b_pa"]) / p["mean_area"]


def valve_flow(rig: Mapping[str, Any], spool: np.ndarray, supply: np.ndarray, p_load: np.ndarray) -> np.ndarray:
    """Return the flow of the valve to a double rod, (1), m^3/s."""
    plant = rig["plant"]
    flow = plant["discharge_coefficient"] * plant["valve_area_gradient"] * spool
    return flow * np.sqrt(np.maximum(supply - np.sign(spool) * p_load, 0.0) / plant["oil_density"])


def edge_flows(rig: Mapping[str, Any], spool: np.ndarray, supply: np.ndarray, a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    """Return the flows through the metering edges in the order of `kernel.EDGES`, m^3/s."""
    plant, tank = rig["plant"], chambers(rig)["tank_pressure"]
    wide = plant["discharge_coefficient"] * plant["valve_area_gradient"] * np.sqrt(2.0 / plant["oil_density"])
    laminar = rig["valve"].get("transition_pressure", 1.0e5)
    e = edges(rig)
    flows = []
    for i, (side, drop) in enumerate([(1.0, supply - a), (-1.0, a - tank), (-1.0, supply - b), (1.0, b - tank)]):
        past = side * spool - e["overlap"][i]
        opening = 0.5 * e["gain"][i] * (past + np.hypot(past, e["rounding"][i]))
        flows.append(wide * opening * drop / np.sqrt(np.hypot(drop, laminar)))
    return flows


def _load_balance(
    rig: Mapping[str, Any], c: Columns, spool: np.ndarray, x: np.ndarray, v: np.ndarray, step: float
) -> list[np.ndarray]:
    plant, p_load = rig["plant"], c["load_pressure_pa"]
    supply = c.get("supply_pressure_pa", plant["supply_pressure"])
    compressed = plant["total_volume"] / (4.0 * plant["bulk_modulus"]) * np.gradient(p_load, step)
    flow = valve_flow(rig, spool, supply, p_load)
    return [
        flow - plant["piston_area"] * v - plant["leakage_coefficient"] * p_load - compressed,
        *([supply - plant["supply_pressure"]] if "supply_pressure_pa" in c else []),
    ]


def _chamber_balances(
    rig: Mapping[str, Any], c: Columns, spool: np.ndarray, x: np.ndarray, v: np.ndarray, step: float
) -> list[np.ndarray]:
    plant, p = rig["plant"], chambers(rig)
    a, b, supply = (c[name] for name in ("pressure_a_pa", "pressure_b_pa", "supply_pressure_pa"))
    flow = dict(zip(kernel.EDGES, edge_flows(rig, spool, supply, a, b), strict=True))
    past = plant["leakage_coefficient"] * (a - b)
    give_a = (p["volume_a"] + p["area_a"] * x) / plant["bulk_modulus"] + p["hose_compliance_a"]
    give_b = (p["volume_b"] - p["area_b"] * x) / plant["bulk_modulus"] + p["hose_compliance_b"]
    lost_a, lost_b = (p[f"leakage_{side}"] * (c[f"pressure_{side}_pa"] - p["tank_pressure"]) for side in "ab")
    wanted = plant["supply_pressure"] - p["supply_resistance"] * (flow["pa"] + flow["pb"])
    lagged = np.empty_like(supply)
    lagged[0] = supply[0]
    lagged[1:] = follow(wanted, np.exp(-step / p["supply_time_constant"]), supply[0])
    return [
        flow["pa"] - flow["at"] - p["area_a"] * v - past - lost_a - give_a * np.gradient(a, step),
        flow["pb"] - flow["bt"] + p["area_b"] * v + past - lost_b - give_b * np.gradient(b, step),
        supply - lagged,
    ]


def model_residuals(rig: Mapping[str, Any], r: Recording) -> dict[str, list[np.ndarray]]:
    """Return the residuals of the nominal equations for a recording, by stage.

    Columns of a double rod may be missing: residuals that compare them are omitted, the spool follows from the command, and the
    supply pressure is the rig file's.
    """
    plant, friction = rig["plant"], rig["friction"]
    c, step = r.columns, 1.0 / r.truth["rate"]
    low = butter(3, BAND, fs=1.0 / step, output="sos")
    edge = round(EDGE / step)

    def band(a: np.ndarray) -> np.ndarray:
        return sosfiltfilt(low, a)[edge:-edge]

    x = sosfiltfilt(low, c["position_m"])
    v = np.gradient(x, step)
    drive, command = mean_area(rig) * load_pressure(rig, c), plant["valve_gain"] * c["valve_command_m"]
    modelled = np.empty_like(command)
    modelled[0] = c["spool_m"][0] if "spool_m" in c else command[0]
    modelled[1:] = follow(command, np.exp(-plant["valve_bandwidth"] * step), modelled[0])
    spool = c.get("spool_m", modelled)
    balance = _chamber_balances if is_single(rig) else _load_balance
    lugre = friction["model"] == "lugre"
    stiffness, weight = (np.asarray(friction[key], float) for key in ("element_stiffness", "element_weight"))
    if lugre:
        stiffness, weight = stiffness.sum(keepdims=True), np.ones(1)
    rub = friction_along(
        v, step, stiffness, weight, friction["attraction_rate"], friction["coulomb_force"], friction["static_force"],
        friction["stribeck_velocity"], friction["stribeck_exponent"], lugre,
    )  # fmt: skip
    force = (
        drive
        - plant["moving_mass"] * (np.gradient(v, step) + plant["gravity"])
        - (plant["viscous_damping"] + friction["viscous_coefficient"]) * v
        - plant["spring_stiffness"] * x
        - rub
        - c["disturbance_force_n"]
    )
    return {
        "force_balance": [band(force)],
        "flow": [band(row) for row in balance(rig, c, spool, x, v, step)],
        "valve": [(spool - modelled)[edge:-edge]] if "spool_m" in c else [],
        "sensors": [band(c[name] - other) for name, other in {"force_n": drive, "velocity_m_s": v}.items() if name in c],
    }


def largest_terms(rig: Mapping[str, Any], r: Recording) -> dict[str, list[float]]:
    """Return the rms of the largest term in each residual of `model_residuals`; 0 for that of the supply."""
    c, step = r.columns, 1.0 / r.truth["rate"]
    p_load, speed, supply = load_pressure(rig, c), rms(np.gradient(c["position_m"], step)), c["supply_pressure_pa"]
    load = rms(mean_area(rig) * p_load)
    if is_single(rig):
        p, flows = chambers(rig), edge_flows(rig, c["spool_m"], supply, c["pressure_a_pa"], c["pressure_b_pa"])
        flow = [max(rms(flows[0]), rms(flows[1]), p["area_a"] * speed), max(rms(flows[2]), rms(flows[3]), p["area_b"] * speed)]
    else:
        flow = [max(rms(valve_flow(rig, c["spool_m"], supply, p_load)), mean_area(rig) * speed)]
    return {
        "force_balance": [max(load, rms(c["disturbance_force_n"]))],
        "flow": [*flow, 0.0],
        "valve": [rms(c["spool_m"])],
        "sensors": [load, speed],
    }


def rms(a: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(a * a)))
