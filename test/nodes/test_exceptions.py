"""An unforeseen exception in a node: one line with the place and the traceback's file, exit code 1, the valve at null first.

`benchmarks/injected_exceptions.py` covers every method of every node.
"""

import re
from pathlib import Path

import pytest
from tiers import tiered

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from benchmarks.injected_exceptions import Case

CASES = [
    ("fasmc_node", "apart", "prepare", 1),
    ("fasmc_node", "composed", "_answer", 30),
    ("friction_estimator_node", "composed", "react", 30),
    ("reference_node", "apart", "__init__", 1),
    ("reference_node", "composed", "stop", 1),
    ("plant_sim_node", "composed", "_look_around", 1),
    ("plant_sim_node", "apart", "Lifecycle.on_deactivate", 1),
    ("hardware_bridge_node", "composed", "once", 300),
    ("hardware_bridge_node", "composed", "stop", 1),
    ("hardware_bridge_node", "composed", "release", 1),
]
QUICK = [case for case in CASES if case[2] in {"_answer", "once"}]
"""One case of the loop and of the hardware."""


@pytest.mark.parametrize(
    ("node", "way", "method", "call"),
    tiered(CASES, *QUICK, unpack=True),
)
def test_the_end_of_a_node_is_reported(node_server, monkeypatch, tmp_path, node, way, method, call):
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "logs"))
    case = Case(node_server, tmp_path, node, way)
    outcome = case.run(method, call)
    assert outcome.reached
    assert not outcome.silent
    assert outcome.code == 1
    assert outcome.null in {True, None}
    log = case.graph.log("composed" if way == "composed" else node)
    line = next(line for line in log.splitlines() if "so the node ends" in line)
    assert re.search(r"failed, so the node ends: Injected: \S+ \(injection.py:\d+\); traceback: (\S+)", line)
    traceback = Path(re.search(r"traceback: (\S+)", line)[1]).read_text(encoding="utf-8")
    assert f"injection.Injected: {method}" in traceback
