"""`ehls param`: parameters of running nodes, without `ros2 param`."""

import json
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

import yaml

from ehls_ros.cli.arguments import needs_ros
from ehls_ros.errors import BadInput

if TYPE_CHECKING:
    from ehls_ros.nodes.parameter_requests import Described, Requests

HELP = "List, get, set, describe or dump parameters of a running node, as `ros2 param` does."

USES = {
    "list": ("[NODE]", 0, 1),
    "get": ("NODE NAME", 2, 2),
    "set": ("NODE NAME VALUE", 3, 3),
    "describe": ("NODE NAME [NAME ...]", 2, None),
    "dump": ("NODE", 1, 1),
}
"""Arguments of each action, with their minimum and maximum number."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("action", choices=tuple(USES), help="request")
    follows = "; ".join(f"{action} {use}" for action, (use, _, _) in USES.items())
    parser.add_argument(
        "words", nargs="*", metavar="WORD", help=f"arguments: {follows}; a node by its full name or its last part"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(options: Namespace) -> int:
    """Ask the node and print its answer."""
    use, least, most = USES[options.action]
    words: list[str] = options.words
    if len(words) < least or (most is not None and len(words) > most):
        raise BadInput(f"{len(words)} words follow '{options.action}'", "command line", f"ehls param {options.action} {use}")
    with needs_ros():
        from ehls_ros.nodes.parameter_requests import requests
    with requests() as ask:
        content, text = _answer(ask, options.action, *words)
    print(json.dumps(content) if options.json else text)
    return 0


def _answer(ask: "Requests", action: str, *words: str) -> tuple[Any, str]:
    """Return the answer as data and in the output format of `ros2 param`."""
    if action == "list":
        return _listed(ask, [ask.resolve(word) for word in words])
    node, names = ask.resolve(words[0]), words[1:]
    if action == "get":
        [value] = ask.get(node, names).values()
        return {names[0]: value.value}, f"{value.words} {value.value}"
    if action == "set":
        remark = ask.set(node, *names)
        return {"successful": True, "reason": remark}, f"Set parameter successful{f': {remark}' if remark else ''}"
    if action == "describe":
        found = ask.describe(node, names)
        return [each._asdict() for each in found], "\n".join(map(_description, found))
    values = {name: value.value for name, value in ask.get(node, ask.names(node)).items()}
    dumped = {node: {"ros__parameters": values}}
    return dumped, yaml.safe_dump(dumped, default_flow_style=False).rstrip("\n")


def _listed(ask: "Requests", chosen: list[str]) -> tuple[Any, str]:
    """Return the parameters of one node, or of all nodes by name."""
    content = {node: ask.names(node) for node in chosen or ask.nodes()}
    lines = [
        line for node, names in content.items() for line in ([] if chosen else [f"{node}:"]) + [f"  {name}" for name in names]
    ]
    return content, "\n".join(lines)


def _description(described: "Described") -> str:
    """Return a description in the output format of `ros2 param`."""
    lines = [f"Parameter name: {described.name}", f"  Type: {described.type}"]
    lines += [f"  Description: {described.description}"] if described.description else []
    lines += ["  Constraints:"]
    lines += ["    Read only: true"] if described.read_only else []
    if described.range is not None:
        low, high = described.range
        lines += [f"    Min value: {low}", f"    Max value: {high}"]
    lines += [f"    Additional constraints: {described.constraints}"] if described.constraints else []
    return "\n".join(lines)
