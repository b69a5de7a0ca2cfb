"""A digest of the package's own sources, by which results of older code are told from those of this."""

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


@cache
def sources_digest(*folders: str) -> str:
    """Return a digest of every source file in some folders of the package, its name included.

    Args:
        folders: names of subpackages.
    """
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted((PACKAGE / folder).rglob("*.py")):
            digest.update(str(path.relative_to(PACKAGE)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
