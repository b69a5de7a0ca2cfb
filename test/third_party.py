"""A third-party distribution in the form that pip leaves: modules, and metadata with entry points."""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from docs_snippets import ROOT, Block, entry_points, members

from ehls_ros.families import Family

NAME = "acme_ehls"


def families() -> dict[str, Family[Any]]:
    """Return all families of the project by their groups."""
    found: dict[str, Family[Any]] = {}
    for path in sorted((ROOT / "ehls_ros").rglob("__init__.py")):
        if "Family(" in path.read_text(encoding="utf-8"):
            package = import_module(".".join(path.parent.relative_to(ROOT).parts))
            found |= {family.group: family for family in vars(package).values() if isinstance(family, Family)}
    return found


def install(site: Path, modules: Mapping[str, str], points: Mapping[str, Mapping[str, str]], name: str = NAME) -> None:
    """Write a distribution into a folder of packages.

    Args:
        site: the folder.
        modules: text of each module by its dotted name.
        points: by group, the entry points.
        name: the distribution's.
    """
    for module, text in modules.items():
        path = site.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    info = site / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    sections = (f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in own.items()) for group, own in points.items())
    (info / "entry_points.txt").write_text("\n".join(sections), encoding="utf-8")


def install_page(site: Path, page: str) -> list[str]:
    """Install the parts added by a page, as its lines of `pyproject.toml` declare them, and return the modules' names."""
    files: Mapping[str, Block] = members(page)
    modules = {module: files[name].text for own in entry_points(page).values() for name, module in own.items()}
    install(site, modules, entry_points(page))
    return list(modules)
