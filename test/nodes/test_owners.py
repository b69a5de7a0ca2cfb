"""Two sources of one input: the first drives, the second is refused, named with its remedy, and deactivates itself."""

import pytest
import yaml

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray

from ehls_msgs.msg import Disturbance, LoaderState
from ehls_ros.nodes.diagnostics import ERROR
from ehls_ros.nodes.transport import DEPTH, control_qos

FORCE = 1500.0
"""Reference of the first source; the second's is the opposite [N]."""

FOLLOWED = 100.0
"""Maximum force error of the law at a constant reference [N]."""

PROGRAMME = f"""
title: other
blocks:
  - {{block: cycles, amplitude: 800.0, mean: {-FORCE}, frequency: 1.0, count: 1000}}
"""


class TwoSources:
    """A graph in lockstep, and further sources of its inputs under different names."""

    def __init__(self, graph, participant, spec_file, folder):
        self.graph, self.participant, self.folder = graph, participant, folder
        content = yaml.safe_load(spec_file(duration=1e4).read_text(encoding="utf-8"))
        self.specs = {
            name: self._spec(name, {**content, "reference": {"name": "constant", "value": force}})
            for name, force in (("first", FORCE), ("second", -FORCE))
        }
        self.states = participant.collect(LoaderState, "loader_state")
        self.diagnostics = participant.collect(DiagnosticArray, "/diagnostics")

    def _spec(self, name, content):
        path = self.folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path

    def begin(self):
        partners = ("reference_node", "disturbance_node", "friction_estimator_node", "fasmc_node")
        for name in partners:
            self.graph.start(name, spec=self.specs["first"], timing="lockstep")
        self.graph.start("plant_sim_node", spec=self.specs["first"], timing="lockstep", speed=2.0, partners=",".join(partners))
        self.participant.until(lambda: self.follows(FORCE))

    def second(self, name, called="", **parameters):
        """Start a second node of a kind."""
        given = {"spec": self.specs["second"], "timing": "lockstep", **parameters}
        words = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
        arguments = ["-m", f"ehls_ros.nodes.{name}", "--ros-args", *words, "-r", f"__node:={called or name}"]
        return self.graph.run(called or f"{name} again", arguments)

    def follows(self, force):
        """Return whether the force has been at a value for the last 300 cycles."""
        latest = [state.force for state in self.states[-300:]]
        return len(latest) == 300 and max(abs(value - force) for value in latest) < FOLLOWED

    def said(self, node):
        """Return level and message of a node's last diagnostics."""
        found = [status for array in self.diagnostics for status in array.status if status.name == node]
        return (found[-1].level, found[-1].message) if found else (b"", "")

    def was_named(self, sender):
        """Return whether a reader of the reference has logged that it refuses a sender."""
        return any(f"force_reference of {sender}" in self.graph.log(name) for name in ("fasmc_node", "plant_sim_node"))

    def is_refused(self, node, owner):
        level, message = self.said(node)
        return level == ERROR and "is refused" in message and owner in message and "deactivate or stop" in message


@pytest.fixture
def sources(graph, participant, spec_file, tmp_path):
    """The graph, following the first reference."""
    two = TwoSources(graph, participant, spec_file, tmp_path)
    two.begin()
    return two


def test_a_second_reference_is_refused_and_taken_only_after_the_first_has_left(sources):
    two, participant = sources, sources.participant
    two.second("reference_node", "reference_node_2")
    participant.until(lambda: two.is_refused("reference_node_2", "/ehls/reference_node-"))
    participant.until(lambda: participant.state_of("reference_node_2") == "inactive")
    # A reader named it, and all continued with the first.
    assert two.was_named("/ehls/reference_node_2-")
    two.states.clear()
    participant.until(lambda: two.follows(FORCE))
    assert max(abs(state.force - FORCE) for state in two.states) < FOLLOWED
    assert participant.change("reference_node", "deactivate")
    assert participant.change("reference_node_2", "activate")
    participant.until(lambda: two.follows(-FORCE))


@pytest.mark.long
def test_what_was_refused_does_not_count_once_its_sender_has_left(sources):
    two, participant = sources, sources.participant
    two.second("reference_node", "reference_node_2")
    participant.until(lambda: two.is_refused("reference_node_2", "/ehls/reference_node-"))
    participant.until(lambda: participant.state_of("reference_node_2") == "inactive")
    # The second one owns nothing, although its messages were kept.
    for transition in ("deactivate", "activate"):
        assert participant.change("reference_node", transition)
    two.states.clear()
    participant.until(lambda: two.follows(FORCE))
    assert participant.state_of("reference_node") == "active"
    assert max(abs(state.force - FORCE) for state in two.states) < FOLLOWED
    assert "is refused" not in two.graph.log("reference_node")


@pytest.mark.long
def test_a_programme_beside_a_reference_does_not_begin(sources):
    two, participant = sources, sources.participant
    file = two.folder / "programme.yaml"
    file.write_text(PROGRAMME, encoding="utf-8")
    two.graph.start(
        "programme_node", spec=two.specs["first"], timing="lockstep", programme=file, folder=two.folder / "programme"
    )
    owner = f"/ehls/reference_node-{two.graph.processes['reference_node'].pid}"
    participant.until(lambda: f"waits to begin: {owner} owns /ehls/force_reference" in two.said("programme_node")[1])
    two.states.clear()
    participant.until(lambda: two.follows(FORCE))
    assert max(abs(state.force - FORCE) for state in two.states) < FOLLOWED


@pytest.mark.long
@pytest.mark.parametrize("name", ["disturbance_node", "friction_estimator_node", "plant_sim_node"])
def test_a_second_source_of_another_input_is_refused(sources, name):
    two, participant = sources, sources.participant
    two.second(name, f"{name}_2")
    participant.until(lambda: two.is_refused(f"{name}_2", f"/ehls/{name}-"))
    two.states.clear()
    participant.until(lambda: two.follows(FORCE))


@pytest.mark.long
def test_a_disturbance_returns_in_the_cycle_that_waits_for_it_although_a_second_plant_has_sent_since(sources):
    two, participant = sources, sources.participant
    assert participant.change("disturbance_node", "deactivate")
    participant.until(lambda: two.said("plant_sim_node")[1].startswith("waiting for"))
    two.second("plant_sim_node", "plant_sim_node_2")
    participant.until(lambda: any("plant_sim_node_2" in state.sender for state in two.states))
    assert participant.change("disturbance_node", "activate")
    two.states.clear()
    participant.until(lambda: two.follows(FORCE))


@pytest.mark.long
def test_a_flood_of_refused_rows_does_not_stall_the_cycles_for_good(sources):
    two, participant = sources, sources.participant
    flood = participant.node.create_publisher(Disturbance, "disturbance", control_qos())
    participant.until(lambda: flood.get_subscription_count() >= 1)
    for _ in range(10 * DEPTH):
        flood.publish(Disturbance(force=1e4, sender="/ehls/flood-1"))
    two.states.clear()
    participant.until(lambda: two.follows(FORCE))


@pytest.mark.long
def test_two_nodes_of_one_name_are_told_apart(sources):
    two, participant = sources, sources.participant
    owner = two.graph.processes["reference_node"].pid
    other = two.second("reference_node")
    participant.until(lambda: "is refused" in two.graph.log("reference_node again"))
    assert f"/ehls/reference_node-{owner} owns it" in two.graph.log("reference_node again")
    assert two.was_named(f"/ehls/reference_node-{other.pid}")
    two.states.clear()
    participant.until(lambda: two.follows(FORCE))


@pytest.mark.long
def test_a_reference_that_was_killed_is_replaced_by_one_of_another_name(sources):
    two, participant = sources, sources.participant
    two.graph.kill("reference_node")
    two.second("reference_node", "reference_node_2")
    participant.until(lambda: two.follows(-FORCE))
    # It was not refused on behalf of the killed one.
    assert participant.state_of("reference_node_2") == "active"
    assert "is refused" not in two.graph.log("reference_node_2")
