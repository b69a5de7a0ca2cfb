"""The array type and the compiling decorators of the numerical code."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic
from numpy.typing import NDArray

from ehls_ros.inlining import Inlined

Array = NDArray[np.float64]

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(function: _Function, python: Callable[..., Any] | None = None) -> _Function:
    """Compile a per-sample function and inline it into its compiled callers.

    :mod:`ehls_ros.physics.composition` generates the functions that are called from Python.

    Args:
        function: the function.
        python: takes its place in calls from Python, which else compile a function that calls it, in each process anew.
    """
    return cast(_Function, Inlined(function, targetoptions={"error_model": "numpy"}, python=python))


def lean(function: _Function) -> _Function:
    """Compile like :func:`kernel`, but without reference counting of arrays; the function must not allocate any.

    For a function that passes many array views, counting their references would cost ten times the work itself.
    """
    return cast(_Function, Inlined(function, targetoptions={"error_model": "numpy", "_nrt": False}))


@kernel
def copy(source: Array, target: Array) -> None:
    """Copy an array of one dimension, for compiled callers.

    Where one assigns a slice instead, numba compiles the message for arrays that differ in shape, which takes over a second.
    """
    for i in range(source.size):
        target[i] = source[i]


def apart(function: _Function) -> _Function:
    """Compile a function for compiled callers as numba would by itself, with none of its wrappers for others."""
    compile_with: Any = numba.njit
    return cast(_Function, compile_with(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(function))


def direct(compiled: _Function, *arguments: Any) -> _Function:
    """Return a compiled function's entry for arguments of certain types, compiled or loaded.

    A call of the function itself finds out the types of its arguments each time: some 10 us for bundles of constants and
    arrays, more than most kernels run for.

    Args:
        compiled: the function; it must live as long as its entry.
        *arguments: an example; later ones must have the same types, and arrays the same dimensions, contiguous.
    """
    if not isinstance(compiled, Dispatcher):
        return compiled
    type_of: Callable[[Any], Any] = numba.typeof
    return cast(_Function, compiled.compile(tuple(type_of(argument) for argument in arguments)))


def plain(array: Array) -> Array:
    """Return an array as a :func:`direct` entry takes it: of floats, contiguous; the array itself if it is that."""
    return np.ascontiguousarray(array, dtype=np.float64)


def compiler_function(build: Callable[..., Any], python: Callable[..., Any] | None = None) -> Callable[..., Any]:
    """Make a function of compiled code from its intermediate code, which ``build`` types and writes.

    Args:
        build: see :func:`numba.extending.intrinsic`; its first argument is numba's.
        python: takes its place where nothing is compiled.
    """
    if numba.config.DISABLE_JIT and python is not None:  # type: ignore[attr-defined]  # set when numba reads the environment
        return python
    return cast(Callable[..., Any], intrinsic(build))


def in_python(compiled: _Function) -> _Function:
    """Return the Python function behind a compiled one, as a single call is not worth compiling."""
    return cast(_Function, cast(Any, compiled).py_func)
