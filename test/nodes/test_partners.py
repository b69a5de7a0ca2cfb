"""A plant that is to start with others activates itself once they are active."""

import pytest

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState


def state_of(participant, node):
    return participant.call(GetState, f"{node}/get_state", GetState.Request()).current_state.id


def change(participant, node, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    assert participant.call(ChangeState, f"{node}/change_state", request).success


def test_the_plant_waits_for_its_partners_and_says_for_whom(graph, participant, spec_file):
    spec = spec_file(controller="sic")
    graph.start("plant_sim_node", spec=spec, partners="reference_node,sic_node")
    graph.start("reference_node", spec=spec)
    graph.start("sic_node", spec=spec, autostart="false")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")

    def says(words):
        return any(status.message == words for array in diagnostics for status in array.status)

    participant.until(lambda: says("waiting for sic_node"))
    change(participant, "sic_node", Transition.TRANSITION_CONFIGURE)
    assert state_of(participant, "plant_sim_node") == State.PRIMARY_STATE_INACTIVE
    change(participant, "sic_node", Transition.TRANSITION_ACTIVATE)
    participant.until(lambda: state_of(participant, "plant_sim_node") == State.PRIMARY_STATE_ACTIVE)


def test_a_plant_that_waits_can_be_stopped(graph, participant, spec_file):
    graph.start("plant_sim_node", spec=spec_file(), partners="sic_node")
    participant.until(lambda: state_of(participant, "plant_sim_node") == State.PRIMARY_STATE_INACTIVE)
    assert graph.stop("plant_sim_node") == 0
