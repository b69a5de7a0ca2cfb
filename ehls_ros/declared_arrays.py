"""Declarations of arrays that are stored between runs: type, shape and range, and the check against them."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]
"""Arrays by name."""


class Entry(NamedTuple):
    """Declaration of one array.

    Attributes:
        kind: numpy's name of the type: ``float64``, ``float32``, ``complex128`` or ``int64``.
        shape: lengths; a name denotes one length shared by all arrays of a group.
        minimum, maximum: range of the values, or of their magnitudes if complex.
        infinite: whether values may be infinite, such as an unknown variance.
        missing: whether values may be NaN, such as missing samples of a signal.
    """

    kind: str = "float64"
    shape: tuple[int | str, ...] = ()
    minimum: float = -math.inf
    maximum: float = math.inf
    infinite: bool = False
    missing: bool = False


def check_arrays(arrays: Arrays, declared: Mapping[str, Entry], lengths: Mapping[str, int] | None = None) -> dict[str, int]:
    """Check a group of arrays against its declaration.

    Args:
        arrays: the arrays by name.
        declared: declaration of each; no other array is accepted, and none may be absent.
        lengths: lengths that are known beforehand, by the names used in ``shape``.

    Returns:
        The lengths by name.

    Raises:
        ValueError: names the first array that does not match.
    """
    for name in arrays:
        if name not in declared:
            raise ValueError(f"the array {name!r} is unknown")
    known = dict(lengths or {})
    for name, entry in declared.items():
        if name not in arrays:
            raise ValueError(f"the array {name!r} is missing")
        _check(name, arrays[name], entry, known)
    return known


def _check(name: str, array: NDArray[Any], entry: Entry, lengths: dict[str, int]) -> None:
    if array.dtype != np.dtype(entry.kind):
        raise ValueError(f"{name!r} has the type {array.dtype}, not {entry.kind}")
    if len(array.shape) != len(entry.shape):
        raise ValueError(f"{name!r} has {len(array.shape)} dimensions, not {len(entry.shape)}")
    for found, length in zip(array.shape, entry.shape, strict=True):
        wanted = length if isinstance(length, int) else lengths.setdefault(length, found)
        if found != wanted:
            raise ValueError(f"{name!r} has the shape {array.shape}, with {found} in place of {wanted}")
    if not array.size:
        return
    if np.isnan(array).any() and not entry.missing:
        raise ValueError(f"{name!r} has a value that is not a number")
    if np.isinf(array).any() and not entry.infinite:
        raise ValueError(f"{name!r} has an infinite value")
    size = np.abs(array) if np.iscomplexobj(array) else array
    # NaN passes both comparisons; it is rejected above unless permitted.
    if (size < entry.minimum).any() or (size > entry.maximum).any():
        raise ValueError(f"{name!r} has a value out of {entry.minimum:g} to {entry.maximum:g}")
