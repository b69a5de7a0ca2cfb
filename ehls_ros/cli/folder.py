"""A folder for results that a verb is about to write."""

from pathlib import Path

from ehls_ros.errors import BadInput


def writable(folder: Path, file: str) -> Path:
    """Make a folder unless it is there, and find out before the work whether a file can be written in it.

    Raises:
        BadInput: it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        new = not (folder / file).exists()
        (folder / file).touch()
        if new:
            (folder / file).unlink()  # work that is interrupted leaves no empty result
    except OSError as error:
        raise BadInput(f"the folder cannot be written ({error.strerror})", str(folder), "a writable folder") from None
    return folder
