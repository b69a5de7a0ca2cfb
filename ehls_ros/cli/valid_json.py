"""Values as JSON can hold them."""

import math
from collections.abc import Mapping
from typing import Any


def valid_json(value: Any) -> Any:
    """Return a value with null in place of what JSON has no number for, such as the error of a run that diverged."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: valid_json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [valid_json(entry) for entry in value]
    return value
