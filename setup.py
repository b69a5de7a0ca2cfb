"""Build of the ament_python package ehls_ros; ``pip install .`` without ROS gives its offline half."""

import os
import re
import sys
import tomllib
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "ehls_ros"
ROOT = Path(__file__).resolve().parent
NODES = [path.stem for path in (ROOT / PACKAGE / "nodes").glob("*_node.py")]
EXTRAS = ("campaign", "dashboard", "files", "fmu", "foxglove", "nidaqmx", "optimisers", "peers", "programme", "ros")
CONTROLLERS = [path.stem for path in (ROOT / PACKAGE / "control" / "controllers").glob("[!_]*.py") if path.stem != "base"]


def dependency_groups() -> dict[str, list[str]]:
    """Return the dependency groups of pyproject.toml that list packages, not other groups."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    return {name: group for name, group in groups.items() if all(isinstance(entry, str) for entry in group)}


def version() -> str:
    """Return the package's version; importing the package would need what it requires."""
    [found] = re.findall(r'^__version__ = "(.+)"$', (ROOT / PACKAGE / "__init__.py").read_text(encoding="utf-8"), re.MULTILINE)
    return str(found)


def installed_tree(top: str) -> list[tuple[str, list[str]]]:
    """Return the files under ``top`` as data_files, each folder below ``share/ehls_ros``."""
    files: dict[str, list[str]] = {}
    for path in sorted((ROOT / top).rglob("*")):
        relative = path.relative_to(ROOT)
        if path.is_file() and "__pycache__" not in relative.parts:
            files.setdefault(f"share/{PACKAGE}/{relative.parent}", []).append(str(relative))
    return list(files.items())


def refuse_without_messages() -> None:
    """End colcon's build of ehls_ros where ehls_msgs is not built: its nodes would not start.

    colcon and rosdep look for no package inside another. A link beside this package shows it to both.
    """
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    if any(Path(prefix, "share", "ehls_msgs", "package.xml").is_file() for prefix in prefixes):
        return
    line = f"ln -sfn {ROOT.name}/ehls_msgs src/ehls_msgs && colcon build --packages-up-to {PACKAGE}"
    sys.exit(f"{PACKAGE} needs ehls_msgs, which is not built yet; in the workspace's folder: {line}")


if "AMENT_PREFIX_PATH" in os.environ and not {"develop", "install"}.isdisjoint(sys.argv):
    refuse_without_messages()

GROUPS = dependency_groups()
setup(
    name=PACKAGE,
    version=version(),
    description="Node graph, identification and diagnosis for an electro-hydraulic load simulator",
    license="Apache-2.0",
    maintainer="ehls_ros maintainers",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={"": ["*.css", "*.js", "*.xml", "py.typed", "msg/*.msg"], f"{PACKAGE}.fmu": ["source/*"]},
    include_package_data=False,  # setuptools warns of each folder without Python code that MANIFEST.in names
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *installed_tree("config"),
        *installed_tree("launch"),
    ],
    python_requires=">=3.11",
    install_requires=GROUPS["base"],
    extras_require={
        **{name: GROUPS[name] for name in EXTRAS},
        "test": ["pytest>=7.4"],  # tells colcon how to run the tests
    },
    entry_points={
        "console_scripts": [
            f"ehls = {PACKAGE}.cli.main:entry",
            # A controller has no separate node file: ehls_ros.nodes creates its module.
            *(f"{node} = {PACKAGE}.nodes.{node}:main" for node in sorted([*NODES, *(f"{name}_node" for name in CONTROLLERS)])),
        ],
    },
    zip_safe=False,
)
