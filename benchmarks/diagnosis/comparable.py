"""True sizes and estimated parameters as the same quantity: a deviation from neutral."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from benchmarks.common import Quantity
from benchmarks.diagnosis.cases import rig_file

Sizes = Mapping[str, Any]
Values = Mapping[str, list[float]]


def same(**pairs: str) -> Callable[[Sizes, Values], list[Quantity]]:
    """Compare parameters with true sizes, given as parameter=size."""

    def compare(true: Sizes, found: Values) -> list[Quantity]:
        return [Quantity(name, true[size], *found[name]) for name, size in pairs.items() if name in found]

    return compare


def beyond_one(**pairs: str) -> Callable[[Sizes, Values], list[Quantity]]:
    """Compare factors by their distance from 1."""

    def compare(true: Sizes, found: Values) -> list[Quantity]:
        return [
            Quantity(name, true[size] - 1.0, found[name][0] - 1.0, found[name][1])
            for name, size in pairs.items()
            if name in found
        ]

    return compare


def _null_bias(true: Sizes, found: Values) -> list[Quantity]:
    return [Quantity("bias", true["bias"], *estimate) for estimate in found.values()]


def _gain_asymmetry(true: Sizes, found: Values) -> list[Quantity]:
    return [
        Quantity(name, true[side] - 1.0, *found[name])
        for name in found
        for side in ("positive", "negative")
        if name.endswith(side)
    ]


def _saturation(true: Sizes, found: Values) -> list[Quantity]:
    return [Quantity("limit", true["limit"], *estimate) for estimate in found.values()]


def _external_leakage(true: Sizes, found: Values) -> list[Quantity]:
    sides = {"first": 1.0, "second": -1.0}
    signed = true["side"] * true["coefficient"]
    return [Quantity("coefficient", signed, sides[n] * v, s) for n, (v, s) in found.items() if n in sides]


def _temperature(true: Sizes, found: Values) -> list[Quantity]:
    if "viscous_slope" not in found:
        return []
    # The true law is exponential; the parameter is the slope of its chord over the recording.
    reached = true["warming"] * (1.0 - math.exp(-60.0 / true["time_constant"]))
    viscous = rig_file()["friction"]["viscous_coefficient"]
    chord = viscous * (math.exp(-true["coefficient"] * reached) - 1.0) / reached
    return [Quantity("viscous_slope", chord, *found["viscous_slope"])]


def _end_stop(true: Sizes, found: Values) -> list[Quantity]:
    side = "upper" if true["side"] > 0.0 else "lower"
    return same(**{side: "position"}, stiffness="stiffness")(true, found)


def _mode(true: Sizes, found: Values) -> list[Quantity]:
    mass = true["mass_ratio"] * rig_file()["plant"]["moving_mass"]
    return same(frequency="frequency", damping="damping_ratio", mass="mass")({**true, "mass": mass}, found)


def _periodic(true: Sizes, found: Values) -> list[Quantity]:
    (sine, of_sine), (cosine, of_cosine) = found["sine"], found["cosine"]
    amplitude = math.hypot(sine, cosine)
    std = math.hypot(sine * of_sine, cosine * of_cosine) / max(amplitude, 1e-300)
    out = [Quantity("amplitude", true["amplitude"], amplitude, std)]
    return out + same(frequency="frequency")(true, found)


def _constant_load(true: Sizes, found: Values) -> list[Quantity]:
    # The true load acts like fd, against +x; the parameter acts along +x.
    value, std = found["force"]
    return [Quantity("force", true["force"], -value, std)]


def _any_one(size: str) -> Callable[[Sizes, Values], list[Quantity]]:
    return lambda true, found: [Quantity(size, true[size], *estimate) for estimate in found.values()]


COMPARE: dict[str, Callable[[Sizes, Values], list[Quantity]]] = {
    "valve_dead_zone": same(positive="positive", negative="negative"),
    "valve_null_bias": _null_bias,
    "valve_gain_asymmetry": _gain_asymmetry,
    "valve_gain_shift": beyond_one(gain="gain"),
    "valve_saturation": _saturation,
    "valve_bandwidth_shift": beyond_one(factor="factor"),
    "valve_second_order": same(natural_frequency="natural_frequency", damping="damping_ratio"),
    "valve_hysteresis": same(width="width"),
    "command_delay": same(delay="delay"),
    "tank_pressure_shift": same(added="offset"),
    "supply_pressure_droop": same(resistance="resistance", time_constant="time_constant"),
    "bulk_modulus_shift": beyond_one(factor="factor"),
    "entrained_air": same(chambers="fraction"),
    "internal_leakage_shift": same(added="offset"),
    "turbulent_leakage": same(coefficient="coefficient"),
    "external_leakage": _external_leakage,
    "coulomb_shift": same(offset="offset"),
    "coulomb_asymmetry": same(offset="half_difference"),
    "viscous_shift": same(added="offset"),
    "viscous_asymmetry": same(asymmetry="half_difference"),
    "stribeck_shift": lambda true, found: [
        *same(static_offset="static_offset")(true, found),
        *beyond_one(velocity_factor="velocity_factor")(true, found),
    ],
    "presliding_stiffness_shift": beyond_one(factor="factor"),
    "pressure_dependent_friction": same(slope="coefficient"),
    "position_dependent_friction": same(slope="force_gradient"),
    "temperature_dependent_friction": _temperature,
    "mass_shift": beyond_one(factor="factor"),
    "spring_rate_shift": same(added="offset"),
    "spring_hardening": same(cubic="cubic"),
    "hinge_backlash": same(gap="gap", held_gap="gap", load_gap="gap"),
    "end_stop": _end_stop,
    "flexible_mode": _mode,
    "periodic_disturbance": _periodic,
    "constant_load": _constant_load,
    "coupling_stiffness": same(stiffness="stiffness"),
    "pressure_sensor_bias": same(bias="bias"),
    "pressure_sensor_gain": beyond_one(gain="gain"),
    "pressure_sensor_lag": same(time_constant="time_constant"),
    "position_sensor_bias": same(bias="bias"),
    "position_sensor_gain": beyond_one(gain="gain"),
    "sensor_delay": _any_one("delay"),
}


SIDES = {"first": "a", "second": "b", "each": "both", "chambers": "both"}
"""Sides on which parameters of a single rod's effects act."""


def _of_side(size: str, neutral: float = 0.0) -> Callable[[Sizes, Values], list[Quantity]]:
    """Compare the parameter of the true side."""
    return lambda true, found: [
        Quantity(size, true[size] - neutral, value - neutral, std)
        for name, (value, std) in found.items()
        if SIDES.get(name) == true["side"]
    ]


def _edge_gain(true: Sizes, found: Values) -> list[Quantity]:
    return beyond_one(**{f"gain_{true['edge']}": "factor"})(true, found)


COMPARE_SIDES: dict[str, Callable[[Sizes, Values], list[Quantity]]] = {
    "external_leakage": _of_side("coefficient"),
    "edge_wear": lambda true, found: [],  # of another formula
    "edge_gain": _edge_gain,
    "hose_compliance": _of_side("compliance"),
    "entrained_air": _of_side("fraction"),
    "pressure_sensor_bias": _of_side("bias"),
    "pressure_sensor_gain": _of_side("gain", 1.0),
}
"""Those of a single rod's effects with a side."""


def quantities(name: str, true: Sizes, found: Values) -> list[Quantity]:
    """Return the quantities of a rightly named cause that can be compared."""
    compare = COMPARE_SIDES if isinstance(true.get("side"), str) else COMPARE
    return compare[name](true, found)
