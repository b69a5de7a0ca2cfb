"""Two rigs on one machine and in one ROS domain, a namespace each: neither hears the other."""

from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray

from ehls_msgs.msg import ForceReference, LoaderState, ValveCommand
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers.base import model_of
from ehls_ros.experiments.loop import run_in_process, simulator_of
from ehls_ros.experiments.spec import load_spec, spec_to_mapping
from ehls_ros.nodes.ahead import LEAD
from ehls_ros.nodes.transport import DEPTH, RECORDER_DEPTH, control_qos

NODES = ("reference_node", "disturbance_node", "sic_node", "plant_sim_node")
AMPLITUDES = {"ehls": 1.0e4, "rig2": 4.0e3}
CYCLES = {"ehls": 750, "rig2": 600}
"""Other numbers, so that the rigs' times go apart; no more than writers keep, so that a listener who comes late misses none."""


@pytest.fixture
def specs(spec_file, tmp_path) -> dict[str, Path]:
    """Return a spec for each rig; they differ in amplitude."""
    plain = spec_to_mapping(load_spec(spec_file(controller="sic")))
    paths = {}
    for rig, amplitude in AMPLITUDES.items():
        plain["reference"] = {"name": "sine", "amplitude": amplitude, "frequency": 0.5}
        plain["duration"] = (CYCLES[rig] - 1) * plain["control_period"]
        paths[rig] = tmp_path / f"{rig}.yaml"
        paths[rig].write_text(yaml.safe_dump(plain), encoding="utf-8")
    return paths


def start(graph, rig, spec):
    for name in NODES:
        parameters = ["-p", f"spec:={spec}", "-p", "timing:=lockstep"]
        parameters += ["-p", f"cycles:={CYCLES[rig]}"] if name == "plant_sim_node" else []
        arguments = ["-m", f"ehls_ros.nodes.{name}", "--ros-args", "-r", f"__ns:=/{rig}", *parameters]
        graph.run(f"{rig}_{name}", arguments)


TOPICS = {
    "loader_state": (LoaderState, "force", "force_n"),
    "force_reference": (ForceReference, "force", "force_reference_n"),
    "valve_command": (ValveCommand, "spool", "valve_command_m"),
}
"""Message, field, and the signal it is."""


def listen(participant, topic, kind):
    """Return the messages of a topic, all of them."""
    received = []
    participant.node.create_subscription(kind, topic, received.append, control_qos(RECORDER_DEPTH))
    return received


def test_two_rigs_in_lockstep_do_not_hear_each_other(graph, participant, specs):
    assert max(CYCLES.values()) + LEAD < DEPTH
    heard = {
        rig: {topic: listen(participant, f"/{rig}/{topic}", kind) for topic, (kind, *_) in TOPICS.items()} for rig in CYCLES
    }
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    # Compiled here once, not by every node at the same time.
    spec = load_spec(specs["ehls"])
    simulator_of(spec)
    Controller("sic", spec.controller.parameters, model_of(spec.controller_rig, spec.settings.control_period))
    for rig, path in specs.items():
        start(graph, rig, path)
    # References run ahead of the last cycle.
    topics = [heard[rig][topic] for rig in CYCLES for topic in TOPICS]
    last = [CYCLES[rig] - 1 for rig in CYCLES for _ in TOPICS]
    participant.until(lambda: all(t and t[-1].cycle >= end for t, end in zip(topics, last, strict=True)))

    for rig, path in specs.items():
        wanted = run_in_process(load_spec(path))
        for topic, (_, field, signal) in TOPICS.items():
            messages = heard[rig][topic][: CYCLES[rig]]
            assert [message.cycle for message in messages] == list(range(CYCLES[rig])), (rig, topic)
            assert np.array_equal([getattr(message, field) for message in messages], wanted[signal]), (rig, topic)
        senders = {message.header.frame_id.rpartition("-")[0] for message in heard[rig]["valve_command"]}
        assert senders == {f"/{rig}/sic_node"}

    assert participant.node.count_publishers("/clock") == participant.node.count_publishers("/rig2/clock") == 1
    tellers = {**dict.fromkeys(NODES, "ehls"), **{f"rig2/{name}": "rig2" for name in NODES}}

    def told():
        return {status.name: status.hardware_id for array in diagnostics for status in array.status}

    # Once a second, and from the plants after their last cycle as well: the cycles may all be over before that.
    participant.until(lambda: len(told()) >= len(tellers))
    assert told() == tellers
