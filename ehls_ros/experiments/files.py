"""Location of the files that come with the package, in a checkout and in an installation."""

from pathlib import Path

from ehls_ros.errors import BadInput

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


def configured(name: str | Path, folder: str = "") -> Path:
    """Return a file, or the one that comes with the package where only its name is given.

    Args:
        name: path of a file, or name without ``.yaml`` of one that comes with the package, such as ``sine_fd2``.
        folder: where those are in the configuration folder: ``experiments``, ``campaigns``, or the empty text for rigs.

    Raises:
        BadInput: no file of that name comes with the package.
    """
    path = Path(name)
    if path.exists() or path.suffix or path.name != str(name):
        return path
    own = config_folder() / folder
    found = own / f"{name}.yaml"
    if not found.is_file():
        names = ", ".join(sorted(file.stem for file in own.glob("*.yaml")))
        raise BadInput(f"there is no file {str(name)!r}", folder or "rigs", f"a file's path, or a name of {names}")
    return found
