"""Files that results are written to."""

from collections.abc import Callable
from pathlib import Path

from ehls_ros.errors import BadInput


def written(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Write a file into a folder, which is made if it is missing, and return its path.

    Raises:
        BadInput: it cannot be written.
    """
    file = Path(path)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write(file)
    except OSError as error:
        raise BadInput(f"it cannot be written ({error.strerror})", str(file), "a writable place") from None
    return file
