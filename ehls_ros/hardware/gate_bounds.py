"""Bounds of the gate's parameters on a real rig, so that no setting can defeat the protection.

All follow from the rig file's limits, the valve bandwidth and the control period.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.hardware.gate_parameters import Parameters
from ehls_ros.physics.rig import Rig

BLIND_TRAVEL = 0.1
"""Fraction of the stroke that the piston may travel at the velocity limit before a fault is acted on."""

MIN_PERIODS = 5
"""Minimum number of periods in which a command may cross the full spool range."""

MIN_ENABLE_LAGS = 10.0
"""Minimum enabling time, in time constants of the valve."""

MIN_ENABLE_PERIODS = 50
"""Minimum enabling time, in control periods."""


class Bound(NamedTuple):
    """The range of one parameter.

    Attributes:
        low: smallest value.
        high: largest value.
        reason: origin of the bound.
    """

    low: float
    high: float
    reason: str


def bounds_of(rig: Rig, period: float) -> dict[str, Bound]:
    """Return the bounds of the gate's parameters for a real actuator, by name.

    Args:
        rig: with valid limits.
        period: control period [s].
    """
    limits, unbounded = rig.limits, float("inf")
    stroke = limits.position[1] - limits.position[0]
    blind = max(BLIND_TRAVEL * stroke / limits.velocity, 3.0 * period)
    travel = f"at the velocity limit the piston travels {100.0 * BLIND_TRAVEL:g} % of its stroke in {blind:.3g} s"
    waits = Bound(0.0, blind, travel)
    fastest, slowest = 2.0 * limits.spool / (MIN_PERIODS * period), limits.spool / blind
    gentle = max(MIN_ENABLE_LAGS / rig.plant.valve_bandwidth, MIN_ENABLE_PERIODS * period)
    return {
        **dict.fromkeys(("command_timeout", "sensor_timeout", "hold_time", "ramp_time", "limit_time"), waits),
        "command_rate": Bound(
            slowest,
            fastest,
            f"the spool closes within {blind:.3g} s and takes at least {MIN_PERIODS} periods to cross its range",
        ),
        "enable_time": Bound(
            gentle, unbounded, f"{MIN_ENABLE_LAGS:g} time constants of the valve and {MIN_ENABLE_PERIODS} periods"
        ),
        "position_margin": Bound(0.0, unbounded, "the ends of the rig's stroke"),
    }


def out_of_bounds(parameters: Parameters, bounds: Mapping[str, Bound]) -> Iterator[BadInput]:
    """Yield an error for each parameter that is out of its bounds."""
    for name, (low, high, reason) in bounds.items():
        value = getattr(parameters, name)
        if not low <= value <= high:
            expected = f"{low:.3g} to {high:.3g} for this rig: {reason}"
            yield BadInput(f"{name} is {value:g}", "safety gate", expected)


def within(parameters: Parameters, bounds: Mapping[str, Bound]) -> Parameters:
    """Clip the parameters to the bounds; for the defaults."""
    held = {name: min(max(getattr(parameters, name), low), high) for name, (low, high, _) in bounds.items()}
    return parameters._replace(**held)
