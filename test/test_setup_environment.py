"""`make setup` reports a missing requirement in one line, and repairs the remains of an interruption."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parent.parent
NO_NETWORK = "packages could not be downloaded, is there a network? (PIP_INDEX_URL names a mirror) "


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a copy of the files that setup reads, without an environment."""
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    shutil.copytree(ROOT / "requirements", tmp_path / "requirements")
    shutil.copytree(ROOT / "ehls_msgs", tmp_path / "ehls_msgs")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


@pytest.fixture
def setup(checkout: Path) -> ModuleType:
    """Import the script of that copy."""
    specification = importlib.util.spec_from_file_location("setup_environment", checkout / "tools" / "setup_environment.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def complaint(checkout: Path, *arguments: str, **variables: str) -> str:
    """Run setup, which must fail before it makes anything, and return its only line of output."""
    environment = {
        name: value for name, value in os.environ.items() if name not in {"ROS_DISTRO", "AMENT_PREFIX_PATH", "CC", "CXX"}
    }
    done = subprocess.run(
        [sys.executable, checkout / "tools" / "setup_environment.py", *arguments],
        env=environment | variables,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert not (checkout / ".venv" / "pyvenv.cfg").exists()
    (line,) = done.stderr.splitlines()
    return line


def pretend_environment(checkout: Path, **made_for: str) -> None:
    """Create the traces of a finished setup that setup checks."""
    (checkout / ".venv" / "bin").mkdir(parents=True)
    (checkout / ".venv" / "bin" / "python").touch()
    made = {"python": "3.12", "folder": str(checkout), "ros": "", "groups": []} | made_for
    (checkout / ".venv" / "setup.json").write_text(json.dumps(made), encoding="utf-8")


def test_a_missing_compiler_is_named(setup: ModuleType, monkeypatch: pytest.MonkeyPatch, checkout: Path) -> None:
    monkeypatch.setenv("PATH", str(checkout))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(setup.SetupError, match=r"^no C compiler \(cc, gcc, clang\): install one"):
        setup.check_compilers("")
    monkeypatch.setenv("CC", sys.executable)
    monkeypatch.setenv("CXX", "no-such-compiler -O2")
    with pytest.raises(setup.SetupError, match=r"^no C\+\+ compiler \(CXX=no-such-compiler\): install one"):
        setup.check_compilers("")


def test_an_unsupported_python_is_named(setup: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setup, "NEWEST", (3, 10))
    with pytest.raises(setup.SetupError, match=r"is Python 3\.\d+\.\d+: CPython 3.11, 3.12 or 3.13 is needed"):
        setup.check_python("")


def test_a_sourced_ros_that_this_python_cannot_import_is_named(checkout: Path) -> None:
    sourced = {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": "/nowhere", "PYTHONPATH": str(checkout)}
    (checkout / "rclpy.py").write_text("raise ImportError\n", encoding="utf-8")
    assert "cannot import rclpy of ROS 2 jazzy: set PYTHON to" in complaint(checkout, **sourced)


def test_an_environment_made_with_another_ros_is_kept(checkout: Path) -> None:
    pretend_environment(checkout, ros="jazzy")
    assert "made with ROS 2 jazzy sourced, and now none is sourced" in complaint(checkout)


def test_an_environment_is_made_anew_only_when_it_has_to_be(checkout: Path, setup: ModuleType) -> None:
    assert setup.needs_remaking({}, "", python_was_chosen=False)
    pretend_environment(checkout, python="3.0")
    made = setup.read_made()
    assert not setup.needs_remaking(made, "", python_was_chosen=False)
    assert setup.needs_remaking(made, "", python_was_chosen=True)
    assert setup.needs_remaking(made | {"folder": "/elsewhere"}, "", python_was_chosen=False)


def test_messages_built_once_are_used_again_until_they_change(
    setup: ModuleType, checkout: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    built: list[Path] = []

    def build(folder: Path, ros: str) -> Path:
        built.append(folder)
        (folder / "share").mkdir()
        (folder / "share" / "package.xml").write_text("it", encoding="utf-8")
        return folder

    monkeypatch.setattr(setup, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(setup, "build_messages", build)
    monkeypatch.setattr(setup, "check_compilers", lambda ros: None)
    setup.VENV.mkdir()
    first = setup.message_wheel("3.12", "")
    assert zipfile.ZipFile(first).read(f"{first.name.partition('-cp')[0]}.data/data/share/package.xml") == b"it"
    assert setup.message_wheel("3.12", "") == first
    assert len(built) == 1
    with (checkout / "ehls_msgs" / "msg" / "Disturbance.msg").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    wheels = {first, setup.message_wheel("3.12", ""), setup.message_wheel("3.11", ""), setup.message_wheel("3.12", "jazzy")}
    assert len(wheels) == 4


def test_large_files_that_are_alike_are_kept_once(setup: ModuleType, tmp_path: Path) -> None:
    contents = {"a": b"1" * setup.LARGE * 2, "b": b"1" * setup.LARGE * 2, "c": b"2" * setup.LARGE * 2, "d": b"", "e": b""}
    for name, content in contents.items():
        (tmp_path / "lib" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "lib" / name).write_bytes(content)
    setup.keep_one_copy(tmp_path / "lib")
    assert {name: (tmp_path / "lib" / name).read_bytes() for name in contents} == contents
    assert [(tmp_path / "lib" / name).stat().st_nlink for name in contents] == [2, 2, 1, 1, 1]


def test_half_installed_packages_are_removed(setup: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(setup, "python_paths", lambda python: {"purelib": str(tmp_path / "packages")})
    for name in ("whole-1.dist-info/METADATA", "whole-1.dist-info/INSTALLER", "half-1.dist-info/METADATA"):
        path = tmp_path / "packages" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    setup.remove_half_installed()
    assert [path.name for path in (tmp_path / "packages").iterdir()] == ["whole-1.dist-info"]


def test_exports_of_the_wheels_point_to_this_environment(setup: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        setup, "python_paths", lambda python: {"include": "/usr/include/python3.12", "purelib": "/here/packages"}
    )
    export = setup.VENV / "share/std_msgs/cmake/export_std_msgs__rosidl_generator_pyExport.cmake"
    export.parent.mkdir(parents=True)
    built_at = "/opt/python/cp312-cp312"
    headers = f"{built_at}/include/python3.12;{built_at}/lib/python3.12/site-packages/numpy/_core/include"
    export.write_text(f'INTERFACE_INCLUDE_DIRECTORIES "{headers}"', encoding="utf-8")
    cached = export.with_name("cached")
    os.link(export, cached)
    setup.point_exports_here(setup.VENV, setup.PYTHON)
    wanted = 'INTERFACE_INCLUDE_DIRECTORIES "/usr/include/python3.12;/here/packages/numpy/_core/include"'
    assert export.read_text(encoding="utf-8") == wanted
    assert built_at in cached.read_text(encoding="utf-8")  # uv's own copy, for other environments


@pytest.mark.parametrize(
    ("output", "wanted"),
    [
        (
            ["-- ok", "CMake Error at x.cmake:3:", "  Could NOT find NumPy", "make: error"],
            "CMake Error at x.cmake:3: Could NOT find NumPy",
        ),
        (["Collecting x", "ERROR: hashes do not match", "done"], "ERROR: hashes do not match"),
        (
            ["WARNING: Max retries exceeded", "ERROR: No matching distribution found for x==1"],
            NO_NETWORK + "ERROR: No matching distribution found for x==1",
        ),
        ([], "no output"),
    ],
)
def test_a_failure_is_told_in_one_line(setup: ModuleType, output: list[str], wanted: str) -> None:
    assert setup.reason(output) == wanted


def test_uv_looks_where_pip_is_told_to(setup: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = """
:env:.index-url='https://mirror.invalid/simple'
global.extra-index-url='\\nhttps://a.invalid\\nhttps://b.invalid'
global.index-url='https://file.invalid/simple'
global.timeout='60'
"""
    monkeypatch.setattr(setup.subprocess, "run", lambda *_, **__: SimpleNamespace(stdout=listed.strip()))
    assert setup.settings_of_pip() == {
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_DEFAULT_INDEX": "https://mirror.invalid/simple",
        "UV_INDEX": "https://a.invalid https://b.invalid",
    }
