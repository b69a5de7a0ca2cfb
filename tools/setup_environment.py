"""Create ``.venv/``: the locked packages of the requested groups, the messages of ehls_msgs, and the project itself, editable.

With ``EHLS_VERSIONS=noble`` it is ``.venv-noble/``, with the versions of Ubuntu 24.04 and without packages it does not have.

``make setup`` runs it. uv installs the dependency groups listed in `pyproject.toml`, in the versions and with the hashes of
the lock; it skips packages already installed, and continues after an interruption. A sourced ROS 2 installation is used;
otherwise ROS is installed as locked wheels.

Uses only the standard library, and nothing newer than Python 3.8 before the version is checked.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import fcntl
import filecmp
import functools
import hashlib
import importlib.util
import inspect
import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

ROOT = Path(__file__).resolve().parent.parent
NOBLE = os.environ.get("EHLS_VERSIONS") == "noble"
VENV = ROOT / (".venv-noble" if NOBLE else ".venv")
PYTHON = VENV / "bin" / "python"
MADE = VENV / "setup.json"
LOG = VENV / "setup.log"
LOCK = ROOT / "requirements" / ("noble.txt" if NOBLE else "lock.txt")
MESSAGES = ROOT / "ehls_msgs"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ehls_ros"

OLDEST, NEWEST = ((3, 12), (3, 12)) if NOBLE else ((3, 11), (3, 13))
GLIBC = (2, 28)
# The ROS wheels restart Python with a library path unless this is set; inherited from another environment, it does harm.
WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
NO_INDEX = re.compile(
    r"Max retries|NewConnectionError|name resolution|lookup address|Connection refused|timed out|[Pp]roxy|"
    r"Network is unreachable|No matching distribution|error sending request|[Ff]ailed to fetch"
)
LARGE = 2**16
"""Size from which on files contained in several packages are stored only once [B]."""


class SetupError(Exception):
    """Failure of the setup; one line states the problem and the remedy."""


def main() -> int:
    """Bring the environment up to date.

    Returns:
        Exit code: 0 done, 1 failed with one line on stderr, 130 interrupted.
    """
    parser = argparse.ArgumentParser(description="Make .venv/ for the demo, with the requested groups.")
    parser.add_argument("groups", nargs="*", help="further dependency groups of pyproject.toml, such as dashboard or test")
    parser.add_argument(
        "--python-was-chosen",
        action="store_true",
        help="rebuild the environment if it was made with another version of Python than the one running this",
    )
    arguments = parser.parse_args()
    try:
        with one_setup_at_a_time():
            set_up(arguments.groups, python_was_chosen=arguments.python_was_chosen)
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nsetup: interrupted; the same command continues from here", file=sys.stderr)
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


def set_up(asked: Iterable[str], *, python_was_chosen: bool) -> None:
    """Create the environment if it is missing, and install the packages missing in it.

    Args:
        asked: dependency groups to add to those that are installed.
        python_was_chosen: whether the caller chose the running version of Python.

    Raises:
        SetupError: a requirement is missing, or a step failed.
    """
    started = time.monotonic()
    ros = sourced_ros()
    made = read_made()
    if needs_remaking(made, ros, python_was_chosen=python_was_chosen):
        check_python(ros)
        print(f"making {VENV.name} with Python {platform.python_version()}", flush=True)
        made = {"python": python_version(), "folder": str(ROOT), "ros": ros, "groups": made.get("groups", [])}
        make_environment(ros)
        replace(MADE, json.dumps(made))
    groups = sorted({*made["groups"], *asked})
    inputs = [Path(__file__).resolve(), LOCK, *(ROOT / name for name in ("pyproject.toml", "setup.py", "setup.cfg"))]
    state = fingerprint([*inputs, *files_below(MESSAGES)])
    if made.get("state") == state and made["groups"] == groups:
        print(f"{VENV.name} is up to date")
        return
    print(" ".join(["installing packages as locked", *(["for", ", ".join(groups)] if groups else [])]), flush=True)
    install_packages(groups, ros)
    wheel = message_wheel(made["python"], ros)
    uv("pip", "install", "--python", str(PYTHON), "--no-deps", "--no-index", str(wheel), doing="installing ehls_msgs")
    check_messages()
    replace(MADE, json.dumps({**made, "groups": groups, "state": state}))
    print(f"{VENV.name} is ready after {time.monotonic() - started:.0f} s: {VENV.name}/bin/ehls --help")


def sourced_ros() -> str:
    """Return the name of the ROS 2 distribution sourced in this shell, empty if none is."""
    return os.environ.get("ROS_DISTRO", "") if os.environ.get("AMENT_PREFIX_PATH") else ""


def python_version() -> str:
    """Return the running version of Python as far as packages depend on it, such as ``3.12``."""
    return f"{sys.version_info[0]}.{sys.version_info[1]}"


def needs_remaking(made: dict[str, Any], ros: str, *, python_was_chosen: bool) -> bool:
    """Return whether the environment must be rebuilt.

    Args:
        made: configuration of the existing environment; empty if there is none or it is incomplete.
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
    return bool(python_was_chosen and made["python"] != python_version())


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


def glibc_version() -> tuple[int, ...]:
    """Return the version of glibc, ``(0,)`` for another C library."""
    name, version = platform.libc_ver()
    return tuple(int(part) for part in version.split(".")[:2]) if name == "glibc" else (0,)


def check_compilers(ros: str) -> None:
    """Check that the messages can be built.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.

    Raises:
        SetupError: a compiler or Python's headers are missing, or cmake if it is not in the lock.
    """
    for language, variable, usual in (("C", "CC", ("cc", "gcc", "clang")), ("C++", "CXX", ("c++", "g++", "clang++"))):
        chosen = shlex.split(os.environ.get(variable, ""))[:1]
        if not any(shutil.which(name) for name in chosen or usual):
            looked_for = f"{variable}={chosen[0]}" if chosen else ", ".join(usual)
            raise SetupError(f"no {language} compiler ({looked_for}): install one, on Debian or Ubuntu `apt install g++`")
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise SetupError(f"{sys.executable} without Python.h: install it, on Debian or Ubuntu python{python_version()}-dev")
    if ros and not shutil.which("cmake"):
        raise SetupError("no cmake: install it, on Debian or Ubuntu `apt install cmake`")


def make_environment(ros: str) -> None:
    """Replace the environment by an empty one, which sees the system's packages if ROS 2 is sourced.

    Args:
        ros: name of the sourced ROS 2 distribution, or empty.
    """
    shutil.rmtree(VENV, ignore_errors=True)
    options = ["--prompt", "ehls_ros", *(["--system-site-packages"] if ros else [])]
    uv("venv", "--python", sys.executable, *options, str(VENV), doing="making .venv")
    if ros:
        packages = Path(python_paths(PYTHON)["purelib"])
        shutil.copy(ROOT / "tools" / "venv_library_path.py", packages / "ehls_ros_library_path.py")
        (packages / "ehls_ros_library_path.pth").write_text("import ehls_ros_library_path\n", encoding="utf-8")


def install_packages(groups: Iterable[str], ros: str) -> None:
    """Install the locked packages of some groups, and the project.

    Args:
        groups: dependency groups besides those that everything needs.
        ros: name of the sourced ROS 2 distribution, or empty.
    """
    remove_half_installed()
    wanted = ["noble"] if NOBLE else ["base", *groups]
    locked(PYTHON, [*wanted, *([] if ros else ["ros"]), *(["colcon"] if NOBLE and not ros else [])])
    point_exports_here(VENV, PYTHON)
    keep_one_copy(VENV)
    build = ("--build-constraints", str(LOCK))
    uv("pip", "install", "--python", str(PYTHON), "--no-deps", *build, "--editable", str(ROOT), doing="installing ehls_ros")
    # An editable installation leaves out the data_files of setup.py.
    index = VENV / "share" / "ament_index" / "resource_index" / "packages"
    share = VENV / "share" / "ehls_ros"
    index.mkdir(parents=True, exist_ok=True)
    share.mkdir(parents=True, exist_ok=True)
    for link, source in (
        (index / "ehls_ros", ROOT / "resource" / "ehls_ros"),
        (share / "package.xml", ROOT / "package.xml"),
        (share / "config", ROOT / "config"),
        (share / "launch", ROOT / "launch"),
    ):
        link.unlink(missing_ok=True)
        link.symlink_to(source)


def locked(python: Path, groups: Iterable[str]) -> None:
    """Install dependency groups as locked; the hash of each package is checked against the lock.

    Args:
        python: interpreter of the environment.
        groups: the dependency groups.
    """
    named = [word for group in groups for word in ("--group", f"{ROOT / 'pyproject.toml'}:{group}")]
    constraints = ("--constraints", str(LOCK), "--build-constraints", str(LOCK))
    uv("pip", "install", "--python", str(python), *constraints, *named, doing="installing packages")


def remove_half_installed() -> None:
    """Remove packages left incomplete by an interruption: INSTALLER is not one of their files, and written late."""
    for description in Path(python_paths(PYTHON)["purelib"]).glob("*.dist-info"):
        if not (description / "INSTALLER").exists():
            shutil.rmtree(description)


def point_exports_here(prefix: Path, python: Path) -> None:
    """Replace the build machine's paths in the cmake exports of the ROS wheels by the environment's paths.

    Args:
        prefix: folder of the environment.
        python: its interpreter.
    """
    paths = python_paths(python)
    of_numpy_1 = "numpy/core/include"
    headers = of_numpy_1 if Path(paths["purelib"], of_numpy_1).exists() else "numpy/_core/include"
    build_machine = re.compile(r"/opt/python/[^/;\"]+/(include|lib)/python3\.\d+(/site-packages)?")
    for export in prefix.glob("share/*/cmake/*rosidl_generator_py*.cmake"):
        text = export.read_text(encoding="utf-8")
        here = build_machine.sub(lambda match: paths["include" if match[1] == "include" else "purelib"], text)
        here = here.replace("numpy/_core/include", headers)
        if here != text:
            replace(export, here)


def keep_one_copy(prefix: Path) -> None:
    """Deduplicate large files: wheels contain links as copies, and bundled libraries.

    Args:
        prefix: folder of the environment.
    """
    first: dict[int, Path] = {}
    for file in sorted(file for file in files_below(prefix) if not file.is_symlink()):
        size = file.stat().st_size
        same = first.setdefault(size, file) if size > LARGE else file
        if not same.samefile(file) and filecmp.cmp(same, file, shallow=False):
            fresh = file.with_name(f"{file.name}.new")
            os.link(same, fresh)
            fresh.replace(file)


def message_wheel(python: str, ros: str) -> Path:
    """Return ehls_msgs as a wheel: kept from an earlier build of the same sources with the same packages, or built now.

    Args:
        python: version of Python, such as ``3.12``.
        ros: name of the sourced ROS 2 distribution, or empty.

    Raises:
        SetupError: the build failed.
    """
    recipe = [inspect.getsource(build_messages), inspect.getsource(pack), fingerprint(files_below(MESSAGES))]
    built_with = re.findall(r"^(?:ros-|numpy)\S*", LOCK.read_text(encoding="utf-8"), re.MULTILINE)
    digest = hashlib.sha256("\n".join([*recipe, *built_with]).encode()).hexdigest()[:16]
    tag = f"cp{python.replace('.', '')}"
    [version] = re.findall(r"<version>(.+)</version>", (MESSAGES / "package.xml").read_text(encoding="utf-8"))
    name = f"ehls_msgs-{version}+{ros or 'wheels'}.{digest}"
    wheel = CACHE / "messages" / f"{name}-{tag}-{tag}-linux_{platform.machine()}.whl"
    if not wheel.exists():
        check_compilers(ros)
        print("building the messages of ehls_msgs (about 15 s; once for all checkouts)", flush=True)
        wheel.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="ehls_msgs_", dir=VENV) as folder:
            built = build_messages(Path(folder), ros)
            pack(built, name, f"{tag}-{tag}-linux_{platform.machine()}", wheel)
    return wheel


def build_messages(folder: Path, ros: str) -> Path:
    """Build ehls_msgs, with build packages installed in a folder that is removed with it.

    Args:
        folder: an empty folder.
        ros: name of the sourced ROS 2 distribution, or empty.

    Returns:
        The folder it is installed in.
    """
    environment = child_environment()
    python, tools = PYTHON, VENV
    if not ros:
        tools = folder / "tools"
        python = tools / "bin" / "python"
        uv("venv", "--python", str(PYTHON), str(tools), doing="making an environment to build in")
        locked(python, ["messages"])
        point_exports_here(tools, python)
        environment["PATH"] = os.pathsep.join([str(python.parent), environment["PATH"]])
    for variable in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        others = os.environ.get(variable, "") if ros else ""
        environment[variable] = os.pathsep.join(filter(None, [str(tools), others]))
    configuration = {
        "CMAKE_BUILD_TYPE": "Release",
        "CMAKE_INSTALL_PREFIX": str(folder / "installed"),
        "Python3_EXECUTABLE": str(python),
        "BUILD_TESTING": "OFF",
    }
    definitions = [f"-D{name}={value}" for name, value in configuration.items()]
    doing, build = "building ehls_msgs", str(folder / "build")
    run(["cmake", "-S", str(MESSAGES), "-B", build, *definitions], doing, environment)
    run(["cmake", "--build", build, "--target", "install", "--parallel", str(os.cpu_count() or 1)], doing, environment)
    return folder / "installed"


def pack(folder: Path, name: str, tag: str, wheel: Path) -> None:
    """Pack a cmake installation as a wheel, whose files are placed relative to the environment's folder.

    Args:
        folder: the cmake installation.
        name: name and version, as in the file name of the wheel.
        tag: versions of Python and machine that it is for.
        wheel: file to write.
    """
    project, version = name.split("-")
    info = f"{name}.dist-info"
    texts = {
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {project}\nVersion: {version}\n",
        f"{info}/WHEEL": f"Wheel-Version: 1.0\nGenerator: ehls_ros\nRoot-Is-Purelib: false\nTag: {tag}\n",
    }
    # cmake's description of the Python package would duplicate that of the wheel.
    built = [path for path in files_below(folder) if ".egg-info" not in str(path)]
    files = {f"{name}.data/data/{path.relative_to(folder)}": path for path in built}
    texts[f"{info}/RECORD"] = "".join(f"{path},,\n" for path in (*files, *texts, f"{info}/RECORD"))
    fresh = wheel.with_suffix(f".{os.getpid()}")
    with zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, file in files.items():
            archive.write(file, path)
        for path, text in texts.items():
            archive.writestr(path, text)
    fresh.replace(wheel)


def check_messages() -> None:
    """Check that the messages can be imported.

    Raises:
        SetupError: they cannot.
    """
    message = min(path.stem for path in MESSAGES.glob("msg/*.msg"))
    load = f"from ehls_msgs.msg import {message}; type({message}).__import_type_support__()"
    run([str(PYTHON), "-c", load], "importing the messages", child_environment())


def uv(*arguments: str, doing: str) -> None:
    """Run uv.

    Args:
        arguments: its command line.
        doing: description, for the error message.

    Raises:
        SetupError: it failed.
    """
    environment = settings_of_pip() | child_environment() | {"UV_PYTHON_DOWNLOADS": "never", "UV_NO_PROGRESS": "1"}
    environment.pop("VIRTUAL_ENV", None)
    run([str(uv_program()), *arguments], doing, environment)


@functools.cache
def settings_of_pip() -> dict[str, str]:
    """Return pip's package sources as uv's variables, since uv reads none of pip's files and variables.

    With several indexes, pip takes the best version of all of them.
    """
    names = {
        "index-url": "UV_DEFAULT_INDEX",
        "extra-index-url": "UV_INDEX",
        "find-links": "UV_FIND_LINKS",
        "trusted-host": "UV_INSECURE_HOST",
        "cert": "SSL_CERT_FILE",
    }
    listing = [sys.executable, "-m", "pip", "--disable-pip-version-check", "config", "list"]
    listed = subprocess.run(listing, capture_output=True, text=True, check=False, env=child_environment()).stdout
    settings = {"UV_INDEX_STRATEGY": "unsafe-best-match"}
    for line in reversed(listed.splitlines()):  # variables come first, and take precedence
        key, _, value = line.partition("=")
        if variable := names.get(key.rpartition(".")[2]):
            settings[variable] = " ".join(ast.literal_eval(value).split())
    return settings


def uv_program() -> Path:
    """Return uv: the user's, or the locked one, which is fetched once with pip and kept in the cache.

    Raises:
        SetupError: there is no pip to fetch it with, or it could not be fetched.
    """
    if found := shutil.which("uv"):
        return Path(found)
    program = CACHE / f"uv-{fingerprint([LOCK])[:16]}"
    if not program.exists():
        if importlib.util.find_spec("pip") is None:
            advice = "install either, on Debian or Ubuntu `apt install python3-pip`"
            raise SetupError(f"{sys.executable} is without pip, and there is no uv: {advice}")
        program.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="uv_", dir=program.parent) as folder:
            pinned = Path(folder, "uv.txt")
            (block,) = re.findall(r"^uv==(?:.*\\\n)+.*", LOCK.read_text(encoding="utf-8"), re.MULTILINE)
            pinned.write_text(block, encoding="utf-8")
            pip = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--progress-bar=off"]
            only = ["--require-hashes", "--only-binary=:all:", "--requirement", str(pinned), "--target", folder]
            run([*pip, *only], "fetching uv", child_environment())
            Path(folder, "bin", "uv").replace(program)
    return program


def run(command: list[str], doing: str, environment: dict[str, str]) -> None:
    """Run a command; its output goes to the log and, line by line, to the last line of a terminal.

    Args:
        command: program and arguments.
        doing: description, for the error message.
        environment: environment variables.

    Raises:
        SetupError: it failed.
    """
    output = []
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
    log = LOG if VENV.is_dir() else Path(os.devnull)
    with log.open("a", encoding="utf-8") as file:
        file.writelines([f"$ {shlex.join(command)}\n", *output])
    if process.returncode:
        where = f" (full output in {LOG.relative_to(ROOT)})" if log == LOG else ""
        raise SetupError(f"{doing} failed: {reason(output)}{where}")


def show(line: str) -> None:
    """Replace the previous line, on a terminal only."""
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
    network = ""
    if any(map(NO_INDEX.search, lines)):
        network = "packages could not be downloaded, is there a network? (PIP_INDEX_URL names a mirror) "
    return network + (errors or lines)[-1]


def child_environment() -> dict[str, str]:
    """Return the environment variables for a program in ``.venv``."""
    environment = dict(os.environ)
    if environment.pop(WHEELS_GUARD, None):
        environment.pop("LD_LIBRARY_PATH", None)
    environment["PATH"] = os.pathsep.join([str(PYTHON.parent), environment.get("PATH", os.defpath)])
    return environment


def python_paths(python: Path) -> dict[str, str]:
    """Return the installation paths of an environment's Python, as sysconfig names them."""
    code = "import json, sysconfig; print(json.dumps(sysconfig.get_paths()))"
    shown = subprocess.run([python, "-c", code], check=True, capture_output=True, text=True, env=child_environment())
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


def read_made() -> dict[str, Any]:
    """Return the configuration that the environment was made for; empty if there is no valid record of it."""
    try:
        made = json.loads(MADE.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return made if isinstance(made, dict) else {}


def replace(file: Path, text: str) -> None:
    """Replace a file by one with this text in one step: the old one may be a link into a cache, and must stay unchanged."""
    fresh = file.with_name(f"{file.name}.new")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(file)


if __name__ == "__main__":
    sys.exit(main())
