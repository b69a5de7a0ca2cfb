"""The repository builds with colcon, its imports follow the layers, and its locks and metadata are right."""

import os
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE

from ehls_ros.nodes import node_names

ROOT = Path(__file__).resolve().parent.parent
LOCKS = sorted((ROOT / "requirements").glob("*.txt"))
CORE = ("physics", "control", "identification", "diagnosis")


def copy_sources(destination: Path) -> Path:
    """Copy the sources, without environments, builds and caches."""
    generated = shutil.ignore_patterns(".*", "build", "install", "log", "runs", "__pycache__", "*.egg-info")
    return Path(shutil.copytree(ROOT, destination, ignore=generated))


# --- colcon -----------------------------------------------------------------------------------------------------------


def ros_environment() -> dict[str, str]:
    """Return the environment variables for colcon and ament: of a sourced ROS, or of the wheels' prefix."""
    environment = dict(os.environ)
    if not environment.get("AMENT_PREFIX_PATH"):
        environment.update(AMENT_PREFIX_PATH=sys.prefix, CMAKE_PREFIX_PATH=sys.prefix)
    environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), environment.get("PATH", os.defpath)])
    return environment


def files_below(top: Path) -> set[Path]:
    """Return the relative paths of all files below a folder except Python's caches."""
    files = (path for path in top.rglob("*") if path.is_file())
    return {path.relative_to(top) for path in files if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a workspace with a copy of the sources in ``src``, built by a plain ``colcon build``."""
    environment = ros_environment()
    colcon = shutil.which("colcon", path=environment["PATH"])
    if colcon is None:
        pytest.skip("colcon is not installed")
    top = tmp_path_factory.mktemp("colcon")
    copy_sources(top / "src" / "ehls_ros")
    (top / "src" / "ehls_msgs").symlink_to("ehls_ros/ehls_msgs")
    # Run by this interpreter, so that the installed executables use it too.
    build = subprocess.run(
        [sys.executable, colcon, "build"],
        cwd=top,
        env=environment,
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert build.returncode == 0, build.stdout
    assert "2 packages finished" in build.stdout, build.stdout
    assert "stderr" not in build.stdout, build.stdout  # no warnings
    return top


def in_workspace(workspace: Path, command: str) -> list[str]:
    """Return the command as run by a shell that has sourced the install space."""
    underlay = f"AMENT_PREFIX_PATH=$AMENT_PREFIX_PATH:{shlex.quote(sys.prefix)}"
    return ["bash", "-c", f". {shlex.quote(str(workspace))}/install/setup.bash && export {underlay} && exec {command}"]


@pytest.mark.long
def test_colcon_puts_executables_where_ros2_run_looks(workspace: Path) -> None:
    scripts = {path.name for path in (workspace / "install/ehls_ros/lib/ehls_ros").iterdir() if os.access(path, os.X_OK)}
    assert scripts == {"ehls", *node_names()}
    assert scripts > {"plant_sim_node", "hardware_bridge_node", "recorder_node", "fasmc_node", "sic_node"}


@pytest.mark.long
def test_colcon_installs_what_ament_and_launch_look_for(workspace: Path) -> None:
    prefix = workspace / "install/ehls_ros/share"
    assert files_below(workspace / "src/ehls_ros/ehls_ros") == files_below(
        *(workspace / "install/ehls_ros/lib").glob("python*/*/ehls_ros")
    )
    assert (prefix / "ament_index/resource_index/packages/ehls_ros").is_file()
    assert (prefix / "ehls_ros/package.xml").is_file()
    for top in ("config", "launch"):
        assert files_below(workspace / "src/ehls_ros" / top) == files_below(prefix / "ehls_ros" / top)


@pytest.mark.long
def test_the_install_space_comes_before_the_environment(workspace: Path) -> None:
    where = "import ehls_msgs, ehls_ros; print(ehls_msgs.__file__, ehls_ros.__file__)"
    shown = subprocess.run(
        in_workspace(workspace, f"{shlex.quote(sys.executable)} -c {shlex.quote(where)}"),
        cwd=workspace.parent,
        env=ros_environment(),
        check=True,
        capture_output=True,
        text=True,
    )
    for path in shown.stdout.split():
        assert path.startswith(f"{workspace}/install/")


@pytest.fixture
def installed_fasmc_node(workspace: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start the controller from the install space, as ``ros2 run`` would."""
    log = tmp_path / "fasmc_node.log"
    with log.open("w", encoding="utf-8") as output:
        node = subprocess.Popen(
            in_workspace(workspace, f"{shlex.quote(str(workspace))}/install/ehls_ros/lib/ehls_ros/fasmc_node"),
            cwd=tmp_path,
            env=ros_environment(),
            stdout=output,
            stderr=subprocess.STDOUT,
            text=True,
        )
    try:
        yield node
    finally:
        if node.poll() is None:
            node.kill()
            node.wait()
        print(log.read_text(encoding="utf-8"))


@pytest.mark.long
def test_a_node_of_the_install_space_comes_up_and_shuts_down(installed_fasmc_node: subprocess.Popen[str]) -> None:
    pytest.importorskip("rclpy", reason="rclpy is not installed")
    assert settled_lifecycle_state("/ehls/fasmc_node", installed_fasmc_node) in {"unconfigured", "inactive", "active"}
    installed_fasmc_node.send_signal(signal.SIGINT)
    assert installed_fasmc_node.wait(timeout=PATIENCE) == 0


def settled_lifecycle_state(name: str, process: subprocess.Popen[str], timeout: float = PATIENCE) -> str:
    """Return a lifecycle node's state once it is between two transitions.

    Args:
        name: its full name.
        process: its process; the wait fails if that ends.
        timeout: longest wait [s]; the first transition compiles the controller.

    Returns:
        The label of the state.
    """
    import rclpy
    from lifecycle_msgs.srv import GetState
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor

    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("test_build", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        client = node.create_client(GetState, f"{name}/get_state")
        label = "no state"
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            assert process.poll() is None, f"the node ended with exit code {process.returncode}"
            if not client.wait_for_service(timeout_sec=0.2):
                continue
            answer = client.call_async(GetState.Request())
            executor.spin_until_future_complete(answer, timeout_sec=1.0)
            if answer.done():
                label = str(answer.result().current_state.label)
                if not label.endswith("ing"):
                    return label
        pytest.fail(f"{name} still had {label} after {timeout} s")
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


# --- import contracts -------------------------------------------------------------------------------------------------


def lint_imports(top: Path) -> subprocess.CompletedProcess[str]:
    """Run the import linter on a checkout."""
    pytest.importorskip("importlinter", reason="import-linter is not installed")
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    return subprocess.run([sys.executable, "-c", code, "--no-cache"], cwd=top, check=False, capture_output=True, text=True)


def contracts() -> list[dict[str, Any]]:
    """Return the import contracts of this repository."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return list(settings["tool"]["importlinter"]["contracts"])


def test_import_contracts_hold() -> None:
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize(
    ("module", "line", "complaint"),
    [
        ("physics/stray.py", "import rclpy", "ehls_ros.physics is not allowed to import rclpy"),
        ("physics/stray.py", "import yaml", "ehls_ros.physics is not allowed to import yaml"),
        ("physics/stray.py", "from ehls_ros import control", "ehls_ros.physics is not allowed to import ehls_ros.control"),
        ("report/stray.py", "from ehls_msgs.msg import LoaderState", "ehls_ros.report is not allowed to import ehls_msgs"),
        ("stray.py", "", "The following modules are not listed as layers"),
    ],
)
def test_import_contracts_catch(tmp_path: Path, module: str, line: str, complaint: str) -> None:
    shutil.copytree(ROOT / "ehls_ros", tmp_path / "ehls_ros", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "ehls_ros" / module).write_text(f"{line}\n", encoding="utf-8")
    result = lint_imports(tmp_path)
    assert result.returncode != 0
    assert complaint in result.stdout


def test_every_core_package_is_under_the_core_contract() -> None:
    """import-linter refuses names of packages that do not exist, so the list has to grow with the package."""
    listed = next(contract["source_modules"] for contract in contracts() if contract["name"].startswith("The numerical core"))
    assert sorted(listed) == sorted(f"ehls_ros.{name}" for name in CORE if (ROOT / "ehls_ros" / name).is_dir())


# --- locks ------------------------------------------------------------------------------------------------------------


def requirement_blocks(lock: Path) -> list[str]:
    """Return the requirements of a lock file, each with its hashes, on one line."""
    lines = [line for line in lock.read_text(encoding="utf-8").splitlines() if not line.lstrip().startswith("#")]
    return "\n".join(lines).replace("\\\n", " ").splitlines()


def requirement_names(lines: list[str]) -> set[str]:
    """Return the normalised names of the packages in requirement lines."""
    stripped = (line.partition("#")[0].strip() for line in lines)
    return {re.sub(r"[-_.]+", "-", re.split(r"[\s\[=<>!~;]", line)[0]).lower() for line in stripped if line}


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_everything_locked_is_pinned_and_hashed(lock: Path) -> None:
    for requirement in requirement_blocks(lock):
        assert re.match(r"[a-z0-9-]+==[0-9][\w.+]* ", requirement), requirement
        assert re.search(r" --hash=sha256:[0-9a-f]{64}\b", requirement), requirement


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_the_lock_names_no_host_and_no_path(lock: Path) -> None:
    text = lock.read_text(encoding="utf-8")
    assert not re.search(r"://|--find-links|--(extra-)?index-url|--trusted-host|(^|\s)-[a-z]\b| @ |/\w+/", text)


def asked_for(group: str) -> set[str]:
    """Return the names of the packages in a dependency group of pyproject.toml."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    return requirement_names([entry for entry in groups[group] if isinstance(entry, str)])


@pytest.mark.parametrize(("lock", "word"), [("lock.txt", "FOR_ALL"), ("noble.txt", "FOR_NOBLE")])
def test_a_lock_holds_each_package_once_and_all_that_is_asked_for(lock: str, word: str) -> None:
    names = [requirement.split("==")[0] for requirement in requirement_blocks(ROOT / "requirements" / lock)]
    assert len(names) == len(set(names))
    (groups,) = re.findall(rf"^{word} := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for group in groups.split():
        assert asked_for(group) <= set(names)


# --- metadata ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def metadata(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the arguments of setup.py to setuptools."""
    setuptools = pytest.importorskip("setuptools", reason="setuptools is not installed")
    told: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", told.update)
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py")
    return told


def test_the_offline_half_needs_no_ros(metadata: dict[str, Any]) -> None:
    names = requirement_names(metadata["install_requires"])
    assert names == {"numpy", "scipy", "numba", "pandas", "pyyaml", "rosbags", "plotly", "rich", "shtab"}
    assert all(name.startswith("ros-") for name in requirement_names(metadata["extras_require"]["ros"]))


def test_all_packages_are_installed_and_nothing_else(metadata: dict[str, Any]) -> None:
    folders = {path.parent for path in (ROOT / "ehls_ros").rglob("*.py")}
    assert set(metadata["packages"]) == {".".join(folder.relative_to(ROOT).parts) for folder in folders}


def test_every_console_script_exists(metadata: dict[str, Any]) -> None:
    for script in metadata["entry_points"]["console_scripts"]:
        module, function = script.split(" = ")[1].split(":")
        spec = find_spec(module)
        assert spec is not None, script
        assert re.search(rf"^def {function}\(", Path(spec.origin or "").read_text(encoding="utf-8"), re.MULTILINE), script


def test_every_node_has_a_console_script(metadata: dict[str, Any]) -> None:
    scripts = {script.partition(" = ")[0] for script in metadata["entry_points"]["console_scripts"]}
    assert scripts == {"ehls", *node_names()}


def test_package_xml_and_setup_agree(metadata: dict[str, Any]) -> None:
    manifest = (ROOT / "package.xml").read_text(encoding="utf-8")
    for tag in ("name", "version", "license"):
        assert f"<{tag}>{metadata[tag]}</{tag}>" in manifest
