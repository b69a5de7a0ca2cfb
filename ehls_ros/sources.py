"""Digest of the package's sources, to tell results of this version from those of an older one."""

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


@cache
def sources_digest(*parts: str) -> str:
    """Return a digest of the names and contents of all source files in some parts of the package.

    Args:
        parts: names of subpackages, and of single files such as ``arrays.py``.
    """
    digest = hashlib.sha256()
    for part in parts:
        place = PACKAGE / part
        for path in [place] if place.suffix else sorted(place.rglob("*.py")):
            digest.update(str(path.relative_to(PACKAGE)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
