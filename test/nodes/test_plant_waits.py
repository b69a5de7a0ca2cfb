"""The simulated rig in realtime waits for the inputs from its graph, command and disturbance."""

import gc
import time

import pytest
from patience import PATIENCE

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

import rclpy
from rclpy.signals import SignalHandlerOptions

from ehls_msgs.msg import Disturbance, ValveCommand
from ehls_ros.hardware import simulated_clock
from ehls_ros.nodes import plant_sim_node
from ehls_ros.nodes.transport import control_qos

TURNS = 20
"""Turns of the plant's loop: without waiting, more than five cycles."""


@pytest.fixture
def plant(spec_file, ros_domain_id, monkeypatch):
    # However slow the machine, an answer is awaited; the loop polls often enough for a short test.
    monkeypatch.setattr(simulated_clock, "MAX_WAIT", 1e9)
    monkeypatch.setattr(plant_sim_node, "WAIT", 0.01)
    rclpy.init(args=["--ros-args", "-p", f"spec:={spec_file()}"], signal_handler_options=SignalHandlerOptions.NO)
    node = plant_sim_node.PlantSimNode()
    node.prepare()
    yield node
    node.release()
    node.destroy_node()
    del node
    gc.collect()
    rclpy.try_shutdown()


def test_time_waits_for_a_held_up_disturbance_but_not_for_one_that_left(plant, participant):
    commands = participant.node.create_publisher(ValveCommand, "valve_command", control_qos())
    disturbances = participant.node.create_publisher(Disturbance, "disturbance", control_qos())

    def turn(*, disturbed):
        if plant.answered < plant.cycle:
            commands.publish(ValveCommand(cycle=plant.cycle))
        if disturbed:
            disturbances.publish(Disturbance(cycle=plant.cycle))
        plant.once()

    def run(until, *, disturbed):
        # Without spinning: only the plant's loop receives.
        deadline = time.monotonic() + PATIENCE
        while not until():
            turn(disturbed=disturbed)
            assert time.monotonic() < deadline, f"the plant stays in cycle {plant.cycle}"

    participant.until(lambda: commands.get_subscription_count() and disturbances.get_subscription_count())
    participant.until(lambda: plant.disturbance.handle.get_publisher_count() > 0)
    plant.start()
    run(lambda: plant.cycle > TURNS, disturbed=True)

    run(lambda: plant.time.waiting and plant.answered == plant.cycle, disturbed=False)
    held = plant.cycle
    for _ in range(TURNS):
        turn(disturbed=False)
    assert plant.cycle == held

    run(lambda: plant.cycle > held, disturbed=True)

    participant.node.destroy_publisher(disturbances)
    participant.until(lambda: plant.disturbance.handle.get_publisher_count() == 0)
    run(lambda: plant.cycle > held + TURNS, disturbed=False)
