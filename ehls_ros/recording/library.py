"""Libraries for formats that not everybody has."""

import sys
from importlib.util import find_spec
from pathlib import Path

from ehls_ros.errors import BadInput


def check_library(module: str, package: str, path: Path) -> None:
    """Refuse a file whose library is not installed, without importing it: that takes as long as reading a file.

    Args:
        module: dotted name of the module that reads it.
        package: what installs it.
        path: the file.

    Raises:
        BadInput: it is not installed.
    """
    try:
        found = find_spec(module) is not None
    except (ImportError, ValueError):
        found = False
    if not found:
        expected = f"it installed (`{sys.executable} -m pip install {package}`), or the data as CSV"
        raise BadInput(f"{package} is not installed, which reads this format", str(path), expected)
