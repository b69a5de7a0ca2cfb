"""Libraries that are not installed with ehls_ros."""

from importlib import import_module
from typing import Any

from ehls_ros.errors import BadInput


def library(module: str, where: str) -> Any:
    """Import a module of such a library.

    Args:
        module: dotted name.
        where: name of the problem, for the error.

    Raises:
        BadInput: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise BadInput(f"{name} is not installed", where, "pip install 'ehls_ros[optimisers]', or another optimiser") from None
