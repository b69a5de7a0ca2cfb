"""The array type and the compiling decorator of the numerical code."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

kernel = njit(error_model="numpy", forceinline=True)
"""Compile a per-sample function and inline it into the compiled function that calls it.

Do not call such a function from Python; :mod:`ehls_ros.physics.composition` makes the callable entry points.
"""
