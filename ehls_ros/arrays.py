"""What numerical code is written with: the array type and the compiling decorator."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

kernel = njit(error_model="numpy", forceinline=True)
"""Compile a per-sample function into whatever compiled function calls it.

Such a function is not called from Python; :mod:`ehls_ros.physics.composition` makes the entries that are.
"""
