"""An attacked rig comes to rest: running processes over DDS and UDP, compared with the log of the valve's true motion.

``pytest -s test/nodes/test_attacks.py | grep '^|'`` prints the table: time to null. All policies are checked in each test.
"""

import signal
import socket
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from commanded_rig import BRIDGE, LATE, SLOW, CommandedRig
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from patience import PATIENCE
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.msg import LoaderState
from ehls_msgs.srv import AcknowledgeStop
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from ehls_ros.hardware.packet import Codec, Kind, Packet
from ehls_ros.hardware.safety_gate import MAX_SILENCE, STOP_TIME
from ehls_ros.nodes.transport import control_qos


@pytest.fixture
def rig(one_realtime_graph, graph, participant, tmp_path):
    started = []

    def start(**options):
        started.append(CommandedRig(graph, participant, tmp_path, **options))
        started[-1].open()
        return started[-1]

    yield start
    for each in started:
        each.close()


def tell(attack, null):
    print(f"| {attack} | {1e3 * null:.0f} ms |")


def judge(attack, truth, since, policy, until=np.inf):
    """Check that a policy evaluated the valve after an attack; it is known to hold, like all others."""
    assert np.any(truth.between(0.0, since)), "the valve was never open"
    assert truth.said_of(policy, since, until), f"{attack}: {policy} says nothing of that time"
    tell(attack, truth.time_to_null(since, until))


# Inputs from a client


INVALID = {
    "configure while active": lambda rig: changes(rig, Transition(label="configure")),
    "transition 77": lambda rig: changes(rig, Transition(id=77)),
    "activate while active": lambda rig: changes(rig, Transition(label="activate")),
    "parameter of type 255": lambda rig: set_raw(rig, "force_error", ParameterValue(type=255)),
    "parameter without name": lambda rig: set_raw(rig, "", ParameterValue(type=3, double_value=1.0)),
    "parameter removed": lambda rig: set_raw(rig, "force_error", ParameterValue(type=0)),
    "parameter atomically of type 255": lambda rig: (
        rig.ask(
            SetParametersAtomically,
            f"{BRIDGE}/set_parameters_atomically",
            parameters=[Parameter(name="force_error", value=ParameterValue(type=255))],
        ).result.successful
    ),
}


def changes(rig, transition):
    return rig.ask(ChangeState, f"{BRIDGE}/change_state", transition=transition).success


def set_raw(rig, name, value):
    [result] = rig.ask(SetParameters, f"{BRIDGE}/set_parameters", parameters=[Parameter(name=name, value=value)]).results
    assert result.reason
    return result.successful


def test_invalid_requests_are_refused_and_the_stop_still_works(rig):
    # ROS time stands still, as there is no /clock publisher.
    running = rig(use_sim_time=True)

    def send_all():
        for what, send in INVALID.items():
            assert not send(running), what

    running.bears(send_all)
    assert running.participant.set_parameter(BRIDGE, "force_error", 1000.0).successful
    stopped = running.emergency_stop()
    running.live(0.5)
    judge("emergency stop after invalid requests", running.finish(), stopped, "emergency_stop")


SABOTAGED = str(Path(__file__).with_name("sabotaged_bridge.py"))


def sabotage(running, request):
    """Send the request, which is not answered."""
    client = running.participant.node.create_client(SetBool, "sabotage")
    assert client.wait_for_service(PATIENCE)
    client.call_async(request)


@pytest.mark.long
def test_services_that_hang_close_the_valve(rig, graph):
    running = rig(bridge=SABOTAGED)
    sabotage(running, SetBool.Request(data=False))
    running.participant.until(lambda: "hangs" in graph.log(BRIDGE))
    hung = graph.journal.note("deaf", BRIDGE)
    running.live(MAX_SILENCE + 1.5)
    judge("services hang", running.finish(), hung, "services_silent")
    assert graph.processes[BRIDGE].poll() is None


@pytest.mark.long
def test_a_dead_service_thread_or_an_exception_in_the_loop_closes_the_valve_and_ends_the_process(rig, graph):
    running = rig(bridge=SABOTAGED)
    graph.journal.note("stopped", BRIDGE)
    sabotage(running, SetBool.Request(data=True))
    assert running.bridge.wait(PATIENCE) == 1
    ended = graph.journal.note("ended", BRIDGE, code=1)
    running.live(3 * SLOW.watchdog)
    assert "service thread failed, so the node ends: SystemExit: 3" in graph.log(BRIDGE)
    running.restart_bridge()
    restarted = time.monotonic()
    running.open()
    running.live(0.3)
    graph.journal.note("stopped", BRIDGE)
    assert running.ask(Trigger, "break_loop").success
    assert running.bridge.wait(PATIENCE) == 1
    raised = graph.journal.note("ended", BRIDGE, code=1)
    running.live(3 * SLOW.watchdog)
    assert "ZeroDivisionError" in graph.log(BRIDGE)
    truth = running.finish()
    judge("services die", truth, ended, "end_of_process", restarted)
    judge("exception in the loop", truth, raised, "end_of_process")


@pytest.mark.long
def test_each_change_of_the_gate_is_reported_at_once_whatever_else_there_is_to_report(rig):
    running = rig()
    # From now on there are unanswered cycles to report.
    running.command("mute")
    running.participant.rest(3.0 * SLOW.period)
    running.command("sine 1e-4 0.7")
    for _ in range(2):
        assert running.ask(SetBool, "enable", data=False).success
        running.participant.rest(0.7)
        running.ask(Trigger, "reset_trips")
        running.enable()
        running.participant.rest(0.7)
    truth = running.finish()
    assert truth.verdicts["changes_are_reported"].evaluated >= 2


# The lifecycle


@pytest.mark.long
def test_outside_active_the_valve_is_at_null_and_returning_takes_reset_and_enable(rig):
    running = rig()
    moments = []
    for labels, state in (
        (("deactivate",), "inactive"),
        (("deactivate", "cleanup"), "unconfigured"),
    ):
        for label in labels:
            assert running.transition(label)
        left = time.monotonic()
        assert running.state() == state
        running.live(0.3)
        for label in ("configure", "activate")[len(labels) == 1 :]:
            assert running.transition(label)
        # If this computer was late, the gate had tripped before.
        expected = tuple(f"tripped by {cause}" for cause in ("left active", *LATE))
        running.participant.until(lambda expected=expected: running.enable().message.startswith(expected))
        moments.append((" and ".join(labels), left, time.monotonic()))
        running.open()
        running.live(0.3)
    stopped = running.emergency_stop()
    for label in ("deactivate", "cleanup", "configure", "activate"):
        assert running.transition(label)
    assert running.said()["state"] == "stopped"
    moments.append(("stop through deactivate, cleanup, configure, activate", stopped, time.monotonic()))
    running.open()
    running.live(0.3)
    assert running.transition("shutdown")
    left, left_ns = time.monotonic(), time.time_ns()
    assert running.state() == "finalized"
    running.live(0.5)
    assert not running.states.after(left_ns)
    assert not running.transition("activate")
    truth = running.finish()
    for labels, since, until in (*moments, ("shutdown", left, np.inf)):
        judge(labels, truth, since, "outside_active", until)


ENDS = [(signal.SIGTERM, signal.SIGKILL), (signal.SIGINT,)]


@pytest.mark.long
@pytest.mark.parametrize("numbers", ENDS)
def test_the_end_of_the_process_closes_the_valve(rig, graph, numbers):
    running = rig()
    moments = []
    for number in numbers:
        graph.stop(BRIDGE, number)
        gone = time.monotonic()
        running.live(3 * SLOW.watchdog)
        running.restart_bridge()
        moments.append((number.name, gone, time.monotonic()))
        running.open()
        running.live(0.3)
    truth = running.finish()
    for name, since, until in moments:
        judge(name, truth, since, "killed" if name == "SIGKILL" else "end_of_process", until)


# Gaps


@pytest.mark.long
def test_after_a_freeze_or_a_lost_link_the_valve_stays_at_null(rig, graph):
    running = rig()
    moments = []

    def trial(what, cause, seconds, policy, line="clear", frozen=None):
        since = running.fault(line) if frozen is None else graph.freeze(frozen)
        # The rig, too, must have run for that long; it reports its time with every fault.
        while running.fault(line) < since + seconds:
            running.participant.rest(SLOW.period)
        running.fault("clear")
        if frozen is not None:
            graph.wake(frozen)
        # If this computer was late, that is the cause.
        expected = tuple(f"tripped by {cause}" for cause in (cause, "gap", "device_null"))
        assert any(words in running.tripped() for words in expected), what
        running.live(0.3)
        moments.append((what, since, policy, time.monotonic()))
        running.open()
        running.live(0.3)

    trial("bridge frozen for 1 s", "gap", 1.0, "gap", frozen=running.bridge)
    trial("bridge frozen for 220 ms", "device_null", 0.22, "device_null", frozen=running.bridge)
    # A packet with a NaN is refused entirely.
    trial("sensor: nan force", "sensor_stale", 0.5, "no_measurement", "nan force")
    trial("sensor: nan position", "sensor_stale", 0.5, "no_measurement", "nan position")
    trial("link to the target lost for 300 ms", "device_null", 0.3, "device_null", "deaf")
    trial("link from the target lost for 500 ms", "sensor_stale", 0.5, "no_measurement", "silent")
    graph.freeze(running.emulator)
    time.sleep(1.0)
    woken = graph.wake(running.emulator)
    running.tripped()
    running.live(1.0)
    truth = running.finish()
    for what, since, policy, until in (*moments, ("target frozen for 1 s", woken, "latched", np.inf)):
        judge(what, truth, since, policy, until)


@pytest.mark.long
def test_corrupted_lost_duplicated_and_reordered_packets_are_refused_and_counted(rig):
    net = "--corrupt", "0.05", "--loss", "0.05", "--duplicate", "0.05", "--reorder", "0.05", "--jitter-ms", "3"
    running = rig(net=net)
    running.live(2.0)
    stopped = running.emergency_stop()
    running.live(0.3)
    truth = running.finish()
    assert running.counts["refused_tag"] > 0
    assert running.counts["order"] > 0
    judge("packets corrupted, lost, duplicated, reordered (5 % each), then a stop", truth, stopped, "emergency_stop")


# Attacks that end no process, on one rig

DEFAULTS = Gate()._asdict()


@pytest.mark.long
def test_parameters_slow_controllers_spam_and_forged_messages_take_no_protection_away(rig):
    running = rig()
    moments = [
        weaken_the_gate(running),
        spam_resets_and_enables(running),
        forge_snapshots_and_measurements(running),
        slow_the_controller(running),
    ]
    truth = running.finish()
    for attack, since, policy, until in moments:
        judge(attack, truth, since, policy, until)
    _, stopped, _, until = moments[1]
    assert until - stopped > STOP_TIME
    assert np.any(truth.between(until))


def weaken_the_gate(running):
    def accepted(name, value):
        return running.participant.set_parameter(BRIDGE, name, value).successful

    never = [("on_force", "warn"), ("on_load_pressure", "warn"), ("on_velocity", "warn"), ("on_position", "warn")]
    never += [("on_sensor_stale", "warn"), ("on_command_stale", "warn"), ("on_sensor_not_finite", "warn")]
    never += [("command_rate", 20.0), ("command_rate", 1e-9), ("enable_time", 0.0), ("command_timeout", 0.5)]
    weaker = [("on_sensor_jump", "warn"), ("on_command_rate", "warn"), ("force_error", 1e5), ("trip_level", 1.0)]
    for name, value in never:
        assert not accepted(name, value), name
    for name, value in weaker:
        while accepted(name, value):
            assert running.was_late(), name
            assert accepted(name, running.gate.get(name, DEFAULTS[name])), name
            running.open()
    assert running.ask(SetBool, "enable", data=False).success
    closed = time.monotonic()
    for name, value in never:
        assert not accepted(name, value), name
    for name, value in weaker:
        assert accepted(name, value), name
    said = running.said()
    assert sum(line.endswith("s") and "(weaker)" in line for key, line in said.items() if key.startswith("change_")) >= 4
    moment = "gate disabled for weaker parameters", closed, "disable", time.monotonic()
    for name, _ in weaker:
        assert accepted(name, running.gate.get(name, DEFAULTS[name])), name
    running.open()
    running.live(0.3)
    return moment


def spam_resets_and_enables(running):
    stopped = running.emergency_stop()
    # An unanswered enable ends the policy's span after the stop.
    running.live(0.1)
    node = running.participant.node
    clients = [node.create_client(Trigger, "reset_trips"), node.create_client(SetBool, "enable")]
    clients.append(node.create_client(AcknowledgeStop, "acknowledge_stop"))
    requests = [Trigger.Request(), SetBool.Request(data=True), AcknowledgeStop.Request(stop="stop")]
    for client in clients:
        assert client.wait_for_service(PATIENCE)
    sent = 0
    while sent <= 20 or time.monotonic() < stopped + 2.0:
        for client, request in zip(clients, requests, strict=True):
            running.participant.note_unanswered(client.srv_name.rpartition("/")[2], request)
            client.call_async(request)
        sent += 1
        running.participant.rest(2e-3)
    until = time.monotonic()
    early = running.ask(AcknowledgeStop, "acknowledge_stop", stop="stop-0")
    assert not early.success
    running.open()
    running.live(0.3)
    return f"{sent} resets and enables within {until - stopped:.1f} s of a stop", stopped, "emergency_stop", until


def forge_snapshots_and_measurements(running):
    forger = running.participant.node.create_publisher(LoaderState, "loader_state", control_qos(10))
    codec = Codec()

    def forge():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for number in range(300):
                newest = running.states[-1]
                forged = LoaderState(cycle=newest.cycle + 5, force=1e5, position=0.29, header=newest.header)
                forger.publish(forged)
                packet = Packet(Kind.MEASUREMENT, 1 + number, 2, newest.cycle + 10**6, values=(9.9,) * 6)
                stranger.sendto(codec.pack(packet), ("127.0.0.1", running.port))
                running.participant.rest(5e-3)

    running.bears(forge)
    stopped = running.emergency_stop()
    running.live(0.3)
    return "forged snapshots and measurements, then a stop", stopped, "emergency_stop", time.monotonic()


def slow_the_controller(running):
    running.graph.stop(BRIDGE)
    closed = time.monotonic()
    # A tenth must be answered. Fewer are, but some in each window.
    running.gate["least_answered"] = 0.1
    running.command("skip 15")
    running.restart_bridge()
    # In a window without any answer, for example because this computer is late, the controller counts as missing instead.
    running.participant.until(lambda: running.enable().message.startswith("too slow: "))
    return "controller too slow for a new bridge", closed, "end_of_process", np.inf
