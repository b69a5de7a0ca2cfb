"""Optional libraries, and the commands that install them."""

import os
import shlex
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from ehls_ros.errors import BadInput

CHECKOUT = Path(__file__).resolve().parent.parent


def install_command(extra: str) -> str:
    """Return the command that adds an extra of setup.py to the running environment.

    Args:
        extra: name of the extra, such as ``dashboard``.
    """
    if Path(sys.prefix) == CHECKOUT / ".venv":
        folder = "" if Path.cwd() == CHECKOUT else f"-C {shlex.quote(os.path.relpath(CHECKOUT))} "
        return f"make {folder}setup WITH={extra}"
    return f"{shlex.quote(sys.executable)} -m pip install 'ehls_ros[{extra}]'"


def library(module: str, extra: str, where: str) -> Any:
    """Import a module of an optional library.

    Args:
        module: dotted name.
        extra: the extra that brings it.
        where: command or file that requires it, for the error.

    Raises:
        BadInput: it cannot be imported.
    """
    try:
        return import_module(module)
    except ImportError:
        raise missing(f"{module.partition('.')[0]} is not installed", extra, where) from None


def missing(what: str, extra: str, where: str, instead: str = "") -> BadInput:
    """Return the error that requests installation of an extra.

    Args:
        what: the missing library, as a sentence.
        extra: the extra that brings it.
        where: command or file that requires it.
        instead: alternative without it.
    """
    return BadInput(what, where, ", or ".join(filter(None, [f"`{install_command(extra)}`", instead])))
