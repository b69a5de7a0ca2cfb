"""Compiled functions that exist only inside others.

Numba optimises every function it compiles, makes machine code of it and wraps it for calls from Python, each time with all
that it calls. For a function that is inlined wherever it is called, all of that is thrown away. Here such a function stays
intermediate code, and the function that is called from Python is optimised once, as a whole: the same machine code to the
bit, in half the time.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

from numba import njit
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher


class _IntermediateCode(CPUCodeLibrary):
    """A function and what it calls, neither optimised nor made into machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Inliner(Compiler):
    """Numba's compiler, to intermediate code."""

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        target = self.state.targetctx
        # Numba finds the code to inline by the function made of it; where there is none, any object will do.
        target.get_executable = lambda library, description, environment: object()
        self.state.library = _IntermediateCode(target.codegen(), func.__qualname__)
        return super().compile_extra(func)


class Inlined(CPUDispatcher):
    """A function to call from compiled code.

    A call from Python works too, for tests and debugging: it compiles a function that calls this one.
    """

    def __init__(
        self,
        py_func: Callable[..., Any],
        locals: dict[str, Any] | None = None,  # noqa: A002 - numba's own name, for pickling
        targetoptions: dict[str, Any] | None = None,
        pipeline_class: type[Compiler] = _Inliner,
    ) -> None:
        """Take a Python function.

        Args:
            py_func: the function.
            locals: types of its local variables, where they cannot be inferred.
            targetoptions: options of :func:`numba.njit`.
            pipeline_class: numba's compiler.
        """
        options = {"nopython": True, "forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(py_func, locals or {}, options | (targetoptions or {}), pipeline_class)

    def add_overload(self, cres: Any) -> None:
        """Keep what was compiled; the base class would also have it called from Python."""
        self.overloads[tuple(cres.signature.args)] = cres

    def __call__(self, *args: Any) -> Any:
        """Call it from Python."""
        return self._from_python(*args)

    @cached_property
    def _from_python(self) -> Any:
        inlined = self

        @njit(error_model=self.targetoptions["error_model"])
        def call(*args: Any) -> Any:
            return inlined(*args)

        return call
