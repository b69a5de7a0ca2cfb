"""Truth about the terms of the effects outside the list: the signals that they depend on, and the numbers of their shape."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmarks.diagnosis.cases import rig
from ehls_ros.diagnosis.record import COMMAND, LOAD, POSITION, PRESSURE, SPOOL, TEMPERATURE, VELOCITY
from ehls_ros.diagnosis.result import Term

Sizes = Mapping[str, Any]

Check = Callable[[Term, Sizes], bool]
"""Returns whether the shape of a term has the numbers of an effect with the given sizes."""

TIME = "time_s"

CLOSE = 0.15
"""Relative error of a number up to which it is right."""

EXACT = 0.01
"""The same of a period, from which many periods of the recording drift away."""

ODD = 0.2
"""Part of a curve's range by which a symmetric one may depart from its mirror image."""


class Truth(NamedTuple):
    """What a term of an effect must show.

    Attributes:
        signals: signals on which the error depends, by the names of the data contract; each of a term's must be among them.
        reads: check of its shape; None where the error has none that a term could have.
    """

    signals: tuple[str, ...]
    reads: Check | None = None


def signals_right(term: Term, truth: Truth) -> bool:
    """Return whether a term depends on no signal but those of the truth."""
    return all(signal in truth.signals for signal in (term.argument, term.factor) if signal)


def _near(value: float, true: float, tolerance: float = CLOSE) -> bool:
    return bool(abs(value - true) <= tolerance * abs(true))


def _power(exponent: float, symmetry: str) -> Check:
    def check(term: Term, sizes: Sizes) -> bool:
        power = term.reading.power
        return power is not None and power.symmetry == symmetry and _near(power.exponent, exponent)

    return check


def _places(term: Term) -> list[float]:
    """Return the places that the shapes of a term are at, in the unit of its argument."""
    shown = [shape.numbers["place"].value for shape in term.formula if "place" in shape.numbers]
    return shown if term.reading.place is None else [*shown, term.reading.place]


def _place(width: str | float) -> Check:
    """Return a check of the place within half a width, which may be one of the sizes."""

    def check(term: Term, sizes: Sizes) -> bool:
        within = 0.5 * (sizes[width] if isinstance(width, str) else width)
        return any(abs(place - sizes["position"]) <= within for place in _places(term))

    return check


def _threshold(of: Callable[[Sizes], float]) -> Check:
    """Return a check of the magnitude beyond which a term sets in."""

    def check(term: Term, sizes: Sizes) -> bool:
        return any(_near(abs(place), of(sizes)) for place in _places(term) if place != 0.0)

    return check


def _limit(of: Callable[[Sizes], float]) -> Check:
    """Return a check of the value at which a term ends beside a line."""

    def check(term: Term, sizes: Sizes) -> bool:
        return any(shape.name == "step" and _near(abs(shape.numbers["size"].value), of(sizes)) for shape in term.formula)

    return check


def _period(of: Callable[[Sizes], float]) -> Check:
    return lambda term, sizes: term.period is not None and _near(term.period.value, of(sizes), EXACT)


def _lag(size: str) -> Check:
    return lambda term, sizes: term.lag is not None and _near(term.lag.value, sizes[size])


def _amplitude(size: str) -> Check:
    return lambda term, sizes: _near(term.reading.amplitude, sizes[size])


def _mirrored(sign: float) -> Check:
    """Return a check of symmetry about zero: odd for a sign of -1, even for 1."""

    def check(term: Term, sizes: Sizes) -> bool:
        reach = min(-float(term.at[0]), float(term.at[-1]))
        if reach <= 0.0:
            return False
        at = np.linspace(0.0, reach, 50)
        right, left = np.interp(at, term.at, term.values), np.interp(-at, term.at, term.values)
        # An odd curve may have an offset, which another cause of the same stage would explain.
        apart = right - sign * left if sign > 0.0 else right + left - np.mean(right + left)
        return float(np.sqrt(np.mean(apart**2))) <= ODD * float(np.ptp(term.values))

    return check


def _changes_by(of: Callable[[Sizes, float], float]) -> Check:
    """Return a check of the change over the range of the argument, which has to be as in the truth."""

    def check(term: Term, sizes: Sizes) -> bool:
        low, high = float(term.at[0]), float(term.at[-1])
        return _near(float(term.values[-1] - term.values[0]), of(sizes, high) - of(sizes, low), 2.0 * CLOSE)

    return check


def _rises(term: Term, sizes: Sizes) -> bool:
    return term.reading.rise is not None and term.reading.rise > 0.0


def _either(*checks: Check) -> Check:
    return lambda term, sizes: any(check(term, sizes) for check in checks)


def _every(*checks: Check) -> Check:
    return lambda term, sizes: all(check(term, sizes) for check in checks)


def _turns(term: Term, sizes: Sizes) -> bool:
    return term.direction > 0.0


def _in_proportion(term: Term, sizes: Sizes) -> bool:
    return bool(term.factor)


def _error_at_limit(sizes: Sizes) -> float:
    """Return the spool's error at which its speed reaches its limit [m]."""
    return float(sizes["rate"]) / rig().plant.valve_bandwidth


TRUTHS: Mapping[str, Truth] = {
    "quadratic_drag": Truth((VELOCITY,), _power(2.0, "odd")),
    "inertial_friction": Truth((VELOCITY,), _every(lambda term, sizes: term.lag is not None, _amplitude("force"))),
    "ratchet_cogging": Truth((POSITION, VELOCITY), _every(_period(lambda sizes: sizes["length"]), _turns)),
    "creeping_spring": Truth((POSITION,), _lag("time_constant")),
    "stick_patch": Truth((POSITION,), _place("width")),
    "detent": Truth((POSITION,), _place("width")),
    "squared_crosstalk": Truth((LOAD,), _power(2.0, "even")),
    "preloaded_side_spring": Truth((POSITION,), _place(4e-3)),
    "laminar_orifice": Truth((SPOOL, PRESSURE), _mirrored(-1.0)),
    "crossport_relief": Truth((PRESSURE,), _threshold(lambda sizes: sizes["pressure"])),
    "cavitation": Truth((PRESSURE,)),
    "swelling_hose": Truth((PRESSURE,), _lag("time_constant")),
    "lifting_seal": Truth((VELOCITY, PRESSURE), _every(_in_proportion, _rises)),
    "line_restriction": Truth((SPOOL, PRESSURE), _mirrored(-1.0)),
    "spool_stiction": Truth((COMMAND, SPOOL)),
    "spool_slew_limit": Truth((SPOOL, COMMAND), _either(_threshold(_error_at_limit), _limit(_error_at_limit))),
    "valve_power_gain": Truth((COMMAND, SPOOL), _mirrored(-1.0)),
    "mains_hum": Truth((TIME,), _every(_period(lambda sizes: 1.0 / sizes["frequency"]), _amplitude("amplitude"))),
    "null_drift": Truth((TIME,), _changes_by(lambda sizes, t: sizes["drift"] * (1.0 - np.exp(-t / sizes["time_constant"])))),
    "spool_sticky_place": Truth((SPOOL, COMMAND), _place("width")),
    "spool_flow_force": Truth((SPOOL, COMMAND, PRESSURE), _in_proportion),
    "pressure_sensor_bow": Truth((PRESSURE,), _power(2.0, "even")),
    "pressure_sensor_hysteresis": Truth(
        (PRESSURE,), lambda term, sizes: term.play is not None and _near(term.play.value, 2.0 * sizes["half_width"])
    ),
    "pressure_missing_codes": Truth((PRESSURE,)),
    "pressure_zero_wander": Truth((TIME,)),
    "position_interpolation": Truth((POSITION,), _every(_period(lambda sizes: sizes["period"]), _amplitude("amplitude"))),
    "pressure_sees_position": Truth((POSITION,), _changes_by(lambda sizes, x: sizes["slope"] * x + sizes["curvature"] * x * x)),
    "pressure_sees_temperature": Truth((TEMPERATURE, TIME), lambda term, sizes: term.reading.rise is not None),
    "held_dropouts": Truth(()),
}
"""Truth by the name of the effect."""
