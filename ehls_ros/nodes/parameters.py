"""ROS parameters from the declarations of a parameter set."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from ehls_ros.errors import BadInput
from ehls_ros.schema import Declaration, declarations, parse

Parameters = TypeVar("Parameters")

LARGEST_INTEGER = 2**63 - 1


def declare(node: Node, parameters: type, values: dict[str, Any] | None = None, *, live: bool) -> None:
    """Declare a parameter set on a node.

    Args:
        node: owner.
        parameters: the ``NamedTuple`` class with the declarations.
        values: values that replace the declared defaults.
        live: whether the parameters may change while the node runs.
    """
    for declared in declarations(parameters):
        value = (values or {}).get(declared.name, declared.default)
        if declared.kind in (float, int, str, bool):
            node.declare_parameter(declared.name, declared.kind(value), _descriptor(declared, live=live))


def _descriptor(declared: Declaration, *, live: bool) -> ParameterDescriptor:
    unit = f" [{declared.unit}]" if declared.unit else ""
    descriptor = ParameterDescriptor(description=f"{declared.description}{unit}", read_only=not live)
    if declared.kind is float and (declared.minimum is not None or declared.maximum is not None):
        low = declared.minimum if declared.minimum is not None else -1e308
        high = declared.maximum if declared.maximum is not None else 1e308
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    if declared.kind is int and declared.minimum is not None:
        high = int(declared.maximum) if declared.maximum is not None else LARGEST_INTEGER
        descriptor.integer_range = [IntegerRange(from_value=int(declared.minimum), to_value=high)]
    return descriptor


def refuse_unknown(node: Node) -> None:
    """Refuse to change unknown parameters or to remove any; rclpy lets both pass in some cases."""

    def check(changes: Sequence[Parameter]) -> SetParametersResult:
        for change in changes:
            if not node.has_parameter(change.name):
                return SetParametersResult(successful=False, reason=f"parameter {change.name!r} is unknown")
            if change.type_ is Parameter.Type.NOT_SET:
                return SetParametersResult(successful=False, reason=f"parameter {change.name!r} cannot be removed")
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def values_of(node: Node, parameters: type[Parameters], where: str) -> Parameters:
    """Build a parameter set from a node's parameters.

    Raises:
        BadInput: a value does not fit its declaration.
    """
    names = [d.name for d in declarations(parameters) if node.has_parameter(d.name)]
    return parse(parameters, {name: node.get_parameter(name).value for name in names}, where)


def follow(
    node: Node,
    parameters: type[Parameters],
    retune: Callable[[Parameters], None],
    objection: Callable[[Parameters], BadInput | None] = lambda _: None,
) -> None:
    """Pass on every accepted change of a parameter set, and refuse invalid ones with the reason.

    An integer is accepted for a float.

    Args:
        node: owner, on which the set was declared live.
        parameters: the ``NamedTuple`` class.
        retune: called with the complete set after a change.
        objection: further check of a set that fits its declaration; returns the error or None.
    """
    kinds = {d.name: d.kind for d in declarations(parameters) if node.has_parameter(d.name)}

    def coerce(changes: list[Parameter]) -> list[Parameter]:
        return [
            Parameter(change.name, Parameter.Type.DOUBLE, float(change.value))
            if kinds.get(change.name) is float and change.type_ is Parameter.Type.INTEGER
            else change
            for change in changes
        ]

    def check(changes: Sequence[Parameter]) -> SetParametersResult:
        requested = {name: node.get_parameter(name).value for name in kinds}
        requested.update({change.name: change.value for change in changes if change.name in kinds})
        try:
            wrong = objection(parse(parameters, requested, node.get_name()))
        except BadInput as error:
            wrong = error
        return SetParametersResult(successful=wrong is None, reason="" if wrong is None else str(wrong))

    def changed(changes: Sequence[Parameter]) -> None:
        if any(change.name in kinds for change in changes):
            retune(values_of(node, parameters, node.get_name()))

    node.add_pre_set_parameters_callback(coerce)
    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(changed)
