"""A controller of another distribution has a node without a line in this project: by `ehls run`, and in the launch file."""

import os
import runpy
import sys
from types import SimpleNamespace
from unittest import mock

import pytest
from docs_snippets import ROOT
from third_party import install_page

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from ehls_msgs.msg import ForceReference, LoaderState, ValveCommand
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import chosen_spec
from ehls_ros.families import offered
from ehls_ros.nodes import node_names
from ehls_ros.nodes.frames import robot_description

DEFAULT = 10
"""Depth of ROS's default profile, which is volatile."""

LAUNCH_MODULES = (
    "ament_index_python",
    "ament_index_python.packages",
    "launch",
    "launch.actions",
    "launch.launch_context",
    "launch.substitutions",
    "launch_ros",
    "launch_ros.actions",
    "launch_ros.parameter_descriptions",
)
SPEC = "reference: {name: constant, value: 1.0e+4}\ncontroller: {name: proportional, gain: 2.0e-7}\n"
FORCE, WANTED = 9_000.0, 10_000.0


@pytest.fixture
def site(tmp_path):
    """Return a folder of packages with the controller of docs/how_to/controller.md."""
    install_page(tmp_path / "site", "docs/how_to/controller.md")
    return tmp_path / "site"


@pytest.mark.long
def test_its_node_answers_and_is_tuned(site, graph, participant, tmp_path, monkeypatch):
    spec = tmp_path / "spec.yaml"
    spec.write_text(f"title: a new law\nrig: {ROOT}/config/rig_paper.yaml\n{SPEC}", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), str(ROOT)]))
    monkeypatch.setenv("EHLS_CACHE_DIR", str(tmp_path / "kernels"))
    parameters = ["--ros-args", "-p", f"spec:={spec}", "-p", "timing:=lockstep"]
    graph.run("proportional_node", ["-m", "ehls_ros.cli.main", "run", "proportional_node", *parameters])
    commands = participant.collect(ValveCommand, "valve_command")
    states = participant.node.create_publisher(LoaderState, "loader_state", DEFAULT)
    references = participant.node.create_publisher(ForceReference, "force_reference", DEFAULT)
    participant.until(lambda: states.get_subscription_count() and references.get_subscription_count())

    def answer(cycle):
        """Open a cycle as the plant and return the command."""
        references.publish(ForceReference(cycle=cycle, force=WANTED))
        states.publish(LoaderState(cycle=cycle, force=FORCE))
        participant.until(lambda: commands and commands[-1].cycle == cycle)
        return commands[-1].spool

    assert answer(0) == pytest.approx(-2e-7 * (FORCE - WANTED), rel=1e-12)
    assert participant.set_parameter("proportional_node", "gain", 0.0).successful
    # The change is blended in.
    for cycle in range(1, 401):
        last = answer(cycle)
    assert abs(last) < 1e-9
    refused = participant.set_parameter("proportional_node", "gain", 1.0)
    assert not refused.successful
    assert "0 to 0.001" in refused.reason
    assert graph.stop("proportional_node") == 0, graph.log("proportional_node")


@pytest.fixture
def installed(site, monkeypatch):
    """Make the package importable in this process."""
    monkeypatch.syspath_prepend(site)
    offered.cache_clear()
    yield
    offered.cache_clear()
    CONTROLLERS._loaded.pop("proportional", None)


@pytest.fixture
def launch_file():
    """Return the definitions of the launch file; without `launch` installed, it gets stand-ins that record their arguments."""
    stand_ins = {name: mock.MagicMock() for name in LAUNCH_MODULES}
    stand_ins["launch.substitutions"].LaunchConfiguration = lambda name: SimpleNamespace(perform=lambda chosen: chosen[name])
    stand_ins["launch_ros.actions"].Node = SimpleNamespace
    with mock.patch.dict(sys.modules, stand_ins):
        yield lambda: runpy.run_path(str(ROOT / "launch" / "ehls.launch.py"))


@pytest.mark.usefixtures("installed")
def test_it_is_a_word_of_the_launch_file(launch_file):
    found = launch_file()
    assert "proportional_node" in node_names()
    assert "proportional" in found["ARGUMENTS"]["controller"][2]
    defaults = {name: default for name, (default, _, _) in found["ARGUMENTS"].items()}
    nodes = found["nodes"]({**defaults, "controller": "proportional"})
    assert [(node.executable, node.arguments) for node in nodes if node.arguments] == [("ehls", ["run", "proportional_node"])]
    assert {node.executable for node in nodes if not node.arguments} < set(node_names())


def test_the_specs_controller_is_the_default_and_one_that_cannot_follow_is_refused(launch_file):
    found = launch_file()
    defaults = {name: default for name, (default, _, _) in found["ARGUMENTS"].items()}
    measured = {**defaults, "plant": "bridge", "spec": str(ROOT / "config" / "experiments" / "measured_sine_fd1.yaml")}
    assert ["run", "fasmc_output_feedback_node"] in [node.arguments for node in found["nodes"](measured)]
    assert ["run", "fasmc_predictive_node"] in [
        node.arguments for node in found["nodes"]({**measured, "controller": "fasmc_predictive"})
    ]
    with pytest.raises(BadInput, match=r"the spec's reference is a force .* as pid does"):
        found["nodes"]({**measured, "controller": "pid"})


def test_the_plant_comes_last_and_arguments_that_are_not_given_leave_the_files_values(launch_file):
    found = launch_file()
    defaults = {name: default for name, (default, _, _) in found["ARGUMENTS"].items()}
    *others, plant = found["nodes"]({**defaults, "params_file": "mine.yaml", "without": "disturbance_node"})
    assert plant.parameters == ["mine.yaml", {"partners": "reference_node,friction_estimator_node,fasmc_node"}]
    assert [node.parameters for node in others] == [["mine.yaml", {}]] * 3
    [first, *_] = found["nodes"]({**defaults, "timing": "lockstep", "priority": "3", "autostart": "false"})
    assert first.parameters == [{"timing": "lockstep", "priority": 3, "autostart": False, "use_sim_time": True}]


def test_what_is_left_out_is_not_started(launch_file):
    found = launch_file()
    defaults = {name: default for name, (default, _, _) in found["ARGUMENTS"].items()}
    nodes = found["nodes"]({**defaults, "without": "fasmc_node,reference_node"})
    assert {node.executable for node in nodes} == {"friction_estimator_node", "plant_sim_node", "disturbance_node"}


def test_the_rig_is_described_where_robot_state_publisher_is_installed(launch_file):
    found = launch_file()
    defaults = {name: default for name, (default, _, _) in found["ARGUMENTS"].items()}
    [publisher] = found["frames"]({**defaults, "namespace": "rig2", "timing": "lockstep"})
    assert (publisher.package, publisher.namespace) == ("robot_state_publisher", "rig2")
    [parameters] = publisher.parameters
    assert (parameters["frame_prefix"], parameters["use_sim_time"]) == ("rig2/", True)
    described = sys.modules["launch_ros.parameter_descriptions"].ParameterValue.call_args
    assert described == mock.call(robot_description(chosen_spec("", "").rig), value_type=str)
    assert found["frames"]({**defaults, "frames": "false"}) == []


def test_a_launch_without_robot_state_publisher_says_so(launch_file):
    index = sys.modules["ament_index_python.packages"]
    index.PackageNotFoundError, index.get_package_prefix.side_effect = LookupError, LookupError
    found = launch_file()
    defaults = {name: default for name, (default, _, _) in found["ARGUMENTS"].items()}
    [word] = found["frames"](defaults)
    assert word is found["LogInfo"].return_value
    assert "no robot_state_publisher is installed" in found["LogInfo"].call_args.kwargs["msg"]
