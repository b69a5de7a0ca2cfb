"""Two rigs on one machine in one ROS domain, each in a separate namespace, do not affect each other."""

from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray

from ehls_msgs.msg import ForceReference, LoaderState, ValveCommand
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers.base import model_of
from ehls_ros.experiments.loop import run_in_process, simulator_of
from ehls_ros.experiments.spec import load_spec, spec_to_mapping
from ehls_ros.nodes.ahead import LEAD
from ehls_ros.nodes.frames import loader_frame
from ehls_ros.nodes.transport import RECORDER_DEPTH, control_qos
from ehls_ros.recording.topics import DEPTH

NODES = ("reference_node", "disturbance_node", "sic_node", "plant_sim_node")
AMPLITUDES = {"ehls": 1.0e4, "rig2": 4.0e3}
CYCLES = {"ehls": 750, "rig2": 600}
"""Different numbers, so that the rigs' times differ; at most the writers' depth, so that a late listener misses none."""


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
        # All of ROS reads /clock: one of two rigs in lockstep has its time elsewhere.
        remaps = ["-r", f"__ns:=/{rig}", *(["-r", "/clock:=/rig2/clock"] if rig == "rig2" else [])]
        arguments = ["-m", f"ehls_ros.nodes.{name}", "--ros-args", *remaps, *parameters]
        graph.run(f"{rig}_{name}", arguments)


TOPICS = {
    "loader_state": (LoaderState, "force", "force_n"),
    "force_reference": (ForceReference, "force", "force_reference_n"),
    "valve_command": (ValveCommand, "spool", "valve_command_m"),
}
"""Message, field and signal by topic."""


def listen(participant, topic, kind):
    """Return a list that collects all messages of a topic."""
    received = []
    participant.node.create_subscription(kind, topic, received.append, control_qos(RECORDER_DEPTH))
    return received


@pytest.mark.long
def test_two_rigs_in_lockstep_do_not_hear_each_other(graph, participant, specs):
    assert max(CYCLES.values()) + LEAD < DEPTH
    heard = {
        rig: {topic: listen(participant, f"/{rig}/{topic}", kind) for topic, (kind, *_) in TOPICS.items()} for rig in CYCLES
    }
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")
    # Compile here once instead of in every node at the same time.
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
        expected = run_in_process(load_spec(path))
        for topic, (_, field, signal) in TOPICS.items():
            # Rows ahead come again where the cycles stall.
            messages = list({message.cycle: message for message in heard[rig][topic]}.values())[: CYCLES[rig]]
            assert [message.cycle for message in messages] == list(range(CYCLES[rig])), (rig, topic)
            assert np.array_equal([getattr(message, field) for message in messages], expected[signal]), (rig, topic)
        senders = {message.sender.rpartition("-")[0] for message in heard[rig]["valve_command"]}
        assert senders == {f"/{rig}/sic_node"}
        frames = {message.header.frame_id for topic in TOPICS for message in heard[rig][topic]}
        assert frames == {loader_frame(f"/{rig}")}

    participant.until(lambda: all(participant.node.count_publishers(clock) == 1 for clock in ("/clock", "/rig2/clock")))
    tellers = {**dict.fromkeys(NODES, "ehls"), **{f"rig2/{name}": "rig2" for name in NODES}}

    def told():
        return {status.name: status.hardware_id for array in diagnostics for status in array.status}

    # Published once per second, by the plants even after their last cycle.
    participant.until(lambda: len(told()) >= len(tellers))
    assert told() == tellers
