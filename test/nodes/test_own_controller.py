"""The nodes of docs/how_to/own_node.md close the loop against the simulated rig, as published on the page."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from docs_snippets import blocks

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from ehls_msgs.msg import LoaderState
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.loop import sampled
from ehls_ros.experiments.spec import load_spec

STEADY_CYCLE = 500
"""Cycle from which on the error counts."""

HEARD = 500
"""Minimum number of settled cycles compared: half a period of the disturbance."""

LARGEST_ERROR = 500.0
"""Error bound stated on the page [N]."""

PREFIXES = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]


@pytest.fixture
def folder(tmp_path):
    """Return a folder with the page's files."""
    for block in blocks("docs/how_to/own_node.md"):
        if block.mark == "file":
            (tmp_path / block.note).parent.mkdir(exist_ok=True)
            (tmp_path / block.note).write_text(block.text, encoding="utf-8")
    return tmp_path


def largest_error(graph, participant):
    """Run the simulated rig in lockstep beside the node and return the largest settled force error [N].

    The rig runs on until enough has been received: messages sent before the test's reader is matched may be lost to it.
    """
    path = config_folder() / "experiments" / "sine_fd2.yaml"
    spec = load_spec(path)
    wanted = sampled(spec.reference, spec.settings.control_period)
    states = participant.collect(LoaderState, "loader_state")
    for name in ("reference_node", "disturbance_node", "plant_sim_node"):
        graph.start(name, spec=path, timing="lockstep")

    def settled():
        return {state.cycle: state.force for state in states if state.cycle >= STEADY_CYCLE}

    participant.until(lambda: len(states) > HEARD and len(settled()) >= HEARD)
    return max(abs(force - wanted.row(cycle)[0]) for cycle, force in settled().items())


@pytest.mark.long
def test_the_python_node_holds_the_force(graph, participant, folder):
    graph.run("own_controller", [str(folder / "own_controller.py")])
    assert largest_error(graph, participant) < LARGEST_ERROR


@pytest.mark.skipif(not any((prefix / "share" / "rclcpp").is_dir() for prefix in PREFIXES), reason="needs rclcpp")
@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs cmake")
def test_the_cpp_node_is_built_and_holds_the_force(graph, participant, folder):
    build = folder / "build"
    for step in (["-S", folder, "-B", build, f"-DPython3_EXECUTABLE={sys.executable}"], ["--build", build]):
        done = subprocess.run(["cmake", *step], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    graph.run("own_controller", ["-c", f"import os; os.execl('{build}/own_controller', 'own_controller')"])
    assert largest_error(graph, participant) < LARGEST_ERROR
