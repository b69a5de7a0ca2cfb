"""Publishers from outside this project: matched if they use ROS's default profile, otherwise reported."""

import pytest

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, ReliabilityPolicy

from ehls_msgs.msg import Disturbance, ForceReference, LoaderState, ValveCommand
from ehls_ros.nodes.ahead import LEAD

DEFAULT = 10
"""Depth of ROS's default profile, which is reliable and volatile."""

CYCLES = 50


@pytest.mark.long
def test_a_controller_with_the_default_profile_drives_the_plant_and_one_that_is_best_effort_is_named(
    graph, participant, spec_file
):
    spec = spec_file(duration=1000.0)
    graph.start("plant_sim_node", spec=spec, timing="lockstep")
    graph.start("reference_node", spec=spec, timing="lockstep")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")

    def told(words):
        return lambda: any(words in status.message for array in diagnostics for status in array.status)

    # The first snapshot is sent before any reader can receive it.
    participant.until(told("waiting for the controller"))
    node = participant.node
    commands = node.create_publisher(ValveCommand, "valve_command", DEFAULT)
    disturbances = node.create_publisher(Disturbance, "disturbance", DEFAULT)
    waiting, references, answered = [], {}, []

    def answer():
        if waiting and waiting[-1] in references:
            cycle = waiting.pop()
            answered.append(cycle)
            # The first disturbance gets lost, being sent before it can be received.
            if len(answered) > 1:
                disturbances.publish(Disturbance(cycle=cycle))
            commands.publish(ValveCommand(cycle=cycle))

    def open_cycle(state):
        waiting.append(state.cycle)
        answer()

    def take_reference(reference):
        references[reference.cycle] = reference.force
        answer()

    node.create_subscription(LoaderState, "loader_state", open_cycle, DEFAULT)
    # References come in bursts.
    node.create_subscription(ForceReference, "force_reference", take_reference, QoSProfile(depth=LEAD))
    participant.until(lambda: bool(answered) and answered[-1] >= CYCLES)
    assert set(answered) == set(range(answered[-1] + 1))
    assert "valve_command: a publisher offers durability volatile" in graph.log("plant_sim_node")

    unreliable = QoSProfile(depth=DEFAULT, reliability=ReliabilityPolicy.BEST_EFFORT)
    forgotten = node.create_publisher(ValveCommand, "valve_command", unreliable)
    words = (
        "/ehls/valve_command: /ehls/participant offers reliability best_effort, "
        "/ehls/plant_sim_node requests reliability reliable; publish what is requested, or request less"
    )
    participant.until(told(words))
    assert words in graph.log("plant_sim_node")
    node.destroy_publisher(forgotten)
    diagnostics.clear()
    participant.until(lambda: any(status.name == "plant_sim_node" for array in diagnostics for status in array.status))
    diagnostics.clear()
    participant.until(lambda: any(status.name == "plant_sim_node" for array in diagnostics for status in array.status))
    assert not told(words)()
