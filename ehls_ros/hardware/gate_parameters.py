"""The safety gate's limits, times and reactions.

The declarations give the widest ranges; on a real rig :mod:`ehls_ros.hardware.gate_bounds` narrows them. Six checks protect
the rig itself: force, pressure, position, velocity, stale snapshot and stale command. They cannot be set to ``warn``.
"""

from collections.abc import Iterator
from typing import Annotated, Final, NamedTuple

from ehls_ros.schema import Note, quantity, text

REACTIONS = WARN, HOLD, POSITION, UNLOAD, RAMP, CUT = ("warn", "hold", "position", "unload", "ramp", "cut")
"""Reactions to a fault, mildest first.

``warn`` only reports the fault. ``hold`` keeps the last safe command for a while. ``position`` holds the piston where it comes
to rest, and ``unload`` lets the load pressure decay; in both the gate itself drives the valve. ``ramp`` ramps the command to
null, and ``cut`` sets it to null at once.
"""

PROTECTS_WHEN_LARGER = frozenset({"enable_time", "position_margin"})
"""Parameters that protect more when larger; all others protect more when smaller."""

SIMULATED: Final[dict[str, float]] = {"enable_time": 0.0, "position_margin": -0.005}
"""Defaults for a simulated rig of the paper's size, which starts at once and has no end stop.

The stroke is 0.3 m. In the paper's case of constant 10 kN and large disturbance, the piston moves to 0.303 m, with SIC to
0.304 m.
"""


def reaction(description: str, *, least: str = WARN) -> Note:
    """Declare a reaction, for use inside ``Annotated[str, ...]``.

    Args:
        description: the fault, in a few words.
        least: the mildest reaction allowed.
    """
    choices = REACTIONS[REACTIONS.index(least) :]
    return text(f"{description}: {', '.join(choices)}", choices=choices)


class Parameters(NamedTuple):
    """Limits and times of the gate, and its reaction to each fault."""

    command_timeout: Annotated[
        float, quantity("s", "age at which a command is stale and its sender may be replaced", minimum=0.002, maximum=0.5)
    ] = 0.02
    sensor_timeout: Annotated[float, quantity("s", "age at which a snapshot is stale", minimum=0.002, maximum=0.5)] = 0.02
    command_rate: Annotated[
        float, quantity("m/s", "largest rate of the spool command", above=0.0, maximum=20.0, scale="spool")
    ] = 2.0
    hold_time: Annotated[float, quantity("s", "longest hold; after it the gate ramps to null", minimum=0.0, maximum=0.1)] = 0.02
    ramp_time: Annotated[float, quantity("s", "time of the ramp to null", minimum=0.0, maximum=0.2)] = 0.02
    unload_time: Annotated[
        float, quantity("s", "longest unloading; after it the gate ramps to null", minimum=0.0, maximum=60.0)
    ] = 5.0
    enable_time: Annotated[
        float, quantity("s", "duration of blending in the command after enabling", minimum=0.0, maximum=10.0)
    ] = 0.5
    trip_level: Annotated[
        float, quantity("1", "fraction of the rig's limits of force, pressure and velocity", above=0.0, maximum=1.0)
    ] = 0.9
    limit_time: Annotated[float, quantity("s", "minimum duration of an excess over a limit", minimum=0.0, maximum=0.1)] = 0.002
    position_margin: Annotated[
        float, quantity("m", "clearance to the ends of the rig's stroke", minimum=-0.05, maximum=0.5, scale="stroke")
    ] = 0.015
    force_error: Annotated[float, quantity("N", "largest sustained force error", above=0.0, maximum=1e9, scale="force")] = 2e3
    force_error_time: Annotated[float, quantity("s", "minimum duration of the force error", minimum=0.0, maximum=10.0)] = 2.0
    sensor_range: Annotated[
        float, quantity("1", "plausible range of a reading, as a multiple of the rig's limits", minimum=1.0, maximum=10.0)
    ] = 1.5
    acceleration: Annotated[
        float, quantity("m/s^2", "largest plausible acceleration", above=0.0, maximum=1e5, scale="force / mass")
    ] = 1e3
    pressure_rate: Annotated[
        float,
        quantity(
            "Pa/s",
            "largest plausible pressure rate; higher for the load with an open valve",
            above=0.0,
            maximum=1e11,
            scale="compression * speed",
        ),
    ] = 2e9
    frozen_time: Annotated[
        float, quantity("s", "time after which an unchanged reading may be frozen", minimum=0.005, maximum=10.0)
    ] = 0.05
    frozen_command: Annotated[
        float, quantity("m", "span of the command over which a reading must change", above=0.0, maximum=0.1, scale="spool")
    ] = 2e-4
    force_mismatch: Annotated[
        float,
        quantity(
            "N", "largest difference between force and load pressure times piston area", above=0.0, maximum=1e9, scale="force"
        ),
    ] = 1e3
    position_mismatch: Annotated[
        float,
        quantity(
            "m", "largest difference between travel and integrated velocity over 0.1 s", above=0.0, maximum=1.0, scale="stroke"
        ),
    ] = 5e-3
    supply_mismatch: Annotated[
        float,
        quantity(
            "Pa", "largest excess of the load pressure over the supply pressure", above=0.0, maximum=1e8, scale="pressure"
        ),
    ] = 7e5
    mismatch_time: Annotated[float, quantity("s", "minimum duration of a mismatch", minimum=0.0, maximum=1.0)] = 0.02
    stiffness_drop: Annotated[
        float,
        quantity(
            "1",
            "fraction of the learnt stiffness whose loss is a failure of the specimen; 1: not checked, as against an actuator"
            " that moves by itself, whose force is no function of the position",
            above=0.0,
            maximum=1.0,
        ),
    ] = 1.0

    on_command_not_finite: Annotated[str, reaction("command not a finite number")] = HOLD
    on_command_range: Annotated[str, reaction("command beyond the rig's limit; warn: clamped")] = HOLD
    on_command_rate: Annotated[str, reaction("command too fast; warn: rate-limited")] = HOLD
    on_command_stale: Annotated[str, reaction("no fresh command", least=HOLD)] = CUT
    on_command_order: Annotated[str, reaction("command for an answered, too old or future cycle; it is ignored")] = WARN
    on_second_sender: Annotated[str, reaction("command from a second sender; it is ignored")] = WARN
    on_force: Annotated[str, reaction("force beyond its limit", least=RAMP)] = CUT
    on_load_pressure: Annotated[str, reaction("load pressure beyond its limit", least=RAMP)] = CUT
    on_velocity: Annotated[str, reaction("velocity beyond its limit", least=RAMP)] = RAMP
    on_position: Annotated[str, reaction("position beyond its limits and command further outwards", least=RAMP)] = CUT
    on_force_error: Annotated[str, reaction("sustained force error")] = RAMP
    on_sensor_not_finite: Annotated[str, reaction("reading not a finite number", least=HOLD)] = HOLD
    on_sensor_range: Annotated[str, reaction("reading outside its physical range")] = RAMP
    on_sensor_jump: Annotated[str, reaction("reading changes faster than the rig can")] = RAMP
    on_sensor_frozen: Annotated[str, reaction("reading unchanged while the command moves")] = RAMP
    on_sensor_mismatch: Annotated[str, reaction("readings that contradict each other")] = RAMP
    on_specimen: Annotated[str, reaction("failed specimen or load cell; the force falls short of the stiffness learnt")] = (
        POSITION
    )
    on_sensor_stale: Annotated[str, reaction("no fresh snapshot", least=RAMP)] = CUT
    on_clock: Annotated[str, reaction("clock not finite, stopped or running backwards; one period is assumed instead")] = WARN


class Change(NamedTuple):
    """One changed parameter."""

    name: str
    before: float | str
    after: float | str

    @property
    def weakens(self) -> bool:
        """Whether the gate protects less than before."""
        if isinstance(self.after, str):
            return REACTIONS.index(self.after) < REACTIONS.index(str(self.before))
        larger = self.after > float(self.before)
        return larger != (self.name in PROTECTS_WHEN_LARGER)

    def __str__(self) -> str:
        """Return the change as a short text."""
        what = f"{self.before:g} -> {self.after:g}" if isinstance(self.after, float) else f"{self.before} -> {self.after}"
        return f"{self.name} {what}{' (weaker)' if self.weakens else ''}"


def changes(before: Parameters, after: Parameters) -> Iterator[Change]:
    """Yield the differences between two parameter sets."""
    old, new = before._asdict(), after._asdict()
    for name in Parameters._fields:
        if old[name] != new[name]:
            yield Change(name, old[name], new[name])
