"""Libraries for formats that not everybody has."""

from importlib.util import find_spec
from pathlib import Path

from ehls_ros.extras import missing


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
        raise missing(f"{package} is not installed, which reads this format", "files", str(path), "the data as CSV")
