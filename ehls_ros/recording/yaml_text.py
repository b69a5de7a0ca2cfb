"""YAML of any origin: plain data in bounded time and memory, or one line that says where it is wrong.

PyYAML alone lets the last of several equal keys win, follows aliases that unfold to any size, overflows the stack when
brackets are nested deeply, and raises whatever a wrong date or number makes Python raise.
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
except ImportError:  # PyYAML built without libyaml: the same at an eighth of the speed
    from yaml import SafeLoader  # type: ignore[assignment]

NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")

EXPONENT = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+\Z")
"""Numbers such as 1e3 and 2.5e6, which are texts to YAML 1.1 and numbers to ROS and to everybody who writes them."""

EXPECTED = "valid YAML without aliases, each key once"


def read_yaml(path: Path, what: str) -> Any:
    """Read a YAML file.

    Args:
        path: the file.
        what: what the file is, such as ``rig file``.

    Returns:
        Mappings, lists and scalars.

    Raises:
        BadInput: it cannot be read, or is refused by :func:`parse_yaml`.
    """
    return parse_yaml(read_text(path, limits.TEXT, "a YAML file", what), str(path), what)


def parse_yaml(text: str, where: str, what: str) -> Any:
    """Parse one YAML document.

    Args:
        text: the document.
        where: its file, for errors.
        what: what the file is, such as ``rig file``.

    Returns:
        Mappings, lists and scalars.

    Raises:
        BadInput: it is no YAML, too long, nested too deeply, or has an alias or the same key twice in a mapping.
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
        raise BadInput(f"{what} is no YAML ({problem})", place, EXPECTED) from None


def _check_structure(text: str) -> None:
    """Refuse what takes more stack or memory than its text is long, before anything is built of it."""
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
    return _complaint(f"{str(node.value)[:40]!r} is no {node.tag.rpartition(':')[2]}", node.start_mark)


class _Loader(SafeLoader):
    """PyYAML's safe loader, which complains with the line about what it otherwise takes or stumbles over."""

    def construct_object(self, node: Node, deep: bool = False) -> Any:
        """Build what a node says."""
        if node.tag in NUMBERS and len(node.value) > limits.YAML_NUMBER:
            raise _misfit(node)
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            raise _misfit(node) from None

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Build a mapping whose keys all differ."""
        mapping = super().construct_mapping(node, deep)
        seen: set[Hashable] = set()
        for key_node, _ in node.value if len(mapping) < len(node.value) else ():
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise _complaint(f"key {key!r} is there twice", key_node.start_mark)
            seen.add(key)
        return mapping


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", EXPONENT, list("-+.0123456789"))
