"""Location of the files that come with the package, in a checkout and in an installation."""

import os
from pathlib import Path

from ehls_ros.errors import BadInput, one_of

PACKAGE = Path(__file__).resolve().parent.parent


def config_folder() -> Path:
    """Return the folder of the package's rig files and experiment specs.

    Raises:
        BadInput: the installation has no such folder.
    """
    for parent in PACKAGE.parents:
        for folder in (parent / "config", parent / "share" / "ehls_ros" / "config"):
            if (folder / "rig_paper.yaml").is_file():
                return folder
    raise BadInput("the installation has no config folder", str(PACKAGE), "share/ehls_ros/config as setup.py installs it")


def configured_names(folder: str = "") -> list[str]:
    """Return the names of the package's configuration files.

    Args:
        folder: subfolder of the configuration folder: ``experiments``, ``campaigns``, or empty for rigs.
    """
    return sorted(file.stem for file in (config_folder() / folder).glob("*.yaml" if folder else "rig_*.yaml"))


def configured(name: str | Path, folder: str = "", beside: Path = Path()) -> Path:
    """Resolve a file by its path, or a file of the package by its name.

    Args:
        name: path of a file, or name without ``.yaml`` of a file of the package, such as ``sine_fd2``.
        folder: subfolder of the configuration folder: ``experiments``, ``campaigns``, or empty for rigs.
        beside: base folder of a relative path.

    Raises:
        BadInput: there is no file of that name.
    """
    path = beside / name
    if path.suffix or Path(name).name != str(name) or os.path.exists(path):  # noqa: PTH110 - Path.exists raises for a long name
        return path
    names = configured_names(folder)
    if str(name) not in names:
        raise BadInput(f"there is no file {str(path)!r}", folder or "rig", f"a file's path, or {one_of(name, names)}")
    return config_folder() / folder / f"{name}.yaml"
