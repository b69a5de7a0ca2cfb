"""A running graph: retuned, refused, and bereft of its estimator."""

import math
import time

import pytest

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray

from ehls_msgs.msg import ControllerStatus

PERIOD_NS = 1e6
NODES = ("reference_node", "disturbance_node", "friction_estimator_node", "fasmc_node")


@pytest.fixture
def running(graph, participant, spec_file):
    """Start the graph by hand, wait until it controls, and return the statuses it keeps sending."""
    spec = spec_file(duration=1000.0)
    for name in NODES:
        graph.start(name, spec=spec)
    graph.start("plant_sim_node", spec=spec, timing="realtime")
    statuses = participant.collect(ControllerStatus, "controller_status")
    participant.until(lambda: len(statuses) > 200, 120.0)
    return statuses


def goes_on(participant, statuses, cycles=100):
    seen = statuses[-1].cycle
    participant.until(lambda: statuses[-1].cycle >= seen + cycles, 20.0)


def tuned_at(participant, diagnostics):
    def found():
        return [
            int(pair.value)
            for array in diagnostics
            for status in array.status
            if status.name == "fasmc_node"
            for pair in status.values
            if pair.key == "tuned_at_cycle"
        ]

    participant.until(lambda: any(cycle >= 0 for cycle in found()), 20.0)
    return max(found())


def test_a_new_k_acts_within_two_cycles_and_wrong_ones_are_refused(running, participant):
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    assert participant.set_parameter("fasmc_node", "k", 14.0).successful
    accepted_ns = time.time_ns()
    last = running[-1]
    stamp_ns = last.header.stamp.sec * 10**9 + last.header.stamp.nanosec
    cycle_under_way = last.cycle + (accepted_ns - stamp_ns) / PERIOD_NS
    assert tuned_at(participant, diagnostics) <= cycle_under_way + 2
    assert participant.get_parameter("fasmc_node", "k").double_value == 14.0

    for value, word in [(1e9, "range"), (-3.0, "range"), (math.nan, "nan"), ("fast", "type")]:
        result = participant.set_parameter("fasmc_node", "k", value)
        assert not result.successful
        assert word in result.reason.lower()
        assert participant.get_parameter("fasmc_node", "k").double_value == 14.0
        goes_on(participant, running)

    # A whole number is taken as the number it is.
    assert participant.set_parameter("fasmc_node", "k", 13).successful
    assert participant.get_parameter("fasmc_node", "k").double_value == 13.0
    goes_on(participant, running)


def test_the_estimator_may_go_and_come_back_and_every_node_ends_cleanly(running, participant, graph, spec_file):
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    participant.until(lambda: not running[-1].friction_fallback, 20.0)
    graph.stop("friction_estimator_node")
    participant.until(lambda: running[-1].friction_fallback, 20.0)
    goes_on(participant, running)
    participant.until(lambda: any("Stribeck" in status.message for array in diagnostics for status in array.status), 20.0)
    graph.start("friction_estimator_node", spec=spec_file(duration=1000.0))
    participant.until(lambda: not running[-1].friction_fallback, 60.0)
    goes_on(participant, running)

    for name in (*NODES, "plant_sim_node"):
        assert graph.stop(name) == 0, graph.log(name)
        assert "Traceback" not in graph.log(name)
