"""Compiled functions that exist only inlined in others.

Numba optimises each function it compiles together with all its callees, generates machine code, and wraps it for calls from
Python. For a function that is always inlined, this work is wasted. Here such a function stays intermediate code, and only the
function called from Python is optimised, once and as a whole. The machine code is the same to the bit and takes half the time
to compile.
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


def take_scipy_for_granted() -> None:
    """Let numba load its functions without a look whether scipy is there, which this package needs anyway.

    That look imports scipy's linear algebra and takes more time than all else in loading a kernel. What calls BLAS looks again.
    """
    # Numba too loads them with the first function that it compiles or loads, not before.
    linalg: Any = import_module("numba.np.linalg")
    ensure_blas = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = ensure_blas


@contextmanager
def swiftly() -> Iterator[None]:
    """Spare numba a quarter of its work while it compiles a function and its callees; what it makes is the same.

    The caller holds numba's lock.
    """
    collecting = gc.isenabled()
    # Hundreds of thousands of new objects stay, and would be looked through again and again.
    gc.disable()
    try:
        with _signatures_remembered():
            yield
    finally:
        if collecting:
            gc.enable()


@contextmanager
def _signatures_remembered() -> Iterator[None]:
    """Let numba find only once what an operator or another function of its own returns for arguments of given types.

    It tries each of its dozens of implementations at each call in the code. An implementation in Python is compiled with the
    options of its caller and is asked for each time; what the others return depends on the types alone.
    """
    functions: Any = types.Function
    if "get_call_type" in vars(functions):
        # It compiles a function for another one that is being compiled.
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
    """A function and its callees as intermediate code, neither optimised nor translated to machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Inliner(Compiler):
    """Numba's compiler, stopped at intermediate code."""

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        target = self.state.targetctx
        # Numba looks up the code to inline by its executable function; there is none, so any object will do.
        target.get_executable = lambda library, description, environment: object()
        self.state.library = _IntermediateCode(target.codegen(), func.__qualname__)
        return super().compile_extra(func)


class Inlined(CPUDispatcher):
    """A function for compiled callers.

    It can be called from Python too, for tests and debugging; this compiles a function that calls it, where no other is given
    for Python.
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
            python: takes its place in calls from Python.
        """
        self._python = python
        options = {"nopython": True, "forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(py_func, locals or {}, options | (targetoptions or {}), pipeline_class)

    def add_overload(self, cres: Any) -> None:
        """Store a compiled signature; the base class would also make it callable from Python."""
        self.overloads[tuple(cres.signature.args)] = cres

    def __call__(self, *args: Any) -> Any:
        """Call it from Python."""
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
