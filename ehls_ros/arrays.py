"""The array type and the compiling decorators of the numerical code."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic
from numpy.typing import NDArray

from ehls_ros.inlining import inlined

Array = NDArray[np.float64]

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(function: _Function, python: Callable[..., Any] | None = None) -> _Function:
    """Compile a per-sample function and inline it into its compiled callers.

    :mod:`ehls_ros.physics.composition` generates the functions that are called from Python.

    Args:
        function: the function.
        python: replacement for calls from Python; without one, each process compiles a wrapper at the first such call.
    """
    return cast(_Function, inlined(function, python=python))


def kernel_no_refcount(function: _Function) -> _Function:
    """Compile like :func:`kernel`, but without reference counting of arrays; the function must not allocate any.

    In a function that passes many array views, counting their references would take ten times as long as the computation.
    """
    return cast(_Function, inlined(function, counts_references=False))


@kernel
def copy(source: Array, target: Array) -> None:
    """Copy a one-dimensional array, for compiled callers.

    A slice assignment would make numba compile the error message for a shape mismatch, which takes over a second.
    """
    for i in range(source.size):
        target[i] = source[i]


def separate_kernel(function: _Function) -> _Function:
    """Compile a function for compiled callers as a separate numba function, without wrappers for Python or C."""
    compile_with: Any = numba.njit
    return cast(_Function, compile_with(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(function))


def direct(compiled: _Function, *arguments: Any) -> _Function:
    """Return the entry point of a compiled function for given argument types, compiled or loaded.

    A call through the dispatcher determines the argument types each time. For bundles of constants and arrays this takes some
    10 us, longer than most kernels run.

    Args:
        compiled: the function; it must outlive the entry point.
        *arguments: example arguments; later ones must have the same types, and arrays the same number of dimensions,
            contiguous.
    """
    if not isinstance(compiled, Dispatcher):
        return compiled
    type_of: Callable[[Any], Any] = numba.typeof
    types = tuple(type_of(argument) for argument in arguments)
    # Compiling again would first check the cached code of the kernel for changes.
    ready: Any = compiled.overloads.get(types)
    return cast(_Function, compiled.compile(types) if ready is None else ready.entry_point)


def contiguous(array: Array) -> Array:
    """Return an array as contiguous floats, as a :func:`direct` entry point requires; the array itself if it already is."""
    return np.ascontiguousarray(array, dtype=np.float64)


def compiler_function(build: Callable[..., Any], python: Callable[..., Any] | None = None) -> Callable[..., Any]:
    """Make a compiled function from the types and intermediate code that ``build`` generates.

    Args:
        build: see :func:`numba.extending.intrinsic`; its first argument is numba's typing context.
        python: replacement where compilation is disabled.
    """
    if numba.config.DISABLE_JIT and python is not None:  # type: ignore[attr-defined]  # set when numba reads the environment
        return python
    return cast(Callable[..., Any], intrinsic(build))


def in_python(compiled: _Function) -> _Function:
    """Return the Python function behind a compiled one, for single calls that do not justify compilation."""
    return cast(_Function, cast(Any, compiled).py_func)
