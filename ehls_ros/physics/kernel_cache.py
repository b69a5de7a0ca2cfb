"""Cache folder of compiled kernels, with safeguards for running its contents.

Machine code is cached as pickles, and loading a pickle can run any code. Therefore only the user can write to the folder. A
kernel's text is run from memory; its file serves only for numba to find the machine code. Machine code is loaded only if it is
unchanged since it was compiled; damaged code is compiled again.
"""

import fcntl
import hashlib
import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import BinaryIO

from ehls_ros.errors import BadInput

PREFIX = "ehls_kernel_"
"""Prefix of the names of kernels."""

CODE = "__pycache__"
"""Subfolder in which numba caches machine code."""

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH

OWN_FOLDER = "a folder that only you can write: remove this one, or set EHLS_CACHE_DIR to another"


def cache_folder() -> Path:
    """Return the folder of generated kernels: ``$EHLS_CACHE_DIR``, or ``ehls_ros`` in the user's cache folder."""
    chosen = os.environ.get("EHLS_CACHE_DIR")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ehls_ros"


def make_private(folder: Path) -> None:
    """Create a folder for kernels that only the user can write; one writable by others is emptied first.

    Args:
        folder: the folder; if missing, it is created with mode 700.

    Raises:
        BadInput: it belongs to another user, or others may write it and it contains more than kernels.
        OSError: it cannot be created.
    """
    folder.mkdir(0o700, parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        # If several processes start at once, only one empties it.
        fcntl.flock(handle, fcntl.LOCK_EX)
        status = os.fstat(handle)
        if status.st_uid != os.geteuid():
            raise BadInput(f"the folder of compiled kernels belongs to user {status.st_uid}", str(folder), OWN_FOLDER)
        if status.st_mode & OTHERS_WRITE:
            _take_over(folder)
    finally:
        os.close(handle)


def _take_over(folder: Path) -> None:
    """Revoke others' write permission and delete all content that they may have placed there."""
    strangers = sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith((PREFIX, CODE, "tmp")))
    if strangers:
        what = f"others may write the folder of compiled kernels, which holds '{strangers[0]}' too"
        raise BadInput(what, str(folder), OWN_FOLDER)
    folder.chmod(0o700)
    for entry in folder.iterdir():
        shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
    logging.getLogger(__name__).warning("%s: others could write it; its kernels are compiled again", folder)


def store_source(name: str, source: str) -> Path:
    """Write a kernel's text to the cache folder unless it is already there.

    Args:
        name: name of the kernel's module.
        source: text of the module.

    Returns:
        The file, in a temporary folder if the cache folder cannot be written.

    Raises:
        BadInput: other users can write to the cache folder.
    """
    try:
        make_private(cache_folder())
        return _written(cache_folder(), name, source)
    except OSError:
        return _written(_temporary_folder(), name, source)


@cache
def _temporary_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="ehls_ros_"))


def _written(folder: Path, name: str, source: str) -> Path:
    path, text = folder / f"{name}.py", source.encode()
    if path.is_file() and os.access(folder, os.W_OK) and path.read_bytes() == text:
        return path
    handle, scratch = tempfile.mkstemp(dir=folder, prefix=PREFIX, suffix=".py")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(text)
        # Several nodes may start at once: each writes a separate file, and all rename the same text.
        Path(scratch).replace(path)
    except OSError:
        Path(scratch).unlink(missing_ok=True)
        raise
    return path


@contextmanager
def sealed(seal: Path, code: Path, pattern: str) -> Iterator[None]:
    """Lock machine code for loading or compiling, and delete it first if it has changed since the last use.

    Args:
        seal: file with the digest of the machine code, which is also the lock file. The operating system releases the lock
            when its process ends, even by a crash.
        code: folder of the machine code.
        pattern: glob pattern of the machine code files.
    """
    with _locked(seal) as file:
        found = file.read() if file else b""
        if found != _digest(code, pattern):
            for damaged in code.glob(pattern):
                damaged.unlink()
        yield
        left = _digest(code, pattern)
        # On a full disk the seal matches no code, and the code is compiled again.
        with suppress(OSError):
            if file and left != found:
                file.seek(0)
                file.truncate()
                file.write(left)


def is_sealed(seal: Path) -> bool:
    """Return whether a seal covers any machine code."""
    try:
        return seal.stat().st_size > 0
    except OSError:
        return False


def _digest(code: Path, pattern: str) -> bytes:
    """Return a digest of all matching files and their names; empty if there are none."""
    files = sorted(code.glob(pattern))
    text = "".join(f"{file.name} {hashlib.sha256(file.read_bytes()).hexdigest()}\n" for file in files)
    return hashlib.sha256(text.encode()).hexdigest().encode() if files else b""


@contextmanager
def _locked(file: Path) -> Iterator[BinaryIO | None]:
    """Lock out other processes; without a lock file, code is compiled twice at worst."""
    try:
        handle = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError:
        yield None
        return
    with os.fdopen(handle, "r+b", buffering=0) as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield stream
