"""The node of docs/how_to/own_node.md closes the loop against the simulated rig, as its reader has it."""

import math

import pytest
from docs_snippets import blocks

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from ehls_msgs.msg import ForceReference, LoaderState
from ehls_ros.experiments.files import config_folder

PAGE = {block.note: block.text for block in blocks("docs/how_to/own_node.md") if block.mark == "file"}
CYCLES = 1000
SETTLED = 500
LARGEST_ERROR = 500.0
"""What the page promises [N]."""


def test_the_python_node_holds_the_force(graph, participant, tmp_path):
    node = tmp_path / "own_controller.py"
    node.write_text(PAGE[node.name], encoding="utf-8")
    states = participant.collect(LoaderState, "loader_state")
    references = participant.collect(ForceReference, "force_reference")
    common = {"spec": config_folder() / "experiments" / "sine_fd2.yaml", "timing": "lockstep"}
    graph.start("reference_node", **common)
    graph.start("disturbance_node", **common)
    graph.start("plant_sim_node", cycles=CYCLES, **common)
    graph.run("own_controller", [str(node)])
    participant.until(lambda: states and states[-1].cycle == CYCLES - 1)
    wanted = {reference.cycle: reference.force for reference in references}
    errors = [state.force - wanted[state.cycle] for state in states if state.cycle >= SETTLED]
    assert len(errors) == CYCLES - SETTLED
    assert all(map(math.isfinite, errors))
    assert max(map(abs, errors)) < LARGEST_ERROR
