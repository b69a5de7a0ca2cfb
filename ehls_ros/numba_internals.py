"""The overridden private parts of numba: the one module that depends on them.

:mod:`ehls_ros.inlining` imports it only where numba has these names as known here, and uses plain numba otherwise.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from importlib import import_module
from typing import Any

from numba import config, njit, types
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher


def skip_scipy_check() -> None:
    """Skip numba's check for scipy when it loads its functions; this package requires scipy anyway.

    The check imports scipy's linear algebra, which dominates the loading time of a kernel. Functions that call BLAS check
    again.
    """
    # Numba, too, loads them only with the first function that it compiles or loads.
    linalg: Any = import_module("numba.np.linalg")
    ensure_blas = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = ensure_blas


@contextmanager
def faster_compilation() -> Iterator[None]:
    """Reduce numba's compile time by a quarter for a function and its callees; the compiled code is the same.

    The caller holds numba's lock.
    """
    collecting = gc.isenabled()
    # Compilation keeps hundreds of thousands of new objects, which the garbage collector would scan repeatedly.
    gc.disable()
    try:
        with _signatures_remembered():
            yield
    finally:
        if collecting:
            gc.enable()


@contextmanager
def _signatures_remembered() -> Iterator[None]:
    """Cache numba's look-up of the result type of operators and built-in functions by argument types.

    At each call in the code, numba tries each of dozens of implementations. An implementation in Python is compiled with the
    options of its caller and is therefore looked up each time; the result of all others depends on the types alone.
    """
    functions: Any = types.Function
    if "get_call_type" in vars(functions):
        # Nested compilation: a callee of the function being compiled.
        yield
        return
    find = functions.get_call_type
    known: dict[Any, Any] = {}

    def remembered(function: Any, context: Any, arguments: Any, keywords: Any) -> Any:
        if keywords:
            return find(function, context, arguments, keywords)
        call = function, tuple(arguments)
        if call not in known:
            found = find(function, context, arguments, keywords)
            if function.get_impl_key(found) is not function.typing_key:
                return found
            known[call] = found
        return known[call]

    functions.get_call_type = remembered
    try:
        yield
    finally:
        del functions.get_call_type


class _IntermediateCode(CPUCodeLibrary):
    """Code library of a function and its callees as intermediate code, neither optimised nor translated to machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Inliner(Compiler):
    """Numba compiler that stops at intermediate code."""

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        target = self.state.targetctx
        # Numba looks up the code to inline by its executable function; there is none, so any object will do.
        target.get_executable = lambda library, description, environment: object()
        self.state.library = _IntermediateCode(target.codegen(), func.__qualname__)
        return super().compile_extra(func)


class Inlined(CPUDispatcher):
    """A function that is inlined into compiled callers.

    A call from Python, for tests and debugging, runs the replacement given for Python; without one, it compiles a wrapper.
    """

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: dict[str, Any] | None = None,  # noqa: A002 - numba's own name, for pickling
        targetoptions: dict[str, Any] | None = None,
        pipeline_class: type[Compiler] = _Inliner,
        python: Callable[..., Any] | None = None,
    ) -> None:
        """Prepare a Python function for compilation.

        Args:
            py_func: the function.
            locals: types of local variables that cannot be inferred.
            targetoptions: options of :func:`numba.njit`.
            pipeline_class: the compiler.
            python: replacement for calls from Python.
        """
        self._python = python
        options = {"nopython": True, "forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(py_func, locals or {}, options | (targetoptions or {}), pipeline_class)

    def add_overload(self, cres: Any) -> None:
        """Store a compiled signature; the base class would also make it callable from Python."""
        self.overloads[tuple(cres.signature.args)] = cres

    def __call__(self, *args: Any) -> Any:
        """Call the function from Python."""
        return self._from_python(*args)

    @cached_property
    def _from_python(self) -> Any:
        inlined = self
        if self._python is not None:
            return self._python
        if config.DISABLE_JIT:  # type: ignore[attr-defined]  # set when numba reads the environment
            return self.py_func

        @njit(error_model=self.targetoptions["error_model"])
        def call(*args: Any) -> Any:
            return inlined(*args)

        return call
