"""A plant with partners activates itself once they are active."""

import pytest

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray


def test_the_plant_waits_for_its_partners_and_says_for_whom(graph, participant, spec_file):
    spec = spec_file(controller="sic")
    graph.start("plant_sim_node", spec=spec, partners="reference_node,sic_node")
    graph.start("reference_node", spec=spec)
    graph.start("sic_node", spec=spec, autostart="false")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")

    def says(words):
        return any(status.message == words for array in diagnostics for status in array.status)

    participant.until(lambda: says("waiting for sic_node"))
    assert participant.change("sic_node", "configure")
    assert participant.state_of("plant_sim_node") == "inactive"
    assert participant.change("sic_node", "activate")
    participant.until(lambda: participant.state_of("plant_sim_node") == "active")


def test_a_plant_that_waits_can_be_stopped(graph, participant, spec_file):
    graph.start("plant_sim_node", spec=spec_file(), partners="sic_node")
    participant.until(lambda: participant.state_of("plant_sim_node") == "inactive")
    assert graph.stop("plant_sim_node") == 0
