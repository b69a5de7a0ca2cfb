"""Requests to the services of running nodes: parameters, as with `ros2 param`, and controller switches.

:mod:`ehls_ros.nodes.rig_requests` has those to the safety gate and the programme of a rig.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import rclpy
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import ParameterType
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, get_parameter_value, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_namespace import validate_namespace

from ehls_msgs.srv import SwitchController
from ehls_ros.errors import BadInput, WorkFailed

FOUND = 5.0
"""Longest wait for the discovery of a node [s]."""

DISCOVERY_TIME = 1.5
"""Time without a new node after which discovery counts as complete [s]."""

ANSWERED = 30.0
"""Longest wait for an answer [s]; on a busy machine, real-time nodes leave other threads little time."""

AGAIN = 2.0
"""Time after which an unanswered request is repeated [s]: a node drops an answer to a client that it has not discovered yet."""

LOOK = 0.1
"""Interval between checks of the graph [s]."""

STARTED = 120.0
"""Longest wait for a controller that is starting [s]: the first time, it compiles its law."""

FIRST_COMMAND = 12.0
"""Longest wait for the first standby command of an active controller [s]: in lockstep it waits ten seconds for an estimate."""

STARTING = frozenset({State.TRANSITION_STATE_CONFIGURING, State.TRANSITION_STATE_ACTIVATING})
"""States of a node that is on its way to become active."""

WORDS: Mapping[int, tuple[str, str]] = {
    ParameterType.PARAMETER_NOT_SET: ("not set", "Parameter not set."),
    ParameterType.PARAMETER_BOOL: ("boolean", "Boolean value is:"),
    ParameterType.PARAMETER_INTEGER: ("integer", "Integer value is:"),
    ParameterType.PARAMETER_DOUBLE: ("double", "Double value is:"),
    ParameterType.PARAMETER_STRING: ("string", "String value is:"),
    ParameterType.PARAMETER_BYTE_ARRAY: ("byte array", "Byte values are:"),
    ParameterType.PARAMETER_BOOL_ARRAY: ("boolean array", "Boolean values are:"),
    ParameterType.PARAMETER_INTEGER_ARRAY: ("integer array", "Integer values are:"),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("double array", "Double values are:"),
    ParameterType.PARAMETER_STRING_ARRAY: ("string array", "String values are:"),
}
"""Name of each type, and the words before a value, as `ros2 param` prints them."""


class Value(NamedTuple):
    """A parameter's value, and the words before it."""

    words: str
    value: Any


class Described(NamedTuple):
    """A parameter's description.

    Attributes:
        name: its name.
        type: name of its type.
        description: help; empty if there is none.
        read_only: whether it is fixed while the node runs.
        range: smallest and largest value; None: no limits.
        constraints: further constraints, in words.
    """

    name: str
    type: str
    description: str
    read_only: bool
    range: tuple[float, float] | None
    constraints: str


class Requests:
    """Client of the nodes of this process's ROS domain."""

    def __init__(self, node: Node, executor: Executor) -> None:
        """Send requests as a node, with an executor for its context that is used for nothing else."""
        self._node = node
        self._executor = executor

    def nodes(self) -> list[str]:
        """Return the full names of all nodes, once discovery yields no new ones."""
        found: list[str] = []
        since = time.monotonic()
        while time.monotonic() - since < DISCOVERY_TIME:
            time.sleep(LOOK)
            if (names := self.present()) != found:
                found, since = names, time.monotonic()
        return found

    def resolve(self, name: str) -> str:
        """Return the full name of a node from its full name or its last part.

        Raises:
            BadInput: there is no such node, or several.
        """
        deadline = time.monotonic() + FOUND
        while not (matching := [full for full in self.present() if full == name or full.endswith(f"/{name.strip('/')}")]):
            if time.monotonic() > deadline:
                running = ", ".join(self.present()) or "none"
                where = f"ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')}"
                raise BadInput(f"no node is named '{name}'", where, f"one of those that run: {running}")
            time.sleep(LOOK)
        if len(matching) > 1 and name not in matching:
            raise BadInput(f"several nodes are named '{name}'", "command line", f"one of {', '.join(matching)}")
        return name if name in matching else matching[0]

    def names(self, node: str) -> list[str]:
        """Return the names of a node's parameters."""
        return sorted(self._ask(node, lambda client: client.list_parameters()).result.names)

    def get(self, node: str, names: Sequence[str]) -> dict[str, Value]:
        """Return values by name.

        Raises:
            BadInput: the node has no parameter of that name.
        """
        self._check(node, names)
        got = self._ask(node, lambda client: client.get_parameters(list(names)))
        return {
            name: Value(WORDS[value.type][1], _plain(parameter_value_to_python(value)))
            for name, value in zip(names, got.values, strict=True)
        }

    def describe(self, node: str, names: Sequence[str]) -> list[Described]:
        """Return descriptions.

        Raises:
            BadInput: the node has no parameter of that name.
        """
        self._check(node, names)
        return [
            _described(each) for each in self._ask(node, lambda client: client.describe_parameters(list(names))).descriptors
        ]

    def set(self, node: str, name: str, text: str) -> str:
        """Set a parameter to a value given as in YAML; return the node's remark on success.

        Raises:
            BadInput: the node has no parameter of that name.
            WorkFailed: the node refuses the value.
        """
        self._check(node, [name])
        wanted = Parameter(name, value=parameter_value_to_python(get_parameter_value(text)))
        [result] = self._ask(node, lambda client: client.set_parameters([wanted])).results
        if not result.successful:
            raise WorkFailed(f"Setting parameter failed: {result.reason or 'the node gives no reason'}")
        return str(result.reason)

    def switch(self, node: str, waiting: Callable[[str], None] | None = None) -> str:
        """Let a standby controller take over; return the answer of the plant node in its namespace.

        A controller that is starting is awaited, as it stands by only once its law is compiled.

        Args:
            node: full name of the controller's node.
            waiting: called once with the reason for waiting, if there is any.

        Raises:
            WorkFailed: no plant node is there, or it refuses.
        """
        service = f"{node.rpartition('/')[0]}/switch_controller"
        request = SwitchController.Request(controller=node)
        deadline, since_active = time.monotonic() + STARTED, 0.0
        while True:
            answer = self.call(SwitchController, service, request)
            if answer.success:
                return str(answer.message)
            state = self._state_of(node)
            starting = state is not None and state.id in STARTING
            if state is not None and state.id == State.PRIMARY_STATE_ACTIVE:
                since_active = since_active or time.monotonic()
                starting = time.monotonic() - since_active < FIRST_COMMAND
            if not starting or time.monotonic() > deadline:
                inactive = state is not None and state.id != State.PRIMARY_STATE_ACTIVE
                reason = f"{node} is {state.label}; it stands by once it is active" if inactive else answer.message
                raise WorkFailed(f"Switch refused: {reason}")
            if waiting is not None:
                waiting(f"{node} is starting: it stands by once its law is compiled")
                waiting = None
            time.sleep(LOOK)

    def call(self, kind: Any, service: str, request: Any, *, repeat: bool = True) -> Any:
        """Return the answer of a service.

        Args:
            kind: type of the service.
            service: its full name.
            request: the request.
            repeat: whether the request may be repeated if its answer gets lost.

        Raises:
            WorkFailed: no node offers the service, or it does not answer.
        """
        client = self._node.create_client(kind, service)
        if not client.wait_for_service(FOUND):
            raise WorkFailed(f"no node offers {service}")
        return self._answered(service, lambda: client.call_async(request), AGAIN if repeat else ANSWERED)

    def _state_of(self, node: str) -> Any:
        """Return the state of a lifecycle node; None if it does not answer."""
        try:
            return self.call(GetState, f"{node}/get_state", GetState.Request()).current_state
        except WorkFailed:
            return None

    def present(self) -> list[str]:
        """Return the full names of the nodes discovered so far."""
        present = self._node.get_node_names_and_namespaces()
        own = self._node.get_fully_qualified_name()
        # Names that begin with an underscore are hidden, such as those of this command and of ros2.
        full = {f"{namespace.rstrip('/')}/{name}" for name, namespace in present if not name.startswith("_")}
        return sorted(full - {own})

    def _check(self, node: str, names: Sequence[str]) -> None:
        known = self.names(node)
        for name in names:
            if name not in known:
                raise BadInput(f"no parameter '{name}'", node, f"one of those that `ehls param list {node}` prints")

    def _ask(self, node: str, request: Callable[[AsyncParameterClient], Any]) -> Any:
        client = AsyncParameterClient(self._node, node)
        if not client.wait_for_services(FOUND):
            raise WorkFailed(f"{node} offers no parameter services")
        return self._answered(node, lambda: request(client))

    def _answered(self, asked_of: str, request: Callable[[], Any], again: float = AGAIN) -> Any:
        """Return the first answer to a request, which is repeated at an interval [s]."""
        asked: list[Any] = []
        deadline = time.monotonic() + ANSWERED
        while (left := deadline - time.monotonic()) > 0.0:
            asked.append(request())
            rclpy.spin_until_future_complete(self._node, asked[-1], self._executor, min(left, again))
            for future in asked:
                if future.done():
                    return future.result()
        raise WorkFailed(f"{asked_of} has not answered for {ANSWERED:g} s")


def checked_namespace(namespace: str) -> str:
    """Return a namespace given on the command line, without slashes around it.

    Raises:
        BadInput: not a valid ROS namespace.
    """
    inner = namespace.strip("/")
    try:
        validate_namespace(f"/{inner}")
    except InvalidNamespaceException as error:
        expected = "letters, digits and underscores, such as rig2"
        raise BadInput(f"'{namespace}' is not a valid ROS namespace", "--namespace", expected) from error
    return inner


@contextmanager
def joined() -> Iterator[tuple[Node, Executor]]:
    """Join the graph as a node, with an executor for its context."""
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f"_ehls_param_{os.getpid()}", context=context, start_parameter_services=False)
    executor = SingleThreadedExecutor(context=context)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)


@contextmanager
def requests() -> Iterator[Requests]:
    """Join the graph for the duration of the requests."""
    with joined() as (node, executor):
        yield Requests(node, executor)


def _plain(value: Any) -> Any:
    """Return lists instead of arrays, for printing."""
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value


def _described(descriptor: Any) -> Described:
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    return Described(
        name=descriptor.name,
        type=WORDS[descriptor.type][0],
        description=descriptor.description,
        read_only=descriptor.read_only,
        range=(ranges[0].from_value, ranges[0].to_value) if ranges else None,
        constraints=descriptor.additional_constraints,
    )
