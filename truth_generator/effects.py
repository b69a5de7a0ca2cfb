"""Hidden effects that the rig file does not contain: those that `ehls_ros` lists, and some that it lacks.

Each effect declares the stage it acts in, draws its size, writes it into the kernel's record and converts it for comparison
with estimates. Sizes are absolute (N, Pa, m, s) or factors of a nominal value; those that scale with the rig need a rig file.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import kernel

Sizes = dict[str, Any]
Rng = np.random.Generator
STAGES = ("force_balance", "flow", "valve", "sensors")

# The paper's rig, for draws without a rig file.
PAPER = {
    "plant": {"moving_mass": 70.0, "spring_stiffness": 4.0e4, "valve_bandwidth": 111.46},
    "friction": {"coulomb_force": 640.8, "static_force": 865.4, "viscous_coefficient": 7265.0},
}


@dataclass(frozen=True)
class Effect:
    """Hidden effect; with the size `site` equal to "ports" it appears in the flow residual instead of that of `stage`."""

    name: str
    stage: str  # one of STAGES
    draw: Callable[[Rng, dict], Sizes]
    apply: Callable[[np.ndarray, Sizes], None]
    neutral: Sizes
    range: str
    natural: Callable[[Sizes, dict], Sizes] = lambda sizes, rig: dict(sizes)
    near: tuple[str, ...] = ()  # listed names that are also acceptable as an answer


LISTED: dict[str, Effect] = {}
OUTSIDE: dict[str, Effect] = {}
SINGLE_ROD: dict[str, Effect] = {}
"""Listed effects of a single rod, which the module `single_rod` adds."""
SINGLE_ROD_OUTSIDE: dict[str, Effect] = {}
"""Those outside the list."""


def log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def signed(rng: Rng, low: float, high: float) -> float:
    return log_uniform(rng, low, high) * (1.0 if rng.random() < 0.5 else -1.0)


def about_one(rng: Rng, low: float, high: float) -> float:
    """Draw a factor 1 +- size."""
    return 1.0 + signed(rng, low, high)


def ratio(rng: Rng, low: float, high: float) -> float:
    """Draw a factor between low and high, or its reciprocal."""
    factor = log_uniform(rng, low, high)
    return factor if rng.random() < 0.5 else 1.0 / factor


def choice(rng: Rng, *options: str) -> str:
    return options[int(rng.integers(len(options)))]


def times(p: np.ndarray, name: str, factor: float) -> None:
    p[name] = p[name] * factor


def plus(p: np.ndarray, name: str, offset: float) -> None:
    p[name] = p[name] + offset


def put(**fields: str) -> Callable[[np.ndarray, Sizes], None]:
    """Make an `apply` that copies sizes: kernel field = name of the size."""

    def apply(p: np.ndarray, sizes: Sizes) -> None:
        for field, size in fields.items():
            p[field] = sizes[size]

    return apply


def scale(*fields: str) -> Callable[[np.ndarray, Sizes], None]:
    """Make an `apply` that multiplies nominal values by the size `factor`."""

    def apply(p: np.ndarray, sizes: Sizes) -> None:
        for field in fields:
            times(p, field, sizes["factor"])

    return apply


def _adding_to(effects: dict[str, Effect]) -> Callable[..., None]:
    """Return a function that makes an effect and adds it to some others."""

    def add(*args, **kwargs) -> None:
        effect = Effect(*args, **kwargs)
        effects[effect.name] = effect

    return add


listed, outside, of_single_rod = _adding_to(LISTED), _adding_to(OUTSIDE), _adding_to(SINGLE_ROD)


def factor_and_offset(section: str, key: str) -> Callable[[Sizes, dict], Sizes]:
    """Convert a factor of a nominal value to that factor and an offset from the nominal value."""

    def natural(sizes: Sizes, rig: dict) -> Sizes:
        nominal = rig[section][key]
        return {"factor": sizes["factor"], "offset": (sizes["factor"] - 1.0) * nominal}

    return natural


# ---------------------------------------------------------------------------------------------------------------- valve


def valve_dead_zone(p, sizes):
    if sizes.get("site", "ports") == "ports":
        p["dead_pos"], p["dead_neg"] = sizes["positive"], sizes["negative"]
        p["dead_corner"] = 0.08 * 0.5 * (sizes["positive"] + sizes["negative"])
    else:
        p["pilot_dead_pos"], p["pilot_dead_neg"] = sizes["positive"], sizes["negative"]


def draw_dead_zone(rng, rig):
    size, skew = log_uniform(rng, 5e-6, 150e-6), rng.uniform(0.8, 1.25)
    return {"positive": size * skew, "negative": size / skew, "site": "ports"}


listed(
    "valve_dead_zone", "valve", draw_dead_zone, valve_dead_zone, {"positive": 0.0, "negative": 0.0},
    "overlap 5..150 um per side, sides differ by up to x1.56; rounded corner of 8 %; site ports (flow) or pilot (spool)",
)  # fmt: skip


def valve_null_bias(p, sizes):
    p["null_ports" if sizes.get("site") == "ports" else "null_command"] = sizes["bias"]


listed(
    "valve_null_bias", "valve",
    lambda rng, rig: {"bias": signed(rng, 3e-6, 100e-6), "site": choice(rng, "command", "ports")},
    valve_null_bias, {"bias": 0.0},
    "+-3..100 um; site command (the spool stands off) or ports (the ports stand off)",
)  # fmt: skip


def valve_gain_asymmetry(p, sizes):
    first, second = ("ports_pos", "ports_neg") if sizes.get("site") == "ports" else ("gain_pos", "gain_neg")
    p[first] = p[first] * (1.0 + sizes["asymmetry"])
    p[second] = p[second] * (1.0 - sizes["asymmetry"])


listed(
    "valve_gain_asymmetry", "valve",
    lambda rng, rig: {"asymmetry": signed(rng, 0.02, 0.3), "site": choice(rng, "command", "ports")},
    valve_gain_asymmetry, {"asymmetry": 0.0},
    "gain x(1 +- a) for either side, a = +-2..30 %; site command or ports",
    natural=lambda sizes, rig: {
        **sizes, "positive": 1.0 + sizes["asymmetry"], "negative": 1.0 - sizes["asymmetry"],
        "ratio": (1.0 + sizes["asymmetry"]) / (1.0 - sizes["asymmetry"]),
    },
)  # fmt: skip


def valve_gain_shift(p, sizes):
    p["gain_pos"], p["gain_neg"] = p["gain_pos"] * sizes["gain"], p["gain_neg"] * sizes["gain"]


listed(
    "valve_gain_shift", "valve", lambda rng, rig: {"gain": about_one(rng, 0.02, 0.4)}, valve_gain_shift, {"gain": 1.0},
    "spool per command x(1 +- 2..40 %)",
)  # fmt: skip


def valve_saturation(p, sizes):
    p["spool_stop"] = min(sizes["limit"], kernel.HUGE)


listed(
    "valve_saturation", "valve", lambda rng, rig: {"limit": log_uniform(rng, 0.06e-3, 0.20e-3)}, valve_saturation,
    {"limit": math.inf}, "the spool meets a hard stop at +-0.06..0.20 mm",
)  # fmt: skip
listed(
    "valve_bandwidth_shift", "valve", lambda rng, rig: {"factor": ratio(rng, 1.1, 2.5)}, scale("valve_rate"),
    {"factor": 1.0}, "x or / 1.1..2.5",
    natural=factor_and_offset("plant", "valve_bandwidth"),
)  # fmt: skip
listed(
    "valve_second_order", "valve",
    lambda rng, rig: {
        "natural_frequency": rig["plant"]["valve_bandwidth"] * log_uniform(rng, 0.7, 3.0),
        "damping_ratio": log_uniform(rng, 0.2, 1.0),
    },
    put(second_rate="natural_frequency", second_damping="damping_ratio"),
    {"natural_frequency": 0.0, "damping_ratio": 0.7},
    "in place of (4): natural frequency 0.7..3 of the bandwidth (rad/s), damping ratio 0.2..1",
)  # fmt: skip
listed(
    "valve_hysteresis", "valve", lambda rng, rig: {"width": log_uniform(rng, 3e-6, 80e-6)},
    lambda p, sizes: p.__setitem__("play", 0.5 * sizes["width"]), {"width": 0.0},
    "five plays in parallel between command and spool, mean full width 3..80 um, spread 0.2..1.8",
)  # fmt: skip
listed(
    "command_delay", "valve", lambda rng, rig: {"delay": log_uniform(rng, 1e-3, 10e-3)}, put(command_delay="delay"),
    {"delay": 0.0}, "1..10 ms, any fraction of a sample",
)  # fmt: skip

# ----------------------------------------------------------------------------------------------------------------- flow

listed(
    "supply_pressure_droop", "flow",
    lambda rng, rig: {"resistance": log_uniform(rng, 1e8, 4e9), "time_constant": log_uniform(rng, 0.02, 0.5)},
    put(droop="resistance", droop_time="time_constant"), {"resistance": 0.0, "time_constant": 0.1},
    "0.1..4 GPa s/m^3 (0.05..2 MPa at 0.2 m/s), behind an accumulator of 20..500 ms; the recorded supply pressure droops",
)  # fmt: skip
listed(
    "bulk_modulus_shift", "flow", lambda rng, rig: {"factor": ratio(rng, 1.15, 3.0)}, scale("bulk"), {"factor": 1.0},
    "x or / 1.15..3", natural=factor_and_offset("plant", "bulk_modulus"),
)  # fmt: skip
listed(
    "entrained_air", "flow", lambda rng, rig: {"fraction": log_uniform(rng, 8e-3, 0.12)}, put(air="fraction"),
    {"fraction": 0.0}, "0.8..12 % of free air by volume at 1 bar, compressed at n = 1.3, in both chambers at (ps +- pL)/2",
)  # fmt: skip
listed(
    "internal_leakage_shift", "flow", lambda rng, rig: {"factor": ratio(rng, 1.3, 5.0)}, scale("leakage"), {"factor": 1.0},
    "x or / 1.3..5", natural=factor_and_offset("plant", "leakage_coefficient"),
)  # fmt: skip
listed(
    "turbulent_leakage", "flow", lambda rng, rig: {"coefficient": log_uniform(rng, 1e-9, 2e-8)}, put(turbulent="coefficient"),
    {"coefficient": 0.0}, "1e-9..2e-8 m^3/(s Pa^0.5) times the root of pL (2..45 cm^3/s at 5 MPa), laminar below 0.2 MPa",
)  # fmt: skip
listed(
    "external_leakage", "flow",
    lambda rng, rig: {"coefficient": log_uniform(rng, 1e-12, 2e-11), "side": 1.0 if rng.random() < 0.5 else -1.0},
    put(external="coefficient", external_side="side"), {"coefficient": 0.0, "side": 1.0},
    "one rod seal leaks 1e-12..2e-11 m^5/(N s) of its chamber's pressure to the tank, either side",
)  # fmt: skip

# ------------------------------------------------------------------------------------------------------------- friction


def coulomb_shift(p, sizes):
    plus(p, "fc", sizes["offset"])
    plus(p, "fs", sizes["offset"])


listed(
    "coulomb_shift", "force_balance",
    lambda rng, rig: {"offset": signed(rng, 0.05, 0.6) * rig["friction"]["coulomb_force"]}, coulomb_shift, {"offset": 0.0},
    "+-5..60 % of Fc, added to Fc and Fs",
    natural=lambda sizes, rig: {**sizes, "factor": 1.0 + sizes["offset"] / rig["friction"]["coulomb_force"]},
)  # fmt: skip
listed(
    "coulomb_asymmetry", "force_balance",
    lambda rng, rig: {"half_difference": signed(rng, 0.04, 0.4) * rig["friction"]["coulomb_force"]},
    put(asymmetry="half_difference"), {"half_difference": 0.0},
    "s(v) + a for v > 0, s(v) - a for v < 0, a = +-4..40 % of Fc",
    natural=lambda sizes, rig: {
        **sizes, "positive": sizes["half_difference"], "negative": -sizes["half_difference"],
        "relative": sizes["half_difference"] / rig["friction"]["coulomb_force"],
    },
)  # fmt: skip
listed(
    "viscous_shift", "force_balance", lambda rng, rig: {"factor": about_one(rng, 0.03, 0.5)}, scale("viscous"), {"factor": 1.0},
    "x(1 +- 3..50 %)", natural=factor_and_offset("friction", "viscous_coefficient"),
)  # fmt: skip
listed(
    "viscous_asymmetry", "force_balance",
    lambda rng, rig: {"half_difference": signed(rng, 0.03, 0.4) * rig["friction"]["viscous_coefficient"]},
    put(viscous_asymmetry="half_difference"), {"half_difference": 0.0},
    "sigma_f + a for v > 0, sigma_f - a for v < 0, a = +-3..40 % of sigma_f",
    natural=lambda sizes, rig: {
        **sizes, "positive": sizes["half_difference"], "negative": -sizes["half_difference"],
        "relative": sizes["half_difference"] / rig["friction"]["viscous_coefficient"],
    },
)  # fmt: skip


def stribeck_shift(p, sizes):
    times(p, "vs", sizes["velocity_factor"])
    plus(p, "fs", sizes["static_offset"])


def draw_stribeck(rng, rig):
    friction = rig["friction"]
    rise = friction["static_force"] - friction["coulomb_force"]
    return {"velocity_factor": log_uniform(rng, 1.2, 8.0), "static_offset": rise * log_uniform(rng, 0.2, 3.0)}


listed(
    "stribeck_shift", "force_balance", draw_stribeck, stribeck_shift, {"velocity_factor": 1.0, "static_offset": 0.0},
    "Vs x1.2..8 and Fs + 0.2..3 of Fs - Fc (worn boundary lubrication)",
)  # fmt: skip


def presliding_stiffness_shift(p, sizes):
    p["stiffness"] = p["stiffness"] * sizes["factor"]


listed(
    "presliding_stiffness_shift", "force_balance", lambda rng, rig: {"factor": ratio(rng, 1.2, 6.0)},
    presliding_stiffness_shift, {"factor": 1.0}, "all elements x or / 1.2..6",
)  # fmt: skip
listed(
    "pressure_dependent_friction", "force_balance", lambda rng, rig: {"coefficient": log_uniform(rng, 5e-6, 1.5e-4)},
    put(per_pressure="coefficient"), {"coefficient": 0.0},
    "s(v) grows by 5..150 N per MPa of |pL|, rounded below 0.2 MPa",
)  # fmt: skip


def position_dependent_friction(p, sizes):
    p["per_position"] = sizes["gradient"]


listed(
    "position_dependent_friction", "force_balance", lambda rng, rig: {"gradient": signed(rng, 0.5, 8.0)},
    position_dependent_friction, {"gradient": 0.0},
    "s(v) x(1 + g l tanh(x/l)), g = +-0.5..8 1/m, l = 0.3 m",
    natural=lambda sizes, rig: {**sizes, "force_gradient": sizes["gradient"] * rig["friction"]["coulomb_force"]},
)  # fmt: skip


def warm(p, sizes):
    if sizes["warming"] != 0.0:
        p["warming"], p["warming_time"] = sizes["warming"], sizes["time_constant"]


def temperature_dependent_friction(p, sizes):
    p["per_kelvin"] = sizes["coefficient"]
    warm(p, sizes)


listed(
    "temperature_dependent_friction", "force_balance",
    lambda rng, rig: {
        "coefficient": log_uniform(rng, 0.006, 0.04), "warming": signed(rng, 8.0, 25.0),
        "time_constant": rng.uniform(20.0, 60.0),
    },
    temperature_dependent_friction, {"coefficient": 0.0, "warming": 0.0, "time_constant": 30.0},
    "sigma_f exp(-c (T - 313.15 K)), c 0.6..4 %/K, the oil drifts by +-8..25 K (time constant 20..60 s), which is recorded",
    natural=lambda sizes, rig: {**sizes, "reference_temperature": kernel.FIELDS["temperature"]},
)  # fmt: skip

# ------------------------------------------------------------------------------------------------------------ mechanics

listed(
    "mass_shift", "force_balance", lambda rng, rig: {"factor": about_one(rng, 0.05, 0.5)}, scale("mass"), {"factor": 1.0},
    "x(1 +- 5..50 %), inertia and weight", natural=factor_and_offset("plant", "moving_mass"),
)  # fmt: skip
listed(
    "spring_rate_shift", "force_balance", lambda rng, rig: {"factor": about_one(rng, 0.01, 0.4)}, scale("spring"),
    {"factor": 1.0}, "x(1 +- 1..40 %)", natural=factor_and_offset("plant", "spring_stiffness"),
)  # fmt: skip
listed(
    "spring_hardening", "force_balance",
    lambda rng, rig: {"cubic": log_uniform(rng, 6e4, 2e6) if rng.random() < 0.7 else -log_uniform(rng, 4e4, 4e5)},
    put(hardening="cubic"), {"cubic": 0.0},
    "c x^3 for small x, c = 6e4..2e6 N/m^3: 6 c l^3 (sinh(x/l) - x/l), l = 0.15 m (2 % above c x^3 at 0.1 m); "
    "in 3 of 10 softening, c = -4e4..-4e5 N/m^3: 3 c l^3 (x/l - atan(x/l)) (20 % below at 0.1 m)",
)  # fmt: skip


def hinge_backlash(p, sizes):
    if sizes["gap"] > 0.0:
        p["two_body"], p["load_on_second"], p["second_share"] = 1.0, 1.0, 0.9
        p["gap"] = sizes["gap"]
        reduced = 0.09 * p["mass"]
        p["second_stiffness"] = 1.0e8
        p["second_loss"] = 2.0 * 0.2 * math.sqrt(1.0e8 * reduced)


listed(
    "hinge_backlash", "force_balance", lambda rng, rig: {"gap": log_uniform(rng, 1e-5, 2e-3)}, hinge_backlash, {"gap": 0.0},
    "0.01..2 mm in all between the piston (a tenth of the mass, with the position sensor) and the beam with all loads; "
    "contact 1e8 N/m, corners rounded over 5 % of the gap",
)  # fmt: skip


def end_stop(p, sizes):
    if sizes["stiffness"] > 0.0:
        p["stop_side"], p["stop_at"] = sizes["side"], abs(sizes["position"])
        p["stop_stiffness"], p["stop_loss"] = sizes["stiffness"], 2.0


def draw_stop(rng, rig):
    side = 1.0 if rng.random() < 0.5 else -1.0
    return {"position": side * rng.uniform(0.02, 0.045), "stiffness": log_uniform(rng, 1e5, 1.5e6), "side": side}


listed(
    "end_stop", "force_balance", draw_stop, end_stop, {"position": 0.3, "stiffness": 0.0, "side": 1.0},
    "on one side at 20..45 mm: 1e5..1.5e6 N/m with Hunt-Crossley loss 2 s/m",
)  # fmt: skip


def flexible_mode(p, sizes):
    if sizes["frequency"] > 0.0:
        share, rate = sizes["mass_ratio"], 2.0 * math.pi * sizes["frequency"]
        second = share * p["mass"]
        p["two_body"], p["second_share"] = 1.0, share
        p["load_on_second"] = 1.0 if sizes.get("site") == "beam" else 0.0
        p["second_stiffness"] = rate * rate * second
        p["second_loss"] = 2.0 * sizes["damping_ratio"] * rate * second


def draw_mode(rng, rig):
    if rng.random() < 0.5:
        frequency, share, site = log_uniform(rng, 12.0, 60.0), rng.uniform(0.7, 0.9), "beam"
    else:
        frequency, share, site = log_uniform(rng, 2.0, 20.0), rng.uniform(0.2, 0.5), "appendage"
    return {"frequency": frequency, "damping_ratio": log_uniform(rng, 0.02, 0.2), "mass_ratio": share, "site": site}


listed(
    "flexible_mode", "force_balance", draw_mode, flexible_mode,
    {"frequency": 0.0, "damping_ratio": 0.05, "mass_ratio": 0.3},
    "site beam: spring between piston and the beam with all loads, 12..60 Hz with the piston held, 70..90 % of the mass; "
    "site appendage: 20..50 % of the mass hangs on a spring, 2..20 Hz; damping ratio 0.02..0.2",
)  # fmt: skip

# ---------------------------------------------------------------------------------------------------------- environment


def periodic_disturbance(p, sizes):
    p["periodic"], p["periodic_rate"] = sizes["amplitude"], 2.0 * math.pi * sizes["frequency"]
    p["periodic_phase"] = sizes.get("phase", 0.0)


listed(
    "periodic_disturbance", "force_balance",
    lambda rng, rig: {
        "amplitude": log_uniform(rng, 5.0, 500.0), "frequency": log_uniform(rng, 0.7, 40.0), "phase": rng.uniform(0.0, 6.28),
    },
    periodic_disturbance, {"amplitude": 0.0, "frequency": 0.0}, "5..500 N at 0.7..40 Hz with 10 % of second harmonic",
)  # fmt: skip
listed(
    "constant_load", "force_balance", lambda rng, rig: {"force": signed(rng, 5.0, 500.0)}, put(constant="force"),
    {"force": 0.0}, "+-5..500 N, subtracted in (3) as fd is",
)  # fmt: skip
listed(
    "coupling_stiffness", "force_balance", lambda rng, rig: {"stiffness": log_uniform(rng, 1e3, 4e4)},
    put(coupling="stiffness"), {"stiffness": 0.0},
    "1e3..4e4 N/m: + k (x_servo - x) in (3); the servo's displacement and velocity are recorded",
)  # fmt: skip

# -------------------------------------------------------------------------------------------------------------- sensors

listed(
    "pressure_sensor_bias", "sensors", lambda rng, rig: {"bias": signed(rng, 1e4, 3e5)}, put(p_bias="bias"), {"bias": 0.0},
    "+-10..300 kPa on the load pressure; the force sensor is another one",
)  # fmt: skip
listed(
    "pressure_sensor_gain", "sensors", lambda rng, rig: {"gain": about_one(rng, 0.005, 0.15)}, put(p_gain="gain"),
    {"gain": 1.0}, "x(1 +- 0.5..15 %) on the load pressure",
)  # fmt: skip
listed(
    "pressure_sensor_lag", "sensors", lambda rng, rig: {"time_constant": log_uniform(rng, 1e-3, 3e-2)},
    put(p_lag="time_constant"), {"time_constant": 0.0}, "first order, 1..30 ms, on the load pressure",
)  # fmt: skip
listed(
    "position_sensor_bias", "sensors", lambda rng, rig: {"bias": signed(rng, 1e-4, 1e-2)}, put(x_bias="bias"), {"bias": 0.0},
    "+-0.1..10 mm",
)  # fmt: skip
listed(
    "position_sensor_gain", "sensors", lambda rng, rig: {"gain": about_one(rng, 0.003, 0.1)}, put(x_gain="gain"),
    {"gain": 1.0}, "x(1 +- 0.3..10 %); the velocity sensor is another one",
)  # fmt: skip


def sensor_delay(p, sizes):
    late = sizes.get("signals", "all")
    for channel in range(kernel.N_CHANNELS):
        if late == "all" or channel in {
            "position": (kernel.POSITION,),
            "load_pressure": (kernel.PRESSURE, kernel.PRESSURE_A, kernel.PRESSURE_B),
            "spool": (kernel.SPOOL,),
        }.get(late, ()):  # fmt: skip
            p["delay"][channel] += sizes["delay"]


listed(
    "sensor_delay", "sensors",
    lambda rng, rig: {"delay": log_uniform(rng, 1e-3, 1e-2), "signals": choice(rng, "all", "position", "load_pressure")},
    sensor_delay, {"delay": 0.0},
    "1..10 ms, any fraction of a sample, of all that is measured (not command, disturbance), of position or of load pressure",
)  # fmt: skip

# --------------------------------------------------------------------------------- outside the list: force balance

outside(
    "quadratic_drag", "force_balance", lambda rng, rig: {"coefficient": log_uniform(rng, 4e3, 4e4)},
    put(quadratic="coefficient"), {"coefficient": 0.0}, "c v|v|, c 4e3..4e4 N s^2/m^2 (160..1600 N at 0.2 m/s)",
    near=("viscous_shift",),
)  # fmt: skip
outside(
    "inertial_friction", "force_balance",
    lambda rng, rig: {"force": log_uniform(rng, 80.0, 500.0), "acceleration": log_uniform(rng, 0.3, 2.0)},
    put(inertial_friction="force", inertial_scale="acceleration"), {"force": 0.0, "acceleration": 1.0},
    "friction higher by 80..500 N when speeding up, lower when slowing down, tanh over 0.3..2 m/s^2",
)  # fmt: skip
outside(
    "ratchet_cogging", "force_balance",
    lambda rng, rig: {
        "force": log_uniform(rng, 80.0, 600.0), "length": log_uniform(rng, 2e-3, 2e-2), "speed": log_uniform(rng, 2e-3, 3e-2),
        "phase": rng.uniform(0.0, 6.28),
    },
    put(cogging="force", cogging_length="length", cogging_speed="speed", cogging_phase="phase"),
    {"force": 0.0, "length": 1.0, "speed": 1.0, "phase": 0.0},
    "80..600 N, period 2..20 mm along the stroke, turning round with the speed's sign",
    near=("position_dependent_friction",),
)  # fmt: skip
outside(
    "creeping_spring", "force_balance",
    lambda rng, rig: {"stiffness": log_uniform(rng, 2e3, 1.5e4), "time_constant": log_uniform(rng, 0.4, 5.0)},
    put(creep="stiffness", creep_time="time_constant"), {"stiffness": 0.0, "time_constant": 1.0},
    "a spring of 2e3..1.5e4 N/m that relaxes in 0.4..5 s beside the rig's",
)  # fmt: skip
outside(
    "stick_patch", "force_balance",
    lambda rng, rig: {
        "force": log_uniform(rng, 300.0, 1500.0), "position": rng.uniform(-0.03, 0.03), "width": log_uniform(rng, 3e-3, 1.5e-2),
    },
    put(patch="force", patch_at="position", patch_width="width"), {"force": 0.0, "position": 0.0, "width": 0.01},
    "s(v) higher by 300..1500 N at one place, 3..15 mm wide, within +-30 mm",
    near=("position_dependent_friction",),
)  # fmt: skip
outside(
    "detent", "force_balance",
    lambda rng, rig: {
        "force": log_uniform(rng, 150.0, 1200.0), "position": rng.uniform(-0.03, 0.03), "width": log_uniform(rng, 2e-3, 1.2e-2),
    },
    put(notch="force", notch_at="position", notch_width="width"), {"force": 0.0, "position": 0.0, "width": 0.01},
    "a place that holds the beam by up to 150..1200 N (conservative), 2..12 mm wide, within +-30 mm",
)  # fmt: skip
outside(
    "squared_crosstalk", "force_balance",
    lambda rng, rig: {"coefficient": signed(rng, 1.5e-5, 1.5e-4)}, put(crosstalk="coefficient"), {"coefficient": 0.0},
    "c fd^2, c = +-1.5e-5..1.5e-4 1/N (94..940 N at 2.5 kN); does nothing without a disturbance force",
)  # fmt: skip
outside(
    "preloaded_side_spring", "force_balance",
    lambda rng, rig: {
        "preload": log_uniform(rng, 150.0, 1200.0), "stiffness": log_uniform(rng, 3e3, 3e4),
        "position": rng.uniform(-0.02, 0.025), "side": 1.0 if rng.random() < 0.5 else -1.0,
    },
    put(side_preload="preload", side_spring="stiffness", side_at="position", side="side"),
    {"preload": 0.0, "stiffness": 0.0, "position": 0.0, "side": 1.0},
    "beyond a place within -20..25 mm a spring of 3e3..3e4 N/m sets in with a preload of 150..1200 N, on one side",
)  # fmt: skip

# ------------------------------------------------------------------------------------------ outside the list: flow

outside(
    "laminar_orifice", "flow", lambda rng, rig: {"opening": log_uniform(rng, 15e-6, 120e-6)}, put(laminar="opening"),
    {"opening": 0.0}, "Cd falls with Reynolds' number below an opening of 15..120 um at full pressure drop",
)  # fmt: skip
outside(
    "crossport_relief", "flow",
    lambda rng, rig: {"pressure": rng.uniform(0.4e6, 1.0e6), "gain": log_uniform(rng, 1e-11, 2e-10)},
    lambda p, sizes: (
        p.__setitem__("relief", sizes["gain"]),
        p.__setitem__("relief_crack", sizes["pressure"]),
        p.__setitem__("relief_corner", 3.0e4),
    ),
    {"pressure": 1.0e6, "gain": 0.0}, "opens above |pL| = 0.4..1 MPa with 1e-11..2e-10 m^5/(N s)",
)  # fmt: skip
outside(
    "cavitation", "flow", lambda rng, rig: {"rate": log_uniform(rng, 3e6, 3e7)}, put(rate_limit="rate"), {"rate": 0.0},
    "vapour gives way: the load pressure changes by no more than 3..30 MPa/s",
)  # fmt: skip
outside(
    "swelling_hose", "flow",
    lambda rng, rig: {"compliance": log_uniform(rng, 1e-12, 1.5e-11), "time_constant": log_uniform(rng, 0.05, 1.0)},
    put(hose="compliance", hose_time="time_constant"), {"compliance": 0.0, "time_constant": 1.0},
    "1e-12..1.5e-11 m^3/Pa more (twice to 28 times the oil's) that follows in 0.05..1 s",
)  # fmt: skip
outside(
    "lifting_seal", "flow",
    lambda rng, rig: {"coefficient": log_uniform(rng, 1e-11, 1e-10), "speed": log_uniform(rng, 1e-2, 8e-2)},
    put(seal="coefficient", seal_speed="speed"), {"coefficient": 0.0, "speed": 1.0},
    "leakage of 1e-11..1e-10 m^5/(N s) that opens above 10..80 mm/s",
)  # fmt: skip
outside(
    "line_restriction", "flow", lambda rng, rig: {"resistance": log_uniform(rng, 1.5e12, 2e13)},
    put(line="resistance"), {"resistance": 0.0},
    "a sharp-edged restriction between valve and cylinder, 1.5e12..2e13 Pa s^2/m^6 (0.4..5 MPa at 0.2 m/s)",
)  # fmt: skip

# ----------------------------------------------------------------------------------------- outside the list: valve

outside(
    "spool_stiction", "valve", lambda rng, rig: {"threshold": log_uniform(rng, 8e-6, 60e-6)}, put(stiction="threshold"),
    {"threshold": 0.0}, "the spool stays until the command is 8..60 um away, then moves until a fifth of that is left",
    near=("valve_hysteresis",),
)  # fmt: skip
outside(
    "spool_slew_limit", "valve", lambda rng, rig: {"rate": log_uniform(rng, 4e-4, 1.5e-3)}, put(slew="rate"), {"rate": 0.0},
    "the spool moves no faster than 0.4..1.5 mm/s",
)  # fmt: skip
outside(
    "valve_power_gain", "valve", lambda rng, rig: {"exponent": ratio(rng, 1.1, 1.4), "at": rng.uniform(0.1e-3, 0.25e-3)},
    put(power="exponent", power_at="at"), {"exponent": 1.0, "at": 1.0e-3},
    "spool = command^n, n = 0.71..0.91 or 1.1..1.4, right at 0.1..0.25 mm, of constant gain beyond four times that",
)  # fmt: skip
outside(
    "mains_hum", "valve",
    lambda rng, rig: {"amplitude": log_uniform(rng, 8e-6, 60e-6), "frequency": 50.0, "phase": rng.uniform(0.0, 6.28)},
    lambda p, sizes: (
        p.__setitem__("hum", sizes["amplitude"]),
        p.__setitem__("hum_rate", 2.0 * math.pi * sizes["frequency"]),
        p.__setitem__("hum_phase", sizes["phase"]),
    ),
    {"amplitude": 0.0, "frequency": 50.0, "phase": 0.0}, "8..60 um of 50 Hz on the command",
)  # fmt: skip
outside(
    "null_drift", "valve",
    lambda rng, rig: {"drift": signed(rng, 15e-6, 120e-6), "time_constant": rng.uniform(15.0, 60.0)},
    put(null_drift="drift", null_drift_time="time_constant"), {"drift": 0.0, "time_constant": 30.0},
    "the null wanders off by up to +-15..120 um with a time constant of 15..60 s",
    near=("valve_null_bias",),
)  # fmt: skip
outside(
    "spool_sticky_place", "valve",
    lambda rng, rig: {
        "share": rng.uniform(0.9, 0.99), "position": rng.uniform(-60e-6, 60e-6), "width": log_uniform(rng, 8e-6, 40e-6),
    },
    put(sticky="share", sticky_at="position", sticky_width="width"), {"share": 0.0, "position": 0.0, "width": 1.0e-5},
    "the spool moves at 1..10 % of its speed at one place within +-60 um, 8..40 um wide",
)  # fmt: skip
outside(
    "spool_flow_force", "valve", lambda rng, rig: {"coefficient": log_uniform(rng, 0.06, 0.6)}, put(flow_force="coefficient"),
    {"coefficient": 0.0}, "the jet pulls the spool back by 6..60 % of its opening at full pressure drop, by less with less",
    near=("valve_gain_shift",),
)  # fmt: skip

# --------------------------------------------------------------------------------------- outside the list: sensors

outside(
    "pressure_sensor_bow", "sensors", lambda rng, rig: {"deviation": signed(rng, 3e4, 4e5)},
    lambda p, sizes: p.__setitem__("p_quadratic", sizes["deviation"] / 9.0e12), {"deviation": 0.0},
    "+-30..400 kPa at 3 MPa, quadratic in the load pressure",
)  # fmt: skip
outside(
    "pressure_sensor_hysteresis", "sensors", lambda rng, rig: {"half_width": log_uniform(rng, 1.5e4, 2e5)},
    put(p_play="half_width"), {"half_width": 0.0}, "play of +-15..200 kPa",
)  # fmt: skip
outside(
    "pressure_missing_codes", "sensors",
    lambda rng, rig: {"step": log_uniform(rng, 4e4, 2.5e5), "codes": float(rng.integers(1, 8))},
    put(p_step="step", p_codes="codes"), {"step": 0.0, "codes": 0.0},
    "steps of 40..250 kPa instead of 1.2 kPa, one code in eight never comes",
)  # fmt: skip
outside(
    "pressure_zero_wander", "sensors", lambda rng, rig: {"deviation": log_uniform(rng, 3e4, 3e5)}, lambda p, sizes: None,
    {"deviation": 0.0}, "random walk of the zero, 30..300 kPa standard deviation after a minute",
    near=("pressure_sensor_bias",),
)  # fmt: skip
outside(
    "position_interpolation", "sensors",
    lambda rng, rig: {
        "amplitude": log_uniform(rng, 5e-5, 6e-4), "period": log_uniform(rng, 2e-3, 2e-2), "phase": rng.uniform(0.0, 6.28),
    },
    put(x_interpolation="amplitude", x_period="period", x_phase="phase"), {"amplitude": 0.0, "period": 1.0, "phase": 0.0},
    "0.05..0.6 mm, repeating every 2..20 mm",
)  # fmt: skip
outside(
    "pressure_sees_position", "sensors",
    lambda rng, rig: {"slope": signed(rng, 5e5, 5e6), "curvature": signed(rng, 5e6, 8e7)},
    put(p_per_x="slope", p_per_xx="curvature"), {"slope": 0.0, "curvature": 0.0},
    "the pressure sensor is bent by the stroke: +-0.5..5 MPa/m and +-5..80 MPa/m^2",
)  # fmt: skip
outside(
    "pressure_sees_temperature", "sensors",
    lambda rng, rig: {
        "coefficient": signed(rng, 4e3, 3e4), "warming": signed(rng, 8.0, 25.0), "time_constant": rng.uniform(20.0, 60.0),
    },
    lambda p, sizes: (p.__setitem__("p_per_kelvin", sizes["coefficient"]), warm(p, sizes)),
    {"coefficient": 0.0, "warming": 0.0, "time_constant": 30.0},
    "zero of +-4..30 kPa/K while the oil drifts by +-8..25 K",
    near=("pressure_sensor_bias",),
)  # fmt: skip
outside(
    "held_dropouts", "sensors",
    lambda rng, rig: {
        "share": log_uniform(rng, 0.02, 0.2), "length": log_uniform(rng, 8e-3, 6e-2),
        "signals": choice(rng, "load_pressure", "position", "both"),
    },
    lambda p, sizes: None, {"share": 0.0, "length": 0.02, "signals": "both"},
    "2..20 % of the time pressure, position or both hang at their last value, 8..60 ms on average",
)  # fmt: skip

EFFECTS: dict[str, Effect] = LISTED | OUTSIDE


def is_single(rig: Mapping[str, Any]) -> bool:
    """Return whether a rig file describes both chambers of a cylinder."""
    return bool(rig.get("cylinder", {}).get("model") == "two_chamber")


def listed_of(rig: Mapping[str, Any]) -> dict[str, Effect]:
    """Return the listed effects of a rig by the kind of its cylinder."""
    return SINGLE_ROD if is_single(rig) else LISTED


def outside_of(rig: Mapping[str, Any]) -> dict[str, Effect]:
    """Return the effects of a rig outside the list."""
    return SINGLE_ROD_OUTSIDE if is_single(rig) else OUTSIDE


def effects_of(rig: Mapping[str, Any]) -> dict[str, Effect]:
    """Return all effects of a rig."""
    return listed_of(rig) | outside_of(rig)


def draw_effect(name: str, rng: Rng, rig: dict | None = None, **fixed: Any) -> Sizes:
    """Draw the size of an effect.

    Args:
        name: name in `effects_of` the rig.
        rng: random number generator.
        rig: content of the rig file, for sizes proportional to a nominal value; the paper's rig by default.
        fixed: sizes to use instead of drawn ones, such as `site="ports"`.
    """
    rig = rig or PAPER
    sizes = effects_of(rig)[name].draw(rng, rig)
    if unknown := set(fixed) - set(sizes):
        raise ValueError(f"{name} has no {sorted(unknown)}, only {sorted(sizes)}")
    return sizes | fixed


def wander(sizes: Sizes, rng: Rng, n: int, dt: float) -> np.ndarray:
    """Return the drift of the pressure sensor's zero at n ticks for `pressure_zero_wander`, Pa."""
    steps = rng.standard_normal(n)
    return np.cumsum(steps) * sizes["deviation"] * math.sqrt(dt / 60.0)


def hang(sizes: Sizes, rng: Rng, n: int, dt: float) -> np.ndarray:
    """Return the held ticks of `held_dropouts` among n as bit masks: bit 0 the pressure, bit 1 the position."""
    held = np.zeros(n, np.int64)
    if sizes["share"] <= 0.0:
        return held
    signals = sizes.get("signals", "both")
    bits = {"load_pressure": 1, "position": 2, "both": 3}[signals]
    gaps = rng.exponential(sizes["length"] * (1.0 - sizes["share"]) / sizes["share"], n // 4 + 8)
    lengths = rng.exponential(sizes["length"], gaps.size)
    starts = np.cumsum(gaps + lengths) - lengths
    for start, length in zip(starts, lengths, strict=True):
        if start > n * dt:
            break
        held[max(int(start / dt), 1) : int((start + length) / dt) + 1] |= bits
    return held
