"""What numerical code is written with: the array type and the compiling decorator."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

kernel = njit(error_model="numpy", forceinline=True)
"""Compile a per-sample function into whatever compiled function calls it.

Such a function is not called from Python; :mod:`ehls_ros.physics.composition` makes the entries that are.
"""

_LEAN: Any = {"error_model": "numpy", "forceinline": True, "_nrt": False}  # numba's types do not know the last
_Function = TypeVar("_Function", bound=Callable[..., Any])


def lean(function: _Function) -> _Function:
    """Compile as :data:`kernel` does a function that passes views of arrays on and allocates none.

    Counting who holds each view, as numba does elsewhere, would cost ten times what the function does.
    """
    compiled: _Function = njit(**_LEAN)(function)
    return compiled
