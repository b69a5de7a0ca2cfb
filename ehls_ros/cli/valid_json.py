"""Values that are valid JSON."""

import math
from collections.abc import Mapping
from typing import Any


def valid_json(value: Any) -> Any:
    """Return a value with null in place of NaN and infinity, which JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: valid_json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [valid_json(entry) for entry in value]
    return value
