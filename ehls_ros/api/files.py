"""Output files of results."""

from collections.abc import Callable
from pathlib import Path

from ehls_ros.errors import BadInput


def written(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Write a file, creating its folder if necessary, and return its path.

    Raises:
        BadInput: the file cannot be written.
    """
    file = Path(path)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write(file)
    except OSError as error:
        raise BadInput(f"it cannot be written ({error.strerror})", str(file), "a writable place") from None
    return file
