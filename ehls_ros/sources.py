"""A digest of the package's own sources, by which results of older code are told from those of this."""

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


@cache
def sources_digest(*parts: str) -> str:
    """Return a digest of every source file in some parts of the package, its name included.

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
