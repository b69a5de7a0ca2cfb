"""Rig with a single rod: both chambers, four metering edges, tank and supply; its nominal sizes and its hidden effects.

The load, the friction, the spool and the sensors are those of the double rod, and so are their effects. Effects of a chamber or
an edge have the size `side`, "a" or "b", or "both" where one cause acts on both chambers.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from . import kernel
from .effects import (
    LISTED,
    OUTSIDE,
    SINGLE_ROD,
    SINGLE_ROD_OUTSIDE,
    Rng,
    Sizes,
    about_one,
    choice,
    factor_and_offset,
    log_uniform,
    of_single_rod,
    plus,
    put,
    ratio,
    scale,
    signed,
    times,
)

CARRIED_OVER = (
    "valve_gain_shift", "valve_bandwidth_shift", "valve_null_bias", "valve_gain_asymmetry", "valve_dead_zone", "command_delay",
    "coulomb_shift", "viscous_shift", "coulomb_asymmetry", "viscous_asymmetry", "pressure_dependent_friction",
    "position_dependent_friction", "mass_shift", "spring_rate_shift", "spring_hardening", "constant_load",
    "periodic_disturbance", "end_stop", "position_sensor_gain", "sensor_delay",
)  # fmt: skip
"""Listed effects of the double rod that act on a single rod by the same formula, and in the same sizes."""

OUTSIDE_CARRIED_OVER = (
    *(name for name, effect in OUTSIDE.items() if effect.stage in ("force_balance", "valve")),
    "laminar_orifice", "lifting_seal", "line_restriction", "position_interpolation",
)  # fmt: skip

COLUMNS = (
    "valve_command_m", "spool_m", "pressure_a_pa", "pressure_b_pa", "supply_pressure_pa", "position_m", "velocity_m_s",
    "force_n", "disturbance_force_n", "oil_temperature_k",
)  # fmt: skip

CYLINDER = {
    "area_a": "area_a", "area_b": "area_b", "volume_a": "volume_a", "volume_b": "volume_b", "hose_compliance_a": "hose_a",
    "hose_compliance_b": "hose_b", "leakage_a": "leak_a", "leakage_b": "leak_b", "tank_pressure": "tank",
    "vapour_pressure": "vapour", "supply_resistance": "droop", "supply_time_constant": "droop_time",
}  # fmt: skip
"""Keys of a rig file's cylinder, and the kernel's fields."""

OMITTED = {"vapour_pressure": -1.0e5, "supply_time_constant": 1.0e-2}
"""Values of omitted keys other than 0."""


def chambers(rig: Mapping[str, Any]) -> dict[str, float]:
    """Return all values of a rig file's cylinder by their keys, and its mean area."""
    given = {key: rig["cylinder"].get(key, OMITTED.get(key, 0.0)) for key in CYLINDER}
    return given | {"mean_area": 0.5 * (given["area_a"] + given["area_b"])}


def edges(rig: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return gain, overlap and rounding of the edges in the order of `kernel.EDGES`."""
    valve = rig.get("valve", {})
    return {
        key: np.array([valve.get(f"{key}_{edge}", neutral) for edge in kernel.EDGES])
        for key, neutral in {"gain": 1.0, "overlap": 0.0, "rounding": 0.0}.items()
    }


def put_nominal(p: np.ndarray, rig: Mapping[str, Any]) -> None:
    """Write cylinder and valve of a rig file into the kernel's record, and the numbers of the experiment's controller.

    Raises:
        ValueError: the rig file has a key or a valve that this generator does not support.
    """
    valve = rig.get("valve", {"model": "four_edges"})
    known = {"model", "transition_pressure", *(f"{key}_{edge}" for key in edges(rig) for edge in kernel.EDGES)}
    if valve["model"] != "four_edges" or set(valve) - known or set(rig["cylinder"]) - set(CYLINDER) - {"model"}:
        raise ValueError(f"cylinder {rig['cylinder']}, valve {valve}: the truth has two_chamber with four_edges")
    c, given = chambers(rig), edges(rig)
    for key, field in CYLINDER.items():
        p[field] = c[key]
    for key, values in given.items():
        p[f"edge_{key}"] = values
    p["laminar_below"] = valve.get("transition_pressure", 1.0e5)
    p["area"] = c["mean_area"]
    a, b, tank, supply = c["area_a"], c["area_b"], c["tank_pressure"], rig["plant"]["supply_pressure"]
    p["reach_out"], p["reach_in"] = a * supply - b * tank, b * supply - a * tank
    gain = p["valve_gain"] * p["discharge"] * p["gradient"] * math.sqrt(2.0) / np.sqrt(p["density"])
    pa, at, pb, bt = given["gain"]
    for field, of_a, of_b in (("flow_gain_out", pa, bt), ("flow_gain_in", at, pb)):
        # Steady motion divides the spare force between both edges, in proportion to (area / gain)^2.
        p[field] = gain * c["mean_area"] ** 1.5 / math.sqrt(a * (a / of_a) ** 2 + b * (b / of_b) ** 2)
    p["guard"] = 0.9 * min(abs(x) for x in rig.get("limits", {}).get("position", (-0.3, 0.3)))


def resting(rig: Mapping[str, Any], force: float) -> tuple[float, float]:
    """Return chamber pressures with a driving force whose sum is that of supply and tank, Pa."""
    c = chambers(rig)
    both = rig["plant"]["supply_pressure"] + c["tank_pressure"]
    a = (force + c["area_b"] * both) / (c["area_a"] + c["area_b"])
    return a, both - a


# -------------------------------------------------------------------------------------------------------------- effects

SINGLE_ROD |= {name: LISTED[name] for name in CARRIED_OVER}
SINGLE_ROD_OUTSIDE |= {name: OUTSIDE[name] for name in OUTSIDE_CARRIED_OVER}


def one_side(rng: Rng) -> str:
    return choice(rng, "a", "b")


def on_side(field: str, size: str) -> Any:
    """Make an `apply` that adds a size to the field of its side, or of both."""

    def apply(p: np.ndarray, sizes: Sizes) -> None:
        for side in ("a", "b") if sizes["side"] == "both" else (sizes["side"],):
            plus(p, field.format(side), sizes[size])

    return apply


def on_edge(field: str) -> Any:
    """Make an `apply` that writes the size of an edge into an array of the kernel's record."""

    def apply(p: np.ndarray, sizes: Sizes) -> None:
        p[f"edge_{field}"][kernel.EDGES.index(sizes["edge"])] += sizes[field]

    return apply


def draw_edge(rng: Rng) -> Sizes:
    edge = choice(rng, *kernel.EDGES)
    return {"edge": edge, "side": "a" if edge in ("pa", "at") else "b"}


of_single_rod(
    "internal_leakage_shift", "flow", lambda rng, rig: {"factor": ratio(rng, 1.05, 4.0)}, scale("leakage"), {"factor": 1.0},
    "past the piston, x or / 1.05..4", natural=factor_and_offset("plant", "leakage_coefficient"),
)  # fmt: skip
of_single_rod(
    "turbulent_leakage", "flow", lambda rng, rig: {"coefficient": log_uniform(rng, 1e-10, 1e-8)}, put(turbulent="coefficient"),
    {"coefficient": 0.0}, "1e-10..1e-8 m^3/(s Pa^0.5) times the root of pA - pB, past the piston, laminar below 0.2 MPa",
)  # fmt: skip
of_single_rod(
    "bulk_modulus_shift", "flow", lambda rng, rig: {"factor": ratio(rng, 1.04, 2.5)}, scale("bulk"), {"factor": 1.0},
    "x or / 1.04..2.5", natural=factor_and_offset("plant", "bulk_modulus"),
)  # fmt: skip
of_single_rod(
    "external_leakage", "flow", lambda rng, rig: {"coefficient": log_uniform(rng, 1e-13, 8e-12), "side": one_side(rng)},
    on_side("leak_{}", "coefficient"), {"coefficient": 0.0, "side": "a"},
    "1e-13..8e-12 m^5/(N s) from one chamber to the tank",
)  # fmt: skip
of_single_rod(
    "edge_wear", "flow", lambda rng, rig: {"worn": log_uniform(rng, 3e-6, 6e-5), **draw_edge(rng)}, on_edge("worn"),
    {"worn": 0.0, "edge": "pa", "side": "a"},
    "one edge passes w/2 exp(-|u|/2w) more, w = 3..60 um, u beyond its overlap: w/2 more at its corner, little when wide open",
    natural=lambda sizes, rig: {**sizes, "opening": 0.5 * sizes["worn"]},
)  # fmt: skip


def edge_gain(p, sizes):
    p["edge_gain"][kernel.EDGES.index(sizes["edge"])] *= sizes["factor"]


of_single_rod(
    "edge_gain", "flow", lambda rng, rig: {"factor": about_one(rng, 0.005, 0.35), **draw_edge(rng)}, edge_gain,
    {"factor": 1.0, "edge": "pa", "side": "a"}, "flow of one edge x(1 +- 0.5..35 %)",
    natural=lambda sizes, rig: {**sizes, "offset": (sizes["factor"] - 1.0) * rig["valve"].get(f"gain_{sizes['edge']}", 1.0)},
)  # fmt: skip


def draw_hose(rng, rig):
    side = one_side(rng)
    oil = rig["cylinder"][f"volume_{side}"] / rig["plant"]["bulk_modulus"]
    return {"compliance": oil * log_uniform(rng, 0.1, 3.0), "side": side}


of_single_rod(
    "hose_compliance", "flow", draw_hose, on_side("hose_{}", "compliance"), {"compliance": 0.0, "side": "a"},
    "one chamber gives 0.1..3 times as much more as its oil at position 0",
)  # fmt: skip
of_single_rod(
    "entrained_air", "flow",
    lambda rng, rig: {"fraction": log_uniform(rng, 8e-3, 0.12), "side": choice(rng, "a", "b", "both")},
    on_side("air_{}", "fraction"), {"fraction": 0.0, "side": "both"},
    "0.8..12 % of free air by volume at 1 bar, compressed at n = 1.3, in one chamber or both",
)  # fmt: skip


def draw_tank(rng, rig):
    less = -rng.uniform(0.2, 0.9) * chambers(rig)["tank_pressure"]
    return {"offset": log_uniform(rng, 3e4, 1.2e6) if rng.random() < 0.8 else less}


of_single_rod(
    "tank_pressure_shift", "flow", draw_tank, lambda p, sizes: plus(p, "tank", sizes["offset"]), {"offset": 0.0},
    "0.3..12 bar more (a clogged return filter); in 2 of 10, 20..90 % less",
)  # fmt: skip
of_single_rod(
    "supply_pressure_droop", "flow", lambda rng, rig: {"resistance": log_uniform(rng, 1e7, 2e9)},
    lambda p, sizes: plus(p, "droop", sizes["resistance"]), {"resistance": 0.0},
    "0.01..2 GPa s/m^3 more, behind the rig file's lag; the recorded supply pressure droops",
)  # fmt: skip
of_single_rod(
    "pressure_sensor_bias", "sensors", lambda rng, rig: {"bias": signed(rng, 1.5e3, 3e5), "side": one_side(rng)},
    on_side("{}_bias", "bias"), {"bias": 0.0, "side": "a"}, "+-1.5..300 kPa on the pressure of one chamber",
)  # fmt: skip
of_single_rod(
    "pressure_sensor_gain", "sensors", lambda rng, rig: {"gain": about_one(rng, 5e-4, 0.1), "side": one_side(rng)},
    lambda p, sizes: times(p, f"{sizes['side']}_gain", sizes["gain"]), {"gain": 1.0, "side": "a"},
    "x(1 +- 0.05..10 %) on the pressure of one chamber",
)  # fmt: skip
of_single_rod(
    "swapped_pressure_sensors", "sensors", lambda rng, rig: {"swapped": 1.0}, put(swapped="swapped"), {"swapped": 0.0},
    "the sensors of both chambers are swapped: a diagnosis is to refuse the recording",
)  # fmt: skip
