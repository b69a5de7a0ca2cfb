"""Nodes declare their parameters with unit, range and help, and refuse a wrong configuration."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from patience import PATIENCE

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import get_parameter_value, parameter_value_to_python
from tiers import tiered

from ehls_ros.cli.main import main
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.nodes import parameter_requests
from ehls_ros.schema import declarations

RIG = Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"


def test_descriptors_carry_unit_range_and_help(graph, participant, spec_file):
    graph.start("fasmc_node", spec=spec_file())
    names = participant.call(ListParameters, "fasmc_node/list_parameters", ListParameters.Request()).result.names
    for declared in declarations(CONTROLLERS.load("fasmc").Parameters):
        assert declared.name in names
        [descriptor] = participant.call(
            DescribeParameters, "fasmc_node/describe_parameters", DescribeParameters.Request(names=[declared.name])
        ).descriptors
        assert declared.description in descriptor.description
        assert f"[{declared.unit}]" in descriptor.description
        assert descriptor.floating_point_range[0].to_value == declared.maximum
        assert not descriptor.read_only


@pytest.mark.long
def test_the_command_does_as_ros2_param_does(graph, participant, spec_file, capsys, monkeypatch):
    graph.start("fasmc_node", spec=spec_file())
    participant.call(ListParameters, "fasmc_node/list_parameters", ListParameters.Request())

    def asked(*words):
        code = main(["param", *words])
        return code, "".join(capsys.readouterr())

    # The complaint lists the nodes discovered so far; on a busy machine, discovery may outlast the command's search.
    complaints = []
    monkeypatch.setattr(parameter_requests, "FOUND", 0.5)

    def names_those_that_run():
        code, complaint = asked("get", "sic_node", "k")
        complaints.append(complaint)
        assert code == 2
        return "/ehls/fasmc_node" in complaint

    participant.until(names_those_that_run)
    assert "no node is named 'sic_node'" in complaints[-1]
    monkeypatch.setattr(parameter_requests, "FOUND", PATIENCE)
    monkeypatch.setattr(parameter_requests, "ANSWERED", PATIENCE)
    code, listed = asked("list", "fasmc_node")
    assert code == 0
    assert {"  k", "  use_sim_time"} <= set(listed.splitlines())
    assert asked("get", "/ehls/fasmc_node", "k") == (0, "Double value is: 12.0\n")
    assert asked("set", "fasmc_node", "k", "14") == (0, "Set parameter successful\n")
    assert asked("get", "fasmc_node", "k", "--json") == (0, '{"k": 14.0}\n')
    assert yaml.safe_load(asked("dump", "fasmc_node")[1])["/ehls/fasmc_node"]["ros__parameters"]["k"] == 14.0
    described = asked("describe", "fasmc_node", "k")[1].splitlines()
    assert described[:2] == ["Parameter name: k", "  Type: double"]
    assert described[3:] == ["  Constraints:", "    Min value: 0.1", "    Max value: 1000.0"]
    for code, words, complaints in (
        (1, ("set", "fasmc_node", "k", "1e9"), ("Setting parameter failed: ", "1000")),
        (2, ("get", "fasmc_node", "kk"), ("/ehls/fasmc_node", "no parameter 'kk'")),
        (2, ("set", "fasmc_node", "k"), ("ehls param set NODE NAME VALUE",)),
    ):
        refused, complaint = asked(*words)
        assert refused == code
        assert all(part in complaint for part in complaints), complaint


@pytest.mark.parametrize(
    ("node", "parameter", "words"),
    tiered(
        [
            ("fasmc_node", "spec:=/nowhere.yaml", ("/nowhere.yaml", "cannot be read")),
            ("plant_sim_node", "timing:=sometimes", ("timing is 'sometimes'", "lockstep")),
            ("recorder_node", "storage:=tape", ("storage is 'tape'", "mcap")),
            ("friction_estimator_node", "model:=magic", ("'magic'", "gms")),
            ("hardware_bridge_node", "bridge:=/nowhere.yaml", ("/nowhere.yaml", "cannot be read")),
            ("plant_sim_node", "on_command_stale:=warn", ("on_command_stale", "cut")),
            ("fasmc_node", "k:=2000", ("fasmc_node", "k is 2000.0", "[MPa/s]", "0.1 to 1000")),
            ("fasmc_node", "k:=fast", ("fasmc_node", "k is 'fast'", "a valid number", "[MPa/s]", "0.1 to 1000")),
            ("fasmc_node", "use_sim_time:=1", ("'use_sim_time'", "'BOOL'")),
            ("pid_node", "timing:=lockstep", ("reference is a force for fasmc", "follows a position")),
        ],
        ("fasmc_node", "spec:=/nowhere.yaml", ("/nowhere.yaml", "cannot be read")),
        ("fasmc_node", "k:=2000", ("fasmc_node", "k is 2000.0", "[MPa/s]", "0.1 to 1000")),
        unpack=True,
    ),
)
def test_a_wrong_parameter_ends_the_node_with_one_line_and_code_2(node, parameter, words):
    command = [sys.executable, "-m", f"ehls_ros.nodes.{node}", "--ros-args", "-p", parameter]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 2
    [line] = done.stderr.strip().splitlines()
    assert all(word in line for word in words), line


def test_a_parameter_file_that_cannot_be_read_ends_the_node_with_code_2():
    command = [sys.executable, "-m", "ehls_ros.nodes.sic_node", "--ros-args", "--params-file", "/nowhere.yaml"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 2
    assert "'--params-file /nowhere.yaml'" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_file_is_read_like_a_live_change_and_what_was_dumped_can_be_loaded(graph, participant, spec_file, tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("/**: {ros__parameters: {k: 9, phi2: 1e-06, cycles: 3.0}}", encoding="utf-8")
    module = "ehls_ros.nodes.fasmc_node"
    graph.run("fasmc_node", ["-m", module, "--ros-args", "--params-file", str(file), "-p", f"spec:={spec_file()}"])
    names = participant.call(ListParameters, "fasmc_node/list_parameters", ListParameters.Request()).result.names
    values = participant.call(GetParameters, "fasmc_node/get_parameters", GetParameters.Request(names=names)).values
    dumped = {name: parameter_value_to_python(value) for name, value in zip(names, values, strict=True)}
    assert (dumped["k"], dumped["phi2"]) == (9.0, 1e-6)
    # As `ros2 param load` reads the output of `ros2 param dump`.
    loaded = [Parameter(name=name, value=get_parameter_value(str(value))) for name, value in dumped.items() if value != ""]
    results = participant.call(SetParameters, "fasmc_node/set_parameters", SetParameters.Request(parameters=loaded)).results
    assert [result.reason for result in results if not result.successful] == []

    started = subprocess.run(
        [sys.executable, "-m", module, "--ros-args", "-p", "k:=-3"], capture_output=True, text=True, check=False
    )
    refused = participant.set_parameter("fasmc_node", "k", -3)
    assert (refused.successful, refused.reason) == (False, started.stderr.strip())
    refused = participant.set_parameter("fasmc_node", "spec", "/another.yaml")
    assert (refused.successful, "read-only" in refused.reason) == (False, True)


@pytest.mark.parametrize(
    ("node", "options", "named"),
    [
        ("friction_estimator_node", ["-p", "model:=gms"], "friction observer 'gms'"),
        ("fasmc_output_feedback_node", [], "controller 'fasmc_output_feedback'"),
    ],
)
def test_a_node_that_does_not_serve_the_rigs_friction_model_ends_with_code_2(node, options, named, spec_file, tmp_path):
    rig = yaml.safe_load(RIG.read_text(encoding="utf-8"))
    rig["friction"]["model"] = "lugre"
    other = tmp_path / "rig.yaml"
    other.write_text(yaml.safe_dump(rig), encoding="utf-8")
    parameters = ["-p", f"spec:={spec_file()}", "-p", f"rig:={other}", *options]
    command = [sys.executable, "-m", f"ehls_ros.nodes.{node}", "--ros-args", *parameters]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 2
    [line] = done.stderr.strip().splitlines()
    assert f"{named} does not support friction model 'lugre'" in line
