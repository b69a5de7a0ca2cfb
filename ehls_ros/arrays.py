"""The array type and the compiling decorator of the numerical code."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

kernel = njit(error_model="numpy", forceinline=True)
"""Compile a per-sample function and inline it into the compiled function that calls it.

Do not call such a function from Python; :mod:`ehls_ros.physics.composition` makes the callable entry points.
"""

_LEAN: Any = {"error_model": "numpy", "forceinline": True, "_nrt": False}  # numba's types do not know the last
_Function = TypeVar("_Function", bound=Callable[..., Any])


def lean(function: _Function) -> _Function:
    """Compile as :data:`kernel` does a function that passes views of arrays on and allocates none.

    Counting who holds each view, as numba does elsewhere, would cost ten times what the function does.
    """
    compiled: _Function = njit(**_LEAN)(function)
    return compiled
