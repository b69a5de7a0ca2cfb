"""Synthetic logs for the test of the policies: one that holds, and variations of it."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.experiments.spec import load_rig
from ehls_ros.hardware.gate_bounds import bounds_of, within
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from policies.trace import Call, Happening, Report, Setup, Trace

RIG = load_rig(Path(__file__).resolve().parents[2] / "config" / "rig_paper_measured.yaml")
PERIOD = 1e-3
GATE = within(Gate(), bounds_of(RIG, PERIOD))._replace(enable_time=0.1)
WATCHDOG = 0.01
BEGIN = 100.0
"""Time of the first row [s]."""

OPENED = 100
"""Row in which the valve opens."""

AMPLITUDE = 1e-4
"""Amplitude of the command [m]."""

EVENT = 1000
"""Row of the event."""

COMMANDER, PLANT = "commander", "/ehls/hardware_bridge_node-1"


def at(row: float) -> float:
    """Return the time of a row [s]."""
    return BEGIN + row * PERIOD


def opened(rows: int = 4000) -> Array:
    """Return a command that is blended in from :data:`OPENED` on."""
    return AMPLITUDE * np.clip((np.arange(rows) - OPENED + 1) * PERIOD / GATE.enable_time, 0.0, 1.0)


def until(last: int, rows: int = 4000) -> Array:
    """Return a command that is null after a row."""
    return np.where(np.arange(rows) <= last, opened(rows), 0.0)


def trace(
    command: Array | None = None,
    *,
    calls: Iterable[Call] = (),
    happenings: Iterable[Happening] = (),
    messages: dict[str, list[tuple[Any, ...]]] | None = None,
    reports: Iterable[Report] = (),
    lockstep: bool = False,
    watchdog: float = WATCHDOG,
    columns: dict[str, Array] | None = None,
    load_cycles: Iterable[tuple[int, int, int]] = (),
) -> Trace:
    """Return a run; omitted parts are as in a run without events."""
    command = opened() if command is None else command
    row = np.arange(command.size, dtype=float)
    signals = ("force_n", "load_pressure_pa", "velocity_m_s", "position_m", "output_status")
    log = {
        "time_s": row * PERIOD,
        "valve_command_m": command,
        **{name: np.zeros(command.size) for name in signals},
        "output_sequence": row + 1.0,
        "output_answered": row - 1.0,
        "monotonic_s": at(row),
        **(columns or {}),
    }
    enabled = Call("enable", {"data": True}, at(OPENED - 2), at(OPENED - 1), True)
    setup = Setup(PERIOD, RIG, GATE, watchdog, lockstep=lockstep)
    heard = {"valve_command": commands(), **(messages or {})}
    return Trace(setup, log, (enabled, *calls), tuple(happenings), heard, tuple(reports), tuple(load_cycles))


def commands(last: int = 4000, spool: Callable[[int], float] = lambda _: AMPLITUDE) -> list[tuple[Any, ...]]:
    """Return the commander's answers to all cycles up to one; each arrives in the row of its cycle."""
    return [(at(cycle - 0.5), 0, cycle, spool(cycle), COMMANDER) for cycle in range(last)]


def driven() -> dict[str, list[tuple[Any, ...]]]:
    """Return the messages of a plant that the commander drives."""
    states = [(at(cycle - 0.8), 0, cycle, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, PLANT) for cycle in range(4000)]
    return {"driver": [(at(0), 0, 0, True, COMMANDER, PLANT)], "loader_state": states, "valve_command": commands()}


def answered(service: str, row: float, *, success: bool = True, message: str = "", **fields: Any) -> Call:
    """Return a request that was answered in a row, a tenth of a millisecond after it had been sent."""
    return Call(service, fields, at(row) - 1e-4, at(row), success, message)


def report(state: str, row: float, level: int = 0) -> Report:
    """Return diagnostics of the plant."""
    return Report(at(row), "hardware_bridge_node", level, state, {"state": state})


def happening(what: str, row: float, whom: str = "hardware_bridge_node", code: int = 0) -> Happening:
    """Return a happening in a row."""
    return Happening(what, whom, at(row), code)
