"""A few random sequences of attacks on a running bridge; benchmarks/attacks.py runs thousands."""

import random

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from commanded_rig import CommandedRig
from random_attacks import LARGEST, RandomAttacks, judge

SEQUENCES = 5
RESOLUTION = 1e-6


def test_under_random_attacks_the_valve_keeps_to_its_rules(one_realtime_graph, graph, participant, tmp_path):
    rig = CommandedRig(graph, participant, tmp_path)
    try:
        rig.open()
        attacks = RandomAttacks(rig, random.Random(1))
        for _ in range(SEQUENCES):
            attacks.sequence()
        attacks.emergency_stop()
        rig.fault("clear")
        rig.live(0.2)
        attacks.end_of_null()
        worst = judge(rig.seen(), rig.pace, attacks.closed)
    finally:
        rig.close()
    assert worst.opened > 0.0
    assert worst.open_when_closed == 0.0
    assert worst.beyond_ramp <= RESOLUTION
    assert worst.command <= LARGEST
    assert worst.speed <= rig.pace.velocity
