"""A controller receives a rig that an operator has accepted, if it was started with that option."""

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from std_msgs.msg import String

from ehls_msgs.msg import LoaderState
from ehls_ros.experiments.spec import load_spec
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.nodes.transport import control_qos
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.recording.topics import ACCEPTED_RIG

USED, WRONG = "the accepted rig is in use from control cycle", "the accepted rig is not used"


def test_a_controller_that_accepts_knows_the_rig_from_the_next_cycle_on_and_refuses_a_wrong_one(graph, participant, spec_file):
    path = spec_file(duration=1000.0, controller="sic")
    states = participant.collect(LoaderState, "loader_state")
    common = {"spec": path, "timing": "lockstep"}
    graph.start("sic_node", **common, accept_rig=True)
    for name in ("reference_node", "disturbance_node"):
        graph.start(name, **common)
    graph.start("plant_sim_node", **common, speed=0.5, partners="sic_node,reference_node,disturbance_node")
    participant.until(lambda: bool(states))
    telling = participant.node.create_publisher(String, ACCEPTED_RIG.name, control_qos(ACCEPTED_RIG.depth))
    telling.publish(String(data="plant: 3"))
    participant.until(lambda: WRONG in graph.log("sic_node"))
    rig = load_spec(path).rig
    larger = rig._replace(plant=rig.plant._replace(piston_area=10.0 * rig.plant.piston_area))
    telling.publish(String(data=rig_text(rig_to_mapping(larger))))
    participant.until(lambda: "piston_area is 0.026, the rig file's is 0.0026: it may move by 30%" in graph.log("sic_node"))
    assert USED not in graph.log("sic_node")
    telling.publish(String(data=rig_text(rig_to_mapping(rig))))
    participant.until(lambda: USED in graph.log("sic_node"))
    cycle = states[-1].cycle
    participant.until(lambda: states[-1].cycle > cycle + 100)
    # Two monitors are both ignored.
    second = participant.node.create_publisher(String, ACCEPTED_RIG.name, control_qos(ACCEPTED_RIG.depth))
    second.publish(String(data=rig_text(rig_to_mapping(load_spec(path).rig))))
    participant.until(lambda: "/ehls/participant, /ehls/participant publish accepted_rig" in graph.log("sic_node"))
    assert graph.log("sic_node").count(USED) == 1
