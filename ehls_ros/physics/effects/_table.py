"""A term whose shape was found in data and not derived: a formula, or a table, over one argument, times a factor.

The argument is a weighted sum of the stage's own signals, scaled so that the table's first knot is at 0 and its last one at 1.
It may be without its slow part, a first-order lag of it, or be the part of it that a play has not passed on. Between the knots
the table is linear; beyond them it goes on as it began, mirrored at the edge. Beyond the data, formula and table keep their
value. A periodic table repeats with a period of 1. The term may be proportional to a further signal, and its sign may follow
the direction of motion.
"""

import math
import types
from typing import Annotated, Any, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import FOLLOW_RATE, clamp, play_output
from ehls_ros.physics.effects.base import MEMORY_STEP, Form
from ehls_ros.physics.plant import PL, TEMPERATURE, XV, V, X, disturbance_force
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

KNOTS = 16
"""Most values in a table."""

VALUES = tuple(f"value_{k}" for k in range(KNOTS))
"""Names of the values."""

WEIGHTS = {
    "position": ("1/m", "position", 1e6),
    "velocity": ("s/m", "velocity", 1e6),
    "speed": ("s/m", "magnitude of the velocity", 1e6),
    "pressure": ("1/Pa", "load pressure", 1.0),
    "spool": ("1/m", "spool displacement, at the valve's input the command", 1e9),
    "error": ("1/m", "command less spool displacement, at the valve's input", 1e9),
    "load": ("1/N", "force of the disturbance", 1.0),
    "time": ("1/s", "time", 1e4),
    "temperature": ("1/K", "oil temperature", 1e3),
}
"""Unit, meaning and largest size of the weight of each signal in the argument."""

FACTORS = {"velocity": 1e3, "pressure": 1e-4, "spool": 1e6, "error": 1e7, "load": 1.0}
"""Signals to which a term may be proportional, with the largest size of their weights; units as in :data:`WEIGHTS`."""

ERROR_STEP = 1e-3
"""Longest integration step of a valve with a term over the spool's error [s]."""

MOST_ARGUMENT = 1e12
"""Size of an argument from which a run counts as diverged."""

ODD_BUMP = math.sqrt(2.0 * math.e)
"""Factor by which z exp(-z²) has a largest value of 1."""

DISCREPANCY = "Kennedy, O'Hagan, Bayesian calibration of computer models, 2001: a discrepancy of the model, here as a table"
"""Source of the effects with a table."""


def table_parameters(module: str, unit: str, meaning: str, largest: float, *, memory: bool = True) -> Any:
    """Return the parameters of an effect with a formula and a table, a named tuple.

    Args:
        module: name of the effect's module.
        unit: unit of the table's values.
        meaning: of the values.
        largest: largest size of a value.
        memory: whether the effect has the state of :func:`term_rate`; without it, there is neither lag nor play.
    """
    longest, widest = (1e3, 10.0) if memory else (0.0, 0.0)

    def value(what: str) -> Any:
        return quantity(unit, what, minimum=-largest, maximum=largest)

    def number(what: str, low: float, high: float) -> Any:
        return quantity("1", what, minimum=low, maximum=high)

    notes = {
        f"per_{signal}": quantity(own, f"weight of the {name} in the argument", minimum=-most, maximum=most)
        for signal, (own, name, most) in WEIGHTS.items()
    }
    notes["offset"] = number("offset of the argument", -1e6, 1e6)
    notes["memory"] = quantity(
        "s", "time constant of the lag subtracted from the argument; 0: none", minimum=0.0, maximum=longest
    )
    notes["play"] = number("width of the play in whose gap the argument is taken; 0: none", 0.0, widest)
    notes["lowest"] = number("least argument in the data", -10.0, 0.0)
    notes["highest"] = number("largest argument in the data", 1.0, 11.0)
    for signal, most in FACTORS.items():
        own, name, _ = WEIGHTS[signal]
        notes[f"times_{signal}"] = quantity(
            own, f"weight of the {name} in the factor; without any, the factor is 1", minimum=-most, maximum=most
        )
    direction = "speed within which the term's sign follows the direction of motion; 0: it does not"
    notes["direction"] = quantity("m/s", direction, minimum=0.0, maximum=10.0)
    notes |= {
        "level": value(f"{meaning}, constant part of the formula"),
        "power": value(f"{meaning}, power of the argument's distance from `power_at`, at a distance of 1"),
        "power_at": number("argument at which the power is 0", -10.0, 10.0),
        "exponent": number("exponent of the power", 0.1, 8.0),
        "even": number("1: the power is the same on both sides; 0: it changes sign", 0.0, 1.0),
        "bump": value(f"{meaning}, height of a Gaussian bump"),
        "bump_at": number("argument at the middle of the bump", -10.0, 10.0),
        "bump_width": number("distance from its middle at which the bump is 1/e", 1e-3, 10.0),
        "bump_odd": number("1: it changes sign at its middle, with its height before and behind; 0: it does not", 0.0, 1.0),
        "step": value(f"{meaning}, half the height of a hyperbolic tangent"),
        "step_at": number("argument at the middle of the tangent", -10.0, 10.0),
        "step_width": number("width of the tangent", 1e-4, 100.0),
        "beyond": value(f"{meaning}, slope over the argument beyond `beyond_at`"),
        "beyond_at": number("argument beyond which it rises", -10.0, 10.0),
        "beyond_side": number("1: above it, -1: below it, 0: on both sides of 0", -1.0, 1.0),
        "wave": value(f"{meaning}, amplitude of a sine"),
        "wave_number": number("periods of the sine per argument of 1", 1e-3, 1e3),
        "wave_phase": quantity("rad", "phase of the sine", minimum=-100.0, maximum=100.0),
        "wave_2": value(f"{meaning}, amplitude of its second harmonic"),
        "wave_2_phase": quantity("rad", "phase of the second harmonic", minimum=-100.0, maximum=100.0),
        "periodic": number("1: the term repeats with a period of 1 in the argument; 0: it does not", 0.0, 1.0),
        "knots": number("number of values in use, the first ones; 0: no table", 0.0, float(KNOTS)),
    }
    notes |= {name: value(f"{meaning} at knot {k}") for k, name in enumerate(VALUES)}
    defaults = {
        "highest": 1.0, "exponent": 1.0, "bump_width": 1.0, "step_width": 1.0, "wave_number": 1.0, "knots": float(KNOTS)
    }  # fmt: skip
    body = {
        "__module__": module,
        "__doc__": "Argument, factor, formula and table.",
        "__annotations__": {name: Annotated[float, note] for name, note in notes.items()},
        **dict.fromkeys(notes, 0.0),
        **defaults,
    }
    return types.new_class("Parameters", (NamedTuple,), exec_body=lambda namespace: namespace.update(body))


def no_forms(rig: Rig) -> tuple[Form, ...]:
    """Return no form: the argument and its range follow from the data (:mod:`ehls_ros.diagnosis.empirical`)."""
    return ()


def term_step(parameters: Any) -> float:
    """Return the longest integration step of a term's own state and feedback; infinite if it has neither [s]."""
    if parameters.memory > 0.0 or parameters.play > 0.0:
        return MEMORY_STEP
    return ERROR_STEP if parameters.per_error != 0.0 or parameters.times_error != 0.0 else math.inf


@kernel
def _hat(distance: float) -> float:
    return max(0.0, 1.0 - abs(distance))


@kernel
def _between(s: float, p: Any) -> float:
    """Return the value of a table at ``s``, which is 0 at its first knot and 1 at the next."""
    lower = p.value_0 * _hat(s) + p.value_1 * _hat(s - 1.0) + p.value_2 * _hat(s - 2.0)
    lower += p.value_3 * _hat(s - 3.0) + p.value_4 * _hat(s - 4.0) + p.value_5 * _hat(s - 5.0)
    lower += p.value_6 * _hat(s - 6.0) + p.value_7 * _hat(s - 7.0)
    upper = p.value_8 * _hat(s - 8.0) + p.value_9 * _hat(s - 9.0) + p.value_10 * _hat(s - 10.0)
    upper += p.value_11 * _hat(s - 11.0) + p.value_12 * _hat(s - 12.0) + p.value_13 * _hat(s - 13.0)
    return lower + upper + p.value_14 * _hat(s - 14.0) + p.value_15 * _hat(s - 15.0)


@kernel
def _table(u: float, p: Any) -> float:
    last = p.knots - 1.0
    if p.periodic > 0.5:
        s = p.knots * (u - math.floor(u))
        # From the last knot to the first one of the next period.
        beyond = max(s - last, 0.0)
        return (1.0 - beyond) * _between(min(s, last), p) + beyond * p.value_0
    edge = min(max(u, 0.0), 1.0)
    total = _between(last * edge, p)
    if u != edge:
        total = 2.0 * total - _between(last * min(max(2.0 * edge - u, 0.0), 1.0), p)
    return total


@kernel
def formula_value(u: float, p: Any) -> float:
    """Return the value of the formula at an argument."""
    total = p.level
    away = u - p.power_at
    if p.power != 0.0 and away != 0.0:
        size = p.power * abs(away) ** p.exponent
        total += size if p.even > 0.5 or away > 0.0 else -size
    if p.bump != 0.0:
        z = (u - p.bump_at) / p.bump_width
        size = p.bump * math.exp(-z * z)
        total += size if p.bump_odd < 0.5 else size * z * ODD_BUMP
    if p.step != 0.0:
        total += p.step * math.tanh((u - p.step_at) / p.step_width)
    if p.beyond != 0.0:
        if p.beyond_side > 0.5:
            total += p.beyond * max(u - p.beyond_at, 0.0)
        elif p.beyond_side < -0.5:
            total += p.beyond * min(u - p.beyond_at, 0.0)
        else:
            total += p.beyond * (max(u - p.beyond_at, 0.0) - max(-u - p.beyond_at, 0.0))
    if p.wave != 0.0:
        angle = 2.0 * math.pi * p.wave_number * u
        total += p.wave * math.sin(angle + p.wave_phase) + p.wave_2 * math.sin(2.0 * angle + p.wave_2_phase)
    return total


@kernel
def _weighted(spool: float, t: float, y: Array, w: Array, p: Any) -> float:
    """Return the weighted sum of the signals, without offset."""
    u = p.per_position * y[X] + p.per_velocity * y[V] + p.per_speed * abs(y[V]) + p.per_pressure * y[PL]
    u += p.per_spool * spool + p.per_error * (spool - y[XV]) + p.per_load * disturbance_force(t, w) + p.per_time * t
    return u + p.per_temperature * w[TEMPERATURE]


@kernel
def _factor(spool: float, t: float, y: Array, w: Array, p: Any) -> float:
    some = abs(p.times_velocity) + abs(p.times_pressure) + abs(p.times_spool) + abs(p.times_error) + abs(p.times_load)
    if some == 0.0:
        return 1.0
    total = p.times_velocity * y[V] + p.times_pressure * y[PL] + p.times_spool * spool
    return total + p.times_error * (spool - y[XV]) + p.times_load * disturbance_force(t, w)


@kernel
def looked_up(spool: float, t: float, y: Array, w: Array, z: Array, p: Any) -> float:
    """Return the value of a term.

    Args:
        spool: spool displacement or command [m].
        t: time [s].
        y: the plant's state.
        w: its inputs.
        z: the term's state.
        p: from :func:`table_parameters`.
    """
    u = _weighted(spool, t, y, w, p)
    if p.memory > 0.0:
        u -= z[0]
    elif p.play > 0.0:
        u = clamp(u - z[0], -0.5 * p.play, 0.5 * p.play)
    u += p.offset
    if not abs(u) < MOST_ARGUMENT:
        # The run diverges.
        return math.nan
    if p.periodic < 0.5:
        u = min(max(u, p.lowest), p.highest)
    total = formula_value(u, p)
    if p.knots > 1.5:
        total += _table(u, p)
    total *= _factor(spool, t, y, w, p)
    return total * math.tanh(y[V] / p.direction) if p.direction > 0.0 else total


@kernel
def term_rate(spool: float, t: float, y: Array, w: Array, z: Array, p: Any) -> float:
    """Return the rate of a term's state: the lag of its argument, or the output of the play [1/s]."""
    u = _weighted(spool, t, y, w, p)
    if p.memory > 0.0:
        return (u - z[0]) / p.memory
    return FOLLOW_RATE * (play_output(z[0], u, p.play) - z[0]) if p.play > 0.0 else 0.0
