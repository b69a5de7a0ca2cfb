"""YAML of any origin: plain data in bounded time and memory, or one line that says where it is wrong.

PyYAML alone lets the last of several equal keys win, follows aliases that unfold to any size, overflows the stack when
brackets are nested deeply, and raises whatever a wrong date or number makes Python raise.
"""

from collections.abc import Hashable
from typing import Any

import yaml
from yaml.constructor import ConstructorError
from yaml.nodes import MappingNode, Node

from ehls_ros.errors import BadInput

try:
    from yaml import CSafeLoader as SafeLoader
except ImportError:  # PyYAML built without libyaml: the same at an eighth of the speed
    from yaml import SafeLoader  # type: ignore[assignment]

LARGEST = 4 * 2**20
"""Longest text that is read; a load spectrum of 10^5 points is shorter [characters]."""

DEEPEST = 50
"""Collections within each other; a spec has six."""

NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")

LONGEST_NUMBER = 400
"""Characters of a number; the largest float has 309 digits."""

EXPECTED = "valid YAML without aliases, each key once"


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
    if len(text) > LARGEST:
        raise BadInput(f"{what} has {len(text)} characters", where, f"at most {LARGEST}")
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
            if depth > DEEPEST:
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
        if node.tag in NUMBERS and len(node.value) > LONGEST_NUMBER:
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
