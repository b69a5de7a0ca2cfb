"""A running graph: parameters changed and refused, the estimator stopped and restarted, and all of that in the bag.

It runs in lockstep, so that each cycle waits for its answers, however slow the machine.
"""

import math
import signal

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from patience import PATIENCE
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.msg import ControllerStatus
from ehls_ros.recording.events import read_events

NODES = ("reference_node", "disturbance_node", "friction_estimator_node", "fasmc_node")


@pytest.fixture
def running(graph, participant, spec_file):
    """Start the graph, wait until it controls, and return the list of its statuses."""
    spec = spec_file(duration=1000.0)
    graph.start("recorder_node", spec=spec, timing="lockstep", bag=graph.folder / "bag")
    for name in (*NODES, "plant_sim_node"):
        graph.start(name, spec=spec, timing="lockstep")
    statuses = participant.collect(ControllerStatus, "controller_status")
    participant.until(lambda: len(statuses) > 200)
    return statuses


def goes_on(participant, statuses, cycles=100):
    seen = statuses[-1].cycle
    participant.until(lambda: statuses[-1].cycle >= seen + cycles)


def figure(participant, diagnostics, node, name, holds):
    """Wait until a node's message and one of its values satisfy a condition, and return that value."""

    def found():
        statuses = [status for array in diagnostics for status in array.status if status.name == node]
        told = [(status.message, {pair.key: pair.value for pair in status.values}) for status in statuses]
        return [int(figures[name]) for message, figures in told if name in figures and holds(message, int(figures[name]))]

    participant.until(found)
    return found()[0]


@pytest.mark.long
def test_a_graph_is_retuned_loses_its_estimator_regains_it_and_ends_cleanly(running, participant, graph, spec_file):
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    # With the recorder and the test's participant.
    figure(participant, diagnostics, "recorder_node", "nodes_known", lambda _, known: known >= len(NODES) + 3)
    tuned_after = a_new_k_acts_within_two_cycles_and_wrong_ones_are_refused(running, participant, diagnostics)
    the_estimator_may_go_and_come_back(running, participant, diagnostics, graph, spec_file(duration=1000.0))
    an_estimate_at_its_bound_is_said(running, participant, diagnostics)
    the_rig_is_unloaded_on_request(participant, diagnostics)
    assert participant.call(Trigger, "emergency_stop", Trigger.Request()).success
    # SIGINT to all, then their exit codes.
    for name in (*NODES, "plant_sim_node"):
        graph.processes[name].send_signal(signal.SIGINT)
    for name in (*NODES, "plant_sim_node"):
        assert graph.processes.pop(name).wait(PATIENCE) == 0, graph.log(name)
        assert "Traceback" not in graph.log(name)
    assert graph.stop("recorder_node") == 0
    it_is_all_in_the_bag(graph.folder / "bag", tuned_after)


def a_new_k_acts_within_two_cycles_and_wrong_ones_are_refused(running, participant, diagnostics):
    # While the plant is inactive, the cycle in which the new k is accepted is known.
    assert participant.change("plant_sim_node", "deactivate")
    under_way = figure(participant, diagnostics, "plant_sim_node", "cycle", lambda message, _: message == "inactive")
    assert participant.set_parameter("fasmc_node", "k", 14.0).successful
    assert participant.change("plant_sim_node", "activate")
    tuned_at = figure(participant, diagnostics, "fasmc_node", "tuned_at_cycle", lambda _, cycle: cycle >= 0)
    assert under_way <= tuned_at <= under_way + 2
    assert participant.get_parameter("fasmc_node", "k").double_value == 14.0

    for value, word in [(1e9, "0.1 to 1000"), (-3.0, "0.1 to 1000"), (math.nan, "nan"), ("fast", "number")]:
        result = participant.set_parameter("fasmc_node", "k", value)
        assert not result.successful
        assert word in result.reason.lower()
        assert participant.get_parameter("fasmc_node", "k").double_value == 14.0
        goes_on(participant, running)

    # An integer is accepted for a float.
    assert participant.set_parameter("fasmc_node", "k", 13).successful
    assert participant.get_parameter("fasmc_node", "k").double_value == 13.0
    goes_on(participant, running)
    return 1e-3 * under_way


def the_estimator_may_go_and_come_back(running, participant, diagnostics, graph, spec):
    participant.until(lambda: not running[-1].friction_fallback)
    graph.stop("friction_estimator_node")
    participant.until(lambda: running[-1].friction_fallback)
    goes_on(participant, running)
    participant.until(lambda: any("steady sliding" in status.message for array in diagnostics for status in array.status))
    graph.start("friction_estimator_node", spec=spec)
    participant.until(lambda: not running[-1].friction_fallback)
    goes_on(participant, running)


def an_estimate_at_its_bound_is_said(running, participant, diagnostics):
    assert participant.set_parameter("fasmc_node", "delta_maximum", 1e-3).successful
    participant.until(lambda: running[-1].at_bound and abs(running[-1].delta) <= 1.001e-3)
    words = "D̂ stands at its bound of ±0.001 N: raise delta_maximum"
    participant.until(lambda: any(status.message.startswith(words) for array in diagnostics for status in array.status))
    assert participant.set_parameter("fasmc_node", "delta_maximum", 5e4).successful
    participant.until(lambda: not running[-1].at_bound)


def the_rig_is_unloaded_on_request(participant, diagnostics):
    def states():
        pairs = (pair for array in diagnostics for status in array.status for pair in status.values)
        return [pair.value for pair in pairs if pair.key == "state"]

    # The gate is cut since the plant was deactivated.
    assert participant.call(Trigger, "reset_trips", Trigger.Request()).success
    assert participant.call(SetBool, "enable", SetBool.Request(data=True)).success
    participant.until(lambda: "active" in states()[-1:])
    assert participant.call(Trigger, "unload", Trigger.Request()).success
    participant.until(lambda: "unloading" in states())
    participant.until(lambda: "disabled" in states()[-1:])
    refused = participant.call(Trigger, "unload", Trigger.Request())
    assert (refused.success, refused.message) == (False, "the gate is disabled: the valve is closed")


def it_is_all_in_the_bag(bag, tuned_after):
    events = read_events(bag)
    of_law = [(event.time_s, event.what) for event in events if event.node == "fasmc_node"]
    first = next(index for index, (_, what) in enumerate(of_law) if what == "k: 12.0 → 14.0")
    assert of_law[first][0] == pytest.approx(tuned_after, abs=1e-9)
    tuned = [what for _, what in of_law[first:] if what.startswith("k")]
    assert tuned == ["k: 12.0 → 14.0", "k: 14.0 → 13.0"]
    of_plant = [event.what for event in events if event.node == "plant_sim_node"]
    assert "activating → active" in of_plant[of_plant.index("deactivating → inactive") :]
    assert any(what.startswith("stopped") for what in of_plant)
    assert any("steady sliding" in what for _, what in of_law)
