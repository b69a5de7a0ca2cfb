"""Safe reading of untrusted YAML: plain data in bounded time and memory, or an error with the line.

PyYAML alone keeps the last of several equal keys, expands aliases to any size, overflows the stack on deep nesting, and raises
Python exceptions on an invalid date or number.
"""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml
from yaml.constructor import ConstructorError
from yaml.nodes import MappingNode, Node

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.regular_file import read_text

try:
    from yaml import CSafeLoader as SafeLoader
except ImportError:  # PyYAML built without libyaml: same result, eight times slower
    from yaml import SafeLoader  # type: ignore[assignment]

NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")

EXPONENT = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+\Z")
"""Numbers such as 1e3 and 2.5e6, which are strings in YAML 1.1 but numbers in ROS."""

EXPECTED = "valid YAML without aliases or duplicate keys"


def read_yaml(path: Path, what: str) -> Any:
    """Read a YAML file.

    Args:
        path: the file.
        what: kind of file, such as ``rig file``.

    Returns:
        Mappings, lists and scalars.

    Raises:
        BadInput: the file cannot be read, or :func:`parse_yaml` rejects it.
    """
    return parse_yaml(read_text(path, limits.TEXT, "a YAML file", what), str(path), what)


def parse_yaml(text: str, where: str, what: str) -> Any:
    """Parse one YAML document.

    Args:
        text: the document.
        where: its file, for errors.
        what: kind of file, such as ``rig file``.

    Returns:
        Mappings, lists and scalars.

    Raises:
        BadInput: the text is not YAML, too long or nested too deeply, or has an alias or a duplicate key.
    """
    if len(text) > limits.TEXT:
        raise BadInput(f"{what} has {len(text)} characters", where, f"at most {limits.TEXT}")
    try:
        _check_structure(text)
        return yaml.load(text, _Loader)  # noqa: S506 - it is a SafeLoader
    except yaml.YAMLError as error:
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        place = f"{where}:{line + 1}" if line is not None else where
        problem = " ".join(str(getattr(error, "problem", error)).split())
        raise BadInput(f"{what} is not valid YAML ({problem})", place, EXPECTED) from None


def _check_structure(text: str) -> None:
    """Reject deep nesting and aliases before any value is constructed."""
    depth = 0
    for event in yaml.parse(text, SafeLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > limits.YAML_DEPTH:
                raise _complaint(f"collections are nested {depth} deep", event.start_mark)
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.AliasEvent):
            raise _complaint(f"alias *{event.anchor}", event.start_mark)


def _complaint(problem: str, mark: Any) -> ConstructorError:
    return ConstructorError(None, None, problem, mark)


def _misfit(node: Node) -> ConstructorError:
    return _complaint(f"{str(node.value)[:40]!r} is not a valid {node.tag.rpartition(':')[2]}", node.start_mark)


class _Loader(SafeLoader):
    """PyYAML's safe loader, with an error for every invalid value and duplicate key."""

    def construct_object(self, node: Node, deep: bool = False) -> Any:
        """Construct the value of a node."""
        if node.tag in NUMBERS and len(node.value) > limits.YAML_NUMBER:
            raise _misfit(node)
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            raise _misfit(node) from None

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Construct a mapping with unique keys."""
        mapping = super().construct_mapping(node, deep)
        seen: set[Hashable] = set()
        for key_node, _ in node.value if len(mapping) < len(node.value) else ():
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise _complaint(f"duplicate key {key!r}", key_node.start_mark)
            seen.add(key)
        return mapping


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", EXPONENT, list("-+.0123456789"))
