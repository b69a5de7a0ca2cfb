"""Controllers that start before the plant: the first to answer drives, the others stand by with full information."""

import time

import numpy as np
import pytest

pytest.importorskip("ehls_msgs.msg._driver", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray
from patience import PATIENCE

from ehls_msgs.msg import Driver, ForceReference, LoaderState, ValveCommand
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import model_of
from ehls_ros.experiments.spec import load_spec
from ehls_ros.hardware.handover import RELAY_TIME
from ehls_ros.nodes.transport import control_qos
from ehls_ros.physics.rig import SENSED

LAWS = ("sic", "fasmc_output_feedback")

CYCLES = 200

EXACT = 1e-12
"""Permitted deviation of a standby command from the law in one process [m]."""


@pytest.mark.long
def test_of_two_controllers_that_wait_for_the_plant_one_drives_and_the_other_stands_by(graph, participant, spec_file):
    path = spec_file(duration=1000.0, controller="sic")
    told = participant.collect(Driver, "driver")
    states = participant.collect(LoaderState, "loader_state")
    references = participant.collect(ForceReference, "force_reference")
    commands = participant.collect(ValveCommand, "valve_command")
    shadows = participant.collect(ValveCommand, "standby_command")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")

    def told_by_plant():
        reports = [status for array in diagnostics for status in array.status if status.name == "plant_sim_node"]
        figures = [{pair.key: pair.value for pair in status.values} for status in reports]
        return [values for values in figures if "cycle" in values]

    partners = ["reference_node", "disturbance_node", *(f"{law}_node" for law in LAWS)]
    for name in partners:
        graph.start(name, spec=path, timing="lockstep")
    graph.start("plant_sim_node", spec=path, timing="lockstep", speed=0.5, partners=",".join(partners))
    participant.until(lambda: all(len(heard) > CYCLES for heard in (states, references, commands, shadows)))
    # On a busy machine it may miss cycles until the plant registers it as standby, or the first one altogether; then none.
    participant.until(lambda: shadows[-1].cycle - shadows[-CYCLES].cycle == CYCLES - 1)

    [nobody, first] = told
    assert (nobody.sender, first.cycle) == ("", 0)
    assert {message.sender for message in commands if message.cycle > 0} == {first.sender}
    [standing_by] = {message.sender for message in shadows}
    assert standing_by != first.sender
    stood_by = {message.cycle: message.spool for message in shadows}
    answered_first = standing_by in {message.sender for message in commands}
    whole = answered_first and all(cycle in stood_by for cycle in range(1, CYCLES))
    # A command that the other sent before it could learn of the driver is no fault.
    participant.until(lambda: any(int(figures["cycle"]) > CYCLES for figures in told_by_plant()))
    assert told_by_plant()[-1]["fault_second_sender"] == "warn, 0 times"

    # Its standby command is that of the law that has followed from the first cycle on; the test may miss messages as well.
    sent = {message.cycle: message.spool for message in commands if message.sender == first.sender}
    wanted = {message.cycle: message for message in references}
    seen = {message.cycle: message for message in states}
    if not whole or not all(cycle in known for known in (sent, wanted, seen) for cycle in range(CYCLES)):
        return
    [other] = [law for law in LAWS if f"/{law}_node-" not in first.sender]
    spec = load_spec(path)
    law = Controller(other, CONTROLLERS.load(other).Parameters(), model_of(spec.controller_rig, spec.settings.control_period))
    for cycle in range(CYCLES):
        reference = wanted[cycle]
        heard = (
            np.array([getattr(seen[cycle], name) for name in SENSED]),
            np.array([reference.force, reference.force_rate, reference.force_acceleration]),
            np.zeros(2),
        )
        if cycle == 0:
            law.step(*heard)
        else:
            assert abs(law.follow(*heard, sent[cycle - 1]) - stood_by[cycle]) <= EXACT


@pytest.mark.long
def test_a_driver_that_is_heard_late_is_stood_by_for(graph, participant, spec_file):
    """The test is plant and driver at once, and stays silent as driver for longer than a relay may."""
    path = spec_file(duration=1000.0, controller="sic")
    publishers = {
        topic: participant.node.create_publisher(kind, topic, control_qos())
        for kind, topic in (
            (Driver, "driver"),
            (LoaderState, "loader_state"),
            (ForceReference, "force_reference"),
            (ValveCommand, "valve_command"),
        )
    }
    commands = participant.collect(ValveCommand, "valve_command")
    shadows = participant.collect(ValveCommand, "standby_command")
    late = "/elsewhere/late_node-1"

    def cycle(number):
        publishers["force_reference"].publish(ForceReference(cycle=number))
        publishers["loader_state"].publish(LoaderState(cycle=number))

    publishers["driver"].publish(Driver(cycle=0, sender=late))
    cycle(0)
    graph.start("sic_node", spec=path, timing="lockstep")
    participant.until(lambda: all(publishers[topic].get_subscription_count() for topic in ("driver", "loader_state")))
    participant.rest(4.0 * RELAY_TIME)
    # The command may match or arrive later than the snapshots, as another topic.
    number = 0
    deadline = time.monotonic() + PATIENCE
    while not shadows:
        assert time.monotonic() < deadline, "it never stands by"
        publishers["valve_command"].publish(ValveCommand(cycle=number, sender=late))
        number += 1
        cycle(number)
        participant.rest(0.05)
    assert {message.sender for message in commands} == {late}
