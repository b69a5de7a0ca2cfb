"""ROS parameters from the declarations of a parameter set."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter

from ehls_ros.errors import BadInput
from ehls_ros.schema import Declaration, declarations, parse

Parameters = TypeVar("Parameters")

LARGEST_INTEGER = 2**63 - 1


class DeclaredParameters(LifecycleNode):
    """A lifecycle node that checks its parameters against their declarations, wherever they are set.

    Command line, file and live change accept the same values and refuse others in the same words. An unchanged read-only
    parameter is accepted, so that the output of `ros2 param dump` can be loaded.
    """

    def __init__(self, name: str, **options: Any) -> None:
        """Create the node, without parameters.

        Args:
            name: of the node.
            options: further arguments of ``rclpy.lifecycle.LifecycleNode``.
        """
        self.declared: dict[str, tuple[type, Declaration]] = {}
        super().__init__(name, **options)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all parameters or none; rclpy calls this for every request from another process, too."""
        changes = [self._coerced(change) for change in parameter_list if not self._is_kept(change)]
        try:
            self._check(changes)
        except BadInput as error:
            return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(changes) if changes else SetParametersResult(successful=True)

    def _is_kept(self, change: Parameter) -> bool:
        """Return whether a read-only parameter keeps its value; the command line may convert the type of a quoted text."""
        if not self.has_parameter(change.name) or not self.describe_parameter(change.name).read_only:
            return False
        value = self.get_parameter(change.name).value
        return bool(change.value == value or str(change.value) == value)

    def _coerced(self, change: Parameter) -> Parameter:
        if change.name not in self.declared:
            return change
        value = coerced(self.declared[change.name][1], change.value)
        return change if value is change.value else Parameter(change.name, value=value)

    def _check(self, changes: Sequence[Parameter]) -> None:
        """Raise BadInput if a parameter is unknown, is to be removed, or does not fit its declaration."""
        for change in changes:
            if not self.has_parameter(change.name):
                raise BadInput(f"parameter {change.name!r} is unknown", self.get_name(), "one of `ros2 param list`")
            if change.type_ is Parameter.Type.NOT_SET:
                raise BadInput(f"parameter {change.name!r} cannot be removed", self.get_name(), "another value")
        for parameters in {self.declared[change.name][0] for change in changes if change.name in self.declared}:
            parse(parameters, self.requested(parameters, changes), self.get_name())

    def requested(self, parameters: type, changes: Sequence[Parameter]) -> dict[str, Any]:
        """Return the values of a parameter set after the changes."""
        present = {name: self.get_parameter(name).value for name, (kind, _) in self.declared.items() if kind is parameters}
        return present | {change.name: change.value for change in changes if change.name in present}


def declare(node: DeclaredParameters, parameters: type, values: Mapping[str, Any] | None = None, *, live: bool) -> None:
    """Declare a parameter set on a node, with the values from command line and files.

    Args:
        node: owner.
        parameters: the ``NamedTuple`` class with the declarations.
        values: values that replace the declared defaults.
        live: whether the parameters may change while the node runs.

    Raises:
        BadInput: a value does not fit its declaration.
    """
    declared = {entry.name: entry for entry in declarations(parameters) if entry.kind in (float, int, str, bool)}
    with node.handle:
        given: Mapping[str, Parameter] = node.handle.get_parameters(Parameter)
    chosen = {name: (values or {}).get(name, entry.default) for name, entry in declared.items()}
    chosen |= {name: given[name].value for name in declared if name in given}
    chosen = {name: coerced(declared[name], value) for name, value in chosen.items()}
    parse(parameters, chosen, node.get_name())
    for name, entry in declared.items():
        node.declare_parameter(name, chosen[name], _descriptor(entry, live=live), ignore_override=True)
        node.declared[name] = parameters, entry


def coerced(declared: Declaration, value: Any) -> Any:
    """Return a value converted to its declared type if that is lossless, otherwise the value itself.

    Args:
        declared: the parameter's declaration.
        value: an integer is accepted for a float, and so is text that is a number: YAML reads ``1e-06``, which
            `ros2 param dump` writes, as text.
    """
    if declared.kind is float and isinstance(value, int | str) and not isinstance(value, bool):
        with suppress(ValueError):
            return float(value)
    if declared.kind is int and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _descriptor(declared: Declaration, *, live: bool) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=declared.text, read_only=not live)
    if declared.kind is float and (declared.minimum is not None or declared.maximum is not None):
        low = declared.minimum if declared.minimum is not None else -1e308
        high = declared.maximum if declared.maximum is not None else 1e308
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    if declared.kind is int and declared.minimum is not None:
        high = int(declared.maximum) if declared.maximum is not None else LARGEST_INTEGER
        descriptor.integer_range = [IntegerRange(from_value=int(declared.minimum), to_value=high)]
    return descriptor


def values_of(node: Node, parameters: type[Parameters], where: str) -> Parameters:
    """Build a parameter set from a node's parameters.

    Raises:
        BadInput: a value does not fit its declaration.
    """
    names = [d.name for d in declarations(parameters) if node.has_parameter(d.name)]
    return parse(parameters, {name: node.get_parameter(name).value for name in names}, where)


def follow(
    node: DeclaredParameters,
    parameters: type[Parameters],
    retune: Callable[[Parameters], None],
    objection: Callable[[Parameters], BadInput | None] = lambda _: None,
) -> None:
    """Call a function on every accepted change of a parameter set.

    Args:
        node: owner, on which the set was declared live.
        parameters: the ``NamedTuple`` class.
        retune: called with the complete set after a change.
        objection: further check of a set that fits its declaration; returns the error or None.
    """

    def check(changes: Sequence[Parameter]) -> SetParametersResult:
        wrong = objection(parse(parameters, node.requested(parameters, changes), node.get_name()))
        return SetParametersResult(successful=wrong is None, reason="" if wrong is None else str(wrong))

    def changed(changes: Sequence[Parameter]) -> None:
        if any(node.declared.get(change.name, (None,))[0] is parameters for change in changes):
            retune(values_of(node, parameters, node.get_name()))

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(changed)
