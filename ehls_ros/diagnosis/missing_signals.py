"""What can no longer be told apart because a signal is missing."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

from ehls_ros.diagnosis.record import COMMAND, FORCE, LOAD, POSITION, PRESSURE, SPOOL, SUPPLY, VELOCITY


class Merged(NamedTuple):
    """Effects that one signal tells apart.

    Attributes:
        beside: signals of which one must be there for the effects to be seen at all.
        effects: names of the effects.
        like: what they cannot be told from then.
    """

    beside: tuple[str, ...]
    effects: tuple[str, ...]
    like: str


MERGED: Mapping[str, Merged] = {
    SPOOL: Merged(
        (COMMAND,),
        (
            "valve_gain_shift",
            "valve_null_bias",
            "valve_gain_asymmetry",
            "valve_dead_zone",
            "valve_bandwidth_shift",
            "command_delay",
        ),
        "the same fault behind the spool, in the valve's flow",
    ),
    PRESSURE: Merged(
        (FORCE,),
        ("pressure_sensor_gain", "pressure_sensor_bias", "pressure_sensor_lag"),
        "an error of the load cell, which stands for the pressure",
    ),
    FORCE: Merged(
        (PRESSURE,),
        ("pressure_sensor_gain", "pressure_sensor_bias", "pressure_sensor_lag"),
        "an error of the forces: another mass, spring, constant load or friction",
    ),
    VELOCITY: Merged((POSITION,), ("position_sensor_gain",), "another spring, friction and valve gain together"),
    SUPPLY: Merged((SPOOL, COMMAND), ("supply_pressure_droop",), "a valve that passes less flow, as valve_gain_shift"),
    LOAD: Merged(
        (POSITION,), ("constant_load", "periodic_disturbance"), "any other force from outside, which is taken as zero"
    ),
}
"""By the missing signal, which would decide."""


def merged(present: Collection[str]) -> tuple[str, ...]:
    """Say for each missing signal which effects it would tell apart.

    Args:
        present: the recorded signals.

    Returns:
        One sentence for each; none for a signal without which the stage is not judged anyway.
    """
    return tuple(
        f"without {signal}, {_listed(what.effects)} cannot be told from {what.like}; {signal} would decide"
        for signal, what in MERGED.items()
        if signal not in present and any(other in present for other in what.beside)
    )


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
