"""A test node in a separate process, controlled by the last line on its standard input."""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import rclpy
from rclpy.signals import SignalHandlerOptions

from ehls_msgs.msg import ValveCommand
from ehls_ros.nodes.transport import Inbox, Outbox
from ehls_ros.process import Stopping


class ToldNode(NamedTuple):
    """A node that answers one topic with valve commands.

    Attributes:
        node: the rclpy node.
        inbox: messages of its topic.
        outbox: its valve commands.
        told: returns the last line read.
        stopping: set by SIGINT.
    """

    node: Any
    inbox: Inbox
    outbox: Outbox
    told: Callable[[], str]
    stopping: Stopping


@contextlib.contextmanager
def told_node(name: str, message: Any, topic: str, first: str) -> Iterator[ToldNode]:
    """Run a node until SIGINT; ``first`` is used until a line arrives."""
    lines, stopping = [first], Stopping()
    threading.Thread(target=lambda: [lines.append(line.strip()) for line in sys.stdin], daemon=True).start()
    signal.signal(signal.SIGINT, lambda *_: stopping.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name, namespace="ehls")
    inbox, outbox = Inbox(node, message, topic), Outbox(node, ValveCommand, "valve_command", sender=name)
    yield ToldNode(node, inbox, outbox, lambda: lines[-1], stopping)
    inbox.destroy()
    outbox.destroy()
    node.destroy_node()
    rclpy.shutdown()
