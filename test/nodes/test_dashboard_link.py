"""The dashboard as a participant of the graph."""

import time

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from ehls_msgs.msg import ChamberPressures, LoaderState
from ehls_ros.nodes.dashboard_link import Link


def test_late_messages_of_a_stopped_node_are_ignored(participant, monkeypatch):
    link = Link("ehls")
    try:
        publisher = participant.node.create_publisher(DiagnosticArray, "/diagnostics", 10)

        def report(*names):
            # Without a stamp, which may be of any clock: the time of sending counts.
            return DiagnosticArray(
                status=[DiagnosticStatus(name=name, message="running", hardware_id="ehls") for name in names]
            )

        def heard():
            return [health.node for health in link.health()]

        def saying(array, node):
            publisher.publish(array)
            return node in heard()

        participant.until(lambda: saying(report("ended", "other"), "ended"))
        with monkeypatch.context() as later:
            later.setattr(time, "time_ns", lambda: 2**62)
            link.forget(["ended"])
        assert heard() == ["other"]
        participant.until(lambda: saying(report("ended", "late"), "late"))
        assert heard() == ["late", "other"]
        link.forget(["ended"])
        # A restarted node of that name is accepted.
        participant.until(lambda: saying(report("ended"), "ended"))
    finally:
        link.close()


def test_nodes_that_are_there_twice_are_found(participant):
    link = Link("ehls")
    try:
        pair = [rclpy.create_node("fasmc_node", context=participant.context, namespace="ehls") for _ in range(2)]
        other = rclpy.create_node("sic_node", context=participant.context, namespace="rig2")
        participant.until(lambda: link.duplicates(["fasmc_node", "participant", "sic_node"]) == ["fasmc_node"])
        for node in [*pair, other]:
            node.destroy_node()
    finally:
        link.close()


def test_both_pressures_of_a_single_rod_are_drawn(participant):
    link = Link("ehls")
    try:
        states = participant.node.create_publisher(LoaderState, "/ehls/loader_state", 10)
        pressures = participant.node.create_publisher(ChamberPressures, "/ehls/chamber_pressures", 10)
        cycle = 0

        def drawn():
            nonlocal cycle
            for _ in range(100):
                state, chambers = LoaderState(cycle=cycle), ChamberPressures(cycle=cycle, pressure_a=3e6, pressure_b=1e6)
                for message in (state, chambers):
                    message.header.stamp.nanosec = cycle % 1000 * 1_000_000
                    message.header.stamp.sec = cycle // 1000
                states.publish(state)
                pressures.publish(chambers)
                cycle += 1
            part, place = link.window.part(0, -1), link.window.signals.index
            return np.any(part.high[:, place("pressure_a_pa")] == 3e6) and np.any(part.low[:, place("pressure_b_pa")] == 1e6)

        participant.until(drawn)
    finally:
        link.close()
