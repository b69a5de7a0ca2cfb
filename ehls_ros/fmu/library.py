"""Shared libraries of an FMU: the model's machine code linked with the functions of FMI."""

import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from ehls_ros.errors import WorkFailed
from ehls_ros.extras import missing
from ehls_ros.fmu.header import header
from ehls_ros.fmu.machine_code import object_code
from ehls_ros.fmu.model import Model

SOURCE = Path(__file__).resolve().parent / "source"
"""Folder of the C files."""

EXTRA = "fmu"
"""Extra of setup.py with the toolchain and the headers of FMI."""

TARGETS = {"linux": "x86_64-linux-gnu.2.17", "windows": "x86_64-windows-gnu"}
"""Systems as ziglang calls them; for Linux with the oldest C library that runs the code (2012)."""

SUFFIXES = {"linux": ".so", "windows": ".dll"}

C_FILES = ("instance.c", "fmi2.c", "fmi3.c", "system.c")

COMPILING = ("-std=c11", "-O2", "-fPIC", "-fvisibility=hidden", "-fno-sanitize=all", "-fno-stack-protector", "-Wall", "-c")

LINKING = {"linux": ("-lm", "-Wl,-z,defs"), "windows": ("-nostdlib",)}
"""Options of the last step. ziglang would build its own C runtime for Windows, which takes minutes; system.c needs none."""

WINDOWS_RUNTIME = "ucrtbase"
"""Library of Windows, since version 10, with the functions of the C library."""

TIME_LIMIT = 600.0
"""Longest time for a tool [s]; the first link for a system builds parts of its C library."""


def _folder_of(package: str, where: str) -> Path:
    """Return the folder of an optional package.

    Raises:
        BadInput: it is not installed.
    """
    found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise missing(f"{package} is not installed", EXTRA, where)
    return Path(found.submodule_search_locations[0])


def headers(where: str) -> Path:
    """Return the folder with the headers of FMI 2.0 and 3.0.

    Raises:
        BadInput: fmpy, which contains them, is not installed.
    """
    return _folder_of("fmpy", where) / "c-code"


def check_toolchain(where: str) -> None:
    """Check that the toolchain is installed.

    Raises:
        BadInput: it is not.
    """
    _folder_of("ziglang", where)
    headers(where)


def shared_library(model: Model, token: str, system: str, where: str) -> bytes:
    """Return a shared library with the functions of FMI 2.0 and 3.0.

    Args:
        model: the model.
        token: instantiation token.
        system: ``linux`` or ``windows``.
        where: the command, for errors.

    Raises:
        BadInput: the toolchain is not installed.
        WorkFailed: it failed.
    """
    check_toolchain(where)
    with tempfile.TemporaryDirectory(prefix="ehls_fmu_") as name:
        folder = Path(name)
        (folder / "model.h").write_text(header(model, token), encoding="utf-8")
        parts = []
        for entry, kernel in model.entries.items():
            parts.append(folder / f"{entry}.o")
            parts[-1].write_bytes(object_code(kernel, entry, system))
        target = ("-target", TARGETS[system])
        for file in C_FILES:
            parts.append(folder / f"{file}.o")
            included = ("-I", name, "-I", str(headers(where)))
            _zig(folder, "cc", *target, *COMPILING, *included, "-o", str(parts[-1]), str(SOURCE / file))
        if system == "windows":
            parts.append(folder / "runtime.a")
            definition = str(SOURCE / f"{WINDOWS_RUNTIME}.def")
            _zig(folder, "dlltool", "-m", "i386:x86-64", "-d", definition, "-l", str(parts[-1]))
        made = folder / f"{model.name}{SUFFIXES[system]}"
        _zig(folder, "cc", *target, "-shared", "-s", "-o", str(made), *map(str, parts), *LINKING[system])
        return made.read_bytes()


def _zig(folder: Path, *words: str) -> None:
    """Run a tool of ziglang in a folder.

    Raises:
        WorkFailed: it failed.
    """
    command = [sys.executable, "-m", "ziglang", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIME_LIMIT, cwd=folder)
    if done.returncode:
        raise WorkFailed(f"`{' '.join(words[:3])}` failed: {done.stderr.strip()[-2000:]}")
