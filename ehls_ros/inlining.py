"""Compilation of functions that are always inlined.

Numba optimises each compiled function together with all its callees, and generates machine code and a wrapper for Python. For
a function that is always inlined, this work is wasted. Here such a function remains intermediate code. Only the function called
from Python is optimised, once and as a whole. The machine code is bit-identical and compiles in half the time.

This overrides private parts of numba (:mod:`ehls_ros.numba_internals`). Plain numba is slower, with the same numbers. It is
used if these parts are missing or changed, in an untested version, or with the environment variable :data:`PLAIN`.
"""

import contextlib
import inspect
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from importlib import import_module
from typing import Any

import numba

PLAIN = "EHLS_PLAIN_NUMBA"
"""Environment variable that selects plain numba, if not empty."""

OLDEST, UNTESTED = (0, 59), (0, 69)
"""First version of numba with these internals, and first one not tested."""

TESTED = f">={'.'.join(map(str, OLDEST))},<{'.'.join(map(str, UNTESTED))}"
"""Range of tested versions, in the notation of `pyproject.toml`."""

COMPILER = (
    ("numba.core.types", "Function.get_call_type", "self context args kws"),
    ("numba.core.types", "Function.get_impl_key", "self sig"),
    ("numba.core.codegen", "CPUCodeLibrary._optimize_final_module", "self"),
    ("numba.core.codegen", "CPUCodeLibrary._finalize_final_module", "self"),
    ("numba.core.codegen", "CPUCodeLibrary._finalize_dynamic_globals", "self"),
    ("numba.core.compiler", "Compiler.compile_extra", "self func"),
    ("numba.core.cpu", "CPUContext.get_executable", "self library fndesc env"),
    ("numba.core.registry", "CPUDispatcher.__init__", "self py_func locals targetoptions pipeline_class"),
    ("numba.core.registry", "CPUDispatcher.add_overload", "self cres"),
)
"""Module, name and parameters of each overridden or called part of the compiler."""

SCIPY_CHECK = ("numba.np.linalg", "ensure_blas", "")
"""The same for the check for scipy. Its module takes 30 ms to import and is loaded with the first kernel."""

INTERNALS = (*COMPILER, SCIPY_CHECK)


def incompatibilities(parts: Sequence[tuple[str, str, str]] = INTERNALS) -> list[str]:
    """Return the incompatibilities of the installed numba: an untested version, and missing or changed names."""
    version = tuple(int(part) for part in numba.__version__.split(".")[:2])
    found = [] if OLDEST <= version < UNTESTED else [f"version {numba.__version__} is not tested"]
    for module, name, parameters in parts:
        try:
            part: Any = import_module(module)
            for step in name.split("."):
                part = getattr(part, step)
            known = " ".join(inspect.signature(part).parameters) == parameters
        except (ImportError, AttributeError, TypeError, ValueError):
            known = False
        if not known:
            found.append(f"{module}.{name} is missing or changed")
    return found


def reason_for_plain_numba() -> str:
    """Return the reason for the use of plain numba; empty if it is not used."""
    return f"{PLAIN} is set" if os.environ.get(PLAIN) else "; ".join(_INCOMPATIBILITIES)


_INCOMPATIBILITIES = incompatibilities(COMPILER)
_internals: Any = None if reason_for_plain_numba() else import_module("ehls_ros.numba_internals")

IS_PLAIN = _internals is None
"""Whether plain numba is used."""


def inlined(
    function: Callable[..., Any], *, counts_references: bool = True, python: Callable[..., Any] | None = None
) -> Callable[..., Any]:
    """Compile a function as a part of its compiled callers.

    Args:
        function: the function.
        counts_references: whether references to arrays are counted; if not, the function must not allocate any.
        python: replacement for calls from Python.
    """
    if IS_PLAIN:
        compiled: Callable[..., Any] = numba.njit(error_model="numpy")(function)
        return compiled
    options = {"error_model": "numpy"} | ({} if counts_references else {"_nrt": False})
    made: Callable[..., Any] = _internals.Inlined(function, targetoptions=options, python=python)
    return made


def faster_compilation() -> AbstractContextManager[None]:
    """Return a context that reduces numba's compile time by a quarter.

    The caller holds numba's lock. The compiled code is the same.
    """
    context: AbstractContextManager[None] = contextlib.nullcontext() if IS_PLAIN else _internals.faster_compilation()
    return context


def skip_scipy_check() -> None:
    """Skip numba's check for scipy when it loads its functions; this package requires scipy anyway."""
    if not IS_PLAIN and not incompatibilities([SCIPY_CHECK]):
        _internals.skip_scipy_check()
