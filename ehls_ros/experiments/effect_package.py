"""A Python package of a user's effects: its files, and their entry points in ``pyproject.toml``."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.physics.effects import EFFECTS

PROJECT = """[build-system]
requires = ["setuptools>=64"]
build-backend = "setuptools.build_meta"

[project]
name = "{distribution}"
version = "1.0"
dependencies = ["ehls_ros"]

[tool.setuptools]
packages = ["{package}"]
"""
"""Content of a new ``pyproject.toml``."""

HEADING = f'[project.entry-points."{EFFECTS.group}"]'
"""Heading of the effects' entry points."""


class Added(NamedTuple):
    """Files of a package after an effect was added.

    Attributes:
        effect: the effect's file.
        project: ``pyproject.toml``.
    """

    effect: Path
    project: Path


def check_name(name: str) -> None:
    """Check the name of a new effect.

    Raises:
        BadInput: it is no name of a Python module, or taken by an effect of this project.
    """
    if not name.isidentifier() or name != name.lower() or name.startswith("_"):
        raise BadInput(f"the effect's name is {name!r}", "command line", "lower-case letters, digits and underscores")
    if name in EFFECTS.own_names():
        raise BadInput(f"ehls has an effect {name!r} already", "command line", "another name")


def add_effect(folder: Path, name: str, text: str, *, overwrite: bool = False) -> Added:
    """Write an effect into a package, which is made if there is none, and register it.

    Args:
        folder: folder of ``pyproject.toml``.
        name: name of the effect.
        text: content of its file.
        overwrite: whether to replace an effect of that name.

    Raises:
        BadInput: the effect is there already, ``pyproject.toml`` cannot be extended, or a file cannot be written.
    """
    check_name(name)
    project = folder / "pyproject.toml"
    before = project.read_text(encoding="utf-8") if project.exists() else None
    content = {} if before is None else _parsed(before, project)
    package = _package(content, folder, project)
    module = f"{package}.{name}"
    path = _place(folder, package) / f"{name}.py"
    points = _points(content)
    if path.exists() and not overwrite:
        raise BadInput("the effect is there already", str(path), "another name, or --overwrite")
    if points.get(name, module) != module:
        raise BadInput(f"the effect {name!r} is {points[name]!r}", str(project), f"{module!r}, or another name")
    after = before or PROJECT.format(distribution=package.replace("_", "-"), package=package)
    if name not in points:
        after = _registered(after, f'{name} = "{module}"')
        if _points(_parsed(after, project)).get(name) != module:
            raise BadInput("the effect cannot be registered", str(project), f'{name} = "{module}" under {HEADING}')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        first = path.with_name("__init__.py")
        if not first.exists():
            first.write_text('"""Effects of our rigs."""\n', encoding="utf-8")
        path.write_text(text, encoding="utf-8")
        project.write_text(after, encoding="utf-8")
    except OSError as error:
        raise BadInput(f"the file cannot be written ({error.strerror})", str(path), "a writable folder") from None
    return Added(path, project)


def _parsed(text: str, project: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"no TOML ({error})", str(project), "a valid pyproject.toml") from None


def _points(content: Mapping[str, Any]) -> dict[str, str]:
    points: dict[str, str] = content.get("project", {}).get("entry-points", {}).get(EFFECTS.group, {})
    return points


def _package(content: Mapping[str, Any], folder: Path, project: Path) -> str:
    """Return the name of the package: that of the effects already registered, otherwise the distribution's."""
    if points := _points(content):
        return next(iter(points.values())).rpartition(".")[0]
    name = str(content.get("project", {}).get("name", "") or folder.resolve().name)
    package = name.replace("-", "_").replace(".", "_").lower()
    if not package.isidentifier():
        raise BadInput(f"the package's name would be {package!r}", str(project), "letters, digits and underscores")
    return package


def _place(folder: Path, package: str) -> Path:
    parts = package.split(".")
    inside = folder / "src"
    return inside.joinpath(*parts) if inside.joinpath(*parts).is_dir() else folder.joinpath(*parts)


def _registered(text: str, line: str) -> str:
    """Return the text of ``pyproject.toml`` with one more entry point of an effect."""
    lines = text.splitlines()
    places = [number for number, written in enumerate(lines) if written.strip() == HEADING]
    if places:
        lines.insert(places[0] + 1, line)
    else:
        lines += ["", HEADING, line]
    return "\n".join(lines) + "\n"
