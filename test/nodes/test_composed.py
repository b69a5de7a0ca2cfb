"""The nodes of a cycle in one process: the same trajectory, the same topics and services, one process."""

import json
import signal
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ehls_command import ehls, trajectory_of
from tiers import tiered

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger

from ehls_msgs.msg import Driver, LoaderState, ValveCommand
from ehls_msgs.srv import SwitchController
from ehls_ros.cli.main import main
from ehls_ros.nodes import links
from ehls_ros.nodes.graph_nodes import HOSTS
from ehls_ros.nodes.plant_sim_node import PlantSimNode
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.topics import STANDBY_COMMAND

TOGETHER = "plant_sim_node+reference_node+disturbance_node+friction_estimator_node+fasmc_node"
SERVO = "disturbance: {name: position_servo, signal: {name: sine, amplitude: 0.05, frequency: 0.5}}"


def assert_same_digits(one, other):
    """Compare all signals but the time of the answer, which is not simulated."""
    assert set(one.signals) - {"response_s"} == set(other.signals) - {"response_s"}
    for name in set(one.signals) - {"response_s"}:
        assert np.array_equal(one[name], other[name], equal_nan=True), name


def with_servo(spec: Path) -> Path:
    """Let the disturbance react to the loader: its row of the next cycle needs the snapshot of this one."""
    lines = spec.read_text().splitlines()
    spec.write_text("\n".join(SERVO if line.startswith("disturbance") else line for line in lines))
    return spec


@pytest.mark.long
def test_composed_apart_and_without_ros_are_the_same_to_the_digit(spec_file, tmp_path):
    spec = with_servo(spec_file())
    composed = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "composed", "--json", "--compose"))
    apart = trajectory_of(ehls("experiment", spec, "--out", tmp_path / "apart", "--json"))
    assert len(composed) == 501
    assert np.abs(composed["disturbance_displacement_m"]).max() > 0.01
    assert_same_digits(composed, apart)
    assert main(["experiment", str(spec), "--out", str(tmp_path / "alone"), "--in-process"]) == 0
    alone = read_bag(tmp_path / "alone" / "bag")
    for name in ("force_n", "position_m", "valve_command_m"):
        assert np.max(np.abs(composed[name] - alone[name])) <= 1e-9 * np.max(np.abs(alone[name])), name


def assert_contiguous(messages):
    """Check that each cycle since the first one received occurs once."""
    cycles = [message.cycle for message in messages]
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))


def start_together(graph, spec, names=TOGETHER, **parameters):
    """Start nodes as one process."""
    given = {"spec": spec, **parameters}
    arguments = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
    return graph.run("composed", ["-m", "ehls_ros.cli.main", "run", names, "--ros-args", *arguments])


def test_each_node_keeps_its_name_topics_parameters_and_diagnostics(graph, participant, spec_file):
    states = participant.collect(LoaderState, "loader_state")
    commands = participant.collect(ValveCommand, "valve_command")
    told = participant.collect(DiagnosticArray, "/diagnostics")
    process = start_together(graph, spec_file(duration=60.0), timing="lockstep", speed=1.0)
    nodes = TOGETHER.split("+")
    participant.until(lambda: set(nodes) <= {status.name for array in told for status in array.status})
    participant.until(lambda: len(commands) > 300 and len(states) > 300)
    assert_contiguous(commands)
    assert commands[0].sender == f"/ehls/fasmc_node-{process.pid}"
    # The tuning of the law changes at a cycle, as in a separate process.
    assert participant.set_parameter("fasmc_node", "k", 14.0).successful
    assert not participant.set_parameter("fasmc_node", "k", -1.0).successful
    told.clear()

    def figures(node: str) -> dict[str, str]:
        values = [status.values for array in told for status in array.status if status.name == node]
        return {value.key: value.value for value in values[-1]} if values else {}

    participant.until(lambda: int(figures("fasmc_node").get("tuned_at_cycle", -1)) > 0)
    participant.until(lambda: "response_p50_us" in figures("plant_sim_node"))
    assert figures("plant_sim_node")["missed"] == "0"
    assert graph.stop("composed", signal.SIGINT) == 0


def test_a_controller_apart_takes_over_and_gives_back(graph, participant, spec_file):
    spec = spec_file(duration=60.0)
    commands = participant.collect(ValveCommand, "valve_command")
    drivers = participant.collect(Driver, "driver")
    shadows = participant.collect(ValveCommand, STANDBY_COMMAND.name)
    process = start_together(graph, spec, timing="lockstep", speed=1.0)
    # If two answered the first cycle, both would be accepted until the plant names its driver.
    participant.until(lambda: len(commands) > 100 and drivers)
    graph.start("sic_node", spec=spec, timing="lockstep")
    participant.until(lambda: any("sic_node" in shadow.sender for shadow in shadows))
    for name, node in (("sic_node", "/ehls/sic_node-"), ("fasmc_node", f"/ehls/fasmc_node-{process.pid}")):
        # The plant notices a standby controller within a second.
        request = SwitchController.Request(controller=name)
        participant.until(lambda request=request: participant.call(SwitchController, "switch_controller", request).success)
        participant.until(lambda node=node: drivers[-1].sender.startswith(node))
        first = drivers[-1].cycle
        participant.until(lambda first=first: commands[-1].cycle > first + 100)
    # No cycle is left out, and each has one answer of the controller that drives. A controller that has not received the driver
    # message may answer beside it, and answers of two controllers may arrive in any order.
    every = range(commands[0].cycle, commands[-1].cycle + 1)
    participant.until(lambda: set(every) <= {command.cycle for command in commands})

    def driver_of(cycle):
        return [driver.sender for driver in drivers if driver.cycle <= cycle][-1]

    obeyed = [command.cycle for command in commands if command.cycle in every and command.sender == driver_of(command.cycle)]
    assert sorted(obeyed) == list(every)
    begin = next(driver.cycle for driver in drivers if "sic_node" in driver.sender)
    taken_over = [command.cycle for command in commands if "sic_node" in command.sender and command.cycle >= begin]
    assert taken_over == list(range(begin, taken_over[-1] + 1))
    assert graph.stop("sic_node") == 0
    assert graph.stop("composed") == 0


@pytest.mark.parametrize(
    ("names", "word"),
    [
        ("plant_sim_node+fasmc_nod", "did you mean 'fasmc_node'"),
        ("plant_sim_node+recorder_node", "recorder_node cannot share"),
        ("fasmc_node+reference_node", "0 plant nodes"),
        ("plant_sim_node+fasmc_node+sic_node", "2 controllers"),
    ],
)
def test_what_cannot_be_one_process_is_refused(capsys, names, word):
    assert main(["run", names]) == 2
    assert word in capsys.readouterr().err


@pytest.mark.long
def test_an_estimator_apart_is_waited_for(spec_file, graph, participant, tmp_path):
    spec = spec_file()
    reference = tmp_path / "reference"
    assert main(["experiment", str(spec), "--out", str(reference), "--in-process"]) == 0
    commands = participant.collect(ValveCommand, "valve_command")
    names = TOGETHER.replace("friction_estimator_node+", "")
    start_together(graph, spec, names, timing="lockstep", partners="friction_estimator_node")
    # The first cycle must find the test's reader.
    participant.until(commands.publishers)
    graph.start("friction_estimator_node", spec=spec, timing="lockstep")
    participant.until(lambda: len(commands) >= 501)
    wanted = read_bag(Path(json.loads((reference / "metrics.json").read_text())["bag"]))["valve_command_m"]
    sent = np.array([command.spool for command in commands[:501]])
    assert np.max(np.abs(sent - wanted)) <= 1e-9 * np.max(np.abs(wanted))


def test_a_cycle_that_begins_after_its_end_still_asks_those_in_its_process():
    asked = []
    late = SimpleNamespace(
        answered=3,
        cycle=4,
        answer=SimpleNamespace(wait=asked.append),
        _remaining=lambda: 0.0,
        _is_complete=lambda: False,
        _take=lambda: asked.append("taken"),
    )
    PlantSimNode._await_inputs(late)
    assert asked == [0.0, "taken"]


@pytest.mark.parametrize(
    ("period", "pause"),
    [(1e-2, links.LEAST_PAUSE), (1e-3, links.LEAST_PAUSE), (2.5e-4, 1e-4)],
    ids=["100 Hz", "1 kHz", "4 kHz"],
)
def test_the_service_thread_waits_for_a_pause_that_is_long_enough(period, pause, monkeypatch):
    monkeypatch.setattr(links, "PAUSE_WAIT", 3600.0)
    connected = links.Links(lambda waiter, seconds: None, period=period)
    serving = threading.Thread(target=connected.await_pause, daemon=True)
    serving.start()
    for _ in range(20):
        connected.begin_pause(0.5 * pause)
        serving.join(1e-3)
    assert serving.is_alive()
    while serving.is_alive():
        connected.begin_pause(2.0 * pause)
        serving.join(1e-3)


def test_in_lockstep_the_service_thread_waits_for_no_pause(monkeypatch):
    monkeypatch.setattr(links, "PAUSE_WAIT", 3600.0)
    links.Links(lambda waiter, seconds: None, patient=True).await_pause()


PARTNERS = ("reference_node", "disturbance_node", "friction_estimator_node", "fasmc_node")
TRANSITIONS = ("deactivate", "activate", "deactivate", "cleanup", "configure", "activate")


@pytest.mark.parametrize("gone", tiered(PARTNERS, "fasmc_node"))
def test_a_node_that_is_shut_down_takes_no_other_node_of_its_process_with_it(graph, participant, spec_file, gone):
    states = participant.collect(LoaderState, "loader_state")
    process = start_together(graph, spec_file(duration=1e4), timing="lockstep", speed=2.0)
    participant.until(lambda: len(states) > 100)
    assert participant.change(gone, "shutdown")
    for name in (*PARTNERS, "plant_sim_node"):
        assert participant.state_of(name) == ("finalized" if name == gone else "active")
    answer = participant.call(Trigger, "emergency_stop", Trigger.Request())
    assert answer.success
    assert process.poll() is None
    assert graph.stop("composed") == 0
    assert "failed" not in graph.log("composed")


PAIRS = [
    (plant, partner) for plant in HOSTS for partner in PARTNERS if (plant, partner) != ("hardware_bridge_node", "fasmc_node")
]
"""Every pair of nodes that can share a process; the law of fasmc needs a velocity, which the rig does not measure."""


@pytest.mark.long
@pytest.mark.parametrize(("plant", "partner"), PAIRS)
def test_every_transition_of_each_of_two_nodes_leaves_the_other_alone(graph, participant, spec_file, plant, partner):
    together = f"{plant}+{partner}"
    process = start_together(graph, spec_file(duration=1e4), together, timing="lockstep")
    for node, other in ((partner, plant), (plant, partner)):
        participant.until(lambda: {participant.state_of(name) for name in (partner, plant)} == {"active"})
        for transition in TRANSITIONS:
            assert participant.change(node, transition), (node, transition)
            assert participant.state_of(other) == "active"
            assert not participant.change(other, "configure")
    for node in (partner, plant):
        assert participant.change(node, "shutdown")
        assert participant.state_of(node) == "finalized"
    assert process.poll() is None
    assert graph.stop("composed") == 0
    assert "failed" not in graph.log("composed")
