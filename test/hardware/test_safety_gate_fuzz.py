"""Hostile input streams: the safety gate's output is harmless for any input."""

import math
import random

import pytest
from safety_gate_bench import PERIOD, REST, RIG

from ehls_ros.errors import BadInput
from ehls_ros.hardware.gate_parameters import REACTIONS, Parameters
from ehls_ros.hardware.safety_gate import STOP_TIME, Gate
from ehls_ros.physics.rig import SENSED
from ehls_ros.schema import declarations

LIMIT = RIG.limits.spool
NASTY = [
    0.0, -0.0, math.nan, math.inf, -math.inf, 1e30, -1e30, 1e308, -1e308, 5e-324, LIMIT, -LIMIT, math.nextafter(LIMIT, 1.0),
    10**400, 2**63, None, "1", b"", [],
]  # fmt: skip
FIELDS = list(declarations(Parameters))


class Attack:
    """A random stream of every kind of fault."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.cycle = 0
        self.time = 0.0
        self.sane = 1.0 - 10.0 ** self.random.uniform(-4.0, -0.3)

    def number(self, usual: float) -> object:
        return usual if self.random.random() < self.sane else self.random.choice([*NASTY, self.random.gauss(0.0, 10.0 * LIMIT)])

    def sense(self, gate: Gate) -> None:
        readings = [self.number(REST.get(signal, self.random.gauss(0.0, 1e-6))) for signal in SENSED]
        if self.random.random() < 0.98:
            gate.sense(self.cycle, readings, self.number(0.0))
            self.cycle += 1
        else:
            gate.sense(self.random.choice([self.cycle - 3, self.cycle, -1, None, 2.5]), readings[: self.random.randrange(8)])

    def take(self, gate: Gate) -> None:
        for _ in range(self.random.choice([0, 1, 1, 1, 1, 2, 5])):
            answered = self.cycle - 1 if self.random.random() < 0.9 else self.cycle - self.random.randrange(-5, 40)
            sender = "controller" if self.random.random() < 0.95 else "stranger"
            gate.take(answered, self.number(LIMIT * math.sin(0.01 * self.cycle)), sender)

    def operate(self, gate: Gate) -> None:
        chance = self.random.random()
        if chance < 0.1:
            gate.enable()
        elif chance < 0.105:
            gate.disable()
        elif chance < 0.107:
            gate.emergency_stop()
        elif chance < 0.11:
            gate.unload()
        elif chance < 0.111:
            gate.leave()
            gate.begin()
            self.cycle = 0
        elif chance < 0.123:
            self.retune(gate)

    def retune(self, gate: Gate) -> None:
        field = self.random.choice(FIELDS)
        if field.kind is str:
            value = self.random.choice([*REACTIONS, "off"])
        else:
            low = field.minimum if field.minimum is not None else 0.0
            high = field.maximum if field.maximum is not None else 1e6
            value = self.random.choice([math.nan, math.inf, -1e30, low, high, self.random.uniform(low, high)])
        before = gate.parameters
        try:
            gate.retune(before._replace(**{field.name: value}))
        except BadInput:
            assert gate.parameters == before

    def step(self, gate: Gate) -> tuple[float, float]:
        """Return the output and the true elapsed time."""
        before = self.time
        self.time += PERIOD * self.random.uniform(0.2, 3.0)
        given = self.number(self.time) if self.random.random() < 0.05 else self.time
        written = gate.step(given)
        assert isinstance(written, float)
        return written, self.time - before


@pytest.mark.parametrize("seed", range(25))
def test_the_output_is_harmless_and_no_trip_clears_without_a_reset(seed):
    print("seed", seed)
    attack = Attack(seed)
    wall = 0.0
    gate = Gate(RIG, PERIOD, Parameters(enable_time=0.01), bounds={}, clock=lambda: wall)
    gate.begin()
    enabled = 0
    for _ in range(2000):
        attack.sense(gate)
        attack.take(gate)
        attack.operate(gate)
        causes = list(gate.causes)
        was_cut = gate.state in {"cut", "stopped"}
        written, _ = attack.step(gate)
        assert math.isfinite(written)
        assert abs(written) <= LIMIT
        assert gate.causes[: len(causes)] == causes
        assert bool(gate.causes) or gate.state not in {"position control", "ramping", "cut", "stopped"}
        assert not gate.causes or gate.state in {"position control", "unloading", "ramping", "cut", "stopped"}
        assert written == 0.0 or not was_cut
        names = [cause.detector for cause in gate.causes]
        assert len(names) == len(set(names)) <= len(gate.detectors) + 2
        enabled += gate.state in {"enabling", "active", "holding"}
        if gate.causes and attack.random.random() < 0.1:
            wall += STOP_TIME
            gate.acknowledge(gate.stop)
            gate.reset()
    # The attack is meaningful only if the gate is open at times.
    assert enabled > 0 or attack.sane < 0.98


@pytest.mark.parametrize("seed", range(60))
def test_silence_ends_at_null_in_time_whatever_came_before(seed):
    print("seed", seed)
    attack = Attack(1000 + seed)
    attack.sane = 0.999
    chosen = Parameters(
        command_timeout=attack.random.uniform(0.002, 0.1),
        hold_time=attack.random.uniform(0.0, 0.1),
        ramp_time=attack.random.uniform(0.0, 0.2),
        enable_time=attack.random.choice([0.0, 0.05]),
        on_command_stale=attack.random.choice(["hold", "ramp", "cut"]),
    )
    gate = Gate(RIG, PERIOD, chosen, bounds={})
    gate.begin()
    for _ in range(attack.random.randrange(50, 300)):
        attack.sense(gate)
        gate.take(attack.cycle - 1, LIMIT * math.sin(0.01 * attack.cycle), "controller")
        gate.enable()
        attack.step(gate)
        if gate.causes:
            gate.reset()
    reaction = chosen.on_command_stale
    allowed = chosen.command_timeout + (chosen.hold_time if reaction == "hold" else 0.0)
    grace = 0.0 if reaction == "cut" else chosen.ramp_time
    passed = 0.0
    senses = attack.random.random() < 0.5
    while passed < allowed + grace:
        if senses:
            attack.sense(gate)
        before, left = gate.output, gate.state
        attack.time += PERIOD
        passed += PERIOD
        written = gate.step(attack.time)
        assert abs(written) <= abs(before) or left in {"enabling", "active", "holding"}
        if passed >= allowed + PERIOD:
            assert gate.state not in {"enabling", "active", "holding"}
    attack.time += PERIOD
    assert gate.step(attack.time) == 0.0
