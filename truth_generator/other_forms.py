"""Alternative formulas of listed effects: the same physics by formulas from the literature that differ from `effects`.

A diagnosis must name the effect whichever formula the rig follows. Sizes have the formula's name as `form`. Their values have
another meaning than those of the default formula, so estimates cannot be compared with them.
"""

from dataclasses import replace
from typing import Any

from .effects import LISTED, Rng, Sizes, end_stop, hinge_backlash, log_uniform, put, signed, stribeck_shift, warm

Draw = Any
OTHER_FORMS: dict[str, dict[str, Any]] = {}
"""Effects by name and formula."""


def another(name: str, form: str, draw: Draw, apply: Draw, range_: str) -> None:
    """Register a formula of a listed effect."""
    OTHER_FORMS.setdefault(name, {})[form] = replace(LISTED[name], draw=draw, apply=apply, range=range_)


def draw_other_form(name: str, form: str, rng: Rng, rig: dict[str, Any]) -> Sizes:
    """Draw the size of an effect by another formula.

    Args:
        name: name in `OTHER_FORMS`.
        form: name of the formula.
        rng: random number generator.
        rig: content of the rig file.
    """
    return {**OTHER_FORMS[name][form].draw(rng, rig), "form": form}


# ----------------------------------------------------------------------------------------------------------------- valve

another(
    "valve_dead_zone", "smooth", lambda rng, rig: {"width": log_uniform(rng, 5e-6, 150e-6), "site": "ports"},
    put(dead_smooth="width"),
    "x - w tanh(x/w): worn lands with clearance, w = 5..150 um",
)  # fmt: skip


def one_play(p, sizes):
    p["play"], p["play_spread"] = 0.5 * sizes["width"], 0.0


another(
    "valve_hysteresis", "one play", lambda rng, rig: {"width": log_uniform(rng, 3e-6, 80e-6)}, one_play,
    "a single play of 3..80 um",
)  # fmt: skip

# ------------------------------------------------------------------------------------------------------------------ flow

another(
    "supply_pressure_droop", "turbulent",
    lambda rng, rig: {"resistance": log_uniform(rng, 2e11, 8e12), "time_constant": log_uniform(rng, 0.02, 0.5)},
    put(droop_square="resistance", droop_time="time_constant"),
    "0.2..8 TPa s^2/m^6 (0.05..2 MPa at 0.2 m/s), behind an accumulator of 20..500 ms",
)  # fmt: skip


def between(p, sizes):
    p["turbulent"] = sizes["coefficient"] * 1e6 ** (0.5 - sizes["exponent"])
    p["turbulent_exponent"] = sizes["exponent"]


another(
    "turbulent_leakage", "power",
    lambda rng, rig: {"coefficient": log_uniform(rng, 1e-9, 2e-8), "exponent": rng.uniform(0.55, 0.75)}, between,
    "c pL^n of 1..20 cm^3/s at 1 MPa, n = 0.55..0.75: a gap between laminar and turbulent",
)  # fmt: skip


def air(exponent: float, square: float = 0.0) -> Draw:
    def apply(p, sizes):
        p["air"], p["air_exponent"], p["air_square"] = sizes["fraction"], exponent, square
        p["air_dissolved_at"] = sizes.get("dissolved_at", 0.0)

    return apply


def draw_fraction(rng: Rng, rig: dict[str, Any]) -> Sizes:
    return {"fraction": log_uniform(rng, 8e-3, 0.12)}


another(
    "turbulent_leakage", "turning",
    lambda rng, rig: {"coefficient": log_uniform(rng, 1e-9, 2e-8), "pressure": log_uniform(rng, 0.2e6, 2e6)},
    put(turning_leakage="coefficient", turning_pressure="pressure"),
    "c pL/sqrt(|pL| + p1), p1 = 0.2..2 MPa: laminar below, turbulent above",
)  # fmt: skip
another("entrained_air", "isothermal", draw_fraction, air(1.0), "0.8..12 % of free air, compressed isothermally")
another(
    "entrained_air", "Nykänen", draw_fraction, air(1.4, 1.0),
    "0.8..12 % of free air, Nykänen's two-phase fluid (2000): (1 - a + a (p0/p)^(1/n))^2 over the sum of compliances, n = 1.4",
)  # fmt: skip
another(
    "entrained_air", "dissolving", lambda rng, rig: draw_fraction(rng, rig) | {"dissolved_at": log_uniform(rng, 5e6, 2e7)},
    air(1.4), "0.8..12 % of free air, dissolved in proportion to the pressure (Henry), completely at 5..20 MPa",
)  # fmt: skip
another(
    "entrained_air", "half modulus", lambda rng, rig: {"pressure": log_uniform(rng, 0.1e6, 1.5e6)}, put(air_half="pressure"),
    "beta p/(p + ph), ph = 0.1..1.5 MPa, p absolute in each chamber",
)  # fmt: skip

# -------------------------------------------------------------------------------------------------------------- friction

another(
    "coulomb_asymmetry", "ratio", lambda rng, rig: {"ratio": signed(rng, 0.04, 0.4)}, put(level_side="ratio"),
    "s(v) x(1 +- a) by direction, a = +-4..40 %",
)  # fmt: skip
another(
    "coulomb_asymmetry", "one side",
    lambda rng, rig: {"offset": signed(rng, 0.06, 0.6) * rig["friction"]["coulomb_force"]}, put(level_forward="offset"),
    "s(v) + a for v > 0 only, a = +-6..60 % of Fc",
)  # fmt: skip
another(
    "coulomb_asymmetry", "smooth",
    lambda rng, rig: {
        "half_difference": signed(rng, 0.03, 0.3) * rig["friction"]["coulomb_force"], "speed": log_uniform(rng, 3e-3, 2e-2),
    },
    put(level_turning="half_difference", level_turning_speed="speed"),
    "s(v) + a tanh(v/v0), a = +-3..30 % of Fc, v0 = 3..20 mm/s",
)  # fmt: skip
another(
    "viscous_asymmetry", "one side",
    lambda rng, rig: {"offset": signed(rng, 0.05, 0.5) * rig["friction"]["viscous_coefficient"]}, put(viscous_forward="offset"),
    "sigma_f + a for v > 0 only, a = +-5..50 % of sigma_f",
)  # fmt: skip
another(
    "viscous_asymmetry", "smooth",
    lambda rng, rig: {
        "half_difference": signed(rng, 0.03, 0.4) * rig["friction"]["viscous_coefficient"],
        "speed": log_uniform(rng, 5e-3, 3e-2),
    },
    put(viscous_side="half_difference", viscous_side_speed="speed"),
    "sigma_f + a tanh(v/v0), a = +-3..40 % of sigma_f, v0 = 5..30 mm/s",
)  # fmt: skip
another(
    "pressure_dependent_friction", "level", lambda rng, rig: {"coefficient": log_uniform(rng, 3e-8, 3e-7)},
    put(curve_level_per_pressure="coefficient"), "s(v) x(1 + c |pL|), c = 3..30 % per MPa",
)  # fmt: skip
another(
    "pressure_dependent_friction", "whole curve", lambda rng, rig: {"coefficient": log_uniform(rng, 3e-8, 3e-7)},
    put(curve_level_per_pressure="coefficient", curve_viscous_per_pressure="coefficient"),
    "s(v) and sigma_f x(1 + c |pL|), c = 3..30 % per MPa",
)  # fmt: skip
another(
    "pressure_dependent_friction", "saturating",
    lambda rng, rig: {"rise": log_uniform(rng, 30.0, 300.0), "scale": log_uniform(rng, 0.3e6, 2e6)},
    put(pressure_rise="rise", pressure_scale="scale"), "s(v) + r (1 - exp(-|pL|/p1)), r = 30..300 N, p1 = 0.3..2 MPa",
)  # fmt: skip
another(
    "pressure_dependent_friction", "power",
    lambda rng, rig: {"rise": log_uniform(rng, 20.0, 150.0), "exponent": rng.uniform(0.4, 0.8)},
    put(pressure_power="rise", pressure_exponent="exponent"), "s(v) + r (|pL|/MPa)^n, r = 20..150 N, n = 0.4..0.8",
)  # fmt: skip
another(
    "pressure_dependent_friction", "logarithm",
    lambda rng, rig: {"rise": log_uniform(rng, 30.0, 200.0), "scale": log_uniform(rng, 0.1e6, 1e6)},
    put(pressure_log="rise", pressure_log_at="scale"), "s(v) + r ln(1 + |pL|/p1), r = 30..200 N, p1 = 0.1..1 MPa",
)  # fmt: skip
another(
    "pressure_dependent_friction", "one chamber", lambda rng, rig: {"coefficient": signed(rng, 1e-5, 1.5e-4)},
    put(per_chamber="coefficient"), "s(v) changes by 10..150 N per MPa of pL: the rod seal of one chamber",
)  # fmt: skip
another(
    "position_dependent_friction", "bow", lambda rng, rig: {"bow": signed(rng, 1.5, 15.0)}, put(position_bow="bow"),
    "s(v) x(1 + q x^2), q = +-1.5..15 1/m^2",
)  # fmt: skip


def lorentzian(p, sizes):
    stribeck_shift(p, sizes)
    p["stribeck_lorentz"] = 1.0


another(
    "stribeck_shift", "Lorentzian", LISTED["stribeck_shift"].draw, lorentzian,
    "Fc + (Fs - Fc)/(1 + (v/Vs)^2), Vs x1.2..8 and Fs + 0.2..3 of Fs - Fc",
)  # fmt: skip


def hyperbolic(p, sizes):
    stribeck_shift(p, sizes)
    p["stribeck_tanh"] = 1.0


another(
    "stribeck_shift", "tanh", LISTED["stribeck_shift"].draw, hyperbolic,
    "Fc + (Fs - Fc)(1 - tanh(|v|/Vs)) as in Makkar et al. (2005), Vs x1.2..8 and Fs + 0.2..3 of Fs - Fc",
)  # fmt: skip


def warming(rng: Rng) -> Sizes:
    return {"warming": signed(rng, 8.0, 25.0), "time_constant": rng.uniform(20.0, 60.0)}


def by_temperature(**fields: str) -> Draw:
    def apply(p, sizes):
        put(**fields)(p, sizes)
        warm(p, sizes)

    return apply


def draw_per_kelvin(rng: Rng, rig: dict[str, Any]) -> Sizes:
    return {"coefficient": log_uniform(rng, 0.006, 0.03), **warming(rng)}


another(
    "temperature_dependent_friction", "linear", draw_per_kelvin, by_temperature(linear_per_kelvin="coefficient"),
    "sigma_f (1 - c (T - 313.15 K)), c = 0.6..3 %/K",
)  # fmt: skip
another(
    "temperature_dependent_friction", "Vogel",
    lambda rng, rig: {"vogel": log_uniform(rng, 500.0, 1200.0), "at": rng.uniform(140.0, 190.0), **warming(rng)},
    by_temperature(vogel="vogel", vogel_at="at"), "sigma_f exp(B/(T - C) - B/(313.15 K - C)), B = 500..1200 K, C = 140..190 K",
)  # fmt: skip
another(
    "temperature_dependent_friction", "level", draw_per_kelvin, by_temperature(level_per_kelvin="coefficient"),
    "s(v) exp(-c (T - 313.15 K)), c = 0.6..3 %/K",
)  # fmt: skip
another(
    "temperature_dependent_friction", "whole curve", draw_per_kelvin,
    by_temperature(per_kelvin="coefficient", level_per_kelvin="coefficient"),
    "s(v) and sigma_f exp(-c (T - 313.15 K)), c = 0.6..3 %/K",
)  # fmt: skip

# ------------------------------------------------------------------------------------------------------------- mechanics

another(
    "spring_hardening", "quintic", lambda rng, rig: {"quintic": log_uniform(rng, 2e7, 5e8)}, put(quintic="quintic"),
    "c x^5, c = 2e7..5e8 N/m^5",
)  # fmt: skip


def hertz(p, sizes):
    end_stop(p, sizes)
    p["stop_exponent"] = 1.5


def draw_hertz(rng: Rng, rig: dict[str, Any]) -> Sizes:
    sizes = LISTED["end_stop"].draw(rng, rig)
    return {**sizes, "stiffness": 30.0 * sizes["stiffness"]}  # equal at 1 mm


another("end_stop", "Hertz", draw_hertz, hertz, "on one side at 20..45 mm: k d^1.5, 0.1..1.5 kN at 1 mm, loss 2 s/m")


def soft_contact(p, sizes):
    hinge_backlash(p, sizes)
    if sizes["gap"] > 0.0:
        p["second_stiffness"] = sizes["stiffness"]
        p["second_loss"] = 0.4 * (sizes["stiffness"] * 0.09 * p["mass"]) ** 0.5


another(
    "hinge_backlash", "soft contact",
    lambda rng, rig: {"gap": log_uniform(rng, 2e-5, 2e-3), "stiffness": log_uniform(rng, 1e7, 5e7)}, soft_contact,
    "0.02..2 mm between contacts of 1e7..5e7 N/m",
)  # fmt: skip
