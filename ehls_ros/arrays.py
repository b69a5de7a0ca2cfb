"""The array type and the compiling decorators of the numerical code."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ehls_ros.inlining import Inlined

Array = NDArray[np.float64]

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(function: _Function) -> _Function:
    """Compile a per-sample function and inline it into the compiled function that calls it.

    :mod:`ehls_ros.physics.composition` makes the entry points that are called from Python.
    """
    return cast(_Function, Inlined(function, targetoptions={"error_model": "numpy"}))


def lean(function: _Function) -> _Function:
    """Compile as :func:`kernel` does a function that passes views of arrays on and allocates none.

    Counting who holds each view, as numba does elsewhere, would cost ten times what the function does.
    """
    return cast(_Function, Inlined(function, targetoptions={"error_model": "numpy", "_nrt": False}))


def in_python(compiled: _Function) -> _Function:
    """Return a compiled function as plain Python: a single call is not worth a compilation."""
    return cast(_Function, cast(Any, compiled).py_func)
