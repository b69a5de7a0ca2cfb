"""Output folders of the verbs."""

from pathlib import Path

from ehls_ros.errors import BadInput


def writable(folder: Path, file: str) -> Path:
    """Create a folder if needed, and check in advance that a file can be written in it.

    Raises:
        BadInput: the file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        new = not (folder / file).exists()
        (folder / file).touch()
        if new:
            (folder / file).unlink()  # interrupted work must leave no empty result
    except OSError as error:
        raise BadInput(f"the folder cannot be written ({error.strerror})", str(folder), "a writable folder") from None
    return folder
