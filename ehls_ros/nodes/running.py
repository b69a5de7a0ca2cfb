"""Nodes as a process: their loops in the main thread, and lifecycle, parameters and services in a second one."""

import contextlib
import faulthandler
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ehls_ros.errors import BadInput
from ehls_ros.hardware.realtime import limit_reserved_memory
from ehls_ros.nodes.control import ControlNode
from ehls_ros.nodes.failures import Failures
from ehls_ros.nodes.loop import WAIT
from ehls_ros.nodes.owners import DISCOVERY_RANGE, LOCALHOST
from ehls_ros.process import Stopping, end

CLOSING = 30.0
"""Longest time the middleware may take to close the node's topics and services [s]."""


def survive_requests(node: Node) -> None:
    """Refuse and log a request whose handler raises; rclpy would let it end the thread of all services.

    Args:
        node: owner of the services.
    """
    for service in node.services:
        service.callback = _surviving(node, service)


def _surviving(node: Node, service: Any) -> Callable[[Any, Any], Any]:
    """Return a service's handler that answers with a refusal if the original handler raises."""
    answer = service.callback
    changes_state = service.srv_name.endswith("/change_state")
    guard = node.lifecycle.changing if changes_state and isinstance(node, ControlNode) else contextlib.nullcontext()

    def answer_or_refuse(request: Any, response: Any) -> Any:
        try:
            with guard:
                return answer(request, response)
        except Exception as error:  # noqa: BLE001
            reason = f"{type(error).__name__}: {error}"
            node.get_logger().error(f"{service.srv_name}: a request was refused: {reason}")
            return _refusal(request, response, reason)

    return answer_or_refuse


def _refusal(request: Any, response: Any, reason: str) -> Any:
    """Fill in a refusal, with the reason if the response has a field for it; ``success`` is false by default."""
    refused = SetParametersResult(successful=False, reason=reason)
    if isinstance(response, SetParameters.Response):
        # The parameters before the failed one have been set.
        response.results = [*response.results, *[refused] * (len(request.parameters) - len(response.results))]
    elif isinstance(response, SetParametersAtomically.Response):
        response.result = refused
    elif hasattr(response, "message"):
        response.message = reason
    return response


class _Services:
    """The thread that serves services and timers of a process's nodes; its failure stops the nodes."""

    def __init__(self, nodes: Sequence[ControlNode], failures: Failures) -> None:
        self._failures = failures
        self._blamed = nodes[-1]
        self._executor = EventsExecutor()
        for node in nodes:
            self._executor.add_node(node)
        self._thread = threading.Thread(target=self._serve, name="services")
        self._thread.start()

    def join(self) -> None:
        self._thread.join()

    def close(self, nodes: Sequence[ControlNode]) -> None:
        for node in nodes:
            self._executor.remove_node(node)
        self._executor.shutdown()

    def _serve(self) -> None:
        try:
            while not self._failures.stopping.is_set():
                self._executor.spin_once(timeout_sec=WAIT)
        except BaseException as error:  # noqa: BLE001
            # A node that can no longer be stopped over ROS must not continue, whatever the error.
            self._failures.note(error, self._blamed, "service thread")


def _made(
    makes: Sequence[Callable[[], ControlNode]], check: Callable[[Sequence[ControlNode]], None], failures: Failures
) -> list[ControlNode]:
    """Return the nodes; none if one cannot be made. As a function, it keeps no reference to a failed node."""
    try:
        nodes = [make() for make in makes]
        check(nodes)
    except (BadInput, ParameterException) as error:
        print(error, file=sys.stderr)
        nodes = []
    except Exception as error:  # noqa: BLE001
        failures.note(error, None, "start")
        nodes = []
    return nodes


def _joined() -> str:
    """Join the ROS graph; return the error in the arguments or files of `--ros-args`, or an empty string."""
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        # The text after the first source location of rcl does not help the user.
        return str(error).partition(", at /")[0]
    return ""


def run_node(make: Callable[[], ControlNode]) -> NoReturn:
    """Run one node as a process: the loop in the main thread, lifecycle and parameters in a second one.

    The exit code is 0 after SIGINT or SIGTERM, 1 if the node cannot configure itself, and 2 for bad input.

    Args:
        make: builds the node, after ``rclpy.init``.
    """
    run_nodes([make], lambda nodes: nodes[0].loop.run)


def run_nodes(
    makes: Sequence[Callable[[], ControlNode]],
    join: Callable[[Sequence[ControlNode]], Callable[[Stopping], None]],
    check: Callable[[Sequence[ControlNode]], None] = lambda _: None,
) -> NoReturn:
    """Run nodes as one process: their loops in the main thread, lifecycle and parameters of all in a second one.

    The exit code is that of :func:`run_node`; a node that fails ends them all.

    Args:
        makes: build the nodes, after ``rclpy.init``; in the order in which they configure and activate themselves.
        join: returns a function that runs the nodes' loops until an event is set.
        check: rejects nodes that do not fit together with ``BadInput``.
    """
    limit_reserved_memory()
    stopping = Stopping()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    # However the node is started, it is visible on this host only unless the variable says otherwise.
    os.environ[DISCOVERY_RANGE] = os.environ.get(DISCOVERY_RANGE) or LOCALHOST
    failures = Failures(stopping)
    complaint = _joined()
    if complaint:
        print(complaint, file=sys.stderr)
    nodes = [] if complaint else _made(makes, check, failures)
    code = _work(nodes, join, failures) if nodes else 2
    # Objects that refer to the middleware must be collected before it shuts down.
    del nodes
    gc.unfreeze()
    gc.collect()
    rclpy.try_shutdown()
    end(1 if failures.noted else code)


def _work(
    nodes: Sequence[ControlNode],
    join: Callable[[Sequence[ControlNode]], Callable[[Stopping], None]],
    failures: Failures,
) -> int:
    """Run nodes until the process is stopped, and destroy them; return the exit code."""
    stopping, code = failures.stopping, 0
    for node in nodes:
        node.failures = failures
        survive_requests(node)
    work = join(nodes)
    services = _Services(nodes, failures)
    try:
        if all(not node.get_parameter("autostart").value or node.bring_up(stopping) for node in nodes):
            for node in nodes:
                node.get_logger().info("up")
            work(stopping)
        else:
            code = 1
    except Exception as error:  # noqa: BLE001
        failures.note(error, nodes[-1], "run")
    stopping.set()
    # Fast DDS occasionally deadlocks while it destroys readers and writers (its issues 4026 and 6193), in a call that
    # holds the interpreter lock; only this watchdog then ends the process. The node's data have been written by now.
    faulthandler.dump_traceback_later(CLOSING, exit=True)
    _each(nodes, lambda node: node.make_safe())
    services.join()
    services.close(nodes)
    _each(nodes, lambda node: node.lifecycle.release())
    _each(nodes, lambda node: node.destroy_node())
    return code


def _each(nodes: Sequence[ControlNode], step: Callable[[ControlNode], None]) -> None:
    """Apply a shutdown step to all nodes, even if some of them fail."""
    for node in nodes:
        try:
            step(node)
        except Exception as error:  # noqa: BLE001
            node.report_failure(error, "end")
