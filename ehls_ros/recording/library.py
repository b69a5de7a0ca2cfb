"""Check for optional libraries of file formats."""

from importlib.util import find_spec
from pathlib import Path

from ehls_ros.extras import missing


def check_library(module: str, package: str, path: Path) -> None:
    """Reject a file whose library is not installed, without importing it, which would take as long as reading a file.

    Args:
        module: dotted name of the module that reads the format.
        package: name of the package to install.
        path: the file.

    Raises:
        BadInput: the library is not installed.
    """
    try:
        found = find_spec(module) is not None
    except (ImportError, ValueError):
        found = False
    if not found:
        raise missing(f"{package} is not installed, which reads this format", "files", str(path), "the data as CSV")
