"""Conversion of frozen records to JSON documents."""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def json_document(value: object) -> Any:
    """Return a record as JSON values.

    Args:
        value: a named tuple or frozen dataclass, with field names as keys; or a mapping, sequence, array or scalar.

    Returns:
        Dictionaries, lists and scalars. A number that is not finite becomes null, such as the error of a diverged run.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    elif is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: json_document(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_document(entry) for entry in value]
    return value
