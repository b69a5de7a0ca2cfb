"""The safety gate's limits, times and reactions.

The declarations bound what may be said at all. Before a real actuator :mod:`ehls_ros.hardware.gate_bounds` narrows that to what
the rig stands. What protects the rig itself - force, pressure, position, velocity, a stale snapshot, a stale command - never
only warns.
"""

from collections.abc import Iterator
from typing import Annotated, Any, Final, NamedTuple

from pydantic import Field

from ehls_ros.schema import quantity

REACTIONS = WARN, HOLD, RAMP, CUT = ("warn", "hold", "ramp", "cut")
"""What may follow a fault, mildest first: say so; keep the last safe command for a while; ramp to null; null at once."""

PROTECTS_WHEN_LARGER = frozenset({"enable_time", "position_margin"})
"""Numbers of which more protects more; of all others, less does."""

SIMULATED: Final[dict[str, float]] = {
    "enable_time": 0.0, "position_margin": -0.005, "command_timeout": 0.5, "sensor_timeout": 0.5,
}  # fmt: skip
"""What differs before a simulated rig: it starts at once, has no end stop, and bears with a busy computer.

The paper's constant 10 kN against its large disturbance takes the piston to 0.303 m, with SIC to 0.304 m, of a stroke of 0.3 m.
"""


def reaction(description: str, *, least: str = WARN) -> Any:
    """Declare a reaction, for use inside ``Annotated[str, ...]``.

    Args:
        description: the fault, in one sentence.
        least: the mildest reaction that may be chosen.
    """
    choices = REACTIONS[REACTIONS.index(least) :]
    return Field(description=f"{description}: {', '.join(choices)}", pattern=f"^({'|'.join(choices)})$")


class Parameters(NamedTuple):
    """What the gate lets through, and what it does when it does not."""

    command_timeout: Annotated[
        float, quantity("s", "age at which a command is stale, and its sender has let go", minimum=0.002, maximum=0.5)
    ] = 0.02
    sensor_timeout: Annotated[float, quantity("s", "age at which a snapshot is stale", minimum=0.002, maximum=0.5)] = 0.02
    command_rate: Annotated[float, quantity("m/s", "largest rate of the spool command", above=0.0, maximum=20.0)] = 2.0
    hold_time: Annotated[float, quantity("s", "longest hold; what lasts longer is ramped", minimum=0.0, maximum=0.1)] = 0.02
    ramp_time: Annotated[float, quantity("s", "time of the ramp to null", minimum=0.0, maximum=0.2)] = 0.02
    enable_time: Annotated[float, quantity("s", "time in which enabling blends the command in", minimum=0.0, maximum=10.0)] = (
        0.5
    )
    trip_level: Annotated[
        float,
        quantity("1", "part of the rig's limits of force, pressure and velocity that is let through", above=0.0, maximum=1.0),
    ] = 0.9
    limit_time: Annotated[float, quantity("s", "how long a limit must be exceeded", minimum=0.0, maximum=0.1)] = 0.002
    position_margin: Annotated[
        float, quantity("m", "distance from the ends of the rig's stroke that is kept clear", minimum=-0.05, maximum=0.5)
    ] = 0.015
    force_error: Annotated[float, quantity("N", "largest lasting error of the force", above=0.0, maximum=1e5)] = 2e3
    force_error_time: Annotated[float, quantity("s", "how long it must last", minimum=0.0, maximum=10.0)] = 2.0
    sensor_range: Annotated[
        float, quantity("1", "multiple of the rig's limits beyond which no reading is true", minimum=1.0, maximum=10.0)
    ] = 1.5
    acceleration: Annotated[float, quantity("m/s^2", "largest true acceleration", above=0.0, maximum=1e5)] = 1e3
    pressure_rate: Annotated[
        float,
        quantity(
            "Pa/s", "rate of a pressure that is never a jump; an open valve makes the load's faster", above=0.0, maximum=1e11
        ),
    ] = 2e9
    frozen_time: Annotated[
        float, quantity("s", "how long a reading that repeats itself is put up with", minimum=0.005, maximum=10.0)
    ] = 0.05
    frozen_command: Annotated[
        float, quantity("m", "span of the command over which a reading must have changed", above=0.0, maximum=0.1)
    ] = 2e-4
    force_mismatch: Annotated[
        float, quantity("N", "largest difference of force and load pressure times ram area", above=0.0, maximum=1e5)
    ] = 1e3
    position_mismatch: Annotated[
        float, quantity("m", "largest difference of travel and integrated velocity, over 0.1 s", above=0.0, maximum=1.0)
    ] = 5e-3
    supply_mismatch: Annotated[
        float, quantity("Pa", "how far the load pressure may lie above the supply", above=0.0, maximum=1e8)
    ] = 7e5
    mismatch_time: Annotated[float, quantity("s", "how long a mismatch must last", minimum=0.0, maximum=1.0)] = 0.02

    on_command_not_finite: Annotated[str, reaction("command that is no finite number")] = HOLD
    on_command_range: Annotated[str, reaction("command beyond the rig's limit; warn: it is clamped")] = HOLD
    on_command_rate: Annotated[str, reaction("command that moves too fast; warn: it is slowed down")] = HOLD
    on_command_stale: Annotated[str, reaction("no fresh command", least=HOLD)] = CUT
    on_command_order: Annotated[str, reaction("command for a cycle already answered, too old or to come; it is ignored")] = WARN
    on_second_sender: Annotated[str, reaction("command of another sender than the first; it is ignored")] = WARN
    on_force: Annotated[str, reaction("force beyond its limit", least=RAMP)] = CUT
    on_load_pressure: Annotated[str, reaction("load pressure beyond its limit", least=RAMP)] = CUT
    on_velocity: Annotated[str, reaction("velocity beyond its limit", least=RAMP)] = RAMP
    on_position: Annotated[str, reaction("position beyond its limits while the command leads further out", least=RAMP)] = CUT
    on_force_error: Annotated[str, reaction("lasting error of the force")] = RAMP
    on_sensor_not_finite: Annotated[str, reaction("reading that is no finite number", least=HOLD)] = HOLD
    on_sensor_range: Annotated[str, reaction("reading out of its physical range")] = RAMP
    on_sensor_jump: Annotated[str, reaction("reading that moves faster than the rig can")] = RAMP
    on_sensor_frozen: Annotated[str, reaction("reading that stands still while the command moves")] = RAMP
    on_sensor_mismatch: Annotated[str, reaction("readings that contradict each other")] = RAMP
    on_sensor_stale: Annotated[str, reaction("no fresh snapshot", least=RAMP)] = CUT
    on_clock: Annotated[str, reaction("time that is no number, stands still or goes back; a period is counted instead")] = WARN


class Change(NamedTuple):
    """One parameter that is other than before."""

    name: str
    before: float | str
    after: float | str

    @property
    def weakens(self) -> bool:
        """Whether the gate protects less with it."""
        if isinstance(self.after, str):
            return REACTIONS.index(self.after) < REACTIONS.index(str(self.before))
        larger = self.after > float(self.before)
        return larger != (self.name in PROTECTS_WHEN_LARGER)

    def __str__(self) -> str:
        """Return it in a few words."""
        what = f"{self.before:g} -> {self.after:g}" if isinstance(self.after, float) else f"{self.before} -> {self.after}"
        return f"{self.name} {what}{' (weaker)' if self.weakens else ''}"


def changes(before: Parameters, after: Parameters) -> Iterator[Change]:
    """Yield what differs between two parameter sets."""
    old, new = before._asdict(), after._asdict()
    for name in Parameters._fields:
        if old[name] != new[name]:
            yield Change(name, old[name], new[name])
