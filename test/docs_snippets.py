"""The code blocks of README.md and docs/: found with their marks, checked and run.

An HTML comment before a block states its treatment, other than the rule that a block is run as it is:

* ``file: NAME``    it is the content of a file that later blocks of the page use;
* ``output: WHAT``  it is the output of the last command or Python block before it, with … for parts that vary from run to run;
* ``ros: WHY``      commands are run by ``test_docs_how_to.py`` where ROS 2 is installed, and otherwise parsed;
* ``slow: WHY``     commands are parsed, and run only by `make test-long`;
* ``parsed: WHY``   commands are parsed by the real parsers and never run;
* ``not run: WHY``  nothing can be checked.

Blocks in the language ``text`` are no snippets: output, drawings and other programs' files.

A page that contains the file of a family's member, and in TOML the entry point through which a package offers it, is followed
from top to bottom by ``test_docs_how_to.py``. ``test_docs_snippets.py`` only parses its blocks.
"""

import ast
import re
import shlex
import tomllib
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from markdown_it import MarkdownIt

from ehls_ros.cli.main import parser
from ehls_ros.recording.topics import HANDOVER_TOPICS, MODEL_HEALTH, TOPICS
from ehls_ros.schema import Declaration

ROOT = Path(__file__).resolve().parent.parent
GENERATED = ROOT / "docs" / "reference"
MARK = re.compile(r"<!--\s*(?P<word>file|output|ros|slow|parsed|not run):\s*(?P<rest>.*?)\s*-->", re.DOTALL)
EHLS = ("ehls", ".venv/bin/ehls")
PYTHON = ("python", ".venv/bin/python")
SHELL = "sh"
SECOND_RIG = "/rig2/"
"""Namespace of the second rig on the pages."""


class Block(NamedTuple):
    """One block of code: its position, language, text and mark."""

    page: str
    line: int
    language: str
    text: str
    mark: str
    note: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


class Command(NamedTuple):
    """One command of a block; ``shown`` is its form on the page."""

    shown: str
    words: list[str]


def pages() -> list[str]:
    """Return the pages, relative to the repository."""
    written = [path for path in (ROOT / "docs").rglob("*.md") if not path.is_relative_to(GENERATED)]
    return sorted(str(path.relative_to(ROOT)) for path in [ROOT / "README.md", *written])


def blocks(page: str) -> list[Block]:
    """Return a page's blocks of code in order."""
    found, mark, note = [], "", ""
    for token in MarkdownIt().parse((ROOT / page).read_text(encoding="utf-8")):
        if token.type == "html_block" and (match := MARK.match(token.content.strip())):
            mark, note = match["word"], " ".join(match["rest"].split())
            continue
        if token.type in {"fence", "code_block"}:
            language = token.info.strip() if token.type == "fence" else SHELL
            if mark in {"file", "output"} or not (language == "text" or language.startswith("{")):
                found.append(Block(page, (token.map or [0])[0] + 1, language, token.content, mark, note))
        mark, note = "", ""
    return found


def members(page: str) -> dict[str, Block]:
    """Return the blocks of a page that are files of families' members, by the members' names."""
    files = [block for block in blocks(page) if block.mark == "file" and block.language == "python"]
    return {Path(block.note).stem: block for block in files if block.note.startswith("ehls_ros/")}


def has_slow_blocks(page: str) -> bool:
    """Return whether some blocks of a page run only in the long tier."""
    return any(block.mark == "slow" for block in blocks(page))


def entry_points(page: str) -> dict[str, dict[str, str]]:
    """Return the entry points on a page: by group, each member's module by its name."""
    found: dict[str, dict[str, str]] = {}
    for block in blocks(page):
        if block.language == "toml":
            found |= tomllib.loads(block.text).get("project", {}).get("entry-points", {})
    return found


def commands(block: Block) -> Iterator[Command]:
    """Yield the commands of a shell block."""
    for line in block.text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield Command(line.strip(), [word for word in words if word != "&"])


class Unknown(Exception):
    """Raised if a command refers to something that does not exist."""


def check_output(block: Block, printed: str) -> None:
    """Check that the lines of a block occur in an output, in order; … matches any text in a line.

    Raises:
        Unknown: a line was not printed.
    """
    at = 0
    for line in filter(None, map(str.strip, block.text.splitlines())):
        pattern = ".*?".join(r"\s+".join(map(re.escape, part.split())) for part in line.split("…"))
        found = re.compile(pattern).search(printed, at)
        if found is None:
            raise Unknown(f"{line!r} is not what comes out: {printed}")
        at = found.end()


class ParametersOf:
    """Nodes, launch arguments and services as listed on the reference pages."""

    def __init__(self, reference: Any) -> None:
        """Take the module that generates the reference pages."""
        self._reference = reference

    def node(self, name: str) -> Mapping[str, Declaration]:
        """Return a node's parameters."""
        if name not in self._reference.node_names():
            raise Unknown(f"there is no node {name}")
        found: Mapping[str, Declaration] = self._reference.node_parameters(name)
        return found

    def launch(self) -> set[str]:
        """Return the launch file's arguments."""
        return set(self._reference.launch_arguments())

    def services(self) -> dict[str, str]:
        """Return the types of the services by name."""
        rows = self._reference.services()
        return {name.strip("`"): kind.strip("`") for name, kind, _ in rows}

    def topics(self) -> set[str]:
        """Return the topics."""
        return {topic.resolve() for topic in (*TOPICS, MODEL_HEALTH, *HANDOVER_TOPICS)}


def check(command: Command, parameters_of: ParametersOf, made: Sequence[str]) -> Namespace | None:
    """Parse a command with the parser of its program.

    Args:
        command: the command.
        parameters_of: gives a node's parameters.
        made: files that earlier blocks of the page have made.

    Returns:
        The options of an `ehls` command.

    Raises:
        Unknown: a verb, option, file, target, node, parameter, argument or service is not there.
    """
    program, *rest = command.words
    if program in EHLS:
        return check_ehls(rest, made)
    if program == "make":
        check_make(rest)
    elif program in PYTHON:
        check_python(rest)
    elif program == "ros2":
        check_ros2(rest, parameters_of)
    else:
        raise Unknown(f"nobody knows how to check {program!r}: mark the block with why it is not run")
    return None


def check_ehls(words: list[str], made: Sequence[str]) -> Namespace:
    """Parse an `ehls` command; input files in a folder of the repository must exist."""
    try:
        options = parser().parse_args(words)
    except SystemExit as end:
        raise Unknown(f"ehls {' '.join(words)} is refused") from end
    values = (value for values in vars(options).values() for value in (values if isinstance(values, list) else [values]))
    for path in (value for value in values if isinstance(value, Path) and value != getattr(options, "out", None)):
        if len(path.parts) > 1 and (ROOT / path.parts[0]).is_dir() and path.parts[0] != "runs" and not (ROOT / path).exists():
            raise Unknown(f"{path} is not there")
        if path.suffix == ".yaml" and len(path.parts) == 1 and str(path) not in made:
            raise Unknown(f"{path} is not made on the page")
    return options


def check_make(words: list[str]) -> None:
    """Check the targets, and the groups to install."""
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    if missing := {word for word in words if "=" not in word} - targets:
        raise Unknown(f"make has no target {', '.join(missing)}")
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    wanted = {group for word in words if word.startswith("WITH=") for group in word.removeprefix("WITH=").split()}
    if missing := wanted - groups.keys():
        raise Unknown(f"there is no group {', '.join(missing)}")


def check_python(words: list[str]) -> None:
    """Check that the script or the file of tests exists, and that a script's options are in its text."""
    if words[:2] == ["-m", "pytest"]:
        words = [word for word in words[2:] if word.startswith("test/")]
        if missing := [word for word in words if not (ROOT / word).exists()]:
            raise Unknown(f"{', '.join(missing)} is not there")
        return
    script = ROOT / words[0]
    if not script.is_file():
        raise Unknown(f"{words[0]} is not there")
    text = script.read_text(encoding="utf-8")
    if missing := [word for word in words[1:] if word.startswith("--") and f'"{word}"' not in text]:
        raise Unknown(f"{words[0]} has no {', '.join(missing)}")


def check_ros2(words: list[str], parameters_of: ParametersOf) -> None:
    """Check nodes, their transitions and parameters with ranges, launch arguments, topics and services."""
    match words:
        case ["run", "ehls_ros", node, *rest]:
            known = parameters_of.node(node)
            for given in (rest[i + 1] for i, word in enumerate(rest) if word == "-p"):
                name, _, value = given.partition(":=")
                check_value(known, name, value)
        case ["launch", "ehls_ros", file, *rest]:
            if not (ROOT / "launch" / file).is_file():
                raise Unknown(f"there is no launch file {file}")
            if missing := {word.partition(":=")[0] for word in rest} - parameters_of.launch():
                raise Unknown(f"the launch file has no {', '.join(missing)}")
        case ["param", ("set" | "get" | "describe"), node, name, *value]:
            check_value(parameters_of.node(node.rpartition("/")[2]), name, *value)
        case ["lifecycle", "set", node, ("configure" | "activate" | "deactivate" | "cleanup" | "shutdown")]:
            parameters_of.node(node.rpartition("/")[2])
        case ["topic", _, topic]:
            if in_first_rig(topic) not in parameters_of.topics():
                raise Unknown(f"there is no topic {topic}")
        case ["service", "call", service, kind, *_]:
            if parameters_of.services().get(in_first_rig(service)) != kind:
                raise Unknown(f"there is no service {service} of type {kind}")
        case _:
            raise Unknown(f"nobody knows how to check ros2 {' '.join(words)}")


def in_first_rig(name: str) -> str:
    """Return the first rig's name of a topic or service of the second."""
    return f"/ehls/{name.removeprefix(SECOND_RIG)}" if name.startswith(SECOND_RIG) else name


def check_value(known: Mapping[str, Declaration], name: str, value: str | None = None) -> None:
    """Check that a parameter is there and takes a value."""
    if name not in known:
        raise Unknown(f"there is no parameter {name}")
    declared = known[name]
    if value is None or declared.kind not in {int, float}:
        return
    number = ast.literal_eval(value)
    low, high = declared.minimum, declared.maximum
    if (low is not None and number < low) or (high is not None and number > high):
        raise Unknown(f"{name} does not take {value}")
