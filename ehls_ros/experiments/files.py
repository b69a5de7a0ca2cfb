"""Location of the files that come with the package, in a checkout and in an installation."""

import os
from pathlib import Path

from ehls_ros.errors import BadInput, one_of

PACKAGE = Path(__file__).resolve().parent.parent


def config_folder() -> Path:
    """Return the folder of the rig files and experiment specs that come with the package.

    Raises:
        BadInput: the installation has none.
    """
    for parent in PACKAGE.parents:
        for folder in (parent / "config", parent / "share" / "ehls_ros" / "config"):
            if (folder / "rig_paper.yaml").is_file():
                return folder
    raise BadInput("the installation has no config folder", str(PACKAGE), "share/ehls_ros/config as setup.py installs it")


def configured_names(folder: str = "") -> list[str]:
    """Return the names of the files that come with the package.

    Args:
        folder: where they are in the configuration folder: ``experiments``, ``campaigns``, or the empty text for rigs.
    """
    return sorted(file.stem for file in (config_folder() / folder).glob("*.yaml" if folder else "rig_*.yaml"))


def configured(name: str | Path, folder: str = "", beside: Path = Path()) -> Path:
    """Return a file, or the one of that name that comes with the package where there is none.

    Args:
        name: path of a file, or name without ``.yaml`` of one that comes with the package, such as ``sine_fd2``.
        folder: where those are in the configuration folder: ``experiments``, ``campaigns``, or the empty text for rigs.
        beside: where a relative path starts.

    Raises:
        BadInput: there is no file of that name.
    """
    path = beside / name
    if path.suffix or Path(name).name != str(name) or os.path.exists(path):  # noqa: PTH110 - Path's raises for a long name
        return path
    names = configured_names(folder)
    if str(name) not in names:
        raise BadInput(f"there is no file {str(path)!r}", folder or "rig", f"a file's path, or {one_of(name, names)}")
    return config_folder() / folder / f"{name}.yaml"
