"""A term as a table over one argument, for effects whose shape was found in data and not derived.

The argument is a weighted sum of the stage's own signals, scaled so that its first knot is at 0 and its last one at 1. Between
the knots the table is linear; beyond them it goes on as it began, mirrored at the edge, as far as the data reach, and keeps
that value. A periodic table repeats with a period of 1. Its sign may follow the direction of motion.
"""

import math
import types
from typing import Annotated, Any, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form
from ehls_ros.physics.plant import PL, TEMPERATURE, V, X, disturbance_force
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
    "load": ("1/N", "force of the disturbance", 1.0),
    "time": ("1/s", "time", 1e4),
    "temperature": ("1/K", "oil temperature", 1e3),
}
"""Unit, meaning and largest size of the weight of each signal in the argument."""


DISCREPANCY = "Kennedy, O'Hagan, Bayesian calibration of computer models, 2001: a discrepancy of the model, here as a table"
"""Source of the effects with a table."""


def table_parameters(module: str, unit: str, meaning: str, largest: float) -> Any:
    """Return the parameters of an effect with a table, a named tuple.

    Args:
        module: name of the effect's module.
        unit: unit of the table's values.
        meaning: of the values.
        largest: largest size of a value.
    """
    periodic = "1: the table repeats with a period of 1 in the argument; 0: it does not"
    direction = "speed within which the table's sign follows the direction of motion; 0: it does not"
    notes = {
        f"per_{signal}": quantity(own, f"weight of the {name} in the argument", minimum=-most, maximum=most)
        for signal, (own, name, most) in WEIGHTS.items()
    }
    notes["offset"] = quantity("1", "offset of the argument", minimum=-1e6, maximum=1e6)
    notes["periodic"] = quantity("1", periodic, minimum=0.0, maximum=1.0)
    notes["lowest"] = quantity("1", "least argument in the data", minimum=-10.0, maximum=0.0)
    notes["highest"] = quantity("1", "largest argument in the data", minimum=1.0, maximum=11.0)
    notes["knots"] = quantity("1", "number of values in use, the first ones", minimum=2.0, maximum=float(KNOTS))
    notes["direction"] = quantity("m/s", direction, minimum=0.0, maximum=10.0)
    notes |= {n: quantity(unit, f"{meaning} at knot {k}", minimum=-largest, maximum=largest) for k, n in enumerate(VALUES)}
    body = {
        "__module__": module,
        "__doc__": "Weights of the signals in the argument, and the table.",
        "__annotations__": {name: Annotated[float, note] for name, note in notes.items()},
        **dict.fromkeys(notes, 0.0),
        "highest": 1.0,
        "knots": float(KNOTS),
    }
    return types.new_class("Parameters", (NamedTuple,), exec_body=lambda namespace: namespace.update(body))


def no_forms(rig: Rig) -> tuple[Form, ...]:
    """Return no form: the argument and its range follow from the data (:mod:`ehls_ros.diagnosis.empirical`)."""
    return ()


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
def looked_up(spool: float, t: float, y: Array, w: Array, p: Any) -> float:
    """Return the value of a table.

    Args:
        spool: spool displacement or command [m].
        t: time [s].
        y: the plant's state.
        w: its inputs.
        p: from :func:`table_parameters`.
    """
    u = p.offset + p.per_position * y[X] + p.per_velocity * y[V] + p.per_speed * abs(y[V]) + p.per_pressure * y[PL]
    u += p.per_spool * spool + p.per_load * disturbance_force(t, w) + p.per_time * t
    u += p.per_temperature * w[TEMPERATURE]
    last = p.knots - 1.0
    if p.periodic > 0.5:
        s = p.knots * (u - math.floor(u))
        # From the last knot to the first one of the next period.
        beyond = max(s - last, 0.0)
        total = (1.0 - beyond) * _between(min(s, last), p) + beyond * p.value_0
    else:
        u = min(max(u, p.lowest), p.highest)
        edge = min(max(u, 0.0), 1.0)
        total = _between(last * edge, p)
        if u != edge:
            total = 2.0 * total - _between(last * min(max(2.0 * edge - u, 0.0), 1.0), p)
    return total * math.tanh(y[V] / p.direction) if p.direction > 0.0 else total
