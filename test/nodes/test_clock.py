"""One clock per graph: the system's, or with use_sim_time and in lockstep that of /clock."""

import signal
import time

import pytest

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock

from ehls_msgs.msg import ForceReference, LoaderState
from ehls_ros.hardware.stamps import FAR


def seconds(message) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def figures(diagnostics, name):
    """Return the values of each report of a figure, by its message."""
    pairs = [(status.message, pair) for array in diagnostics for status in array.status for pair in status.values]
    return [(message, float(pair.value)) for message, pair in pairs if pair.key == name]


def test_a_plant_that_slept_stamps_with_the_clock_again_and_tells_the_jump(graph, participant, spec_file):
    plant = graph.start("plant_sim_node", spec=spec_file(duration=1000.0))
    states = participant.collect(LoaderState, "loader_state")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    participant.until(lambda: len(states) > 100)
    plant.send_signal(signal.SIGSTOP)
    participant.rest(FAR + 0.2)
    woken_ns = time.time_ns()
    plant.send_signal(signal.SIGCONT)

    def behind():
        """Return the lag of the stamps sent since behind the times of sending [s]."""
        published = zip(states, states.published_ns, strict=True)
        return [1e-9 * when - seconds(state) for state, when in published if when > woken_ns]

    participant.until(lambda: any(abs(lag) < FAR for lag in behind()))
    participant.until(lambda: any(jump >= FAR for _, jump in figures(diagnostics, "last_stamp_jump_s")))
    participant.until(lambda: "header stamps jumped by +" in graph.log("plant_sim_node"))


@pytest.mark.long
def test_with_use_sim_time_and_no_clock_diagnostics_come_and_say_so_until_it_comes(graph, participant, spec_file):
    graph.start("reference_node", spec=spec_file(), use_sim_time="true")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")

    def told(words):
        return [array for array in diagnostics for status in array.status if words in status.message]

    participant.until(lambda: len(told("no time arrives on /clock")) > 1)
    clock = participant.node.create_publisher(Clock, "/clock", 1)
    present = Clock()
    present.clock.sec = 4711

    def runs():
        clock.publish(present)
        return told("running")

    participant.until(runs)
    assert told("running")[-1].header.stamp.sec == 4711


def test_in_lockstep_all_nodes_have_the_cycles_time(graph, participant, spec_file):
    spec = spec_file(duration=1000.0, controller="sic")
    nodes = ("reference_node", "disturbance_node", "sic_node", "plant_sim_node")
    for name in nodes:
        graph.start(name, spec=spec, timing="lockstep")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    states = participant.collect(LoaderState, "loader_state")
    references = participant.collect(ForceReference, "force_reference")
    for name in nodes:
        assert participant.get_parameter(name, "use_sim_time").bool_value

    def told():
        """Return the nodes that have reported at a time of the cycles."""
        return {status.name for array in diagnostics for status in array.status if 0.0 < seconds(array) < 1000.0}

    participant.until(lambda: told() == set(nodes) and states and references)
    assert [seconds(states[0]), seconds(references[0])] == pytest.approx([1e-3 * states[0].cycle, 1e-3 * references[0].cycle])
    assert max(map(seconds, diagnostics)) < 1000.0
