"""Make ``.venv/``: the locked packages, the messages of ehls_msgs and the project itself, editable.

With ``EHLS_VERSIONS=noble`` it is ``.venv-noble/``, with the versions of Ubuntu 24.04 and without what that has not.

``make setup`` runs it. Each of its four steps leaves a stamp of its inputs, so that a second run repeats only what has changed,
and a run after an interruption continues with the interrupted step. A sourced ROS 2 installation is used; otherwise ROS is
installed as locked wheels.

Uses only the standard library, and nothing newer than Python 3.8 before the version is checked.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import hashlib
import importlib.util
import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

ROOT = Path(__file__).resolve().parent.parent
NOBLE = os.environ.get("EHLS_VERSIONS") == "noble"
VENV = ROOT / (".venv-noble" if NOBLE else ".venv")
PYTHON = VENV / "bin" / "python"
STAMPS = VENV / "setup_stamps.json"
LOG = VENV / "setup.log"
MANIFEST = VENV / "ehls_msgs_manifest.txt"
REQUIREMENTS = ROOT / "requirements"
PACKAGES, WHEELS = (["noble.txt"], "noble_ros.txt") if NOBLE else (["base.txt", "dev.txt"], "ros.txt")
"""The locks; the one of the ROS wheels is left out where a ROS installation is sourced."""
MESSAGES = ROOT / "ehls_msgs"

OLDEST, NEWEST = ((3, 12), (3, 12)) if NOBLE else ((3, 11), (3, 13))
GLIBC = (2, 28)
# The ROS wheels restart Python with a library path unless this is set; inherited from another environment, it does harm.
WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
NO_INDEX = re.compile(
    r"Max retries|NewConnectionError|NameResolutionError|name resolution|Connection refused|timed out|ProxyError|"
    r"Network is unreachable|No matching distribution"
)


class SetupError(Exception):
    """Setup cannot go on; one line says what is wrong and what helps."""


class Step(NamedTuple):
    """A step: its name, the fingerprint of its inputs, its progress message and its function."""

    name: str
    fingerprint: str
    says: str
    does: Any


def main() -> int:
    """Bring the environment up to date.

    Returns:
        Exit code: 0 done, 1 failed with one line on stderr, 130 interrupted.
    """
    parser = argparse.ArgumentParser(description="Make .venv/ with everything the project needs.")
    parser.add_argument(
        "--python-was-chosen",
        action="store_true",
        help="rebuild the environment if it was made with another version of Python than the one running this",
    )
    arguments = parser.parse_args()
    try:
        with one_setup_at_a_time():
            set_up(python_was_chosen=arguments.python_was_chosen)
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nsetup: interrupted; `make setup` continues from here", file=sys.stderr)
        return 130
    return 0


@contextlib.contextmanager
def one_setup_at_a_time() -> Iterator[None]:
    """Hold a lock on the checkout, waiting for another setup to end."""
    folder = os.open(ROOT, os.O_RDONLY)
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("another setup is running in this folder: waiting for it", flush=True)
            fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def set_up(*, python_was_chosen: bool) -> None:
    """Do the steps whose stamps are missing or out of date.

    Args:
        python_was_chosen: whether the caller chose the running version of Python.

    Raises:
        SetupError: a requirement is missing, or a step failed.
    """
    started = time.monotonic()
    ros = sourced_ros()
    stamps = read_stamps()
    remade = needs_remaking(stamps.get("environment", {}), ros, python_was_chosen=python_was_chosen)
    if remade:
        check_python(ros)
        stamps = {}
    pending = [step for step in steps(ros) if stamps.get(step.name) != step.fingerprint]
    if not remade and not pending:
        print(f"{VENV.name} is up to date")
        return
    check_compilers(ros)
    total = len(pending) + remade
    if remade:
        print(f"[1/{total}] making {VENV.name} with Python {platform.python_version()}", flush=True)
        make_environment(ros)
        stamps["environment"] = {"python": python_version(), "folder": str(ROOT), "ros": ros}
        write_stamps(stamps)
    for number, step in enumerate(pending, start=1 + remade):
        print(f"[{number}/{total}] {step.says}", flush=True)
        step.does(ros)
        stamps[step.name] = step.fingerprint
        write_stamps(stamps)
    print(f"{VENV.name} is ready after {time.monotonic() - started:.0f} s: {VENV.name}/bin/ehls --help")


def steps(ros: str) -> list[Step]:
    """Return the steps that follow the making of the environment.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.
    """
    locks = [REQUIREMENTS / name for name in (PACKAGES if ros else [*PACKAGES, WHEELS])]
    packages = len({name for lock in locks for name in re.findall(r"^\S+==", lock.read_text(encoding="utf-8"), re.MULTILINE)})
    project = [ROOT / name for name in ("setup.py", "setup.cfg", "pyproject.toml", "MANIFEST.in")]
    project += REQUIREMENTS.glob("*.in")
    this = Path(__file__).resolve()
    return [
        Step(
            "packages",
            fingerprint([this, *locks]),
            f"installing {packages} packages as locked (the first time a minute or two, up to 250 MB to download)",
            install_packages,
        ),
        Step(
            "messages",
            fingerprint([this, *files_below(MESSAGES), *(lock for lock in locks if lock.name != "dev.txt")]),
            "building the messages of ehls_msgs (about 15 s)",
            build_messages,
        ),
        Step("project", fingerprint([this, *project]), "installing ehls_ros, editable", install_project),
    ]


def sourced_ros() -> str:
    """Return the name of the ROS 2 distribution sourced in this shell, empty if none is."""
    return os.environ.get("ROS_DISTRO", "") if os.environ.get("AMENT_PREFIX_PATH") else ""


def python_version() -> str:
    """Return the running version of Python as far as packages depend on it, such as ``3.12``."""
    return f"{sys.version_info[0]}.{sys.version_info[1]}"


def needs_remaking(made: dict[str, str], ros: str, *, python_was_chosen: bool) -> bool:
    """Return whether the environment must be rebuilt.

    Args:
        made: what the environment was made for, empty if it was not or not to its end.
        ros: name of the sourced ROS 2 distribution, or empty.
        python_was_chosen: whether the caller asked for the running version of Python.

    Raises:
        SetupError: it was made with ROS from elsewhere.
    """
    if not made or not PYTHON.exists() or made["folder"] != str(ROOT):
        return True
    if made["ros"] != ros:
        past = f"with ROS 2 {made['ros']} sourced" if made["ros"] else "without a sourced ROS 2"
        now = f"ROS 2 {ros} is sourced" if ros else "none is sourced"
        raise SetupError(f".venv was made {past}, and now {now}: use such a shell again, or start over with `make clean setup`")
    return python_was_chosen and made["python"] != python_version()


def check_python(ros: str) -> None:
    """Check that the running Python can make the environment.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.

    Raises:
        SetupError: it cannot.
    """
    here = f"{sys.executable} is Python {platform.python_version()}"
    if not OLDEST <= sys.version_info[:2] <= NEWEST or sys.implementation.name != "cpython":
        wanted, make = ("CPython 3.12", "test-noble") if NOBLE else ("CPython 3.11, 3.12 or 3.13", "setup")
        raise SetupError(f"{here}: {wanted} is needed, such as `make {make} PYTHON=python3.12`")
    if ros and subprocess.run([sys.executable, "-c", "import rclpy"], capture_output=True, check=False).returncode:
        raise SetupError(f"{here}, which cannot import rclpy of ROS 2 {ros}: set PYTHON to the Python that ROS was built for")
    if not ros and (sys.platform != "linux" or platform.machine() != "x86_64" or glibc_version() < GLIBC):
        raise SetupError(
            "the ROS 2 wheels are for x86-64 Linux with glibc 2.28 or newer: elsewhere, source a ROS 2 Jazzy installation first"
        )
    if importlib.util.find_spec("ensurepip") is None:
        raise SetupError(f"{here} without the module ensurepip: install it, on Debian or Ubuntu python{python_version()}-venv")
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise SetupError(f"{here} without Python.h: install it, on Debian or Ubuntu python{python_version()}-dev")


def glibc_version() -> tuple[int, ...]:
    """Return the version of glibc, ``(0,)`` for another C library."""
    name, version = platform.libc_ver()
    return tuple(int(part) for part in version.split(".")[:2]) if name == "glibc" else (0,)


def check_compilers(ros: str) -> None:
    """Check that the messages can be built.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.

    Raises:
        SetupError: a compiler is missing, or cmake if it is not in the lock.
    """
    for language, variable, usual in (("C", "CC", ("cc", "gcc", "clang")), ("C++", "CXX", ("c++", "g++", "clang++"))):
        chosen = shlex.split(os.environ.get(variable, ""))[:1]
        if not any(shutil.which(name) for name in chosen or usual):
            looked_for = f"{variable}={chosen[0]}" if chosen else ", ".join(usual)
            raise SetupError(f"no {language} compiler ({looked_for}): install one, on Debian or Ubuntu `apt install g++`")
    if ros and not shutil.which("cmake"):
        raise SetupError("no cmake: install it, on Debian or Ubuntu `apt install cmake`")


def make_environment(ros: str) -> None:
    """Replace the environment by an empty one, which sees the system's packages if ROS 2 is sourced.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.
    """
    options = ["--clear", "--prompt", "ehls_ros", *(["--system-site-packages"] if ros else [])]
    run([sys.executable, "-m", "venv", *options, str(VENV)], "making .venv")
    if ros:
        packages = Path(python_paths()["purelib"])
        shutil.copy(ROOT / "tools" / "venv_library_path.py", packages / "ehls_ros_library_path.py")
        (packages / "ehls_ros_library_path.pth").write_text("import ehls_ros_library_path\n", encoding="utf-8")


def install_packages(ros: str) -> None:
    """Install the locked packages.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.
    """
    remove_half_installed()
    pip("--require-hashes", "--only-binary=:all:", *(f"--requirement={REQUIREMENTS / name}" for name in PACKAGES))
    if not ros:
        # One of them exists as source only; building it with the locked setuptools keeps everything hashed.
        pip("--require-hashes", "--no-build-isolation", "--requirement", str(REQUIREMENTS / WHEELS))
        point_exports_here()


def remove_half_installed() -> None:
    """Remove packages left incomplete by an interruption: pip writes INSTALLER last."""
    for description in Path(python_paths()["purelib"]).glob("*.dist-info"):
        if not (description / "INSTALLER").exists():
            shutil.rmtree(description)


def point_exports_here() -> None:
    """Replace the build machine's paths in the cmake exports of the ROS wheels by this environment's."""
    paths = python_paths()
    of_numpy_1 = "numpy/core/include"
    headers = of_numpy_1 if Path(paths["purelib"], of_numpy_1).exists() else "numpy/_core/include"
    build_machine = re.compile(r"/opt/python/[^/;\"]+/(include|lib)/python3\.\d+(/site-packages)?")
    for export in VENV.glob("share/*/cmake/*rosidl_generator_py*.cmake"):
        text = export.read_text(encoding="utf-8")
        here = build_machine.sub(lambda match: paths["include" if match[1] == "include" else "purelib"], text)
        here = here.replace("numpy/_core/include", headers)
        if here != text:
            export.write_text(here, encoding="utf-8")


def build_messages(ros: str) -> None:
    """Build ehls_msgs into the environment, replacing an earlier build.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.

    Raises:
        SetupError: the build failed, or its result cannot be imported.
    """
    if MANIFEST.exists():
        for name in MANIFEST.read_text(encoding="utf-8").splitlines():
            Path(name).unlink(missing_ok=True)
    build = VENV / "ehls_msgs_build"
    shutil.rmtree(build, ignore_errors=True)
    environment = child_environment()
    for variable in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        others = os.environ.get(variable, "") if ros else ""
        environment[variable] = os.pathsep.join(filter(None, [str(VENV), others]))
    configuration = {
        "CMAKE_BUILD_TYPE": "Release",
        "CMAKE_INSTALL_PREFIX": str(VENV),
        "Python3_EXECUTABLE": str(PYTHON),
        "BUILD_TESTING": "OFF",
    }
    definitions = [f"-D{name}={value}" for name, value in configuration.items()]
    doing = "building ehls_msgs"
    run(["cmake", "-S", str(MESSAGES), "-B", str(build), *definitions], doing, environment)
    run(["cmake", "--build", str(build), "--target", "install", "--parallel", str(os.cpu_count() or 1)], doing, environment)
    shutil.copy(build / "install_manifest.txt", MANIFEST)
    shutil.rmtree(build)
    message = min(path.stem for path in MESSAGES.glob("msg/*.msg"))
    load = f"from ehls_msgs.msg import {message}; type({message}).__import_type_support__()"
    run([str(PYTHON), "-c", load], "importing the messages just built", child_environment())


def install_project(ros: str) -> None:
    """Install ehls_ros in editable mode.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.
    """
    pip("--no-deps", "--no-build-isolation", "--editable", str(ROOT))
    # An editable installation leaves out the data_files of setup.py.
    index = VENV / "share" / "ament_index" / "resource_index" / "packages"
    share = VENV / "share" / "ehls_ros"
    index.mkdir(parents=True, exist_ok=True)
    share.mkdir(exist_ok=True)
    for link, source in (
        (index / "ehls_ros", ROOT / "resource" / "ehls_ros"),
        (share / "package.xml", ROOT / "package.xml"),
        (share / "config", ROOT / "config"),
        (share / "launch", ROOT / "launch"),
    ):
        link.unlink(missing_ok=True)
        link.symlink_to(source)


def pip(*arguments: str) -> None:
    """Run ``pip install`` of the environment.

    Args:
        arguments: what follows ``pip install``.

    Raises:
        SetupError: it failed.
    """
    options = ["--disable-pip-version-check", "--no-input", "--progress-bar=off", "--no-warn-script-location"]
    run([str(PYTHON), "-m", "pip", "install", *options, *arguments], "installing packages", child_environment())


def run(command: list[str], doing: str, environment: dict[str, str] | None = None) -> None:
    """Run a command; its output goes to the log and, line by line, to the last line of a terminal.

    Args:
        command: program and arguments.
        doing: description, for the error message.
        environment: environment variables; by default those of this process.

    Raises:
        SetupError: it failed.
    """
    output = []
    environment = child_environment() if environment is None else environment
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment, text=True
    ) as process:
        try:
            for line in process.stdout or ():
                output.append(line)
                show(line.strip())
        except KeyboardInterrupt:
            process.terminate()
            raise
        finally:
            show("")
    if VENV.is_dir():
        with LOG.open("a", encoding="utf-8") as log:
            log.writelines([f"$ {shlex.join(command)}\n", *output])
    if process.returncode:
        raise SetupError(f"{doing} failed: {reason(output)} (full output in {LOG.relative_to(ROOT)})")


def show(line: str) -> None:
    """Show a line in place of the one before, on a terminal only."""
    if sys.stdout.isatty():
        width = shutil.get_terminal_size().columns - 1
        print(f"\r{line[:width]:{width}}\r", end="", flush=True)


def reason(output: list[str]) -> str:
    """Return the line of a failed command's output that gives the reason."""
    lines = [line.strip() for line in output if line.strip()] or ["no output"]
    for number, line in enumerate(lines):
        if line.startswith("CMake Error"):
            return " ".join(lines[number : number + 2])
    errors = [line for line in lines if re.search(r"\berror\b", line, re.IGNORECASE)]
    network = "packages could not be downloaded, is there a network? " if any(map(NO_INDEX.search, lines)) else ""
    return network + (errors or lines)[-1]


def child_environment() -> dict[str, str]:
    """Return the environment variables for a program in ``.venv``."""
    environment = dict(os.environ)
    if environment.pop(WHEELS_GUARD, None):
        environment.pop("LD_LIBRARY_PATH", None)
    environment["PATH"] = os.pathsep.join([str(PYTHON.parent), environment.get("PATH", os.defpath)])
    return environment


def python_paths() -> dict[str, str]:
    """Return the installation paths of the environment's Python, as sysconfig names them."""
    code = "import json, sysconfig; print(json.dumps(sysconfig.get_paths()))"
    shown = subprocess.run([PYTHON, "-c", code], check=True, capture_output=True, text=True, env=child_environment())
    paths: dict[str, str] = json.loads(shown.stdout)
    return paths


def files_below(*folders: Path) -> list[Path]:
    """Return all files below the folders except Python's caches."""
    return [path for folder in folders for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def fingerprint(paths: Iterable[Path]) -> str:
    """Return a hash of the names and contents of files; a missing file counts as empty."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        content = path.read_bytes() if path.exists() else b""
        digest.update(f"{path.relative_to(ROOT)} {len(content)}\n".encode() + content)
    return digest.hexdigest()


def read_stamps() -> dict[str, Any]:
    """Return the stamps of the finished steps; empty if there are no valid ones."""
    try:
        stamps = json.loads(STAMPS.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamps if isinstance(stamps, dict) else {}


def write_stamps(stamps: dict[str, Any]) -> None:
    """Replace the stamps atomically, so that an interruption leaves the old or the new ones."""
    fresh = STAMPS.with_suffix(".new")
    fresh.write_text(json.dumps(stamps, indent=1), encoding="utf-8")
    fresh.replace(STAMPS)


if __name__ == "__main__":
    sys.exit(main())
