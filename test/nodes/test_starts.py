"""Lifecycle requests to nodes that are just starting themselves: none ends a node, and none waits forever."""

import time

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from held_up import hold_up
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from node_server import COMMAND
from patience import PATIENCE

TOGETHER = "plant_sim_node+reference_node+disturbance_node+fasmc_node"


@pytest.mark.parametrize("label", ["configure", "shutdown"])
def test_a_request_while_a_node_configures_itself_ends_no_node(graph, participant, spec_file, tmp_path, label):
    go_on = tmp_path / "go_on"
    words = ["-p", f"spec:={spec_file()}", "-p", "timing:=lockstep"]
    before = {"module": hold_up.__module__, "function": hold_up.__name__, "arguments": {"until": str(go_on)}}
    graph.run("reference_node", ["-m", "ehls_ros.nodes.reference_node", "--ros-args", *words], before)
    client = participant.node.create_client(ChangeState, "reference_node/change_state")
    assert client.wait_for_service(PATIENCE)
    participant.until(lambda: state_of(participant) == "configuring")
    request = client.call_async(ChangeState.Request(transition=Transition(label=label)))
    # It arrives during the configuration.
    participant.rest(0.5)
    go_on.touch()
    participant.until(request.done)
    process = graph.processes["reference_node"]
    participant.until(lambda: state_of(participant) == ("finalized" if label == "shutdown" else "active"))
    assert process.poll() is None
    assert "failed" not in graph.log("reference_node")
    assert graph.stop("reference_node") == 0


def test_a_request_that_is_faster_than_a_node_itself_ends_no_node(graph, participant, spec_file, tmp_path):
    go_on = tmp_path / "go_on"
    words = ["-p", f"spec:={spec_file(duration=1e4)}", "-p", "timing:=lockstep"]
    before = {"module": hold_up.__module__, "function": hold_up.__name__, "arguments": {"until": str(go_on)}}
    graph.run("composed", ["-m", COMMAND, "run", TOGETHER, "--ros-args", *words], before)
    # The plant comes last.
    for label in ("configure", "activate"):
        assert participant.change("plant_sim_node", label)
    go_on.touch()
    for name in TOGETHER.split("+"):
        participant.until(lambda name=name: participant.state_of(name) == "active")
    assert graph.stop("composed") == 0
    assert "failed" not in graph.log("composed")


def state_of(participant):
    """Return the state reported by the node, if it answers within a second."""
    client = participant.node.create_client(GetState, "reference_node/get_state")
    asked = client.call_async(GetState.Request())
    deadline = time.monotonic() + 1.0
    participant.until(lambda: asked.done() or time.monotonic() > deadline)
    found = asked.result().current_state.label if asked.done() else ""
    participant.node.destroy_client(client)
    return found


def test_a_node_may_be_deactivated_while_the_plant_of_its_process_waits_for_a_partner(graph, participant, spec_file):
    words = ["-p", f"spec:={spec_file(duration=1e4)}", "-p", "timing:=lockstep", "-p", "partners:=friction_estimator_node"]
    graph.run("composed", ["-m", COMMAND, "run", TOGETHER, "--ros-args", *words])
    participant.until(lambda: participant.state_of("plant_sim_node") == "inactive")
    for label, state in (
        ("deactivate", "inactive"),
        ("activate", "active"),
        ("deactivate", "inactive"),
        ("cleanup", "unconfigured"),
    ):
        assert participant.change("reference_node", label)
        assert participant.state_of("reference_node") == state
    assert participant.state_of("plant_sim_node") == "inactive"
    assert graph.stop("composed") == 0
