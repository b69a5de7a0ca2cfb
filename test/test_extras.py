"""Every error about a missing optional library names the command that installs it, and that command works."""

import ast
import sys
import tomllib
from pathlib import Path

import pytest

from ehls_ros import extras

ROOT = Path(__file__).resolve().parent.parent


def extras_named() -> set[str]:
    """Return the extras that the sources refer to."""
    found: set[str] = set()
    for file in (ROOT / "ehls_ros").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {"library", "missing"}:
                found.update(ast.literal_eval(word) for word in node.args[1:2] if isinstance(word, ast.Constant))
    return found


def test_every_extra_that_is_asked_for_is_a_dependency_group_and_an_extra_of_the_package() -> None:
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    asked = extras_named()
    assert asked >= {"campaign", "dashboard", "files", "foxglove", "nidaqmx", "optimisers"}
    assert asked <= groups.keys()
    (line,) = (line for line in (ROOT / "setup.py").read_text(encoding="utf-8").splitlines() if line.startswith("EXTRAS = "))
    assert asked <= set(ast.literal_eval(line.removeprefix("EXTRAS = ")))


def test_in_the_checkout_make_installs_an_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "prefix", str(ROOT / ".venv"))
    monkeypatch.chdir(ROOT)
    assert extras.install_command("dashboard") == "make setup WITH=dashboard"
    monkeypatch.chdir(ROOT / "docs")
    assert extras.install_command("dashboard") == "make -C .. setup WITH=dashboard"


def test_elsewhere_pip_of_the_running_python_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", "/usr")
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    assert extras.install_command("files") == "/usr/bin/python3 -m pip install 'ehls_ros[files]'"
