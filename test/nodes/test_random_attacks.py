"""A few guided sequences of attacks on a running bridge; benchmarks/attacks.py runs thousands."""

import random

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from bridge_attacks import KINDS, batch
from commanded_rig import SLOW
from guided import Search
from policies.monitor import check

SEQUENCES = 5


@pytest.mark.long
def test_under_attack_no_policy_is_violated(one_realtime_graph, graph, participant, tmp_path):
    attacks = batch(graph, participant, tmp_path, SLOW)
    search = Search(random.Random(1), KINDS)
    try:
        for _ in range(SEQUENCES):
            attacks.run(search.next())
        verdicts = check(attacks.trace())
    finally:
        attacks.close()
    for name in ("spool_limit", "opens_gradually", "obeys_who_drives", "emergency_stop", "disable", "fresh_command"):
        assert verdicts[name].evaluated
