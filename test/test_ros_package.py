"""On a ROS 2 machine: package.xml is sufficient, and missing packages are reported with the line that installs them."""

import ast
import importlib
import os
import runpy
import shutil
import subprocess
import sys
from importlib.metadata import requires
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree as ET

import pytest
import yaml

import ehls_ros.nodes
from ehls_ros.cli.main import main
from ehls_ros.cli.verbs import VERBS
from ehls_ros.nodes import node_names

ROOT = Path(__file__).resolve().parent.parent

ROSDEP_KEYS = {
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "pandas": "python3-pandas",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
}
"""Keys of rosdistro's rosdep/python.yaml (commit 8468e88) by the package that is imported; all have a rule for Ubuntu."""

WITH_ROSBAGS = {"backports", "compression", "lz4"}
"""Dependencies of rosbags that it installs; ``compression`` is Python's own from 3.14 on."""

WITH_NUMBA = {"llvmlite"}
"""Dependencies of numba that it installs."""

OPTIONAL = {
    "distributed",
    "fastapi",
    "fmpy",
    "foxglove",
    "h11",
    "nicegui",
    "orjson",
    "pyarrow",
    "pymoo",
    "pyswarms",
    "starlette",
    "uvicorn",
}
"""Packages installed by the extras."""

BY_NAME = {"joblib", "plotly", "shtab"}
"""Imported by name where they are used, and not declared: rosdep does not know them, or noble's is too old."""

LATE = {"pandas"}
"""Imported by name because the import takes long, and declared."""


def imported() -> set[str]:
    """Return the top-level packages that the sources import, except for the standard library's and our own."""
    found: set[str] = set()
    for file in (*(ROOT / "ehls_ros").rglob("*.py"), *(ROOT / "launch").glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - {"ehls_ros"}


@pytest.mark.long
def test_package_xml_asks_for_what_is_imported_and_nothing_else() -> None:
    manifest = ET.parse(ROOT / "package.xml").getroot()
    asked = {element.text for element in manifest.iter("exec_depend")}
    needed = imported() - WITH_ROSBAGS - WITH_NUMBA - OPTIONAL - BY_NAME | LATE  # of BY_NAME, types alone are imported
    assert asked == {ROSDEP_KEYS.get(name, name) for name in needed}


def test_numba_brings_what_writes_intermediate_code() -> None:
    brought = " ".join(requires("numba") or [])
    assert all(name in brought for name in WITH_NUMBA)


def test_rosbags_brings_what_expands_bags() -> None:
    brought = " ".join(requires("rosbags") or [])
    assert all(name in brought for name in WITH_ROSBAGS - {"compression"})


def test_nodes_and_verbs_load_without_what_package_xml_does_not_bring() -> None:
    hidden = sorted(OPTIONAL | BY_NAME | {"pydantic"})
    load = (
        f"import sys\nsys.modules.update(dict.fromkeys({hidden}))\n"
        "from importlib import import_module\nfrom ehls_ros.cli.verbs import VERBS\nfrom ehls_ros.nodes import node_names\n"
        "[VERBS.load(name) for name in VERBS.names()]\n"
    )
    if importlib.util.find_spec("rclpy"):
        load += "[import_module(f'ehls_ros.nodes.{name}') for name in node_names()]\n"
    done = subprocess.run([sys.executable, "-c", load], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert VERBS.names()
    assert node_names()


def test_completion_without_shtab_names_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--print-completion", "bash"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("shtab is not installed; expected pip install shtab, or apt install python3-shtab")


def test_a_node_without_its_messages_says_how_to_get_them(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = [finder for finder in sys.meta_path if getattr(finder, "__module__", "") == "ehls_ros.nodes"]
    monkeypatch.setattr(sys, "meta_path", ours)
    monkeypatch.delitem(sys.modules, "ehls_msgs", raising=False)
    with pytest.raises(ModuleNotFoundError) as caught:
        importlib.import_module("ehls_msgs")
    assert str(caught.value) == ehls_ros.nodes.WITHOUT_MESSAGES


LINE = "ln -sfn ehls_ros/ehls_msgs src/ehls_msgs && colcon build --packages-up-to ehls_ros"


# --- colcon -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package folder in a workspace, with the files that setup.py examines before it sets up."""
    package = tmp_path / "src" / "ehls_ros"
    package.mkdir(parents=True)
    shutil.copy(ROOT / "setup.py", package)
    return package


@pytest.mark.parametrize("command", ["install", "develop"])
def test_a_build_without_the_messages_ends_with_the_line_that_builds_both(package: Path, command: str) -> None:
    done = subprocess.run(
        [sys.executable, "setup.py", command],
        cwd=package,
        env=os.environ | {"AMENT_PREFIX_PATH": "/nowhere"},
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert done.stderr.endswith(f"in the workspace's folder: {LINE}\n")
    assert LINE in ehls_ros.nodes.WITHOUT_MESSAGES
    assert LINE.partition(" && ")[0] in (ROOT / "docs/how_to/ros_machine.md").read_text(encoding="utf-8")


def test_colcon_finds_both_packages_from_a_workspace_and_from_the_checkout(tmp_path: Path) -> None:
    pytest.importorskip("colcon_core", reason="colcon is not installed")
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "ehls_ros").symlink_to(ROOT)
    (tmp_path / "src" / "ehls_msgs").symlink_to("ehls_ros/ehls_msgs")
    for folder in (tmp_path, ROOT):
        listed = subprocess.run(
            [sys.executable, "-c", "from colcon_core.command import main; main()", "list", "--names-only"],
            cwd=folder,
            env=os.environ | {"COLCON_LOG_PATH": str(tmp_path / "log")},
            check=True,
            capture_output=True,
            text=True,
        )
        assert listed.stdout.split() == ["ehls_msgs", "ehls_ros"]


def test_colcon_test_is_told_of_pytest_and_of_tests_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    build = pytest.importorskip("colcon_core.task.python.test", reason="colcon is not installed")
    setuptools: ModuleType = pytest.importorskip("setuptools", reason="setuptools is not installed")
    told: dict[str, object] = {}
    monkeypatch.setattr(setuptools, "setup", told.update)
    monkeypatch.setattr(sys, "argv", ["setup.py"])
    runpy.run_path(str(ROOT / "setup.py"))
    assert build.has_test_dependency(told, "pytest")
    chosen = yaml.safe_load((ROOT / "colcon.pkg").read_text(encoding="utf-8"))["pytest-args"]
    assert all((ROOT / name).is_file() for name in chosen)
