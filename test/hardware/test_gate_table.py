"""The gate's table of states and transitions in docs/hardware.md, tested entry by entry."""

import math
from pathlib import Path

import pytest
from safety_gate_bench import Bench

from ehls_ros.hardware.safety_gate import STATES, STOP_TIME

PAGE = Path(__file__).parents[2] / "docs" / "hardware.md"
SAME, IMPOSSIBLE = "·", "–"
SHARP = {
    "acceleration": 1e5, "hold_time": 0.01, "ramp_time": 0.2, "enable_time": 0.05, "unload_time": 0.03,
    "on_clock": "position", "on_second_sender": "unload",
}  # fmt: skip
"""Parameters; faults that otherwise only warn take position control and unload here."""


def table():
    """Return the next state for each event and state."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    header = next(line for line in lines if line.startswith("| event |"))
    rows = lines[lines.index(header) + 2 :]
    states = [cell.strip() for cell in header.split("|")[2:-1]]
    found = {}
    for row in rows:
        if not row.startswith("|"):
            break
        event, *cells = (cell.strip() for cell in row.split("|")[1:-1])
        found[event] = dict(zip(states, cells, strict=True))
    return found


def enabling(bench):
    bench.turn()
    assert bench.gate.enable() is None
    bench.turns(5)


def active(bench):
    enabling(bench)
    bench.turns(60)


def holding(bench):
    active(bench)
    bench.turn(math.nan)


def position_control(bench):
    active(bench)
    backwards(bench)


def unloading(bench):
    active(bench)
    from_a_stranger(bench)


def ramping(bench):
    active(bench)
    bench.turns(2, velocity=1.9)
    bench.turn()


def cut(bench):
    active(bench)
    bench.turns(2, force=2e4)
    bench.turns(20)


def stopped(bench):
    active(bench)
    bench.gate.emergency_stop()
    bench.turns(20)


PREPARE = {
    "disabled": lambda bench: bench.turn(),
    "enabling": enabling,
    "active": active,
    "holding": holding,
    "position control": position_control,
    "unloading": unloading,
    "ramping": ramping,
    "cut": cut,
    "stopped": stopped,
}


def reset(bench):
    bench.turns(300 if bench.gate.state == "ramping" else 0)
    bench.gate.reset()


def acknowledge(bench):
    bench.wall += STOP_TIME
    bench.gate.acknowledge(bench.gate.stop)


def acknowledge_wrongly(bench):
    bench.gate.acknowledge(bench.gate.stop)
    bench.wall += STOP_TIME
    bench.gate.acknowledge("stop-7")


def from_a_stranger(bench):
    bench.sense()
    bench.gate.take(bench.cycle - 1, 1e-3, "controller")
    bench.gate.take(bench.cycle - 1, 2e-3, "stranger")
    bench.step()


def cycle_with(bench, elapsed=1e-3, **sample):
    """Run an otherwise sound cycle of a rig at rest."""
    bench.gate.sense(bench.cycle, [1e-9 * (bench.cycle % 2)] * 5 + [7e6, 313.0], **sample)
    bench.cycle += 1
    bench.gate.take(bench.cycle - 1, 1e-3, "controller")
    bench.step(elapsed)


def backwards(bench):
    """Let the clock run backwards for a cycle."""
    cycle_with(bench, elapsed=-1e-3)


def out_of_order(bench):
    bench.gate.take(bench.cycle + 5, 1e-3, "controller")
    bench.turn()


def silent(bench):
    bench.gate.set_service_silence(2.0)
    bench.turn()


EVENTS = {
    "enable": lambda bench: bench.gate.enable(),
    "disable": lambda bench: bench.gate.disable(),
    "unload": lambda bench: bench.gate.unload(),
    "emergency stop": lambda bench: bench.gate.emergency_stop(),
    "acknowledge, too early or by another name": acknowledge_wrongly,
    "acknowledge": acknowledge,
    "reset": reset,
    "the loop ends": lambda bench: bench.gate.leave(),
    "fault that warns": out_of_order,
    "fault that holds": lambda bench: bench.turn(math.nan),
    "fault that takes position control": backwards,
    "fault that unloads": from_a_stranger,
    "fault that ramps": lambda bench: bench.turns(2, velocity=1.9),
    "fault that cuts": lambda bench: bench.turns(2, force=2e4),
    "hold_time is used up": lambda bench: bench.turns(11, math.nan),
    "enable_time is over": lambda bench: bench.turns(50),
    "unloaded, or unload_time is used up": lambda bench: bench.turns(30),
    "no plausible position": lambda bench: bench.turn(position=math.nan),
    "no plausible load pressure": lambda bench: bench.turn(load_pressure=math.nan),
    "no more commands": lambda bench: bench.turns(20, None),
    "sound cycle": lambda bench: bench.turn(),
    "gap": lambda bench: cycle_with(bench, elapsed=0.1),
    "device at null": lambda bench: cycle_with(bench, at_null=True),
    "services silent": silent,
}
TABLE = table()


def test_the_table_has_every_state_and_every_event():
    assert set(TABLE) == set(EVENTS)
    assert all(set(row) == set(STATES) == set(PREPARE) for row in TABLE.values())


FIELDS = [(event, state) for event, row in TABLE.items() for state in row if row[state] != IMPOSSIBLE]


@pytest.mark.parametrize(("event", "state"), FIELDS)
def test_each_entry_of_the_table_is_true(event, state):
    bench = Bench(**SHARP)
    PREPARE[state](bench)
    assert bench.gate.state == state
    EVENTS[event](bench)
    expected = TABLE[event][state]
    assert bench.gate.state == (state if expected == SAME else expected)
    if bench.gate.state in {"cut", "stopped"}:
        assert bench.turns(20) == [0.0] * 20


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("state", STATES)
def test_nothing_opens_the_valve_after_the_loop_has_ended(state, event):
    bench = Bench(**SHARP)
    PREPARE[state](bench)
    bench.gate.leave()
    EVENTS[event](bench)
    assert not bench.gate.driving
    assert bench.turns(20, 5e-3) == [0.0] * 20
    assert bench.gate.enable() == "the node is not active"
