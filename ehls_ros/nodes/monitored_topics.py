"""Topics of a running graph for its monitor, read in bulk: no cycle waits for it, and it blocks no sender."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool, String

from ehls_msgs.msg import ControllerStatus, Disturbance, Driver, LoaderState, ValveCommand
from ehls_ros.control.controllers.base import FORCE_ERROR
from ehls_ros.experiments.monitoring.benefit import Benefit
from ehls_ros.experiments.monitoring.cycle_assembly import CycleAssembler, LoaderSnapshot, Stretch
from ehls_ros.nodes.codec import Decoder
from ehls_ros.nodes.control import ControlNode
from ehls_ros.nodes.diagnostics import figures_of
from ehls_ros.nodes.transport import RECORDER_DEPTH, Inbox, control_qos
from ehls_ros.recording.topics import (
    ACCEPTED_RIG,
    CONTROLLER_STATUS,
    DIAGNOSTICS,
    DISTURBANCE,
    DRIVER,
    DRIVING,
    LOADER_STATE,
    OF_GATE,
    TRIPPED_BY,
    VALVE_COMMAND,
    Topic,
)

MAX_READ_DELAY = 20.0
"""Longest interval between bulk reads while the monitor computes something else [s]."""

MAX_GATHERED = 100_000
"""Maximum number of messages of a topic between two reads: 20 s at 5 kHz."""

GATE = f"{OF_GATE}\0".encode()
"""Key of the safety gate's diagnostics as encoded in a message."""

BENEFIT_TIME = 30.0
"""Time over which the force error is measured before and after controllers receive an accepted rig [s]."""

SETTLING = 2.0
"""Time between the two measurements [s]."""


class MonitoredTopics:
    """Snapshots, commands, disturbances, drivers and gate of one rig."""

    def __init__(self, node: ControlNode) -> None:
        """Open the topics of a node's rig."""
        self._rig = node.get_namespace().strip("/")
        self._plant = node.owners.of(LOADER_STATE.name)
        self._states = cycle_inbox(node, LoaderState, LOADER_STATE)
        self._commands = cycle_inbox(node, ValveCommand, VALVE_COMMAND)
        self._disturbances = cycle_inbox(node, Disturbance, DISTURBANCE)
        self._drivers = Inbox(node, Driver, DRIVER.name, control_qos(DRIVER.depth), owned=LOADER_STATE.name)
        self._driving = Inbox(node, Bool, DRIVING.name, control_qos(DRIVING.depth))
        self._diagnostics = Inbox(node, DiagnosticArray, DIAGNOSTICS.name, QoSProfile(depth=200))
        self._state, self._command, self._disturbance = Decoder(LoaderState), Decoder(ValveCommand), Decoder(Disturbance)
        self._trip = ""

    def read(self, assembler: CycleAssembler) -> tuple[list[Stretch], int]:
        """Pass all waiting messages to an assembler, and return the complete samples and the number of new snapshots."""
        while (driver := self._drivers.take()) is not None:
            assembler.add_controller(driver[1], driver[3])
        snapshots = [
            LoaderSnapshot(message[0], message[1], message[2:-1], info["source_timestamp"])
            for raw, info in _messages(self._states)
            if (message := self._state(raw)) is not None and self._plant.admits(message[-1])
        ]
        # After the snapshots: messages older than the newest snapshot have arrived by now.
        for raw, info in _messages(self._driving):
            assembler.add_driving(deserialize_message(raw, Bool).data, info["source_timestamp"])
        assembler.add_commands(
            (message[1], message[2], message[3], info["source_timestamp"])
            for raw, info in _messages(self._commands)
            if (message := self._command(raw)) is not None
        )
        assembler.add_disturbances(
            (message[1], message[2:-1])
            for raw, _ in _messages(self._disturbances)
            if (message := self._disturbance(raw)) is not None
        )
        return assembler.add_snapshots(snapshots), len(snapshots)

    def trips(self) -> Iterator[str]:
        """Yield the cause of each new trip of the gate."""
        for raw, _ in _messages(self._diagnostics):
            if GATE not in raw:
                continue
            for status in deserialize_message(raw, DiagnosticArray).status:
                figures = figures_of(status)
                if status.hardware_id != self._rig or OF_GATE not in figures:
                    continue
                cause = figures.get(TRIPPED_BY, "")
                if cause and cause != self._trip:
                    yield cause
                self._trip = cause

    def destroy(self) -> None:
        """Close the topics."""
        cycle = (self._states, self._commands, self._disturbances)
        for inbox in (*cycle, self._drivers, self._driving, self._diagnostics):
            inbox.destroy()


class InformedControllers:
    """Controllers that receive an accepted rig, with their force error before and after."""

    def __init__(self, node: ControlNode) -> None:
        """Open the topic of accepted rigs."""
        self._node = node
        self._publisher = node.create_publisher(String, ACCEPTED_RIG.name, control_qos(ACCEPTED_RIG.depth))
        self._decode = Decoder(ControllerStatus)
        self._rig = ""
        self._benefit: Benefit | None = None
        self._statuses: Inbox | None = None

    def begin(self, rig: str) -> None:
        """Measure the force error, for the time after which the controllers are informed.

        Args:
            rig: text of the rig file.
        """
        self.end()
        self._rig = rig
        self._benefit = Benefit(round(BENEFIT_TIME / self._node.spec.settings.control_period))
        self._statuses = cycle_inbox(self._node, ControllerStatus, CONTROLLER_STATUS)

    def measure(self) -> Iterator[tuple[str, str]]:
        """Read the waiting force errors, and yield kind and text of an event."""
        if self._benefit is None or self._statuses is None:
            return
        decoded = (self._decode(raw) for raw, _ in _messages(self._statuses))
        self._benefit.add(np.array([message[2 + FORCE_ERROR] for message in decoded if message is not None]))
        if self._benefit.ready:
            self._publisher.publish(String(data=self._rig))
            self._benefit.inform(round(SETTLING / self._node.spec.settings.control_period))
            yield "told", "the controllers are informed of the accepted rig"
        elif self._benefit.complete:
            yield "benefit", self._benefit.sentence()
            self.end()

    def end(self) -> None:
        """End the measurement."""
        if self._statuses is not None:
            self._statuses.destroy()
        self._benefit, self._statuses = None, None

    def destroy(self) -> None:
        """End the measurement, and close the topic."""
        self.end()
        self._node.destroy_publisher(self._publisher)


def cycle_inbox(node: ControlNode, message: Any, topic: Topic) -> Inbox:
    """Return an inbox that blocks no sender: in realtime no sender waits for acknowledgement, and lost messages are gaps.

    In lockstep it loses only messages that a publisher no longer keeps by the time a busy machine lets it read.
    """
    if node.lockstep:
        return Inbox(node, message, topic.name, control_qos(RECORDER_DEPTH))
    depth = min(round(MAX_READ_DELAY / node.spec.settings.control_period), MAX_GATHERED)
    return Inbox(node, message, topic.name, QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT))


def _messages(inbox: Inbox) -> Iterator[tuple[bytes, Mapping[str, int]]]:
    """Yield the waiting messages of an inbox."""
    while (taken := inbox.take_raw()) is not None:
        yield taken
