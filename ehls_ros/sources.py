"""Digest of the package's sources, to distinguish results of different versions."""

import hashlib
import inspect
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType

PACKAGE = Path(__file__).resolve().parent


@cache
def sources_digest(*parts: str) -> str:
    """Return a digest of the names and contents of all source files in parts of the package.

    Args:
        parts: names of subpackages, and of single files such as ``arrays.py``.
    """
    places = (PACKAGE / part for part in parts)
    return _digest_of(path for place in places for path in ([place] if place.suffix else sorted(place.rglob("*.py"))))


@cache
def module_digest(module: ModuleType) -> str:
    """Return a digest of the sources of a family's member.

    The sources are its file and, for a member from another distribution, all files of that distribution's package, as it may
    import them.
    """
    file = Path(inspect.getfile(module))
    top = sys.modules[module.__name__.partition(".")[0]]
    if top.__name__ == PACKAGE.name or not hasattr(top, "__path__"):
        return _digest_of([file])
    return _digest_of(sorted({file, *(path for folder in top.__path__ for path in Path(folder).rglob("*.py"))}))


def import_line(member: object, name: str) -> str:
    """Return the import line of a module or a top-level function, for generated source text.

    The line ends with the digest of the member's sources, so that a change of the sources changes the text.

    Args:
        member: a module, such as a family's member, or a function.
        name: its name in the text.
    """
    if isinstance(member, ModuleType):
        return f"import {member.__name__} as {name}  # {module_digest(member)[:16]}"
    home, own = getattr(member, "__module__", None), getattr(member, "__name__", None)
    if home is None or own is None or getattr(sys.modules[home], own, None) is not member:
        raise TypeError(f"{member!r} is neither a module nor a function at the top level of one")
    return f"from {home} import {own} as {name}  # {module_digest(sys.modules[home])[:16]}"


def _digest_of(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        # Names relative to the package, so that the digest does not depend on the install location.
        digest.update(str(path.relative_to(PACKAGE) if path.is_relative_to(PACKAGE) else path.name).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()
